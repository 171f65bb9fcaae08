"""The receding-horizon speed planner: hills, schedule, a vehicle ahead, failures."""

from dataclasses import replace

import numpy as np
import pytest

from controllers.pcc import (
    Appointment,
    Leader,
    LeaderConfig,
    PccConfig,
    RecedingConfig,
    RecedingPlanner,
    RoadProfile,
    plan,
)
from controllers.pcc.joint import GearTables, JointTask, gears_at
from controllers.pcc.reference import Flow, FlowConfig
from controllers.pcc.schedule import make_schedule
from controllers.pcc.solver import METHODS
from iits_mj.core.errors import InputError, PlanningError
from iits_mj.core.messages import TrackedVehicle, TransmissionMode
from iits_mj.parameters import TruckParameters
from iits_mj.validation.planning.pcc_receding import FINE, drive, fuel_on

STATION = 50.0 * np.arange(241)
ROAD = RoadProfile(
    STATION, 12.0 * np.sin(2.0 * np.pi * STATION / 2500.0), np.full(241, 25.0), "waves"
)
LEVEL = RoadProfile(STATION, np.zeros(241), np.full(241, 30.0), "level")
PARAMETERS = TruckParameters.load()
PATIENT = RecedingConfig(time_limit=np.inf)


@pytest.fixture(scope="module")
def planner():
    return RecedingPlanner(ROAD, PARAMETERS, receding=PATIENT)


@pytest.fixture(scope="module")
def steep():
    """A planner on climbs of 5 %, where full power does not hold the speed."""
    waves = 20.0 * np.sin(2.0 * np.pi * STATION / 2500.0)
    return RecedingPlanner(replace(ROAD, height=waves), PARAMETERS, receding=PATIENT)


@pytest.fixture(autouse=True)
def _fresh(planner):
    planner.reset()


def clock(profile):
    """Time at the stations of a profile, 0 at the first [s]."""
    step = np.diff(profile.station)
    return np.concatenate([[0.0], np.cumsum(2.0 * step / (profile.speed[1:] + profile.speed[:-1]))])


def fail(task, guess, **settings):
    raise PlanningError("time is up")


# On the free road ---------------------------------------------------------------------------------


def test_plan_starts_at_the_trucks_speed_and_keeps_the_limits(planner):
    found = planner.plan(1000.0, 18.0, 0.0)
    assert found.status == "optimal"
    assert found.profile.speed[0] == pytest.approx(18.0)
    assert found.profile.station[-1] - found.profile.station[0] == pytest.approx(5000.0)
    assert found.profile.speed.max() <= min(planner.config.v_max, 25.0) + 1e-6


def test_plan_is_slower_at_the_crest_than_in_the_sag(planner):
    found = planner.plan(0.0, 20.0, 0.0)
    crest, sag = found.profile.at(625.0 + 2500.0), found.profile.at(1875.0 + 2500.0)
    assert crest < sag - 1.0


def test_plan_of_a_level_road_is_the_reference_speed():
    found = RecedingPlanner(LEVEL, PARAMETERS, receding=PATIENT).plan(0.0, 20.0, 0.0)
    assert np.abs(found.profile.speed - 20.0).max() < 0.3


def test_short_horizons_reproduce_the_plan_of_the_whole_trip():
    config = PccConfig()
    whole = plan(ROAD, PARAMETERS, 55_000.0, config)
    end = float(STATION[-1])
    trip = Appointment(end, whole.plan.time, float(whole.plan.speed[-1]))
    short = RecedingConfig(2_500.0, time_limit=np.inf, power_share=1.0, surplus=0.0, reserve=0.0)
    planner = RecedingPlanner(ROAD, PARAMETERS, 55_000.0, config, short, trip)
    driven = drive(planner, 0.0, end, float(whole.plan.speed[0]), period=4.0)
    assert set(driven.plans) <= {"optimal", "kept"}
    vehicle = planner.vehicle
    wanted = fuel_on(vehicle, ROAD, STATION, whole.plan.speed, end - FINE)
    found = fuel_on(vehicle, ROAD, driven.station, driven.speed, end - FINE)
    assert found[0] == pytest.approx(wanted[0], rel=0.003)
    assert found[1] == pytest.approx(wanted[1], abs=0.5)
    assert found[2] == pytest.approx(wanted[2], abs=0.2)


