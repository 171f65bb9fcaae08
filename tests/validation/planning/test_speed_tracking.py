"""Speed tracking on hills, and the measures and records of a drive."""

import numpy as np
import pytest

from iits_mj.core.errors import InputError
from iits_mj.core.timing import CONTROL_PERIOD
from iits_mj.road import Route
from iits_mj.validation.harness.config import ValidateConfig
from iits_mj.validation.planning import speed_tracking
from iits_mj.validation.planning.closed_loop import COLUMNS, DriveTask, Record
from iits_mj.validation.planning.closed_loop import drive as drive_task
from iits_mj.validation.planning.speed_tracking import run_speed_tracking


def record(seconds, **columns):
    """A drive at 20 m/s in gear 12; columns are functions of time [s]."""
    time = np.arange(0.0, seconds, CONTROL_PERIOD)
    table = np.zeros((time.size, len(COLUMNS)))
    given = {"time": lambda t: t, "station": lambda t: 20.0 * t, "gear": lambda t: 12.0 + 0.0 * t}
    for name, function in {**given, **columns}.items():
        table[:, COLUMNS.index(name)] = function(time)
    return Record(table)


def test_coasting_between_two_uses_of_the_pedal_is_no_reversal():
    drive = record(30.0, pedal=lambda t: np.where((t > 10.0) & (t < 20.0), 0.0, 0.5))
    assert speed_tracking.reversals(drive).size == 0
    assert speed_tracking.shortest_turn(drive) == pytest.approx(30.0, abs=0.05)


def test_pedal_brake_pedal_are_two_reversals_with_every_brake():
    for brake in ("engine_brake", "retarder", "xbr_demand"):
        sign = -1.0 if brake == "xbr_demand" else 1.0
        drive = record(
            50.0,
            pedal=lambda t: np.where((t > 10.0) & (t < 20.0), 0.0, 0.5),
            **{brake: lambda t, sign=sign: np.where((t > 12.0) & (t < 18.0), 0.5 * sign, 0.0)},
        )
        assert speed_tracking.reversals(drive) == pytest.approx([12.0, 20.0], abs=0.05)
        assert speed_tracking.reversals_per_km(drive) == pytest.approx(2.0, rel=0.01)
        assert speed_tracking.shortest_turn(drive) == pytest.approx(8.0, abs=0.05)


def test_neutral_in_a_gear_change_is_not_counted_as_a_gear():
    drive = record(20.0, gear=lambda t: np.where(t < 8.0, 11.0, np.where(t < 9.0, 0.0, 12.0)))
    assert speed_tracking.gear_changes(drive) == 1


def test_error_excludes_full_pedal_and_the_time_just_after_it():
    drive = record(
        30.0,
        pedal=lambda t: np.where((t > 10.0) & (t < 20.0), 1.0, 0.4),
        speed=lambda t: np.where((t > 10.0) & (t < 21.0), 19.5, 20.0),
        planned=lambda t: 20.0 + 0.0 * t,
    )
    assert np.abs(speed_tracking.tracking_error(drive)).max() == 0.0
    assert speed_tracking.full_load_share(drive) == pytest.approx(1.0 / 3.0, abs=0.01)
    assert np.count_nonzero(speed_tracking.within_power(drive)) * CONTROL_PERIOD == pytest.approx(
        17.0, abs=0.1
    )


def test_record_is_read_back_unchanged(tmp_path):
    drive = record(5.0, speed=lambda t: 20.0 + t)
    drive.save(tmp_path / "drive.npz")
    assert np.array_equal(Record.load(tmp_path / "drive.npz").table, drive.table)
    assert [path.name for path in tmp_path.iterdir()] == ["drive.npz"]


def test_a_file_that_is_no_record_is_refused_by_name(tmp_path):
    file = tmp_path / "other.npz"
    np.savez(file, columns=np.array(["time"]), table=np.zeros((3, 1)))
    with pytest.raises(InputError, match=r"other\.npz"):
        Record.load(file)
    file.write_bytes(b"no archive")
    with pytest.raises(InputError, match=r"other\.npz"):
        Record.load(file)


@pytest.mark.parametrize("kept", [0, 1, 60, 500])
def test_a_record_that_was_cut_short_is_refused_by_name(tmp_path, kept):
    file = tmp_path / "cut.npz"
    record(5.0).save(file)
    file.write_bytes(file.read_bytes()[:kept])
    with pytest.raises(InputError, match=r"cut\.npz"):
        Record.load(file)


@pytest.mark.parametrize(
    "table", [np.zeros(5), np.zeros((5, 3)), np.full((5, len(COLUMNS)), np.nan)]
)
def test_a_record_of_another_shape_or_without_numbers_is_refused(tmp_path, table):
    file = tmp_path / "other.npz"
    np.savez(file, columns=np.array(COLUMNS), table=table)
    with pytest.raises(InputError, match="remove it to drive again"):
        Record.load(file)


def test_the_empty_truck_keeps_its_speed_on_a_hill():
    results = run_speed_tracking(ValidateConfig(quick=True))
    assert results.ok, results.to_table()
    assert len(results.checks) >= 3


def test_truck_stands_braked_before_its_start_on_a_hill():
    route = Route.straight(length=400.0, grade=0.05)
    driven = drive_task(
        DriveTask(route, 100.0, 100.5, 0.0, 5.0, payload=0.0, timestep=0.005, time_limit=30.0)
    )
    assert driven["station"].min() > driven["station"][0] - 0.01
    assert driven["time"][0] == pytest.approx(2.0)
    assert np.all(driven["station"] < 100.5)


@pytest.mark.slow
def test_speed_is_tracked_from_0_to_90_km_h_laden_and_empty():
    results = run_speed_tracking(ValidateConfig())
    assert results.ok, results.to_table()
