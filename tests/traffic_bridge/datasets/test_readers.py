"""Every reader gives the motion that was written, in SI units."""

import gzip
import re
import subprocess

import numpy as np
import pytest

from iits_mj.core.errors import InputError
from tests.paths import outside
from tests.traffic_bridge.datasets import synthetic_sets as sets
from traffic_bridge import find_netconvert
from traffic_bridge.datasets import pairs, read_trajectories, without_noise

PAIRS = "trajectories/ngsim_i80_1600_1615_reconstructed_pairs.parquet"
TRUTH = {(row["name"], round(row["time"], 2)): row for row in sets.tracks()}
FINE = {(row["name"], round(row["time"], 2)): row for row in sets.tracks(step=0.04)}


def compare(found, truth=TRUTH, shift=0.0, tolerance=1e-3, names=None, across=True):
    """Compares trajectories with the rows from which they were written."""
    first = found.time.min()
    seen = set()
    for k in range(len(found)):
        name = int(found.ids[found.vehicle[k]])
        row = truth[name, round(float(found.time[k] - first), 2)]
        assert found.station[k] + shift == pytest.approx(row["station"], abs=tolerance)
        assert found.speed[k] == pytest.approx(row["speed"], abs=tolerance)
        assert found.acceleration[k] == pytest.approx(row["acceleration"], abs=tolerance)
        if across:
            # On the line between two lanes either one may be the vehicle's.
            place = found.lane[k] + found.offset[k] / found.lane_width
            meant = row["lane"] + row["offset"] / sets.LANE_WIDTH
            assert place == pytest.approx(meant, abs=tolerance)
        leader = found.ids[found.leader[k]] if found.leader[k] >= 0 else "0"
        assert int(leader) == row["leader"]
        seen.add((name, round(float(found.time[k] - first), 2)))
    wanted = {key for key in truth if names is None or key[0] in names}
    assert seen == wanted


@pytest.mark.parametrize("header", [sets.NGSIM_HEADER, sets.DICTIONARY_HEADER])
def test_ngsim_in_feet_and_frames_becomes_meters_and_seconds(tmp_path, header):
    found = read_trajectories(sets.write_ngsim(tmp_path / "table.csv", header))
    compare(found)
    kinds = dict(zip(found.ids, found.kinds, strict=True))
    assert kinds == {"7": "car", "8": "car", "9": "articulated", "12": "truck"}
    assert found.lane_count == 3
    assert found.step == pytest.approx(0.1)


def test_ngsim_text_without_a_header_reads_as_the_table_does(tmp_path):
    path = tmp_path / "trajectories-0400-0415.txt"
    path.write_text("\n".join("  ".join(map(str, row)) for row in sets.ngsim_rows()))
    compare(read_trajectories(path))


def test_ngsim_table_may_be_compressed_and_group_its_digits(tmp_path):
    plain = sets.write_ngsim(tmp_path / "plain.csv")
    rows = list(sets.ngsim_rows())
    for row in rows:
        row[3] = f"{row[3]:,}"
    grouped = sets.write_ngsim(tmp_path / "grouped.csv", rows=rows)
    packed = tmp_path / "packed.csv.gz"
    packed.write_bytes(gzip.compress(grouped.read_bytes()))
    a, b = read_trajectories(plain), read_trajectories(packed)
    assert np.array_equal(a.station, b.station)
    assert np.array_equal(a.time, b.time)


def test_a_name_that_returns_minutes_later_is_another_vehicle(tmp_path):
    rows = list(sets.ngsim_rows())
    later = [[*row[:3], row[3] + 900_000, *row[4:]] for row in rows if row[0] == 7]
    found = read_trajectories(sets.write_ngsim(tmp_path / "twice.csv", rows=rows + later))
    assert "7#2" in found.ids
    assert found.time[found.rows("7#2")].min() == pytest.approx(900.0)


def test_repeated_rows_count_once(tmp_path):
    rows = list(sets.ngsim_rows())
    found = read_trajectories(sets.write_ngsim(tmp_path / "twice.csv", rows=rows + rows[:50]))
    compare(found)
    assert any("50 rows" in note for note in found.notes)