def test_successive_plans_do_not_jump(planner):
    station, speed = 1000.0, 18.0
    before = planner.plan(station, speed, 0.0).profile
    for second in range(1, 5):
        station, speed = station + speed, before.at(station + speed)
        after = planner.plan(station, speed, float(second)).profile
        ahead = np.linspace(station, station + 2000.0, 40)
        gap = np.interp(ahead, after.station, after.speed)
        gap -= np.interp(ahead, before.station, before.speed)
        assert np.abs(gap).max() < 0.15
        before = after


def test_plan_starts_at_the_last_plans_speed_within_a_range_of_the_trucks(planner):
    first = planner.plan(1000.0, 18.0, 0.0).profile
    wanted = first.at(1030.0)
    near = planner.plan(1030.0, wanted - 0.3, 2.0).profile.speed[0]
    assert near == pytest.approx(wanted, abs=1e-6)
    far = planner.plan(1060.0, wanted - 3.0, 4.0).profile.speed[0]
    assert far == pytest.approx(wanted - 3.0 + planner.receding.resync, abs=1e-6)


# The schedule -------------------------------------------------------------------------------------


def test_a_lag_makes_the_plan_faster_and_being_early_slower(planner):
    planner.plan(0.0, 20.0, 0.0)
    due = planner.schedule.due(2000.0)
    plans = [planner.plan(2000.0, 20.0, due + lag) for lag in (-2.0, 0.0, 2.0)]
    means = [found.profile.speed.mean() for found in plans]
    assert means[0] < means[1] < means[2]
    assert [found.lag for found in plans] == pytest.approx([-2.0, 0.0, 2.0], abs=0.05)
    assert plans[0].price < plans[1].price < plans[2].price


def test_price_grows_without_a_jump_with_the_lag(planner):
    planner.plan(0.0, 20.0, 0.0)
    due = planner.schedule.due(6000.0)
    lags = np.linspace(-20.0, 200.0, 400)
    price = [planner.schedule.price_at(planner.vehicle, 6000.0, due + lag) for lag in lags]
    assert (np.diff(price) >= 0.0).all()
    assert np.diff(price).max() < 0.05 * (price[-1] - price[0])


def test_a_wanted_arrival_is_met_after_a_delay():
    end = 10_000.0
    trip = Appointment(end, 540.0)
    planner = RecedingPlanner(ROAD, PARAMETERS, 55_000.0, PccConfig(), PATIENT, trip)
    driven = drive(planner, 0.0, end, 18.0, period=2.0, held=(3000.0, 3600.0, 10.0))
    assert np.nanmax(driven.lag) > 2.0
    assert planner.trip.schedules >= 2
    arrived = float(np.interp(end, driven.station, driven.time))
    # The plan arrives half a percent early, as a reserve.
    assert 535.0 < arrived < 541.0


def test_without_a_wanted_arrival_a_delay_makes_a_later_schedule(planner):
    planner.plan(0.0, 20.0, 0.0)
    before = planner.schedule.clock[-1]
    planner.plan(2000.0, 20.0, 160.0)
    assert planner.trip.schedules == 2
    assert planner.schedule.clock[-1] > before + 20.0


def test_an_arrival_out_of_reach_gives_a_late_and_fast_schedule():
    trip = Appointment(6_000.0, 100.0)
    planner = RecedingPlanner(ROAD, PARAMETERS, 55_000.0, PccConfig(), PATIENT, trip)
    found = planner.plan(0.0, 20.0, 0.0)
    assert found.status == "optimal"
    assert planner.schedule.late > 100.0
    early = RecedingPlanner(
        ROAD, PARAMETERS, 55_000.0, PccConfig(), PATIENT, Appointment(6_000.0, 330.0)
    )
    assert found.profile.speed.mean() > early.plan(0.0, 20.0, 0.0).profile.speed.mean() + 1.0


