"""Plan against cruise on the truck: measures, corrections, and kept drives."""

import dataclasses

import numpy as np
import pytest

from controllers.pcc.fuel import FuelMap
from controllers.pcc.planner import evaluate, make_vehicle
from controllers.pcc.profile import RoadProfile
from controllers.pcc.schedule import make_schedule
from controllers.pcc.vehicle import cruise
from iits_mj.core.errors import InputError
from iits_mj.core.messages import SpeedProfile, TransmissionMode
from iits_mj.validation.harness.config import PAPER_ROAD, ValidateConfig
from iits_mj.validation.planning import replay_drives
from iits_mj.validation.planning.closed_loop import COLUMNS, Record
from iits_mj.validation.planning.pcc_replay import (
    full_cases,
    highway_case,
    paper_case,
    route_case,
    run_replay,
    title,
    valley_case,
)
from iits_mj.validation.planning.replay_drives import (
    CruiseAndPlan,
    MeasuredDrive,
    climbing_power,
    cruise_time,
    plan_with_gears,
    reference_profile,
    set_speed,
    with_all_power,
    with_modes,
    with_power_of,
)

CASE = valley_case(1_000.0, 0.005, depth=0.02)


def record(speed, fuel_rate=0.005, pedal=0.5, torque=1_500.0, engine_speed=130.0):
    """A steady drive over the whole of CASE's route."""
    time = np.arange(0.0, CASE.route.length / speed, 0.02)
    table = np.zeros((time.size, len(COLUMNS)))
    columns = {
        "time": time,
        "station": speed * time,
        "speed": np.full(time.size, speed),
        "fuel_used": fuel_rate * time,
        "pedal": np.full(time.size, pedal),
        "engine_torque": np.full(time.size, torque),
        "engine_speed": np.full(time.size, engine_speed),
    }
    for name, values in columns.items():
        table[:, COLUMNS.index(name)] = values
    return Record(table)


def replay_of(cruise, plan):
    parameters = CASE.parameters()
    fuel_map = FuelMap(parameters)
    vehicle = make_vehicle(parameters, fuel_map, 19_000.0, CASE.config)
    schedule = make_schedule(
        vehicle, CASE.road, CASE.config, 20.0, 0.0, arrival=50.0, end_speed=20.0
    )
    drive = evaluate(vehicle, fuel_map, CASE.road, schedule.speed)
    trips = MeasuredDrive.of(cruise, CASE), MeasuredDrive.of(plan, CASE)
    return CruiseAndPlan(CASE, vehicle, vehicle, schedule, *trips, drive, drive)


def schedule_of(arrival, start=20.0, end=20.0):
    """A plan over CASE's road and its fuel by the optimizer's model [kg]."""
    parameters = CASE.parameters()
    vehicle = make_vehicle(parameters, FuelMap(parameters), 19_000.0, CASE.config)
    schedule = make_schedule(
        vehicle, CASE.road, CASE.config, start, 0.0, arrival=arrival, end_speed=end
    )
    return schedule, float(vehicle.fuel_of(schedule.speed, CASE.road).sum())


def test_time_and_fuel_are_those_of_the_measured_stretch():
    trip = MeasuredDrive.of(record(20.0), CASE)
    assert trip.time == pytest.approx(50.0, abs=1e-6)
    assert trip.fuel == pytest.approx(0.25, abs=1e-6)
    assert trip.record["station"].min() >= CASE.first
    assert trip.record["station"].max() <= CASE.last
    assert pytest.approx(replay_drives.RUN_IN) == CASE.first


def test_equal_drives_save_nothing_and_a_fifth_less_fuel_is_20_percent():
    base = record(20.0)
    assert replay_of(base, base).saving == pytest.approx(0.0, abs=1e-12)
    assert replay_of(base, record(20.0, 0.004)).saving == pytest.approx(0.2, abs=1e-9)


