"""The joint plan of speed, gear and neutral, and its lower bound."""

from dataclasses import replace

import numpy as np
import pytest

from controllers.pcc import PccConfig, RoadProfile, plan
from controllers.pcc.fuel import FuelMap
from controllers.pcc.joint import (
    NEUTRAL,
    GearTables,
    JointTask,
    gears_at,
    joint_drive,
    joint_values,
    lower_bound,
    neutral_force,
    plan_at,
    plan_in_time,
)
from controllers.pcc.planner import make_vehicle
from controllers.pcc.vehicle import durations
from iits_mj.core.errors import InputError, PlanningError
from iits_mj.core.messages import TransmissionMode
from iits_mj.parameters import TruckParameters

PARAMETERS = TruckParameters.load()


def hills(intervals=80, amplitude=0.02, wave=2_000.0):
    station = 50.0 * np.arange(intervals + 1)
    turn = 2.0 * np.pi / wave
    height = amplitude / turn * (1.0 - np.cos(turn * station))
    return RoadProfile(station, height, np.full(station.size, np.inf), "hills")


def task_of(comparison, parameters=PARAMETERS, neutral=True, states=80):
    task = comparison.task
    speeds = np.sqrt(task.b_low.min()) - 1e-6, np.sqrt(task.b_high.max()) + 1e-6
    tables = GearTables.of(parameters, *speeds, neutral=neutral)
    price = comparison.time_price
    return JointTask(task.vehicle, task.road, tables, task.b_low, task.b_high, price, states=states)


@pytest.fixture(scope="module")
def convex():
    return plan(hills(), PARAMETERS, 40_000.0, PccConfig(v_ref=22.0, v_min=20.0, v_max=24.0))


@pytest.fixture(scope="module")
def task(convex):
    return task_of(convex)


@pytest.fixture(scope="module")
def joint(task, convex):
    return plan_in_time(task, convex.baseline.time)


def test_joint_plan_burns_less_than_the_plan_of_speed_alone_in_the_same_time(task, convex, joint):
    alone = gears_at(task, convex.plan.speed)
    assert joint.time <= convex.baseline.time
    assert joint.fuel.sum() < alone.fuel.sum()
    assert joint.fuel.sum() < gears_at(task, convex.baseline.speed).fuel.sum()


def test_joint_plan_keeps_ends_band_full_load_and_brakes(task, joint):
    speed, low, high = joint.speed, np.sqrt(task.b_low), np.sqrt(task.b_high)
    assert speed[0] == pytest.approx(low[0])
    assert speed[-1] == pytest.approx(high[-1])
    assert (speed >= low - 1e-9).all()
    assert (speed <= high + 1e-9).all()
    force, mean = task.vehicle.net_force(speed, task.road), 0.5 * (speed[1:] + speed[:-1])
    tables = task.tables
    for gear in set(joint.gear.tolist()):
        row, used = tables.gears.index(gear), joint.gear == gear
        full = np.interp(mean[used], tables.speed, tables.full[row])
        assert (force[used] <= full * (1.0 + 1e-6) + 1.0).all()
    assert force.min() > -task.vehicle.brake_max - 1e4


def test_in_neutral_no_force_drives_the_wheels():
    truck, config = TruckParameters.load("vecto_40t"), PccConfig(v_ref=23.0, v_min=21.5, v_max=24.5)
    task = task_of(plan(hills(160, 0.02, 4_000.0), truck, 40_000.0, config), truck)
    joint = plan_at(task)
    rolling = joint.gear == NEUTRAL
    assert np.count_nonzero(rolling) > 5
    force = task.vehicle.net_force(joint.speed, task.road)[rolling]
    assert force.max() < 0.0
    time = durations(joint.speed, task.road)[rolling]
    assert joint.fuel[rolling] == pytest.approx(task.tables.idle_rate * time)


