"""The command `pcc`."""

import numpy as np
import pytest

from controllers.planning.speed_reference import read_profile
from iits_mj.commands import pcc
from iits_mj.commands.pcc import Options, load_profile, measure
from iits_mj.core.errors import InputError


@pytest.fixture
def profile(tmp_path):
    station = np.arange(0, 6001, 10)
    height = 10.0 * np.sin(2.0 * np.pi * station / 2000.0)
    path = tmp_path / "road.csv"
    np.savetxt(path, np.column_stack([station, height]), "%.4f", ",", header="s_m,z_m", comments="")
    return path


def test_checks_hold_and_the_papers_four_panels_are_there(profile):
    results = measure(Options(road=profile))
    assert [c.name for c in results.checks if not c.ok and "time" not in c.name] == []
    (panels,) = results.figures.values()
    assert [p.title for p in panels] == ["Road", "Speed", "Engine power", "Accumulated fuel"]
    cruise, plan, elements = panels[3].lines
    assert plan.y[-1] < cruise.y[-1]
    assert {cruise.role, plan.role} == {"reference", "simulation"}
    assert elements.y[-1] == pytest.approx(plan.y[-1], rel=0.01)


def test_method_chooses_which_plan_is_written(profile, tmp_path):
    speeds = {}
    for method in ("distance", "hermite", "both"):
        out = tmp_path / f"{method}.csv"
        measure(Options(road=profile, method=method, profile=out))
        speeds[method] = np.loadtxt(out, delimiter=",", skiprows=1)[:, 2]
    assert speeds["both"] == pytest.approx(speeds["distance"])
    apart = np.abs(speeds["hermite"] - speeds["distance"])
    assert 0.0 < apart.max() < 2.0


def test_an_unknown_method_is_refused(profile):
    with pytest.raises(InputError, match="method"):
        Options(road=profile, method="euler")


def test_the_stack_reads_the_profile(profile, tmp_path):
    out = tmp_path / "speed.csv"
    measure(Options(road=profile, method="distance", profile=out))
    written = np.loadtxt(out, delimiter=",", skiprows=1)
    read = read_profile(out)
    assert read.station == pytest.approx(written[:, 0])
    assert read.speed == pytest.approx(written[:, 2])


def test_profile_with_gears_is_driven_in_them(profile, tmp_path):
    out = tmp_path / "speed.csv"
    measure(Options(road=profile, mass=40_000.0, method="distance", profile=out, gears=True))
    header, *rows = out.read_text().splitlines()
    assert header == "station_m,height_m,speed_mps,cruise_speed_mps,gear"
    gears = [int(row.rsplit(",", 1)[1]) for row in rows]
    assert {11, 12} & set(gears)
    read = read_profile(out)
    requests = [read.mode_at(station) for station in read.station[:-1]]
    assert [mode.gear for mode in requests] == gears[:-1]


@pytest.mark.parametrize("gear", ["-1", "19", "11.5"])
def test_profile_with_a_gear_that_no_truck_has_is_refused(tmp_path, gear):
    path = tmp_path / "speed.csv"
    path.write_text(f"station_m,speed_mps,gear\n0,20,12\n100,20,{gear}\n")
    with pytest.raises(InputError, match=f"gear {gear}: use 0 to 18"):
        read_profile(path)


def test_gears_need_a_profile_and_a_plan_over_distance(profile, tmp_path):
    with pytest.raises(InputError, match="--gears"):
        Options(road=profile, gears=True)
    with pytest.raises(InputError, match="--gears"):
        Options(road=profile, gears=True, method="hermite", profile=tmp_path / "speed.csv")


