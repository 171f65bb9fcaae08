"""Drag-torque control and traction control of the driven wheels."""

import numpy as np
import pytest

import iits_mj
from iits_mj.core.errors import InputError
from iits_mj.core.units import KMH
from iits_mj.parameters import TruckParameters
from iits_mj.road import Route
from iits_mj.validation.handling import drive_slip
from iits_mj.validation.handling.braking_stability import FOLDED, STEADY

EMPTY, LADEN = 0.0, 36_000.0
STEP = 0.005
DRIVEN = slice(2, 6)
# SPN 899.
ACCELERATOR, ASR, ABS = 1.0, 5.0, 7.0


def rolling(friction, speed=60 * KMH, payload=EMPTY, **controls):
    route = Route.straight(2000.0).with_friction(*np.broadcast_to(friction, 2))
    truck = iits_mj.Truck.load(payload=payload, route=route, timestep=STEP, visuals=False)
    truck.reset(speed=speed)
    truck.command(**controls)
    return truck


def sample(truck, duration, read):
    rows = []
    for _ in range(round(duration / 0.02)):
        truck.step(round(0.02 / STEP))
        rows.append(read(truck))
    return np.array(rows)


def active(truck):
    return truck.data.sensor("slip_control_active").data.copy()


@pytest.mark.parametrize("levers", [drive_slip.BRAKING, drive_slip.PULLING])
@pytest.mark.parametrize("friction", [0.2, 0.1])
def test_empty_truck_stays_in_line_in_a_slippery_bend(friction, levers):
    run = drive_slip.in_bend(TruckParameters.load(), EMPTY, STEP, friction, levers)
    assert np.max(np.abs(run.articulation - run.articulation[0])) < STEADY


def test_without_drag_torque_control_the_retarder_folds_the_truck():
    uncontrolled = drive_slip.without_control(TruckParameters.load())
    run = drive_slip.in_bend(uncontrolled, EMPTY, STEP, 0.2, {"retarder": 1.0})
    assert np.max(np.abs(run.articulation)) > FOLDED


@pytest.mark.parametrize("controls", [{"retarder": 1.0, "engine_brake": 1.0}, {"brake_pedal": 0.4}])
def test_no_control_acts_on_a_dry_road(controls):
    assert not sample(rolling(0.8, **controls), 3.0, active).any()


@pytest.mark.parametrize("payload", [EMPTY, LADEN])
def test_traction_control_rests_in_a_start_on_a_dry_road(payload):
    truck = rolling(0.8, 0.0, payload, accelerator_pedal=1.0)
    assert not sample(truck, 6.0, active).any()


def test_engine_pulls_against_the_drag_of_slipping_wheels():
    def read(truck):
        report = truck.report()
        return (
            active(truck)[2],
            truck.data.sensor("engine_torque").data[0],
            truck.data.sensor("retarder_torque").data[0],
            report.engine_torque_mode == ABS,
        )

    acting, torque, retarder, mode = sample(rolling(0.1, retarder=1.0), 3.0, read).T
    assert acting.any()
    assert torque.max() > 0.0 > torque.min()
    assert retarder[-1] < 0.1 * retarder.max()
    assert mode.any()


def test_retarder_returns_slowly_and_goes_again_when_the_wheels_slip():
    def read(truck):
        return truck.observe().speed, truck.data.sensor("retarder_torque").data[0]

    truck = rolling(0.2, 70 * KMH, retarder=1.0)
    speed, torque = sample(truck, 14.0, read).T
    releases = np.flatnonzero((torque[1:] < 300.0) & (torque[:-1] >= 300.0))
    assert len(releases) >= 2
    assert np.diff(releases).min() * 0.02 > 3.0
    # Rolling resistance and air alone give 0.14 m/s2.
    assert (speed[0] - speed[-1]) / 14.0 > 0.25


def test_traction_control_reports_itself_and_keeps_the_wheels_below_a_walking_pace_of_slip():
    truck = rolling(0.1, 0.0, accelerator_pedal=1.0)

    def read(truck):
        radius = truck.parameters.tires["drive"].rolling_radius
        wheels = truck.data.sensor("wheel_speeds").data[DRIVEN] * radius
        report = truck.report()
        spin = wheels.max() - truck.observe().speed
        return spin, report.asr_engine_active, report.engine_torque_mode == ASR

    spin, acting, mode = sample(truck, 8.0, read).T
    assert acting.any()
    assert mode.any()
    assert spin.max() < 2.0
    assert np.mean(spin[len(spin) // 2 :]) < 0.6
    assert truck.observe().speed > 1.5


def test_brakes_of_spinning_wheels_give_the_other_side_torque():
    truck = rolling((0.8, 0.1), 0.0, accelerator_pedal=1.0)

    def read(truck):
        return np.array([*truck.data.sensor("brake_pressures").data[DRIVEN], active(truck)[1]])

    rows = sample(truck, 3.0, read)
    left, right = rows[:, [0, 2]], rows[:, [1, 3]]
    assert rows[:, 4].any()
    assert right.max() > 50e3
    assert left.max() < 0.2 * right.max()
    assert truck.observe().speed > 1.5


def test_braking_ends_traction_control():
    truck = rolling((0.8, 0.1), 0.0, accelerator_pedal=1.0)
    sample(truck, 2.0, active)
    truck.command(accelerator_pedal=1.0, brake_pedal=0.5)
    assert not sample(truck, 1.0, active)[:, :2].any()


def test_slips_of_begin_and_end_are_checked():
    changes = {"air_brake": {"drag_slip_begin": 0.01, "drag_slip_end": 0.02}}
    with pytest.raises(InputError, match="drag_slip_end"):
        iits_mj.Truck.load(parameters=changes, visuals=False)