def test_no_plan_is_below_the_bound_and_the_bound_is_near(task, convex, joint):
    time = convex.baseline.time
    bounds = [
        lower_bound(replace(task, states=300).at_price(share * joint.price), time)
        for share in (0.5, 0.8, 1.0, 1.5)
    ]
    assert max(bounds) < joint.fuel.sum()
    finer = plan_in_time(replace(task, states=200), time)
    assert 0.998 * finer.fuel.sum() < max(bounds) < finer.fuel.sum()
    # Any price gives a bound: drives at random speeds of this time or less burn more.
    rng = np.random.default_rng(1)
    for _ in range(50):
        shape = np.cumsum(rng.normal(0.0, 0.05, joint.speed.size))
        shape -= np.linspace(shape[0], shape[-1], shape.size)
        speed = np.clip(convex.plan.speed + shape, 20.0, 24.0)
        speed[[0, -1]] = convex.plan.speed[[0, -1]]
        found = gears_at(task, speed)
        late = max(found.time - time, 0.0)
        assert found.fuel.sum() + joint.price * late > bounds[2]


def test_the_bound_is_near_on_a_climb_that_full_power_does_not_hold():
    station = 50.0 * np.arange(121)
    height = np.interp(station, [0.0, 1_000.0, 4_000.0, 6_000.0], [0.0, 0.0, 150.0, 150.0])
    road = RoadProfile(station, height, np.full(station.size, np.inf), "climb")
    found = plan(road, PARAMETERS, 40_000.0, PccConfig(v_ref=22.0, v_min=18.0, v_max=25.0))
    task, time = task_of(found), found.baseline.time
    joint = plan_in_time(task, time * (1.0 + 1e-6))
    assert joint.speed.min() < 18.0
    bounds = [
        lower_bound(replace(task, states=states).at_price(joint.price), time)
        for states in (60, 100, 200)
    ]
    assert max(bounds) < joint.fuel.sum()
    assert min(bounds) > 0.98 * joint.fuel.sum()


def test_finer_states_lower_the_values_of_no_plan_and_raise_the_bound(task, convex, joint):
    coarse, fine = (
        lower_bound(replace(task, states=states).at_price(joint.price), convex.baseline.time)
        for states in (100, 400)
    )
    assert fine > coarse
    other = plan_in_time(replace(task, states=160), convex.baseline.time)
    assert other.fuel.sum() == pytest.approx(joint.fuel.sum(), rel=5e-3)


def test_neutral_only_adds_plans(convex, joint):
    geared = plan_in_time(task_of(convex, neutral=False), convex.baseline.time)
    assert NEUTRAL not in geared.gear
    assert joint.fuel.sum() <= geared.fuel.sum() * (1.0 + 1e-3)


def test_fuel_in_the_best_gears_is_that_of_the_engines_map(task, convex):
    free = replace(task, tables=replace(task.tables, change_time=0.0), price=0.0)
    found = gears_at(free, convex.plan.speed)
    geared = found.gear != NEUTRAL
    expected = convex.plan.map_fuel
    assert found.fuel[geared] == pytest.approx(expected[geared], rel=0.02, abs=2e-4)
    assert found.fuel.sum() <= expected.sum() * 1.002


def test_a_dear_second_makes_the_plan_faster(task):
    times = [plan_at(task.at_price(price)).time for price in (0.0, 2e-3, 5e-3, 2e-2)]
    assert times == sorted(times, reverse=True)
    assert times[0] > times[-1] + 3.0


def test_values_at_the_start_are_the_cost_of_the_drive(task):
    values = joint_values(task)
    found = joint_drive(task, values)
    cost = found.fuel.sum() + task.price * found.time
    changes = found.changes * task.tables.change_time * (task.price + task.tables.idle_rate)
    assert cost + changes == pytest.approx(values[0, :, 0].min(), rel=2e-3)