@pytest.mark.parametrize("arrival", [700.0, 800.0, 900.0])
def test_a_late_wanted_arrival_slows_the_truck_below_the_cheapest_drive(arrival):
    # At the least price of a second this road takes 770 s, at v_min 960 s.
    config = PccConfig(v_ref=16.67, v_min=12.5)
    trip = Appointment(12_000.0, arrival, 16.0)
    planner = RecedingPlanner(ROAD, PARAMETERS, 55_000.0, config, PATIENT, trip)
    driven = drive(planner, 0.0, 12_000.0, 16.0, period=4.0)
    assert set(driven.plans) <= {"optimal", "kept"}
    arrived = float(np.interp(12_000.0, driven.station, driven.time))
    assert arrived == pytest.approx(arrival, rel=0.01)


def test_a_negative_price_and_then_a_top_speed_delay_the_arrival(planner):
    config = PccConfig(v_ref=16.67, v_min=12.5)
    prices, tops = [], []
    for arrival in (650.0, 765.0, 850.0):
        found = make_schedule(planner.vehicle, ROAD, config, 16.0, 0.0, arrival)
        assert found.clock[-1] == pytest.approx(arrival, rel=2e-3)
        prices.append(found.price)
        tops.append(found.top)
    assert prices[0] > 0.0 > prices[1] >= prices[2]
    assert tops[0] == tops[1] == np.inf
    assert 12.5 < tops[2] < 20.0


# A vehicle ahead ----------------------------------------------------------------------------------


def test_constraint_of_a_slow_vehicle_ahead_is_kept(planner):
    leader = Leader(rear=1150.0, speed=14.0)
    found = planner.plan(1000.0, 18.0, 0.0, leader)
    assert found.status == "optimal"
    settings = planner.receding.leader
    clear = leader.rear - settings.standstill_gap
    earliest = (found.profile.station - clear) / leader.speed + settings.time_gap
    passed = clock(found.profile)
    assert (passed >= np.minimum(earliest, settings.hold) - 0.05).all()
    assert (passed < 1.05 * earliest)[earliest > 5.0].any()


def test_after_a_cut_in_the_plan_brakes_no_harder_than_the_settings(planner):
    found = planner.plan(1000.0, 20.0, 0.0, Leader(rear=1008.0, speed=12.0))
    assert found.status == "optimal"
    loss = -np.diff(found.profile.speed**2) / (2.0 * planner.receding.step)
    settings = planner.receding.leader
    assert 0.3 < loss.max() < settings.deceleration + 0.1
    gap = clock(found.profile) - (found.profile.station - 998.0) / 12.0
    in_time = clock(found.profile) <= settings.hold
    assert gap[0] < 0.0
    # The gap decreases further while the truck slows down.
    assert gap.min() < gap[0]
    assert found.profile.speed[in_time].min() < 16.0


def test_a_faster_leader_does_not_change_the_plan(planner):
    free = planner.plan(1000.0, 18.0, 0.0).profile
    planner.reset()
    behind = planner.plan(1000.0, 18.0, 0.0, Leader(rear=1200.0, speed=30.0))
    assert behind.status == "optimal"
    same = np.interp(behind.profile.station, free.station, free.speed)
    assert behind.profile.speed == pytest.approx(same, abs=0.05)


@pytest.mark.parametrize("speed", [5.0, 15.0, 20.0])
@pytest.mark.parametrize("leader", [(1005.0, 5.0), (1150.0, 14.0), (1400.0, 8.0), (1030.0, 19.0)])
@pytest.mark.parametrize("station", [1000.0, 1900.0, 2150.0])
def test_there_is_an_optimum_behind_any_moving_vehicle(steep, station, speed, leader):
    steep.reset()
    leader = (station - 1000.0 + leader[0], leader[1])
    found = steep.plan(station, speed, 0.0, Leader(*leader))
    assert (found.status, found.reason) == ("optimal", "")
    begins = found.profile.speed[0] - speed
    assert -1e-6 <= begins <= steep.receding.surplus + 1e-6