def test_ramps_can_be_left_out_and_a_site_selected(tmp_path):
    rows = [[*row, "i-80" if row[0] == 7 else "us-101"] for row in sets.ngsim_rows()]
    path = sets.write_ngsim(tmp_path / "sites.csv", [*sets.NGSIM_HEADER, "Location"], rows)
    with pytest.raises(InputError, match=r"holds i-80, us-101"):
        read_trajectories(path)
    assert read_trajectories(path, location="i-80").ids == ("7",)
    found = read_trajectories(path, location="us-101", main_lanes=2)
    assert set(found.ids) == {"9", "12"}
    assert found.lane_count == 2


def test_leader_follower_pairs_contain_both_vehicles(tmp_path):
    found = read_trajectories(sets.write_pairs(tmp_path / "pairs.parquet"))
    compare(found, names={7, 8}, across=False)


@pytest.mark.parametrize("direction", [1, 2])
def test_highd_like_boxes_become_front_bumpers_in_either_direction(tmp_path, direction):
    found = read_trajectories(sets.write_highd(tmp_path / "set", direction))
    # Stations begin at the upstream end of the recorded stretch: the rear of the last vehicle.
    shift = min(row[5] - row[1] for row in sets.VEHICLES)
    compare(found, FINE, shift)
    assert found.lane_width == pytest.approx(3.75)
    assert dict(zip(found.ids, found.kinds, strict=True))["9"] == "articulated"


@pytest.fixture(scope="module")
def sumo_run(tmp_path_factory):
    """SUMO on a road of two edges that gets a third lane; files of its floating-car data."""
    folder = tmp_path_factory.mktemp("fcd")
    (folder / "n.nod.xml").write_text(
        '<nodes><node id="a" x="0" y="0"/><node id="b" x="300" y="0"/>'
        '<node id="c" x="600" y="0"/><node id="d" x="300" y="200"/></nodes>'
    )
    (folder / "n.edg.xml").write_text(
        '<edges><edge id="ab" from="a" to="b" numLanes="2" speed="20"/>'
        '<edge id="bc" from="b" to="c" numLanes="2" speed="20"/>'
        '<edge id="bd" from="b" to="d" numLanes="1" speed="20"/></edges>'
    )
    (folder / "n.rou.xml").write_text(
        '<routes><vType id="truck" length="9.5" maxSpeed="12"/><vType id="fast"/>'
        '<route id="on" edges="ab bc"/><route id="off" edges="ab bd"/>'
        '<flow id="c" type="fast" route="on" begin="0" end="40" period="3" departLane="random"/>'
        '<flow id="t" type="truck" route="on" begin="0" end="40" period="13"/>'
        '<flow id="x" type="fast" route="off" begin="0" end="40" period="15"/></routes>'
    )
    netconvert = find_netconvert()
    sumo = netconvert.with_name("sumo")
    _call(netconvert, "-n", "n.nod.xml", "-e", "n.edg.xml", "-o", "n.net.xml", folder=folder)
    for name in ("out.xml", "out.csv", "out.xml.gz"):
        _call(
            *(sumo, "-n", "n.net.xml", "-r", "n.rou.xml", "--step-length", "0.1", "--end", "60"),
            *("--no-step-log", "--fcd-output", name, "--fcd-output.acceleration"),
            folder=folder,
        )
    return folder


def _call(*words, folder):
    subprocess.run(words, cwd=folder, check=True, capture_output=True, timeout=60)


def test_floating_car_data_lie_on_one_road_through_the_junction(sumo_run):
    found = read_trajectories(sumo_run / "out.xml")
    assert any("beside the most driven chain" in note for note in found.notes)
    # On this straight road SUMO's x is the station of the front bumper.
    xs = {}
    time = None
    for line in (sumo_run / "out.xml").read_text().splitlines():
        words = dict(part.split("=", 1) for part in line.split() if "=" in part)
        if "<timestep" in line:
            time = round(float(words["time"].strip('">')), 1)
        elif "<vehicle" in line:
            xs[words["id"].strip('"'), time] = float(words["x"].strip('"'))
    apart = [
        abs(found.station[k] - xs[found.ids[found.vehicle[k]], round(float(found.time[k]), 1)])
        for k in range(len(found))
    ]
    assert len(apart) > 3000
    assert max(apart) < 0.1
    kinds = dict(zip(found.ids, found.kinds, strict=True))
    assert kinds["t.0"] == "truck"
    assert found.length[found.index_of("t.0")] == 9.5
    assert found.length[found.index_of("c.0")] == 5.0


