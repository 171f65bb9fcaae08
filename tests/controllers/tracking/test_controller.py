"""Tracking on the small planar plant: requirements that hold for any truck."""

import numpy as np
import pytest

from controllers.planning.config import PlannerConfig, SpeedConfig
from controllers.stack import Stack
from controllers.tracking.controller import Tracker
from controllers.tracking.lateral_gains import LateralConfig, LateralGains
from controllers.tracking.lateral_model import LateralModel
from iits_mj.core.errors import InputError
from iits_mj.core.messages import Decision, EgoState, Scene, XbrMode
from iits_mj.core.timing import CONTROL_PERIOD
from iits_mj.parameters import TruckParameters
from iits_mj.road import RoadMap, Route
from tests.controllers.scenes import Script, car
from tests.controllers.tracking.plant import PlanarTruck
from tests.controllers.tracking.reference import Powertrain, gains_at

PARAMETERS = TruckParameters.load()


def drive(truck, duration, cruise=16.67, vehicles=lambda time: (), maker=None):
    """Rows of time, station, speed, lateral error, pedal, engine brake, demand, offset."""
    config = PlannerConfig(speed=SpeedConfig(cruise_speed=cruise))
    stack = Stack(truck.route, maker, config, parameters=PARAMETERS)
    rows = []
    for k in range(round(duration * 50)):
        ego = truck.ego
        if k % 5 == 0:
            stack.plan(Scene(ego.time, ego, vehicles(ego.time)))
        command = stack.control(ego)
        truck.step(command)
        rows.append(
            (
                ego.time,
                ego.station,
                ego.speed,
                stack.tracker.lateral.error,
                command.accelerator_pedal,
                command.engine_brake,
                command.xbr_demand,
                ego.offset,
            )
        )
    return np.array(rows), stack


@pytest.fixture(scope="module")
def highway():
    return RoadMap.builtin().route()


@pytest.mark.parametrize(("mass", "speed"), [(19_000.0, 22.0), (55_000.0, 16.67)])
def test_curves_are_tracked_although_the_tires_are_softer_than_modeled(highway, mass, speed):
    rows, _ = drive(PlanarTruck(highway, mass, station=2600.0, speed=speed), 14.0, speed)
    error = rows[150:, 3]
    assert np.sqrt(np.mean(error**2)) < 0.15
    assert np.abs(error).max() < 0.4


def test_a_cross_slope_leaves_no_lasting_offset():
    rows, _ = drive(PlanarTruck(Route.straight(length=3000.0), bank=0.025), 25.0)
    assert abs(rows[-1, 3]) < 0.04


def test_a_lane_change_is_tracked_within_0_4_m_and_completed():
    truck = PlanarTruck(Route.straight(length=3000.0), station=200.0)
    rows, stack = drive(truck, 16.0, maker=Script(at2=Decision.LEFT))
    assert stack.lane_changes == 1
    assert np.abs(rows[:, 3]).max() < 0.4
    assert rows[-1, 7] == pytest.approx(float(truck.route.lane_offset(1, 0.0)), abs=0.1)


def test_closed_loop_is_well_damped_at_every_speed_and_load():
    config = LateralConfig()
    for mass in (19_000.0, 40_000.0, 55_000.0):
        model = LateralModel.of(PARAMETERS, mass, config.lag)
        gains = LateralGains.design(model, config)
        for speed in (1.5, 5.5, 12.0, 20.0, 25.0):
            feedback = gains_at(gains, speed).feedback
            a, b, *_ = model.discrete(speed, CONTROL_PERIOD)
            poles = np.log(np.linalg.eigvals(a - b @ feedback[None]).astype(complex))
            poles /= CONTROL_PERIOD
            assert poles.real.max() < -0.02
            oscillating = poles[np.abs(poles.imag) > 0.3]
            assert np.all(-oscillating.real / np.abs(oscillating) > 0.3)


def test_the_model_has_the_masses_of_the_laden_truck():
    model = LateralModel.of(PARAMETERS, 55_000.0, 0.1)
    plane = model.plane
    assert plane.mass[1] == pytest.approx(46_100.0)
    assert plane.cg[1] == pytest.approx(5.05, abs=0.01)
    assert plane.inertia[1] == pytest.approx(683_000.0, rel=0.01)