def test_speed_falls_smoothly_to_that_of_a_jam_ahead(planner):
    found = planner.plan(1000.0, 15.0, 0.0, Leader(rear=1300.0, speed=0.0))
    assert found.status == "cruise"
    assert "jam" in found.reason
    speed = found.profile.at
    assert speed(1000.0) == pytest.approx(15.0, abs=0.1)
    assert speed(1000.0) > speed(1150.0) > speed(1250.0) > speed(1300.0)
    assert speed(1300.0) == pytest.approx(planner.receding.leader.jam, abs=0.5)


def test_speed_of_the_traffic_limits_schedule_and_plan_with_gentle_braking():
    planner = RecedingPlanner(ROAD, PARAMETERS, receding=PATIENT)
    free = planner.plan(1000.0, 20.0, 0.0)
    assert free.profile.speed.max() > 21.0
    found = planner.plan(1000.0, 20.0, 20.0, flow=15.0)
    assert found.status == "optimal"
    assert planner.trip.schedules == 2
    assert planner.schedule.speed[20:].max() < 15.0 + 1e-6
    beyond = found.profile.station > 1400.0
    assert found.profile.speed[beyond].max() < 15.0 + planner.receding.surplus + 1e-6
    loss = -np.diff(found.profile.speed**2) / (2.0 * np.diff(found.profile.station))
    assert loss.max() < 0.8
    again = planner.plan(1400.0, 15.0, 45.0, flow=np.inf)
    assert again.profile.speed.max() > 17.0


def test_a_late_truck_drives_faster_than_the_traffic_while_its_lane_is_free():
    # 6 km and 350 s are left: 17.1 m/s on average, where the traffic drives 15 m/s.
    appointment = Appointment(8_000.0, 400.0)
    planner = RecedingPlanner(LEVEL, PARAMETERS, receding=PATIENT, appointment=appointment)
    free = planner.plan(2000.0, 15.0, 50.0, flow=15.0)
    assert free.profile.speed[30:].min() > 16.5
    needed = 6_000.0 / 350.0
    assert planner.last.speed.max() < needed + 0.05
    planner.reset()
    behind = planner.plan(2000.0, 15.0, 50.0, Leader(2150.0, 15.0), flow=15.0)
    assert behind.profile.speed.max() < 15.0 + planner.receding.surplus + 1e-6
    # A truck in time drives like the traffic.
    planner.reset()
    early = planner.plan(2000.0, 15.0, -50.0, flow=15.0)
    assert early.profile.speed.max() < 15.0 + planner.receding.surplus + 1e-6


def test_where_a_plan_takes_full_power_the_speed_gets_a_surplus():
    hurry = Appointment(8_000.0, 100.0)
    planner = RecedingPlanner(ROAD, PARAMETERS, 55_000.0, PccConfig(), PATIENT, hurry)
    found = planner.plan(1900.0, 16.0, 0.0)
    plain = planner.last
    more = found.profile.speed - plain.speed
    assert more.max() == pytest.approx(planner.receding.surplus)
    road = planner.trip.grid(float(plain.station[0]), plain.station.size - 1)
    power = planner.vehicle.power(plain.speed, road)
    full = power > 0.95 * planner.vehicle.power_max
    beside = np.concatenate([full[:1], full[1:] | full[:-1], full[-1:]])
    assert beside[more > 0.01].all()
    assert (found.profile.speed <= np.maximum(road.v_limit, plain.speed)).all()


# When the optimizer fails -------------------------------------------------------------------------