@pytest.mark.parametrize("gears", [False, True])
def test_driven_saving_is_that_of_the_truck_with_its_load(profile, gears):
    flags = {"method": "distance", "length": 2_000.0, "mass": 40_000.0, "driven": True}
    results = measure(Options(road=profile, gears=gears, **flags))
    found = {check.name: check for check in results.checks if check.name.startswith("driven")}
    saving, plan, base, time, changes = found.values()
    assert 0.5 < saving.value < 30.0
    assert saving.value == pytest.approx(100.0 * (1.0 - plan.value / base.value), abs=2.0)
    assert time.value == pytest.approx(1.0, abs=2e-3)
    assert changes.value <= changes.reference


def test_driven_plan_has_the_grid_of_the_plan(monkeypatch):
    steps = []

    def run_ahead(case):
        steps.append(case.road.step)
        raise InputError("not driven")

    monkeypatch.setattr(pcc, "run_ahead", run_ahead)
    with pytest.raises(InputError, match="not driven"):
        measure(Options(driven=True, method="distance", length=1_000.0, step=25.0))
    assert steps == [25.0]


def test_driven_route_keeps_its_limits():
    with pytest.raises(InputError, match="--no-limits"):
        Options(driven=True, limits=False)


def test_profile_file_holds_the_plan_with_units(profile, tmp_path):
    out = tmp_path / "speed.csv"
    measure(Options(road=profile, profile=out))
    header, *rows = out.read_text().splitlines()
    assert header == "station_m,height_m,speed_mps,cruise_speed_mps"
    assert len(rows) == 121


def test_the_built_in_highway_is_the_default_road_with_its_limits():
    road = load_profile(Options(length=5_000.0))
    assert road.intervals == 100
    assert np.isfinite(road.v_limit).all()
    assert 0.0 < np.abs(road.grade).max() < 0.07


def test_an_unwritable_profile_file_is_refused(profile, tmp_path):
    with pytest.raises(InputError, match="cannot be written"):
        measure(Options(road=profile, profile=tmp_path / "none" / "speed.csv"))


def test_a_band_without_the_set_speed_is_refused_in_the_flags_own_units(profile):
    with pytest.raises(InputError, match=r"band .*--v-ref 100 km/h, --v-max 90 km/h"):
        Options(road=profile, v_ref=100.0)


def test_start_cuts_a_table_like_a_map(profile):
    whole = load_profile(Options(road=profile))
    part = load_profile(Options(road=profile, start=1_000.0, length=2_000.0))
    assert part.station == pytest.approx(np.arange(1_000.0, 3_001.0, 50.0))
    assert part.height == pytest.approx(whole.height[20:61])


def test_a_table_whose_length_is_no_multiple_of_the_step_is_planned_to_the_last_whole_step(
    tmp_path,
):
    station = np.arange(0.0, 1_031.0, 10.0)
    path = tmp_path / "road.csv"
    np.savetxt(
        path,
        np.column_stack([station, 0.001 * station]),
        "%.4f",
        ",",
        header="s_m,z_m",
        comments="",
    )
    results = measure(Options(road=path, method="distance"))
    assert "1.00 km" in results.notes[0]
    assert [c.name for c in results.checks if "5 m" in c.name]


@pytest.mark.parametrize("start", [1e9, -50.0])
def test_a_start_off_the_road_is_named(profile, start):
    for road in (profile, None):
        with pytest.raises(InputError, match=r"start -?\S+ m is (not on|before)"):
            load_profile(Options(road=road, start=start))


def test_a_trip_in_unequal_time_falls_short_with_the_reason(profile):
    results = measure(Options(road=profile, v_min=71.5, mass=70_000.0, method="distance"))
    time = next(c for c in results.checks if c.name.startswith("trip time of the plan"))
    assert time.value < 0.999
    assert not time.ok
    assert any("equal time" in note for note in results.notes)


def test_huge_weights_of_acceleration_are_refused(profile):
    with pytest.raises(InputError, match="k-a"):
        Options(road=profile, k_a=1e9)


def test_no_limits_on_a_table_is_explained(profile):
    results = measure(Options(road=profile, limits=False, method="distance"))
    assert any("--no-limits changes nothing" in note for note in results.notes)
