"""Plan against cruise on the truck: what is compared, and how it is corrected."""

import dataclasses

import numpy as np
import pytest

from controllers.pcc.fuel import FuelMap
from controllers.pcc.planner import evaluate, make_vehicle
from controllers.pcc.schedule import make_schedule
from iits_mj.errors import InputError
from iits_mj.validation import replay_drives
from iits_mj.validation.closed_loop import COLUMNS, Record
from iits_mj.validation.config import ValidateConfig
from iits_mj.validation.pcc_replay import run_replay
from iits_mj.validation.replay_cases import highway_case, hill_case, paper_case
from iits_mj.validation.replay_drives import Replay, Trip, climbing_power, reference_profile

CASE = hill_case(1_000.0, 0.005)


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
    schedule = make_schedule(vehicle, CASE.road, CASE.config, 20.0, 0.0, arrival=50.0)
    drive = evaluate(vehicle, fuel_map, CASE.road, schedule.speed)
    trips = Trip.of(cruise, CASE), Trip.of(plan, CASE)
    return Replay(CASE, vehicle, schedule, *trips, drive, drive)


def test_only_the_measured_stretch_counts():
    trip = Trip.of(record(20.0), CASE)
    assert trip.time == pytest.approx(50.0, abs=1e-6)
    assert trip.fuel == pytest.approx(0.25, abs=1e-6)
    assert trip.record["station"].min() >= CASE.first
    assert trip.record["station"].max() <= CASE.last
    assert pytest.approx(replay_drives.RUN_IN) == CASE.first


def test_two_drives_alike_save_nothing_and_a_fifth_less_fuel_is_20_percent():
    base = record(20.0)
    assert replay_of(base, base).saving == pytest.approx(0.0, abs=1e-12)
    assert replay_of(base, record(20.0, 0.004)).saving == pytest.approx(0.2, abs=1e-9)


def test_a_faster_end_is_worth_fuel_and_a_faster_start_costs_the_same():
    replay = replay_of(record(20.0), record(20.0))
    faster = dataclasses.replace(replay.plan, end_speed=21.0)
    ended = dataclasses.replace(replay, plan=faster)
    assert ended.speed_worth > 0.0
    # Half m v^2 through engine and driveline: 19.6 t, 41 %, about 45.6 MJ/kg of fuel burnt.
    energy = 0.5 * replay.vehicle.inertial_mass * (21.0**2 - 20.0**2)
    assert ended.speed_worth == pytest.approx(energy / 0.45 / 43e6, rel=0.25)
    both = dataclasses.replace(faster, start_speed=21.0)
    assert dataclasses.replace(replay, plan=both).speed_worth == pytest.approx(0.0, abs=1e-12)


def test_climbing_power_is_what_the_engine_gives_with_the_pedal_on_the_floor():
    climb = record(20.0, pedal=1.0)
    assert climbing_power(climb, 4e5) == pytest.approx(1_500.0 * 130.0)
    # A gear change and the seconds after it, in which the torque comes back, do not count.
    changing = (climb["time"] > 20.0) & (climb["time"] < 25.0)
    climb.table[changing, COLUMNS.index("engine_torque")] = 0.0
    climb.table[(climb["time"] > 20.0) & (climb["time"] < 21.0), COLUMNS.index("shift")] = 1.0
    assert climbing_power(climb, 4e5) == pytest.approx(1_500.0 * 130.0)
    # No climb at full pedal: nothing is known, the engine's figure holds.
    assert climbing_power(record(20.0), 4e5) == 4e5


def test_the_profile_lies_on_the_plan_over_the_stations_of_the_route():
    replay = replay_of(record(20.0), record(20.0))
    profile = reference_profile(CASE, replay.vehicle, replay.schedule)
    assert profile.station[0] == pytest.approx(CASE.first)
    assert profile.station[-1] == pytest.approx(CASE.last)
    nodes = CASE.origin + replay.schedule.station
    assert np.interp(nodes, profile.station, profile.speed) == pytest.approx(
        replay.schedule.speed, abs=1e-6
    )


def test_over_a_bump_between_two_nodes_the_reference_slows_down_by_the_energy_it_takes():
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


def test_planner_and_truck_see_the_same_heights():
    for case in (CASE, highway_case(length=2_000.0)):
        station = case.origin + case.road.station
        height = np.asarray(case.route.evaluate(station).z)
        difference = height - case.road.height
        assert np.ptp(difference) < 0.25


def test_without_its_file_the_papers_road_is_left_out():
    assert paper_case(ValidateConfig()) is None


def test_a_finished_drive_is_taken_from_its_folder(tmp_path, monkeypatch):
    calls = []

    def drive(task, parameters):
        calls.append(task)
        return record(20.0)

    monkeypatch.setattr(replay_drives, "drive", drive)
    case = hill_case(300.0, 0.005)
    first = replay_drives.run(case, tmp_path, drives=1)
    again = replay_drives.run(case, tmp_path, drives=1)
    assert len(calls) == 2
    assert again.plan.fuel == first.plan.fuel
    assert sorted(path.name.split("_")[2] for path in tmp_path.iterdir()) == ["cruise", "plan"]


def test_a_route_without_run_in_is_refused():
    early = dataclasses.replace(CASE, origin=0.0)
    with pytest.raises(InputError, match="must begin 300 m before"):
        replay_drives.run(early)


@pytest.mark.slow
def test_the_quick_form_drives_plan_and_cruise_on_the_truck():
    results = run_replay(ValidateConfig(quick=True))
    assert results.ok
    figures = {check.name.split(": ")[1]: check.value for check in results.checks}
    assert figures["fuel, plan"] > 0.0
    assert figures["fuel, cruise"] > 0.0