def test_a_failed_solve_keeps_the_last_plan(planner, monkeypatch):
    first = planner.plan(1000.0, 20.0, 0.0)
    speed = first.profile.at(1200.0)
    monkeypatch.setitem(METHODS, "interior_point", fail)
    second = planner.plan(1200.0, speed, 10.0)
    assert second.status == "kept"
    assert second.reason == "time is up"
    assert second.profile.at(2000.0) == pytest.approx(first.profile.at(2000.0), abs=0.05)


def test_a_last_plan_into_the_vehicle_ahead_is_not_kept(planner, monkeypatch):
    first = planner.plan(1000.0, 20.0, 0.0)
    monkeypatch.setitem(METHODS, "interior_point", fail)
    second = planner.plan(1200.0, first.profile.at(1200.0), 10.0, Leader(1260.0, 8.0))
    assert second.status == "cruise"
    assert second.profile.at(1800.0) == pytest.approx(8.0)


def test_without_a_last_plan_a_failed_solve_gives_the_schedule(planner, monkeypatch):
    planner.plan(1000.0, 20.0, 0.0)
    schedule = planner.schedule
    monkeypatch.setitem(METHODS, "interior_point", fail)
    monkeypatch.setattr(planner, "last", None)
    found = planner.plan(1200.0, float(schedule.speed_at(1200.0)), schedule.due(1200.0))
    assert found.status == "schedule"
    assert found.profile.at(3000.0) == pytest.approx(float(schedule.speed_at(3000.0)), abs=0.1)


def test_without_plan_and_schedule_a_failed_solve_gives_a_cruise(planner, monkeypatch):
    monkeypatch.setitem(METHODS, "interior_point", fail)
    found = planner.plan(1000.0, 24.0, 0.0)
    assert found.status == "cruise"
    assert found.reason == "time is up"
    assert found.profile.speed[0] == pytest.approx(24.0)
    assert found.profile.speed[30:].max() <= planner.config.v_ref + 1e-6
    assert planner.trip.schedule_error == "time is up"


def test_a_solve_beyond_its_time_limit_gives_a_fallback():
    hurried = RecedingPlanner(ROAD, PARAMETERS, receding=RecedingConfig(time_limit=1e-6))
    found = hurried.plan(1000.0, 20.0, 0.0)
    assert found.status in ("schedule", "cruise")
    assert found.reason


def test_an_optimum_that_is_not_finite_is_not_used(planner, monkeypatch):
    solve = METHODS["interior_point"]

    def spoiled(task, guess, **settings):
        answer = solve(task, guess, **settings)
        return replace(answer, speed=np.where(np.arange(answer.speed.size) == 7, np.nan, 20.0))

    monkeypatch.setitem(METHODS, "interior_point", spoiled)
    found = planner.plan(1000.0, 20.0, 0.0)
    assert found.status == "cruise"
    assert "finite" in found.reason
    assert np.isfinite(found.profile.speed).all()


def test_a_climb_beyond_full_power_gives_a_cruise_with_the_reason():
    height = np.concatenate([np.zeros(40), 50.0 * 0.24 * np.arange(201)])
    wall = RoadProfile(STATION, height, np.full(241, 25.0), "wall")
    found = RecedingPlanner(wall, PARAMETERS, receding=PATIENT).plan(0.0, 20.0, 0.0)
    assert found.status == "cruise"
    assert "full power" in found.reason
    assert np.isfinite(found.profile.speed).all()
    assert found.profile.speed.min() >= 1.0


def test_the_last_plan_reaches_the_roads_end_and_v_ref_holds_beyond(planner):
    end = float(STATION[-1])
    for station in np.arange(end - 1000.0, end - 205.0, 100.0):
        found = planner.plan(station, 20.0, station / 20.0)
        assert found.status == "optimal"
        assert found.profile.station[-1] == pytest.approx(end)
    last = found.profile
    arriving = planner.plan(end - 100.0, last.at(end - 100.0), 600.0)
    assert (arriving.status, arriving.reason) == ("kept", "the trip ends here")
    beyond = planner.plan(end + 20.0, last.at(end), 610.0)
    assert beyond.status == "optimal"
    assert beyond.profile.speed[20:60] == pytest.approx(np.full(40, 20.0), abs=1.0)


