"""Recorded trajectories on the roads of other maps."""

import numpy as np
import pytest

from iits_mj.core.errors import InputError
from iits_mj.road import RoadMap, Route
from tests.paths import outside
from tests.traffic_bridge.datasets import synthetic_sets as sets
from traffic_bridge import Recording, RepSim
from traffic_bridge.datasets import (
    ImportConfig,
    Trajectories,
    import_trajectories,
    of_recording,
    read_trajectories,
    write_fcd,
)
from traffic_bridge.recording.rows import COLUMNS

THREE_LANES = 2900.0  # [m]: where the built-in highway has three lanes, in a bend and on a slope


def track(station, across, step=0.1, length=5.0, name="a", lanes=3, speed=None):
    """Trajectories of one vehicle; `across` in lanes from the middle of the right one."""
    time = np.arange(len(station)) * step
    lane = np.floor(np.asarray(across) + 0.5).astype(int)
    rate = np.gradient(station, step) if speed is None else speed
    return Trajectories(
        source="one vehicle",
        ids=(name,),
        kinds=("car",),
        length=[length],
        width=[1.8],
        time=time,
        vehicle=np.zeros(len(time)),
        lane=lane,
        station=station,
        offset=(across - lane) * 3.5,
        speed=np.maximum(rate, 0.0),
        acceleration=np.zeros(len(time)),
        leader=np.full(len(time), -1),
        lane_count=lanes,
    )


def columns(recording, name=None):
    """Columns by name in the order of time, of all vehicles or of one."""
    found = dict(zip(COLUMNS, np.asarray(recording.columns), strict=True))
    found["lane"] = np.asarray(recording.lane)
    found["frame"] = np.repeat(np.arange(len(recording.time)), np.diff(recording.start))
    if name is not None:
        rows = np.asarray(recording.vehicle) == recording.ids.index(name)
        found = {key: values[rows] for key, values in found.items()}
    return found


@pytest.fixture(scope="module")
def flow(tmp_path_factory):
    folder = tmp_path_factory.mktemp("import_trajectories")
    return read_trajectories(sets.write_ngsim(folder / "set.csv"))


@pytest.fixture(scope="module")
def imported(flow, highway):
    return import_trajectories(flow, highway, ImportConfig(start_station=THREE_LANES))


def test_stations_are_those_of_the_data_set_plus_a_constant(flow, imported):
    for name in imported.ids:
        rows = flow.rows(name)
        length = flow.length[flow.index_of(name)]
        front = columns(imported, name)["station"] + 0.5 * length - THREE_LANES
        assert np.abs(front - flow.station[rows]).max() < 0.005
    assert imported.time[-1] == pytest.approx(sets.SECONDS)


def test_imported_vehicles_lie_on_the_road_surface_with_its_slopes(imported, highway):
    at = columns(imported)
    point = highway.evaluate(at["station"], at["offset"])
    assert np.abs(at["x"] - point.x).max() < 1e-9
    assert np.abs(at["z"] - point.z).max() < 1e-9
    # Slopes from the surface itself, 2 m ahead and beside in the vehicle's own directions.
    for k in range(0, len(at["x"]), 97):
        turned = at["yaw"][k] - point.heading[k]
        step = 1.0

        def rise(angle, k=k, step=step):
            ds, do = step * np.cos(angle), step * np.sin(angle)
            s, o = at["station"][k], at["offset"][k]
            return float(
                highway.evaluate(s + ds, o + do).z - highway.evaluate(s - ds, o - do).z
            ) / (2 * step)

        assert at["pitch"][k] == pytest.approx(-np.arctan(rise(turned)), abs=2e-3)
        assert at["roll"][k] == pytest.approx(np.arctan(rise(turned + np.pi / 2)), abs=2e-3)


def test_speed_heading_and_yaw_rate_are_those_of_the_positions(imported):
    for name in imported.ids:
        at = columns(imported, name)
        x, y = np.diff(at["x"]), np.diff(at["y"])
        way = 0.05 * (at["speed"][1:] + at["speed"][:-1])
        assert np.abs(np.hypot(x, y) - way).max() < 2e-3
        yaw = np.unwrap(at["yaw"])
        course = np.unwrap(np.arctan2(y, x))
        middle = 0.5 * (yaw[1:] + yaw[:-1])
        assert np.abs(np.angle(np.exp(1j * (course - middle)))).max() < 2e-3
        turn = 0.05 * (at["yaw_rate"][1:] + at["yaw_rate"][:-1])
        assert np.abs(np.diff(yaw) - turn).max() < 2e-3
        gain = 0.05 * (at["acceleration"][1:] + at["acceleration"][:-1])
        assert np.abs(np.diff(at["speed"]) - gain).max() < 0.01


