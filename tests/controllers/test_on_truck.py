"""The stack on the MuJoCo truck: the targets of path and speed tracking."""

import numpy as np
import pytest

from controllers.planning.config import PlannerConfig, SpeedConfig
from controllers.planning.predicted_boxes import swept_path
from controllers.stack import Stack
from iits_mj.core.messages import Decision, Scene, SpeedProfile
from iits_mj.parameters import TruckParameters, shipped_trucks
from iits_mj.road import RoadMap, Route
from iits_mj.road.measured import Lanes, measured_route
from iits_mj.truck import Truck
from tests.controllers.scenes import Script, car


def drive(
    route,
    payload,
    cruise,
    duration,
    station,
    speed,
    vehicles=lambda t: (),
    maker=None,
    profile=None,
    parameters=None,
):
    """Rows of time, station, speed, planned speed, lateral error, pedal, demand, and more below."""
    truck = Truck.load(payload=payload, route=route, parameters=parameters, visuals=False)
    truck.reset(station=station, offset=float(route.lane_offset(0, station)), speed=speed)
    config = PlannerConfig(speed=SpeedConfig(cruise_speed=cruise))
    stack = Stack(route, maker, config, parameters=truck.parameters, profile=profile)
    rows = []
    for k in range(round(duration * 50)):
        ego = truck.observe()
        if k % 5 == 0:
            plan = stack.plan(Scene(ego.time, ego, vehicles(ego.time)))
        command = stack.control(ego)
        truck.command(command)
        truck.step(10)
        planned = float(np.interp(ego.time, plan.time, plan.speed))
        error = stack.tracker.lateral.error
        rows.append(
            (
                ego.time,
                ego.station,
                ego.speed,
                planned,
                error,
                command.accelerator_pedal,
                command.xbr_demand,
                command.engine_brake,
                command.retarder,
                ego.acceleration,
                ego.shift_in_process,
                truck.read("brake_work"),
            )
        )
    return np.array(rows), stack


ENGINE_BRAKE, RETARDER, ACCELERATION, SHIFT, BRAKE_WORK = range(7, 12)
LEFT_AT_2_S = Script(at2=Decision.LEFT)


@pytest.mark.parametrize(
    ("payload", "speed", "station"), [(36_000.0, 16.67, 2700.0), (0.0, 22.2, 6000.0)]
)
def test_the_lane_is_kept_within_0_15_m_rms_and_0_4_m_peak(payload, speed, station):
    route = RoadMap.builtin().route()
    rows, _ = drive(route, payload, speed, 20.0, station, speed)
    error = rows[100:, 4]
    assert np.sqrt(np.mean(error**2)) <= 0.15
    assert np.abs(error).max() <= 0.4


def test_a_lane_change_of_the_laden_truck_is_tracked_and_completed():
    route = RoadMap.builtin().route()
    rows, stack = drive(route, 36_000.0, 16.67, 13.0, 1000.0, 16.67, maker=LEFT_AT_2_S)
    assert stack.lane_changes == 1
    assert np.abs(rows[:, 4]).max() <= 0.4


@pytest.mark.slow
@pytest.mark.parametrize("share", [0.0, 1.0])
@pytest.mark.parametrize("name", shipped_trucks())
def test_every_truck_keeps_its_lane_and_changes_it_at_80_km_h(name, share):
    truck = TruckParameters.load(name)
    payload, bends = share * truck.payload_max, RoadMap.builtin().route()
    rows, _ = drive(bends, payload, 22.2, 20.0, 6000.0, 22.2, parameters=truck)
    assert np.sqrt(np.mean(rows[100:, 4] ** 2)) <= 0.15
    assert np.abs(rows[100:, 4]).max() <= 0.4
    straight = Route.straight(length=3000.0, lanes=2)
    rows, stack = drive(
        straight, payload, 22.2, 16.0, 200.0, 22.2, maker=LEFT_AT_2_S, parameters=truck
    )
    assert stack.lane_changes == 1
    assert np.abs(rows[:, 4]).max() <= 0.25