@pytest.mark.parametrize("other", ["out.csv", "out.xml.gz"])
def test_floating_car_data_have_the_same_rows_in_every_format(sumo_run, other):
    a, b = read_trajectories(sumo_run / "out.xml"), read_trajectories(sumo_run / other)
    assert a.ids == b.ids
    for name in ("time", "lane", "station", "speed", "acceleration", "leader"):
        assert np.array_equal(getattr(a, name), getattr(b, name)), name


def test_sizes_of_unknown_types_can_be_given(sumo_run):
    found = read_trajectories(sumo_run / "out.xml", types={"fast": ("van", 6.1, 2.1)})
    assert found.kinds[found.index_of("c.0")] == "van"
    assert found.length[found.index_of("c.0")] == 6.1


def _broken(rows, line, column, value):
    rows = [list(row) for row in rows]
    rows[line - 2][sets.NGSIM_HEADER.index(column)] = value
    return rows


@pytest.mark.parametrize(
    ("column", "value", "words"),
    [
        ("v_Vel", "fast", r"line 5, column 'v_Vel': 'fast' is not a number"),
        ("v_Vel", "nan", r"line 5, column 'v_Vel': nan: must be a finite number"),
        ("v_Vel", "", r"line 5, column 'v_Vel': is missing"),
        ("v_Vel", "-3", r"line 5: speed of vehicle '7' is negative"),
        ("Lane_ID", "2.5", r"line 5, column 'Lane_ID': 2.5: must be a whole number"),
        ("Lane_ID", "99", r"line 5, column 'Lane_ID'.*must be 0 to 30"),
        ("v_Class", "4", r"line 5, column 'v_class': '4': must be 1, 2 or 3"),
        ("Frame_ID", "inf", r"line 5, column 'Frame_ID': inf"),
        ("v_Vel", "2000", r"line 5: speed of vehicle '7' is above 150 m/s"),
        ("Local_Y", "1e9", r"line 5: station of vehicle '7' is beyond"),
        ("v_Length", "0", r"line 5: length of vehicle '7' is not positive"),
        ("Global_Time", "1e15", r"line 5: time of vehicle '7' is beyond"),
    ],
)
def test_a_wrong_value_is_named_by_file_line_and_column(tmp_path, column, value, words):
    rows = _broken(sets.ngsim_rows(), 5, column, value)
    path = sets.write_ngsim(tmp_path / "broken.csv", rows=rows)
    with pytest.raises(InputError, match=words) as caught:
        read_trajectories(path)
    assert "broken.csv" in str(caught.value)


def test_a_vehicle_at_two_places_at_once_is_refused(tmp_path):
    rows = list(sets.ngsim_rows())
    twin = list(rows[3])
    twin[sets.NGSIM_HEADER.index("Local_Y")] += 10
    path = sets.write_ngsim(tmp_path / "twin.csv", rows=[*rows, twin])
    with pytest.raises(InputError, match=r"line 5 and line \d+: vehicle '7' is at two places"):
        read_trajectories(path)


def test_meters_read_as_feet_are_refused(tmp_path):
    path = sets.write_ngsim(tmp_path / "meters.csv", scale=1.0)
    with pytest.raises(InputError, match=r"is the file in m\?"):
        read_trajectories(path)
    compare(read_trajectories(path, units="m"))


@pytest.mark.parametrize(
    ("factor", "likely"),
    [
        (3.6, "a factor of 3.6, as of km/h"),
        (sets.FOOT, "a factor of 0.3048, as of m/s taken for ft/s"),
        (1 / sets.FOOT, "a factor of 1/0.3048"),
        (1.467, "no usual factor"),
        (0.0, "no usual factor"),
    ],
)
def test_speeds_that_contradict_the_positions_are_refused_with_the_factor(tmp_path, factor, likely):
    rows = list(sets.ngsim_rows())
    for row in rows:
        row[sets.NGSIM_HEADER.index("v_Vel")] *= factor
    path = sets.write_ngsim(tmp_path / "units.csv", rows=rows)
    with pytest.raises(InputError, match=r"units\.csv, column 'v_Vel': the median speed") as caught:
        read_trajectories(path)
    assert likely in str(caught.value)