def test_a_truck_above_the_limit_brakes_to_it():
    limit = np.full(241, 25.0)
    limit[21:] = 14.0
    slow = replace(ROAD, v_limit=limit)
    found = RecedingPlanner(slow, PARAMETERS, receding=PATIENT).plan(1040.0, 22.0, 0.0)
    assert found.status == "optimal"
    assert found.profile.at(1040.0) == pytest.approx(22.0)
    assert found.profile.at(1500.0) <= 14.0 + 1e-6


def test_grid_has_the_roads_limits_at_its_nodes_and_the_lower_one_between(planner):
    limit = np.full(241, 25.0)
    limit[40:60] = 14.0
    slow = RecedingPlanner(replace(ROAD, v_limit=limit), PARAMETERS, receding=PATIENT)
    assert np.array_equal(slow.trip.grid(500.0, 100).v_limit, limit[10:111])
    between = slow.trip.grid(510.0, 100).v_limit
    assert np.array_equal(between, np.minimum(limit[10:111], limit[11:112]))


@pytest.mark.parametrize("speed", [0.0, 1.0, 5.0])
@pytest.mark.parametrize("limit", [0.8, 1.5, 1.99])
def test_a_limit_of_crawling_speed_does_not_count_as_lack_of_power(speed, limit):
    limits = np.full(241, 13.0)
    limits[[2, 3, 20]] = limit
    slow = RecedingPlanner(replace(LEVEL, v_limit=limits), PARAMETERS, receding=PATIENT)
    found = slow.plan(0.0, speed, 0.0)
    assert (found.status, found.reason) == ("optimal", "")
    assert found.profile.at(1000.0) <= max(limit, 1.2) + 1e-6
    assert found.profile.at(800.0) > 5.0


def test_changed_limits_make_a_new_plan_and_schedule_at_once(planner):
    planner.plan(1000.0, 20.0, 0.0)
    planner.trip.limit_by(lambda station: np.where((station > 1900) & (station < 3100), 10.0, 25.0))
    try:
        found = planner.plan(1020.0, 20.0, 1.0)
        assert found.status == "optimal"
        assert planner.trip.schedules == 2
        inside = (planner.schedule.station > 1900.0) & (planner.schedule.station < 3100.0)
        assert planner.schedule.speed[inside].max() <= 10.0 + 1e-6
        assert found.profile.at(2500.0) <= 10.0 + 1e-6
        planner.plan(1040.0, 20.0, 2.0)
        assert planner.trip.schedules == 2
    finally:
        planner.trip.limits = None


def test_a_stopped_truck_gets_a_plan_that_starts_it(planner):
    found = planner.plan(0.0, 0.0, 0.0)
    assert found.status == "optimal"
    assert found.profile.speed[0] > 0.0
    assert found.profile.at(1000.0) > 10.0


# Wrong use ----------------------------------------------------------------------------------------


def test_numbers_that_are_not_finite_are_refused_by_name(planner):
    with pytest.raises(InputError, match=r"speed \[m/s\] = nan"):
        planner.plan(0.0, float("nan"), 0.0)
    with pytest.raises(InputError, match="time is inf"):
        planner.plan(0.0, 20.0, float("inf"))
    with pytest.raises(InputError, match="rear is inf"):
        Leader(float("inf"), 10.0)
    with pytest.raises(InputError, match="appointment: time is nan"):
        Appointment(1000.0, float("nan"))


@pytest.mark.parametrize(
    ("state", "why"),
    [
        ((-500.0, 20.0, 0.0), r"station \[m\] = -500.0: allowed is -100 to 12100"),
        ((13_000.0, 20.0, 0.0), r"station \[m\] = 13000.0: allowed is -100 to 12100"),
        ((1000.0, 90.0, 0.0), r"speed \[m/s\] = 90.0: allowed is -60 to 60"),
        ((1000.0, 20.0, 0.0, Leader(990.0, 10.0)), "gap -10 m to the vehicle ahead"),
        ((1000.0, 20.0, 0.0, None, -1.0), "flow is -1.0"),
    ],
)
def test_impossible_states_are_refused_by_name(planner, state, why):
    with pytest.raises(InputError, match=why):
        planner.plan(*state)