def test_a_horizon_with_the_values_at_its_end_repeats_the_whole_plan(task):
    values = joint_values(task)
    whole = joint_drive(task, values)
    part = replace(task, road=task.road.part(0, 40), b_low=task.b_low[:41], b_high=task.b_high[:41])
    begun = joint_drive(part, joint_values(part, values[40]))
    assert begun.speed == pytest.approx(whole.speed[:41], abs=1e-9)
    assert (begun.gear == whole.gear[:40]).all()


def test_change_of_gear_at_full_load_costs_the_speed_of_the_lost_pull():
    road = RoadProfile(50.0 * np.arange(5), 0.04 * 50.0 * np.arange(5), np.full(5, np.inf), "climb")
    vehicle = make_vehicle(PARAMETERS, FuelMap(PARAMETERS), 55_000.0, PccConfig())
    tables = GearTables.of(PARAMETERS, 8.0, 26.0, neutral=False, slows=True)
    assert tables.lost_time == PARAMETERS.engine.lost_pull(tables.change_time)
    low, high = np.full(5, 10.0**2), np.full(5, 25.0**2)
    low[0] = high[0] = 17.0**2
    # Time is worth so much that the plan pulls with all it has; only the tenth gear is there.
    place = tables.gears.index(10)
    others = np.arange(len(tables.gears)) != place
    full = np.where(others[:, None], np.nan, tables.full)
    dear = JointTask(vehicle, road, replace(tables, full=full), low, high, 1.0, states=400)
    kept, changed = (joint_drive(dear, joint_values(dear), gear) for gear in (10, 11))
    assert set(kept.gear) == set(changed.gear) == {10}
    force = np.interp(17.0, tables.speed, tables.full[place])
    slower = force * tables.lost_time / vehicle.inertial_mass
    assert kept.speed[1] - changed.speed[1] == pytest.approx(slower, rel=0.06)
    free = replace(dear, tables=replace(dear.tables, lost_time=0.0))
    assert joint_drive(free, joint_values(free), 11).speed[1] == pytest.approx(kept.speed[1])


def test_requests_of_a_plan_are_gears_and_neutral(joint):
    plan = replace(joint, gear=np.array([NEUTRAL, 1, 12, 18, 19]))
    modes = [TransmissionMode(mode) for mode in plan.transmission_mode]
    gears = [TransmissionMode.forward(gear) for gear in (1, 12, 18)]
    assert modes == [TransmissionMode.NEUTRAL, *gears, TransmissionMode.DRIVE]


def test_truck_with_loss_maps_drags_in_neutral_and_the_shipped_one_does_not():
    speed = np.array([15.0, 25.0])
    assert neutral_force(PARAMETERS, speed) == pytest.approx(0.0)
    drag = neutral_force(TruckParameters.load("vecto_40t"), speed)
    assert (drag < -10.0).all()
    assert (drag > -2_000.0).all()


def test_an_impossible_time_and_unusable_tasks_are_refused(task):
    with pytest.raises(PlanningError, match="fastest plan takes"):
        plan_in_time(task, 10.0)
    with pytest.raises(InputError, match="states"):
        replace(task, states=1)
    with pytest.raises(PlanningError, match="price"):
        replace(task, price=-1.0)
    with pytest.raises(PlanningError, match="b_low"):
        replace(task, b_low=np.full(3, 1.0))
    with pytest.raises(PlanningError, match="no gear"):
        GearTables.of(PARAMETERS, 20.0, 60.0)


def test_forces_of_the_tables_lie_between_overrun_and_full_load():
    tables, fuel_map = GearTables.of(PARAMETERS, 14.0, 25.0), FuelMap(PARAMETERS)
    top = tables.full[:-1]
    assert tables.gears[-1] == NEUTRAL
    assert (np.nan_to_num(tables.overrun[:-1], nan=-1.0) < 0.0).all()
    most = np.nanmax(top * tables.speed, axis=0)
    assert most == pytest.approx(fuel_map.power_max(tables.speed) * fuel_map.efficiency, rel=1e-6)