def test_faster_end_is_worth_fuel_and_faster_start_costs_fuel_by_the_optimizer():
    replay = replay_of(record(20.0), record(20.0))
    faster = dataclasses.replace(replay.plan, end_speed=20.2)
    ended = dataclasses.replace(replay, plan=faster).speed_worth
    started = dataclasses.replace(
        replay, plan=dataclasses.replace(replay.plan, start_speed=20.2)
    ).speed_worth
    base = replay_fuel(50.0)
    assert ended == pytest.approx(replay_fuel(50.0, end=20.2) - base, rel=0.02)
    assert started == pytest.approx(replay_fuel(50.0, start=20.2) - base, rel=0.02)
    assert ended > 0.0 > started


def replay_fuel(arrival, start=20.0, end=20.0):
    """Fuel of the optimum [kg]."""
    return schedule_of(arrival, start, end)[1]


def test_longer_trip_is_charged_the_saving_of_the_optimizer():
    schedule, fuel = schedule_of(48.0)
    replay = dataclasses.replace(replay_of(record(20.0), record(20.0)), schedule=schedule)
    later = dataclasses.replace(replay.plan, time=replay.cruise.time + 0.2)
    longer = dataclasses.replace(replay, plan=later)
    assert longer.time_worth == pytest.approx(fuel - schedule_of(48.2)[1], rel=0.1)
    assert longer.time_worth > 0.0
    assert longer.saving < longer.raw_saving


def test_climbing_power_is_the_engine_power_at_full_pedal():
    climb = record(20.0, pedal=1.0)
    assert climbing_power(climb) == pytest.approx(1_500.0 * 130.0)
    # A gear change and the seconds after it, in which the torque comes back, do not count.
    changing = (climb["time"] > 20.0) & (climb["time"] < 25.0)
    climb.table[changing, COLUMNS.index("engine_torque")] = 0.0
    climb.table[(climb["time"] > 20.0) & (climb["time"] < 21.0), COLUMNS.index("shift")] = 1.0
    assert climbing_power(climb) == pytest.approx(1_500.0 * 130.0)
    assert climbing_power(record(20.0)) is None


def on(road):
    """CASE on another road, with the cruise that brakes at its set speed."""
    config = dataclasses.replace(CASE.config, rolls=False)
    return dataclasses.replace(CASE, road=road, config=config)


def climber(power_share):
    """A laden point mass with a share of its power, and a climb of 3 %."""
    parameters = CASE.parameters()
    vehicle = make_vehicle(parameters, FuelMap(parameters), 55_000.0, CASE.config)
    vehicle = dataclasses.replace(vehicle, power_max=power_share * vehicle.power_max)
    station = np.arange(0.0, 4_001.0, 50.0)
    road = RoadProfile.from_heights(station, np.interp(station, [1e3, 3e3], [0.0, 60.0]), 50.0)
    return vehicle, road


def test_cruise_at_the_estimated_power_takes_as_long_as_the_driven_cruise():
    strongest, road = climber(1.0)
    weaker, _ = climber(0.75)
    time = cruise_time(weaker, on(road), 20.0, 20.0)
    assert time > cruise_time(strongest, on(road), 20.0, 20.0) + 5.0
    climb = record(20.0, pedal=1.0, torque=0.9 * strongest.power_max / 130.0)
    found = with_power_of(strongest, on(road), climb, 20.0, 20.0, time)
    assert found.power_max == pytest.approx(weaker.power_max, rel=1e-4)
    # Without a climb at full pedal the delay has other causes: the engine's power holds.
    level = with_power_of(strongest, on(road), record(20.0), 20.0, 20.0, time)
    assert level.power_max == strongest.power_max


def test_set_speed_exceeds_the_mean_speed_on_a_road_with_climbs():
    vehicle, road = climber(0.75)
    case = on(road)
    v_set = set_speed(vehicle, case, 19.0)
    assert v_set > 19.2
    assert road.length / cruise_time(vehicle, case, v_set, v_set) == pytest.approx(19.0, rel=1e-6)
    # For an unreachable mean the greatest allowed speed remains.
    assert set_speed(vehicle, case, 24.9) == pytest.approx(25.0)