@pytest.mark.parametrize("mass", [0.0, -55_000.0, 6_000.0, 79_000.0, float("nan")])
def test_impossible_masses_are_refused_by_name(mass):
    with pytest.raises(InputError, match=rf"mass \[kg\] = {mass!r}"):
        RecedingPlanner(LEVEL, PARAMETERS, mass)


@pytest.mark.parametrize(
    ("kind", "change"),
    [
        (RecedingConfig, {"horizon": 0.0}),
        (RecedingConfig, {"time_limit": float("nan")}),
        (RecedingConfig, {"slack": -0.1}),
        (RecedingConfig, {"surplus": float("nan")}),
        (FlowConfig, {"memory": 0.0}),
        (RecedingConfig, {"power_share": 1.2}),
        (LeaderConfig, {"time_gap": float("inf")}),
    ],
)
def test_settings_out_of_bounds_are_refused_by_name(kind, change):
    with pytest.raises(InputError, match=next(iter(change))):
        kind(**change)


def test_flow_is_the_mean_of_the_vehicles_in_sight_and_fades():
    def ahead(station, speed, lane=0):
        return TrackedVehicle(f"at {station}", station=station, speed=speed, lane=lane)

    flow, margin = Flow(), FlowConfig().margin
    others = [ahead(900.0, 2.0), ahead(1150.0, 14.0, -1), ahead(2000.0, 25.0)]
    assert flow.update(0.0, 1000.0, others) == np.inf
    flow.reset()
    assert flow.update(0.0, 1000.0, [*others, ahead(1100.0, 14.0), ahead(1200.0, 16.0)]) == (
        pytest.approx(15.0 + margin)
    )
    assert flow.update(1.0, 1000.0, []) == pytest.approx(15.0 + margin)
    assert flow.update(60.0, 1000.0, []) == np.inf


def test_plans_with_gears_roll_in_neutral_and_burn_less_in_the_same_time():
    truck, config = TruckParameters.load("vecto_40t"), PccConfig(v_ref=23.0, v_min=21.5, v_max=24.5)
    station = 50.0 * np.arange(121)
    height = 12.7 * (1.0 - np.cos(2.0 * np.pi * station / 4_000.0))
    road = RoadProfile(station, height, np.full(121, np.inf), "hills")
    whole = plan(road, truck, 40_000.0, config)
    trip = Appointment(6_000.0, whole.plan.time, float(whole.plan.speed[-1]))
    burnt, modes = [], []
    for gears in (False, True):
        settings = replace(PATIENT, power_share=1.0, surplus=0.0, reserve=0.0, gears=gears)
        planner = RecedingPlanner(road, truck, 40_000.0, config, settings, trip)
        first = planner.plan(0.0, float(whole.plan.speed[0]), 0.0)
        assert first.status == "optimal"
        modes.append(first.profile.transmission_mode)
        driven = drive(planner, 0.0, 5_990.0, float(whole.plan.speed[0]), period=5.0)
        speed = np.sqrt(np.interp(station, driven.station, driven.speed**2))
        tables = GearTables.of(truck, float(speed.min()) - 0.1, float(speed.max()) + 0.1)
        task = JointTask(planner.vehicle, road, tables, speed**2, speed**2, states=2)
        found = gears_at(task.at_price(whole.time_price), speed)
        assert found.time == pytest.approx(whole.plan.time, rel=0.01)
        burnt.append(found.fuel.sum() + whole.time_price * (found.time - whole.plan.time))
    assert modes[0] is None
    assert set(modes[1]) == {TransmissionMode.DRIVE, TransmissionMode.NEUTRAL}
    assert burnt[1] < 0.99 * burnt[0]