@pytest.mark.slow
@pytest.mark.parametrize("name", shipped_trucks())
def test_in_a_turn_of_20_m_the_last_unit_of_every_truck_follows_the_predicted_path(name):
    parameters, radius = TruckParameters.load(name), 20.0
    station = np.arange(0.0, 220.0, 0.5)
    over = 100.0 + 0.5 * np.pi * radius
    bent = np.interp(station, [100.0, 105.0, over, over + 5.0], [0.0, 1.0, 1.0, 0.0]) / radius
    flat, lanes = np.zeros_like(station), Lanes(1, 5.0, 8.0)
    route = measured_route(station, flat, curvature=bent, lanes=lanes)
    truck = Truck.load(
        0.5 * parameters.payload_max, parameters=parameters, route=route, visuals=False
    )
    truck.reset(station=60.0, offset=float(route.lane_offset(0, 60.0)), speed=2.0)
    config = PlannerConfig(speed=SpeedConfig(cruise_speed=2.0))
    stack = Stack(route, None, config, parameters=parameters)
    group = truck.model.site(f"{parameters.last.name}_axle_center").id
    front, rear = [], []
    for k in range(50 * 50):
        ego = truck.observe()
        if k % 5 == 0:
            stack.plan(Scene(ego.time, ego))
        if k % 10 == 0:
            front.append((ego.x, ego.y))
            rear.append(truck.data.site_xpos[group, :2].copy())
        truck.command(stack.control(ego))
        truck.step(10)
    assert ego.station > over + 10.0
    heading = float(route.evaluate(60.0, 0.0).heading)
    predicted = swept_path(parameters, np.array(front), heading)[-1].group
    apart = [np.hypot(*(predicted - place).T).min() for place in rear[20:]]
    assert max(apart) < 0.1


def test_the_laden_truck_stops_holds_and_restarts_on_a_5_percent_grade():
    route = Route.straight(length=2000.0, lanes=1, grade=0.05)

    def vehicles(time):
        gone = max(time - 22.0, 0.0)
        return (car(route, "block", 150.0 + 6.0 * gone, 0, 6.0 if gone else 0.0),)

    rows, stack = drive(route, 36_000.0, 13.0, 32.0, 50.0, 9.0, vehicles)
    standing = (rows[:, 0] > 19.0) & (rows[:, 0] < 22.0)
    assert np.abs(rows[standing, 2]).max() < 0.01
    assert np.ptp(rows[standing, 1]) < 0.005
    assert 150.0 - 2.4 - 1.4 - rows[standing, 1][0] > 2.0
    after = rows[:, 0] > 22.0
    assert rows[after, 1].min() > rows[standing, 1].min() - 0.03
    assert rows[-1, 2] > 0.8
    assert stack.planner.emergencies == 0


def test_speed_is_held_down_a_4_percent_grade_without_chatter():
    route = Route.straight(length=3000.0, grade=-0.04)
    rows, _ = drive(route, 36_000.0, 16.67, 25.0, 100.0, 16.67)
    error = rows[250:, 2] - rows[250:, 3]
    assert np.sqrt(np.mean(error**2)) <= 0.3
    assert np.sum(np.diff((rows[:, 6] < 0.0).astype(int)) != 0) <= 4
    assert not np.any((rows[:, 5] > 0.0) & (rows[:, 6] < 0.0))


def smooth(acceleration):
    """Mean over 0.2 s of an acceleration every 20 ms, and its jerk [m/s3]."""
    mean = np.convolve(acceleration, np.ones(10) / 10.0, "valid")
    return mean, np.diff(mean) * 50.0


@pytest.mark.parametrize("speed", [60.0 / 3.6, 80.0 / 3.6])
def test_55_t_hold_their_speed_down_6_percent_by_engine_brake_and_retarder(speed):
    # The truck starts on the descent without braking: the first seconds are its response.
    route = Route.straight(length=3000.0, grade=-0.06)
    rows, _ = drive(route, 36_000.0, speed, 25.0, 100.0, speed)
    assert np.abs(rows[:, 2] - speed).max() <= 2.0 / 3.6
    settled = rows[rows[:, 0] > 8.0]
    assert np.abs(settled[:, 2] - speed).max() <= 0.5 / 3.6
    assert np.all(settled[:, 6] == 0.0)
    assert np.all(settled[:, ENGINE_BRAKE] > 0.9)
    fallen = 0.06 * (rows[-1, 1] - rows[0, 1])
    assert rows[-1, BRAKE_WORK] <= 0.01 * 55_000.0 * 9.81 * fallen