def test_set_speed_of_a_rolling_cruise_may_be_below_the_mean_speed():
    vehicle, road = climber(1.0)
    down = dataclasses.replace(road, height=-road.height)
    case = dataclasses.replace(CASE, road=down)
    assert case.top == case.config.v_max
    v_set = set_speed(vehicle, case, 20.0)
    assert v_set < 19.8
    assert down.length / cruise_time(vehicle, case, v_set, v_set) == pytest.approx(20.0, rel=1e-6)


def test_the_trucks_mean_speed_is_corrected_by_a_second_cruise(tmp_path, monkeypatch):
    driven = []

    def drive(task, parameters):
        driven.append(task.cruise_speed)
        return record(0.97 * task.cruise_speed)

    monkeypatch.setattr(replay_drives, "drive", drive)
    mean = dataclasses.replace(CASE.config, mean_speed=True)
    replay = replay_drives.run(dataclasses.replace(CASE, config=mean), tmp_path, drives=1)
    assert CASE.road.length / replay.cruise.time == pytest.approx(20.0, rel=1e-3)
    assert replay.case.config.v_ref == pytest.approx(20.0 / 0.97, rel=2e-3)
    # Two drives for the set speed, of which the better one is kept, and one drive of the plan.
    assert len(driven) == 3


def test_correction_of_the_set_speed_uses_the_power_of_the_driven_cruise(monkeypatch):
    """An overestimated power would make the correction of the set speed too small."""
    weaker, road = climber(0.7)
    driven = []

    def drive(task, parameters):
        driven.append(task.cruise_speed)
        mean = road.length / cruise_time(weaker, case, task.cruise_speed, task.cruise_speed)
        return record(mean, pedal=1.0, torque=0.9 * weaker.power_max / 0.7 / 130.0)

    monkeypatch.setattr(replay_drives, "drive", drive)
    mean = dataclasses.replace(CASE.config, v_ref=19.0, mean_speed=True, rolls=False)
    case = valley_case(4_000.0, 0.005, depth=0.02)
    case = dataclasses.replace(case, config=mean, payload=36_000.0, road=road)
    monkeypatch.setitem(globals(), "CASE", case)
    found = replay_drives.run(case, None, drives=1)
    assert road.length / found.cruise.time == pytest.approx(19.0, rel=1e-3)
    assert len(set(driven)) == 2


def test_reference_speed_is_raised_where_the_plan_uses_all_of_its_power():
    weaker, road = climber(0.75)
    strongest, _ = climber(1.0)
    planned = cruise(weaker, road, 20.0, 20.0)
    raised = with_all_power(weaker, strongest, road, planned, 25.0)
    climb = (road.station > 1_100.0) & (road.station < 2_900.0)
    assert (raised >= planned).all()
    assert (raised[climb] > planned[climb] + 0.1).all()
    # Until the torque must build up for the climb nothing changes.
    before = road.station <= 1_000.0 - 6.0 * 20.0
    assert raised[before] == pytest.approx(planned[before])
    power = strongest.power(raised, road)
    assert power.max() <= 1.001 * strongest.power_max
    # Back to the plan by coasting, without brakes.
    assert strongest.net_force(raised, road).min() > -1.0
    assert raised.max() <= 25.0


def test_a_short_break_of_full_power_is_pulled_through():
    weaker, road = climber(0.75)
    strongest, _ = climber(1.0)
    planned = cruise(weaker, road, 20.0, 20.0)
    node = int(np.searchsorted(road.station, 2_000.0))
    planned[node] -= 0.05
    raised = with_all_power(weaker, strongest, road, planned, 25.0)
    gain = raised - planned
    assert gain[node] == pytest.approx(0.5 * (gain[node - 1] + gain[node + 1]), abs=0.1)
    assert gain[node] > 0.1