@pytest.mark.parametrize("torque", [-120.0, 100.0, 600.0, 1500.0])
@pytest.mark.parametrize("engine_speed", [90.0, 120.0, 150.0])
def test_the_pedal_inverts_the_engine_map(torque, engine_speed):
    inverse, table = Powertrain(PARAMETERS), PARAMETERS.engine.pedal_map
    pedal = inverse.pedal(torque, engine_speed)
    row = np.array([np.interp(engine_speed, table.rows, c) for c in table.values.T])
    drag = inverse.drag_torque(engine_speed)
    fade = np.minimum(1.0, table.columns / 0.05)
    given = np.interp(pedal, table.columns, np.maximum.accumulate(fade * (row + drag) - drag))
    assert given == pytest.approx(torque, abs=2.0)


def test_pedal_and_brakes_are_never_used_together_and_never_chatter():
    route = Route.straight(length=4000.0)

    def vehicles(time):
        station = 160.0 + 12.5 * time - 14.0 * (np.cos(0.21 * time) - 1.0)
        return (car(route, "leader", station, 0, 12.5 + 14.0 * 0.21 * np.sin(0.21 * time)),)

    rows, stack = drive(PlanarTruck(route), 34.0, vehicles=vehicles)
    pedal, engine_brake, demand = rows[:, 4], rows[:, 5], rows[:, 6]
    assert not np.any((pedal > 0.0) & (demand < 0.0))
    assert np.sum(np.diff((demand < 0.0).astype(int)) != 0) <= 8
    assert np.sum(np.diff((pedal > 0.0).astype(int)) != 0) <= 8
    assert np.max(np.abs(np.diff(engine_brake))) <= 0.05
    assert stack.planner.emergencies == 0


def test_speed_is_held_on_grades_within_the_power():
    for grade in (0.01, -0.03):
        route = Route.straight(length=4000.0, grade=grade)
        rows, _ = drive(PlanarTruck(route), 18.0)
        assert np.abs(rows[600:, 2] - 16.67).max() < 0.3


def test_the_truck_stops_holds_and_starts_again_on_a_5_percent_grade():
    route = Route.straight(length=3000.0, lanes=1, grade=0.05)

    def vehicles(time):
        return (car(route, "block", 200.0 + 8.0 * max(time - 22.0, 0.0), 0, 8.0 * (time > 22.0)),)

    rows, _ = drive(PlanarTruck(route, speed=10.0), 29.0, 13.0, vehicles)
    standing = (rows[:, 0] > 18.0) & (rows[:, 0] < 22.0)
    assert np.abs(rows[standing, 2]).max() < 0.02
    assert np.ptp(rows[standing, 1]) < 0.02
    assert rows[:, 2].min() > -0.05
    assert rows[-1, 2] > 0.5
    assert 200.0 - 2.4 - 1.4 - rows[standing, 1][0] > 2.0


def test_the_brakes_hold_a_stopped_truck_behind_an_obstacle():
    route = Route.straight(length=2000.0)
    block = car(route, "block", 107.0, 0, 0.0)
    truck = PlanarTruck(route, speed=0.0)
    stack = Stack(route, parameters=PARAMETERS)
    stack.plan(Scene(0.0, truck.ego, (block,)))
    command = stack.control(truck.ego)
    assert command.xbr_mode is XbrMode.MAXIMUM
    assert command.xbr_demand < -0.5
    assert command.accelerator_pedal == 0.0


def test_a_state_that_is_not_finite_is_refused_by_name():
    route = Route.straight(length=2000.0)
    stack = Stack(route, parameters=PARAMETERS)
    plan = stack.plan(Scene(0.0, PlanarTruck(route).ego))
    with pytest.raises(InputError, match="yaw_rate"):
        Tracker(route, PARAMETERS).command(EgoState(yaw_rate=float("nan")), plan)


def test_control_before_the_first_plan_is_an_error():
    with pytest.raises(InputError, match="plan"):
        Stack(Route.straight(length=2000.0), parameters=PARAMETERS).control(EgoState())


def test_the_decision_maker_is_asked_once_a_second_and_not_during_a_change():
    truck = PlanarTruck(Route.straight(length=3000.0), station=200.0)
    _, stack = drive(truck, 10.0, maker=Script())
    assert stack.decisions == 10
    truck = PlanarTruck(Route.straight(length=3000.0), station=200.0)
    _, stack = drive(truck, 6.0, maker=Script(at1=Decision.LEFT))
    assert stack.decisions == 2


def test_reset_gives_the_same_drive_again():
    route = Route.straight(length=3000.0)
    stack = Stack(route, Script(at1=Decision.LEFT), parameters=PARAMETERS)
    commands = []
    for _ in range(2):
        truck, run = PlanarTruck(route, station=200.0), []
        stack.reset()
        for k in range(150):
            if k % 5 == 0:
                stack.plan(Scene(truck.ego.time, truck.ego))
            run.append(stack.control(truck.ego))
            truck.step(run[-1])
        commands.append(run)
    assert commands[0] == commands[1]
