"""Reports of the powertrain about gears and torque in a launch with gear changes."""

import mujoco
import numpy as np
import pytest

from tests.plugin.vehicle_sled import PARAMETERS, Sled

NAMES = (
    "gear",
    "gear_engaged",
    "shift_in_process",
    "engine_speed",
    "input_shaft_speed",
    "propeller_shaft_speed",
    "engine_torque_mode",
    "engine_torque_percent",
    "engine_torque_percent_driver",
    "engine_load_percent",
)
# Those that the truck has as one sensor only.
REPORT = (
    "gear_engaged",
    "input_shaft_speed",
    "engine_torque_mode",
    "engine_torque_percent_driver",
    "engine_load_percent",
)
SENSORS = tuple((name, "powertrain") for name in REPORT)
NO_REQUEST, ACCELERATOR, TRANSMISSION = 0, 1, 6


@pytest.fixture(scope="module")
def launch():
    """12 s with 60 % pedal from standstill, 19 t: columns by name."""
    rows = Sled(19_000.0, sensors=SENSORS).record(12.0, *NAMES, accelerator_pedal=0.6)
    return dict(zip(NAMES, rows.T, strict=True))


def test_current_gear_is_the_last_engaged_one_until_the_next_one_engages(launch):
    target, engaged = launch["gear"], launch["gear_engaged"]
    changing = launch["shift_in_process"] > 0
    assert np.all(engaged[~changing] == target[~changing])
    # First the gear before, then, while the clutch closes, the new one; never neutral.
    assert set(np.unique(target[changing] - engaged[changing])) == {0.0, 1.0}
    assert engaged.min() == 2


def test_input_shaft_turns_with_the_propeller_shaft_by_the_ratio_of_the_gear_that_is_in(launch):
    closed = launch["shift_in_process"] == 0
    ratio = PARAMETERS.gearbox.ratios[launch["gear_engaged"].astype(int) - 1]
    geared = ratio * launch["propeller_shaft_speed"]
    assert launch["input_shaft_speed"][closed] == pytest.approx(geared[closed], rel=1e-9, abs=1e-9)


def test_input_shaft_turns_with_the_engine_while_no_gear_is_in(launch):
    between = (launch["gear_engaged"] != launch["gear"]) & (launch["engine_torque_percent"] < 3.0)
    same = launch["input_shaft_speed"] == launch["engine_speed"]
    assert np.count_nonzero(between & same) > 100


def test_gearbox_controls_the_torque_only_in_a_change(launch):
    changing = launch["shift_in_process"] > 0
    assert set(launch["engine_torque_mode"][changing]) == {TRANSMISSION}
    assert set(launch["engine_torque_mode"][~changing]) == {ACCELERATOR}


def test_torque_never_exceeds_what_the_driver_asks_for_outside_changes(launch):
    driving = (launch["shift_in_process"] == 0) & (launch["engine_speed"] > 80.0)
    excess = launch["engine_torque_percent"] - launch["engine_torque_percent_driver"]
    # The indicated torque falls no faster than the engine's rate when the driver's share falls.
    assert np.median(excess[driving]) < 0
    assert excess[driving].max() < 5.0


def test_floored_pedal_of_a_laden_truck_ends_at_what_the_driver_asks_for_near_full_load():
    names = ("engine_torque_percent", "engine_torque_percent_driver", "engine_load_percent")
    torque, driver, load = (
        Sled(55_000.0, speed=15.0, sensors=SENSORS).record(8.0, *names, accelerator_pedal=1.0).T
    )
    assert load.min() >= 0.0
    # The pedal map ends a little below the full-load curve.
    assert 90.0 < load.max() <= 100.0
    assert torque[-1] == pytest.approx(driver[-1], rel=2e-3)


def test_no_torque_is_requested_with_the_pedal_up():
    rows = Sled(19_000.0, sensors=SENSORS).record(
        1.0, "engine_torque_mode", "engine_torque_percent_driver"
    )
    assert np.all(rows == NO_REQUEST)


def test_the_report_contains_the_values_of_five_sensors():
    sled = Sled(19_000.0, sensors=SENSORS)
    sled.run(3.0, accelerator_pedal=0.6)
    assert sled.wheels("powertrain_report") == pytest.approx([sled[name] for name in REPORT])


def test_wheel_speeds_are_those_of_the_joints():
    sled = Sled(19_000.0, speed=10.0)
    sled.run(1.0, xbr_demand=-2.0, xbr_mode=2)
    mujoco.mj_forward(sled.model, sled.data)
    spins = [
        sled.data.joint(f"{axle.name}_{side}_spin").qvel[0]
        for axle in PARAMETERS.axles
        for side in ("left", "right")
    ]
    assert sled.wheels("wheel_speeds") == pytest.approx(spins, rel=1e-12)
    assert min(spins) > 10.0