def test_speed_profile_equals_the_plan_at_its_nodes():
    replay = replay_of(record(20.0), record(20.0))
    profile = reference_profile(CASE, replay.vehicle, replay.schedule)
    # The run-in is that of the cruise.
    run_in = profile.station < CASE.first
    assert profile.station[0] == pytest.approx(CASE.first - replay_drives.RUN_IN)
    assert profile.speed[run_in] == pytest.approx(CASE.config.v_ref)
    assert profile.station[-1] == pytest.approx(CASE.last)
    nodes = CASE.origin + replay.schedule.station
    assert np.interp(nodes, profile.station, profile.speed) == pytest.approx(
        replay.schedule.speed, abs=1e-6
    )


def test_reference_speed_drops_on_a_bump_by_its_potential_energy():
    replay = replay_of(record(20.0), record(20.0))
    bumpy = CASE.route.evaluate
    top = CASE.origin + 475.0

    class Bumpy:
        """CASE's route, 0.2 m higher about a place between two nodes."""

        def evaluate(self, station):
            point = bumpy(station)
            return point._replace(z=point.z + 0.2 * (np.abs(np.asarray(station) - top) < 8.0))

    case = dataclasses.replace(CASE, route=Bumpy())
    smooth = reference_profile(CASE, replay.vehicle, replay.schedule)
    rough = reference_profile(case, replay.vehicle, replay.schedule)
    lost = (smooth.speed**2 - rough.speed**2) * 0.5 * replay.vehicle.inertial_mass
    on_top = np.abs(smooth.station - top) < 8.0
    assert lost[on_top] == pytest.approx(19_000.0 * 9.81 * 0.2, rel=0.01)
    assert np.abs(lost[~on_top]).max() < 1e-6


def test_planner_and_truck_have_the_same_heights():
    for case in (CASE, highway_case(length=2_000.0)):
        station = case.origin + case.road.station
        height = np.asarray(case.route.evaluate(station).z)
        difference = height - case.road.height
        assert np.ptp(difference) < 0.25


def test_the_papers_saving_must_be_reached_at_its_set_and_at_its_mean_speed(tmp_path):
    station = np.arange(0.0, 15_301.0, 10.0)
    rows = "".join(f"{s},{20.0 * np.sin(s / 500.0)}\n" for s in station)
    (tmp_path / PAPER_ROAD).write_text("s_m,z_m\n" + rows)
    must = [case for case in full_cases(ValidateConfig(roads=tmp_path)) if case.paper]
    assert [case.config.mean_speed for case in must] == [True, False]
    assert all(case.config.v_ref == pytest.approx(20.0) for case in must)
    assert {case.parameters().gearbox.shift_strategy for case in must} == {"adaptive"}
    # The paper's saving is relative to a cruise that brakes at its set speed.
    assert not any(case.config.rolls for case in must)


def test_every_road_is_driven_with_both_cruises_and_with_gears_planned():
    cases = full_cases(ValidateConfig())
    kinds = [(case.config.rolls, case.joint) for case in cases]
    assert kinds == [(True, False), (False, False), (True, True)]
    assert [title(case).rsplit(", ", 1)[1] for case in cases] == [
        "rolling cruise",
        "braking cruise",
        "gears planned",
    ]


def test_joint_plan_of_a_case_has_its_ends_gears_and_stretches_in_neutral():
    station = np.arange(0.0, 4_001.0, 50.0)
    height = 20.0 * np.cos(2.0 * np.pi * station / 4_000.0)
    road = RoadProfile.from_heights(station, height, 50.0)
    case = dataclasses.replace(CASE, road=road, payload=36_000.0, joint=True)
    parameters = case.parameters()
    vehicle = make_vehicle(parameters, FuelMap(parameters), 55_000.0, case.config)
    schedule = make_schedule(vehicle, road, case.config, 20.0, 0.0, arrival=190.0, end_speed=20.0)
    gears = plan_with_gears(case, vehicle, schedule, 190.0)
    assert gears.speed[[0, -1]] == pytest.approx(schedule.speed[[0, -1]])
    assert gears.time <= 190.0
    profile = SpeedProfile(case.first + np.arange(-50.0, 4_100.0, 10.0), np.full(415, 20.0))
    modes = with_modes(case, profile, gears).transmission_mode
    for gear in set(gears.gear):
        mode = TransmissionMode.forward(gear) if gear else TransmissionMode.NEUTRAL
        assert np.count_nonzero(modes == mode) == 5 * np.count_nonzero(gears.gear == gear)
    assert not modes[:5].any()
    assert not modes[-10:].any()


