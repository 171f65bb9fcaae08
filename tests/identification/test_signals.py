"""Grade from heights, gear changes, tables in overlays, and impossible replays."""

import numpy as np
import pytest

from iits_mj.core.errors import InputError
from iits_mj.identification import Log, Series, read_table
from iits_mj.identification.brakes import brake_events
from iits_mj.identification.log import with_slope
from iits_mj.identification.replay import graded_road, replay
from iits_mj.identification.shifts import identify_shifts
from iits_mj.parameters import TruckParameters

PARAMETERS = TruckParameters.load()


def test_slope_of_coarse_heights_is_the_grade():
    time = np.arange(0.0, 100.0, 0.1)
    station = 15.0 * time
    grade = 0.03 * np.sin(station / 200.0)
    height = 6.0 * (1.0 - np.cos(station / 200.0))
    coarse = np.round(height / 0.125) * 0.125
    found = with_slope(Log({"time": time, "station": station, "z": coarse}))
    inside = (station > 50.0) & (station < 1450.0)
    error = found.at("grade", time)[inside] - grade[inside]
    assert np.sqrt(np.mean(error**2)) < 1e-3
    assert abs(error.mean()) < 1e-4


def test_road_for_a_replay_has_the_grade_of_its_table():
    station = np.arange(0.0, 2000.0, 20.0)
    grade = 0.02 * np.sin(station / 150.0)
    road = graded_road(station, grade, 1900.0)
    place = np.arange(100.0, 1800.0, 5.0)
    error = road.smoothed_grade(place) - np.interp(place, station, grade)
    assert np.abs(error).max() < 1e-3


def _changes(step, length=0.7, count=8):
    time = np.arange(0.0, 10.0 * count, step)
    phase = time % 9.97
    return Log(
        {
            "time": time,
            "gear": np.full(len(time), 8.0),
            "shift_in_process": ((phase > 3.0) & (phase <= 3.0 + length)).astype(float),
        }
    )


def test_gear_changes_of_two_kinds_have_no_mean():
    short, long = _changes(0.02, length=0.5, count=4), _changes(0.02, length=1.0, count=4)
    time = short["time"]
    names = ("gear", "shift_in_process")
    both = {name: np.concatenate([short[name], long[name]]) for name in names}
    log = Log({"time": np.concatenate([time, time + time[-1] + 0.02]), **both})
    duration, _, synchronization = identify_shifts(log, PARAMETERS)
    assert not duration.identifiable
    assert "differ" in duration.reason
    assert np.isfinite(duration.value)
    assert not np.isnan(duration.half_width)
    assert not synchronization.identifiable


def test_duration_of_gear_changes_is_their_mean():
    duration, cut, synchronization = identify_shifts(_changes(0.02), PARAMETERS)
    assert duration.value == pytest.approx(0.7, abs=0.01)
    assert duration.half_width < 0.03
    assert not cut.identifiable
    gearbox = PARAMETERS.gearbox
    rest = duration.value - gearbox.shift_cut_time - gearbox.clutch_close_time
    assert synchronization.value == pytest.approx(rest)


def test_slow_or_short_logs_show_no_gear_change_times():
    for log, words in ((_changes(0.1), "100 ms"), (_changes(0.02, count=2), "are needed")):
        for estimate in identify_shifts(log, PARAMETERS):
            assert not estimate.identifiable
            assert words in estimate.reason


def test_only_steps_from_rest_that_hold_count_as_applications():
    time = np.arange(0.0, 20.0, 0.02)
    demand = np.zeros_like(time)
    demand[(time > 2.0) & (time < 4.0)] = -1.0
    demand[(time > 6.0) & (time < 6.4)] = -1.0
    demand[(time > 8.01) & (time < 8.19)] = -0.5
    demand[(time > 8.19) & (time < 11.0)] = -1.5
    demand[(time > 13.0) & (time < 16.0)] = -0.1
    log = Log({"command_xbr_demand": Series(time, demand)})
    assert [event.time for event in brake_events(log)] == pytest.approx([2.02])
    off = Log({**log.signals, "command_xbr_mode": Series(time, np.zeros_like(time))})
    assert brake_events(off) == []


def test_overlay_may_give_a_table_and_must_give_numbers():
    torque = [1.1 * value for value in PARAMETERS.engine.full_load_torque]
    loaded = TruckParameters.load(overlay={"engine": {"full_load_torque": torque}})
    assert isinstance(loaded.engine.full_load_torque, np.ndarray)
    assert loaded.engine.full_load_torque == pytest.approx(torque)
    for wrong in ("much", [1.0, float("nan")], [[1.0], [1.0, 2.0]], []):
        with pytest.raises(InputError, match="full_load_torque"):
            TruckParameters.load(overlay={"engine": {"full_load_torque": wrong}})


def test_drive_without_a_pedal_cannot_be_replayed():
    time = np.arange(0.0, 10.0, 0.1)
    log = Log({"time": time, "speed": np.full(100, 10.0), "grade": np.zeros(100)})
    with pytest.raises(InputError, match="lacks command_accelerator_pedal"):
        replay(log, PARAMETERS)


def test_a_column_with_an_unknown_unit_is_refused(tmp_path):
    path = tmp_path / "log.csv"
    rows = "\n".join(f"{0.1 * k:.1f},{36.0 + k}" for k in range(60))
    path.write_text(f"time [s],speed [mph]\n{rows}\n", encoding="utf-8")
    with pytest.raises(InputError, match="'speed' has the unit 'mph'; use m/s or km/h"):
        read_table(path)
    path.write_text(f"time [s],speed [km/h]\n{rows}\n", encoding="utf-8")
    assert read_table(path)["speed"][0] == pytest.approx(10.0)