def test_vehicles_that_keep_their_lane_stay_in_its_middle_where_it_tapers(highway):
    # 2 km on which the road widens from two lanes to three and narrows again.
    station = 2400.0 + 15.0 * np.arange(0, 1600) * 0.1
    recording = import_trajectories(track(station, np.ones(1600), lanes=2), highway)
    at = columns(recording, "a")
    middle = np.array([highway.lane_offset(1, s) for s in at["station"]])
    assert np.abs(at["offset"] - middle).max() < 0.01
    assert set(at["lane"].tolist()) == {1}


def test_an_instantaneous_lane_change_takes_3_5_s(straight):
    station = 50.0 + 20.0 * np.arange(300) * 0.1
    across = np.where(np.arange(300) < 150, 0.0, 1.0)
    at = columns(import_trajectories(track(station, across), straight), "a")
    moving = np.flatnonzero(np.abs(at["lateral_speed"]) > 0.02)
    assert (moving[-1] - moving[0]) * 0.1 == pytest.approx(3.5, abs=0.5)
    # The quintic's greatest speed is 15/8 of the mean, 4 m in 3.5 s.
    assert at["lateral_speed"].max() == pytest.approx(1.875 * 4.0 / 3.5, rel=0.01)
    assert np.abs(np.diff(at["offset"])).max() < 0.25
    jumped = columns(
        import_trajectories(
            track(station, across), straight, ImportConfig(lane_change_duration=0.0)
        ),
        "a",
    )
    assert np.abs(np.diff(jumped["offset"])).max() > np.abs(np.diff(at["offset"])).max()


def test_a_lane_change_recorded_in_full_keeps_its_time(flow, imported, highway):
    at = columns(imported, "12")
    low, high = (highway.lane_offset(i, at["station"]) for i in (1, 2))
    part = (high - at["offset"]) / (high - low)
    middle = imported.time[at["frame"][np.argmin(np.abs(part - 0.5))]]
    assert middle == pytest.approx(10.0, abs=0.1)
    assert np.abs(part[at["frame"] < 75]).max() < 0.02
    assert np.abs(part[at["frame"] > 125] - 1.0).max() < 0.02


def test_a_standing_vehicle_does_not_move_with_the_noise_of_its_positions(straight):
    rng = np.random.default_rng(1)
    time = np.arange(400) * 0.1
    smooth = np.interp(time, [0, 10, 20, 40], [100, 200, 250, 250])
    noisy = smooth + rng.normal(0.0, 0.02, 400)
    at = columns(import_trajectories(track(noisy, rng.normal(0.0, 0.01, 400)), straight), "a")
    still = at["frame"] > 230
    assert np.diff(at["station"]).min() >= 0.0
    assert at["speed"][still].max() < 0.2
    assert np.ptp(at["yaw"][still]) < 0.01


def test_vehicles_are_present_only_with_their_whole_length_on_the_route(flow):
    short = Route.straight(length=250.0)
    recording = import_trajectories(flow, short)
    at = columns(recording)
    lengths = np.asarray(recording.sizes)[np.asarray(recording.vehicle), 0]
    assert (at["station"] + 0.5 * lengths).max() <= 250.0 + 1e-9
    assert (at["station"] - 0.5 * lengths).min() >= -1e-9
    assert len(recording.frames[0]) == 4
    assert len(recording.frames[-1]) < 4


def test_a_lane_that_the_map_does_not_have_is_named_with_its_station(flow, highway):
    with pytest.raises(InputError, match=r"lane 2 becomes lane 2.*at station \d+ m \(2 lanes"):
        import_trajectories(flow, highway)
    recording = import_trajectories(flow, highway, ImportConfig(lane_map={0: 0, 1: 1}))
    assert set(recording.ids) == {"7", "8", "9", "12"}
    # Vehicle 12 appears when it enters lane 1.
    assert columns(recording, "12")["frame"].min() == pytest.approx(100, abs=2)
    moved = import_trajectories(
        flow, highway, ImportConfig(start_station=THREE_LANES, lane_map={0: 1, 1: 2})
    )
    assert set(columns(moved)["lane"].tolist()) == {1, 2}


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"lane_map": {5: 0}}, "lane_map"),
        ({"lane_map": {0: 0, 1: 0}}, "its own target lane"),
        ({"lane_map": {}}, "its own target lane"),
        ({"start_station": float("nan")}, "start_station = nan"),
        ({"start_station": 5000.0}, "no vehicle is on the route"),
        ({"step": 0.0}, "step = 0"),
        ({"smoothing": -1.0}, "smoothing = -1"),
    ],
)
def test_unusable_settings_are_refused(flow, straight, settings, words):
    with pytest.raises(InputError, match=words):
        import_trajectories(flow, straight, ImportConfig(**settings))