def test_papers_road_without_its_file_is_left_out():
    assert paper_case(ValidateConfig()) is None


def test_finished_drive_is_read_from_its_folder(tmp_path, monkeypatch):
    calls = []

    def drive(task, parameters):
        calls.append(task)
        return record(20.0)

    monkeypatch.setattr(replay_drives, "drive", drive)
    case = valley_case(300.0, 0.005)
    first = replay_drives.run(case, tmp_path, drives=1)
    again = replay_drives.run(case, tmp_path, drives=1)
    assert len(calls) == 2
    assert again.plan.fuel == first.plan.fuel
    assert sorted(path.name.split("_")[1] for path in tmp_path.iterdir()) == ["cruise", "plan"]


def test_a_plan_that_cannot_be_faster_is_not_driven_again(monkeypatch):
    plans = []

    def drive(task, parameters):
        if task.profile is None:
            return record(20.0)
        plans.append(task)
        return record(14.0)

    monkeypatch.setattr(replay_drives, "drive", drive)
    replay = replay_drives.run(CASE, drives=9)
    assert replay.plan.time > 1.4 * replay.cruise.time
    assert len(plans) == 2


def test_a_route_of_which_run_in_and_end_leave_nothing_is_refused():
    with pytest.raises(InputError, match="too short to be driven"):
        route_case("road", CASE.route, CASE.config, 0.0, start=CASE.route.length - 620.0)


def test_a_route_without_run_in_is_refused():
    early = dataclasses.replace(CASE, origin=0.0)
    with pytest.raises(InputError, match="must begin 300 m before"):
        replay_drives.run(early)


@pytest.mark.slow
def test_quick_form_drives_plan_and_cruise_and_reports_no_saving():
    results = run_replay(ValidateConfig(quick=True))
    assert results.ok, results.to_table()
    figures = {check.name.split(": ")[1]: check.value for check in results.checks}
    assert not [name for name in figures if "saving" in name]
    assert figures["speed error where power suffices, rms"] < 0.3
    # The cruise rolls down into the valley and arrives first.
    assert 0.0 < figures["fuel, cruise"] < figures["fuel, plan"] < 0.1
    assert figures["trip time of the plan against the cruise's"] == pytest.approx(0.0, abs=3.0)


def test_drive_ahead_expects_the_saving_of_the_full_truck():
    case = valley_case(600.0, 0.005)
    ahead, driven = replay_drives.run_ahead(case, drives=1), replay_drives.run(case, drives=1)
    assert (ahead.case.plant, driven.case.plant) == ("kinematic", "full")
    assert ahead.plan.fuel != driven.plan.fuel
    assert 100.0 * ahead.saving == pytest.approx(100.0 * driven.saving, abs=0.5)
    assert ahead.cruise.time == pytest.approx(driven.cruise.time, rel=1e-3)


def test_trip_times_agree_although_the_truck_overreacts_to_its_time_budget(monkeypatch):
    """A gear change more or less makes the driven time change by more than the budget does."""
    plans = []

    def drive(task, parameters):
        if task.profile is None:
            return record(20.0)
        plans.append(task)
        # 2.2 s for every second of the budget; the first plan is late.
        within = task.profile.station >= CASE.first
        mean = 1.0 / np.mean(1.0 / task.profile.speed[within])
        return record(19.9 - 2.2 * (20.0 - mean))

    monkeypatch.setattr(replay_drives, "drive", drive)
    case = dataclasses.replace(CASE, config=dataclasses.replace(CASE.config, rolls=False))
    replay = replay_drives.run(case)
    assert abs(replay.plan.time / replay.cruise.time - 1.0) <= replay_drives.TIME_TOLERANCE
    assert 2 < len(plans) <= replay_drives.DRIVES