def test_friction_adds_the_missing_braking_down_9_percent():
    route = Route.straight(length=3000.0, grade=-0.09)
    rows, _ = drive(route, 36_000.0, 60.0 / 3.6, 30.0, 100.0, 60.0 / 3.6)
    assert np.abs(rows[:, 2] - 60.0 / 3.6).max() <= 2.0 / 3.6
    braking = rows[rows[:, 6] < 0.0]
    assert len(braking) > 100
    late = braking[braking[:, 0] > 2.0]
    assert np.all(late[:, RETARDER] > 0.95)
    _, jerk = smooth(rows[100:, ACCELERATION])
    assert np.abs(jerk).max() < 2.5


def test_without_a_retarder_friction_holds_the_truck_and_does_not_chatter():
    route = Route.straight(length=3000.0, grade=-0.06)
    without = {"retarder": {"torque_max": 0.0}}
    speed = 60.0 / 3.6
    rows, _ = drive(route, 36_000.0, speed, 20.0, 100.0, speed, parameters=without)
    settled = rows[rows[:, 0] > 8.0]
    assert np.abs(settled[:, 2] - speed).max() <= 0.5 / 3.6
    assert np.all(settled[:, 6] < 0.0)
    assert np.all(settled[:, ENGINE_BRAKE] == 1.0)
    _, jerk = smooth(settled[:, ACCELERATION])
    assert np.abs(jerk).max() < 0.5


def test_a_planned_deceleration_needs_no_friction_and_the_truck_pulls_again_smoothly():
    route = Route.straight(length=3000.0)
    profile = SpeedProfile(
        np.array([0.0, 400.0, 401.0, 600.0, 601.0, 3000.0]),
        np.array([20.0, 20.0, 12.0, 12.0, 20.0, 20.0]),
    )
    rows, _ = drive(route, 36_000.0, 30.0, 50.0, 100.0, 20.0, profile=profile)
    slow = int(np.argmax(rows[:, 3] < 12.05))
    slowing = rows[rows[:, 3].argmax() + 100 : slow]
    assert np.abs(slowing[:, 2] - slowing[:, 3]).max() < 0.2
    assert np.all(rows[:slow, 6] == 0.0)
    assert rows[-1, 2] > 13.0
    assert rows[:, RETARDER].max() > 0.05
    pulling = rows[:, 5] > 0.05
    assert np.all(rows[pulling, RETARDER] < 0.05)
    # Gear changes have a jerk of their own.
    _, jerk = smooth(rows[:, ACCELERATION])
    steady = np.convolve(rows[:, SHIFT], np.ones(60), "same")[5:-5] == 0.0
    assert np.abs(jerk[steady[: len(jerk)]]).max() < 2.0


@pytest.mark.slow
@pytest.mark.parametrize("speed", [60.0 / 3.6, 80.0 / 3.6])
def test_6_km_down_6_percent_need_hardly_any_friction(speed):
    route = Route.straight(length=8000.0, grade=-0.06)
    rows, _ = drive(route, 36_000.0, speed, 6000.0 / speed, 100.0, speed)
    assert np.abs(rows[:, 2] - speed).max() <= 2.0 / 3.6
    fallen = 0.06 * (rows[-1, 1] - rows[0, 1])
    assert fallen > 355.0
    assert rows[-1, BRAKE_WORK] <= 0.01 * 55_000.0 * 9.81 * fallen


@pytest.mark.parametrize("wanted", [20.0, 20.17])
def test_a_little_more_speed_up_2_percent_does_not_kick_the_gearbox_down(wanted):
    route = Route.straight(length=1500.0, grade=0.02, speed_limit=40.0)
    profile = SpeedProfile(np.array([0.0, 1500.0]), np.array([wanted, wanted]))
    rows, _ = drive(route, 0.0, 20.0, 5.0, 100.0, 20.0, profile=profile)
    assert rows[:, SHIFT].max() == 0.0
    assert rows[:, 5].max() > 0.6