@pytest.mark.parametrize("column", ["v_vel", "preceding_vel"])
def test_both_speeds_of_a_pair_are_compared_with_the_positions(tmp_path, column):
    import pyarrow.compute
    import pyarrow.parquet

    path = sets.write_pairs(tmp_path / "pairs.parquet")
    table = pyarrow.parquet.read_table(path)
    faster = pyarrow.compute.multiply(table[column], 3.6)
    place = table.column_names.index(column)
    pyarrow.parquet.write_table(table.set_column(place, column, faster), path)
    with pytest.raises(InputError, match=rf"pairs\.parquet, column '{column}'.* factor of 3\.6"):
        read_trajectories(path)


def test_km_per_hour_in_boxes_and_floating_car_data_are_refused(tmp_path, sumo_run):
    path = sets.write_highd(tmp_path / "set")
    head, *lines = path.read_text().splitlines()
    cells = [line.split(",") for line in lines]
    for cell in cells:
        cell[6] = str(3.6 * float(cell[6]))
    path.write_text("\n".join([head, *map(",".join, cells)]))
    with pytest.raises(InputError, match=r"column 'xVelocity'.* factor of 3\.6"):
        read_trajectories(path)
    text = (sumo_run / "out.xml").read_text()
    other = tmp_path / "kmh.xml"
    other.write_text(re.sub(r' speed="([^"]+)"', lambda m: f' speed="{3.6 * float(m[1])}"', text))
    with pytest.raises(InputError, match=r"column 'speed'.* factor of 3\.6"):
        read_trajectories(other)


def test_jitter_queues_and_few_rows_do_not_count_as_wrong_units(tmp_path):
    rng = np.random.default_rng(5)
    way, speed = (sets.NGSIM_HEADER.index(name) for name in ("Local_Y", "v_Vel"))
    rows = list(sets.ngsim_rows())
    for row in rows:
        row[way] += rng.normal(0.0, 1.5)  # feet, as raw NGSIM has it
    read_trajectories(sets.write_ngsim(tmp_path / "jitter.csv", rows=rows))
    for row in rows:
        row[way], row[speed] = 10.0 * row[0] + rng.normal(0.0, 0.5), 0.0
    read_trajectories(sets.write_ngsim(tmp_path / "queue.csv", rows=rows))
    few = [[*row[:speed], 99.0, *row[speed + 1 :]] for row in rows if row[1] < 103]
    read_trajectories(sets.write_ngsim(tmp_path / "few.csv", rows=few))


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("empty.csv", b""),
        ("blank.csv", b"\n\n"),
        ("words.csv", b"some words\nand more\n"),
        ("header.csv", ",".join(sets.NGSIM_HEADER).encode() + b"\n"),
        ("ragged.csv", ",".join(sets.NGSIM_HEADER).encode() + b"\n1,2,3\n"),
        ("binary.bin", bytes(range(256)) * 10),
        ("other.xml", b"<routes/>"),
        ("torn.xml", b"<fcd-export><timestep time='0'><vehicle id='a'"),
        ("no_vehicles.xml", b"<fcd-export><timestep time='0'/></fcd-export>"),
        ("lane.xml", b"<fcd-export><timestep time='0'><vehicle id='a' pos='1' speed='1' "
                     b"lane='x'/></timestep></fcd-export>"),
        ("index.xml", b"<fcd-export><timestep time='0'><vehicle id='a' pos='1' speed='1' "
                      b"lane='e_99999999999999999999'/></timestep></fcd-export>"),
        ("few.xml", b"<fcd-export><timestep time='0'><vehicle id='a'/></timestep></fcd-export>"),
        ("torn.parquet", b"PAR1 and nothing more"),
        ("torn.npz", b"PK\x03\x04 and nothing more"),
        ("torn.gz", b"\x1f\x8b and nothing more"),
        ("columns.csv", b"a,b\n1,2\n"),
        ("name.csv", b"id,\xcc\n1,2\n"),
        ("numbers.txt", b"1 2 3\n4 5 6\n"),
    ],
)  # fmt: skip
def test_a_file_that_is_not_a_data_set_gives_one_clear_error(tmp_path, name, content):
    path = tmp_path / name
    path.write_bytes(content)
    with pytest.raises(InputError, match=name) as caught:
        read_trajectories(path)
    assert "\n" not in str(caught.value).strip()


def test_a_vehicle_that_jumps_continues_as_another_vehicle(tmp_path):
    rows = list(sets.ngsim_rows())
    for row in rows:
        if row[0] == 9 and row[1] > 200:
            row[sets.NGSIM_HEADER.index("Local_Y")] += 500.0
    found = read_trajectories(sets.write_ngsim(tmp_path / "leap.csv", rows=rows))
    assert "9#2" in found.ids
    assert any("jump" in note for note in found.notes)