def test_repsim_replays_the_file_of_an_imported_recording(imported, highway, tmp_path):
    path = imported.save(tmp_path / "imported")
    assert Recording.load(path).meta["mode"] == "DataSet"
    with RepSim(highway, path) as replay:
        assert replay.reset() == imported.frames[0]
        assert replay.step() == imported.frames[1]
        between = replay.at(0.05)
        assert {v.id for v in between} == {"7", "8", "9", "12"}


def test_other_frame_rates_give_the_same_motion(flow, imported, highway):
    fine = import_trajectories(flow, highway, ImportConfig(start_station=THREE_LANES, step=0.04))
    a, b = columns(imported, "8"), columns(fine, "8")
    assert len(b["x"]) == 501
    assert np.abs(b["x"][::5] - a["x"][::2]).max() < 1e-6
    assert np.abs(b["speed"][::5] - a["speed"][::2]).max() < 1e-6


def test_an_imported_recording_reads_back_as_its_trajectories(flow, imported, highway):
    found = of_recording(imported, route=highway)
    assert len(found) == len(flow)
    order = [found.index_of(name) for name in flow.ids]
    for i, name in zip(order, flow.ids, strict=True):
        apart = found.station[found.rows(i)] - THREE_LANES - flow.station[flow.rows(name)]
        assert np.abs(apart).max() < 0.01
    assert np.abs(found.offset[found.lane == 0]).max() < 0.01
    again = import_trajectories(found, highway)
    shift = np.abs(np.asarray(again.columns) - np.asarray(imported.columns)).max(axis=1)
    assert shift[[COLUMNS.index(name) for name in "xyz"]].max() < 0.1
    with pytest.raises(InputError, match="not on"):
        of_recording(imported, route=Route.straight(length=100.0))


def test_floating_car_data_of_a_recording_read_back_and_in_sumos_own_reader(imported, tmp_path):
    import sumolib.xml

    path = write_fcd(imported, tmp_path / "out.xml.gz")
    found = read_trajectories(path)
    at = columns(imported, "9")
    rows = found.rows("9")
    length = imported.sizes[imported.ids.index("9"), 0]
    assert np.abs(found.station[rows] - at["station"] - 0.5 * length).max() < 1e-3
    assert np.abs(found.speed[rows] - at["speed"]).max() < 1e-4
    assert np.array_equal(found.lane[rows], at["lane"])
    steps = list(sumolib.xml.parse(str(path), "timestep"))
    assert len(steps) == len(imported.time)
    first = {v.id: v for v in steps[0].vehicle}["9"]
    # SUMO's position is the front bumper's middle, its angle clockwise from north.
    yaw = np.radians(90.0 - float(first.angle))
    assert float(first.x) == pytest.approx(at["x"][0] + 0.5 * length * np.cos(yaw), abs=0.02)
    assert float(first.y) == pytest.approx(at["y"][0] + 0.5 * length * np.sin(yaw), abs=0.02)


@pytest.mark.parametrize("name", ["esmini_curves_elevation", "esmini_crest-curve", "esmini_e6mini"])
def test_imported_traffic_moves_without_jumps_on_esmini_maps(name):
    route = RoadMap.from_opendrive(outside(f"xodr/{name}.xodr")).route()
    station = 20.0 + 15.0 * np.arange(0, round(max(route.length - 40.0, 50.0) / 1.5)) * 0.1
    one = track(station, np.zeros(len(station)), lanes=1)
    at = columns(import_trajectories(one, route), "a")
    assert len(at["x"]) > 20
    way = np.hypot(np.diff(at["x"]), np.diff(at["y"]))
    assert np.abs(way - 0.05 * (at["speed"][1:] + at["speed"][:-1])).max() < 0.02
    assert np.abs(np.diff(at["z"])).max() < 0.3
    assert np.abs(np.angle(np.exp(1j * np.diff(at["yaw"])))).max() < 0.1