def test_the_wrong_line_of_a_text_table_is_named(tmp_path):
    lines = [" ".join(map(str, row)) for row in sets.ngsim_rows()]
    path = tmp_path / "text.txt"
    path.write_text("\n".join([*lines[:4], lines[4] + " 7", *lines[5:]]))
    with pytest.raises(InputError, match="line 5: 19 values, not 18"):
        read_trajectories(path)
    path.write_text("\n".join([*lines[:4], lines[4].replace("30.0", "x"), *lines[5:]]))
    with pytest.raises(InputError, match="line 5: 'x' is not a number"):
        read_trajectories(path)


def test_missing_values_of_a_parquet_file_are_named(tmp_path):
    import pyarrow.parquet

    path = sets.write_pairs(tmp_path / "pairs.parquet")
    table = pyarrow.parquet.read_table(path)
    speeds = [None, *table["v_vel"].to_pylist()[1:]]
    place = table.column_names.index("v_vel")
    pyarrow.parquet.write_table(table.set_column(place, "v_vel", [speeds]), path)
    with pytest.raises(InputError, match="row 1, column 'v_vel': is missing"):
        read_trajectories(path)


def test_missing_files_and_folders_are_named(tmp_path):
    with pytest.raises(InputError, match="nowhere"):
        read_trajectories(tmp_path / "nowhere.csv")
    with pytest.raises(InputError, match="cannot be read"):
        read_trajectories(tmp_path)
    path = sets.write_highd(tmp_path / "set")
    path.with_name("01_recordingMeta.csv").unlink()
    with pytest.raises(InputError, match=r"needs 01_recordingMeta\.csv beside it"):
        read_trajectories(path)


def test_an_option_that_the_format_does_not_have_is_refused(tmp_path):
    path = sets.write_highd(tmp_path / "set")
    with pytest.raises(InputError, match="no option units"):
        read_trajectories(path, units="m")
    with pytest.raises(InputError, match=r"direction 1: the recording has \[2\]"):
        read_trajectories(path, direction=1)


def test_noise_filter_keeps_steady_motion_and_smooths_jitter(tmp_path):
    rng = np.random.default_rng(3)
    rows = list(sets.ngsim_rows())
    steady = read_trajectories(sets.write_ngsim(tmp_path / "steady.csv"))
    still = np.abs(without_noise(steady).station - steady.station)
    # At constant speed nothing moves; at constant acceleration by half of it times the variance.
    assert still[steady.rows("9")].max() < 1e-3
    assert still.max() < 0.5 * 0.2 * 2.0 * 0.5**2
    column = sets.NGSIM_HEADER.index("Local_Y")
    for row in rows:
        row[column] += rng.normal(0.0, 0.5)
    noisy = read_trajectories(sets.write_ngsim(tmp_path / "noisy.csv", rows=rows))
    calm = without_noise(noisy)

    def error(found):
        return np.std(found.station - steady.station)

    assert error(calm) < 0.55 * error(noisy)
    raw = np.gradient(np.gradient(noisy.station[noisy.rows("9")], 0.1), 0.1)
    middle = slice(50, -50)  # the window narrows towards the ends
    assert np.std(raw[middle]) > 20.0 * np.std(calm.acceleration[calm.rows("9")][middle])


def test_reconstructed_pairs_have_the_counted_followers_and_speeds():
    found = read_trajectories(outside(PAIRS))
    assert len(found) == 110_905
    follow = pairs(found)
    assert len({pair.follower for pair in follow}) >= 142
    rows = sum(len(pair.time) for pair in follow)
    assert rows > 68_000
    mean = {
        lane: np.mean(np.concatenate([pair.speed for pair in follow if pair.lane == lane]))
        for lane in range(3)
    }
    # Lane 1 of the file, the left one, is the fast one.
    assert mean[2] == pytest.approx(13.2, abs=0.3)
    assert mean[1] == pytest.approx(7.6, abs=0.3)
    assert mean[0] == pytest.approx(8.2, abs=0.3)
    # A reader that mixed up rows would give speeds that contradict the positions.
    pair = follow[0]
    driven = np.trapezoid(pair.speed, pair.time)
    assert pair.station[-1] - pair.station[0] == pytest.approx(driven, rel=0.02)
