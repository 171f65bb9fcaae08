"""Reference speeds in the stack: constant, profile, predictive cruise control."""

import dataclasses
import math
from dataclasses import replace

import numpy as np
import pytest

from controllers.decision.base import DecisionContext
from controllers.pcc import Appointment, PccConfig, PccReference, RecedingConfig
from controllers.pcc.solver import METHODS
from controllers.planning.config import PlannerConfig, SpeedConfig
from controllers.planning.speed_reference import (
    CruiseReference,
    ProfileReference,
    check_covers,
    read_profile,
)
from controllers.stack import Stack
from iits_mj.core.errors import InputError, PlanningError
from iits_mj.core.messages import (
    Decision,
    EgoState,
    RoadSignals,
    Scene,
    SpeedProfile,
    SpeedZone,
    TrackedVehicle,
)
from iits_mj.core.neighbors import Neighbor, Neighbors
from iits_mj.parameters import TruckParameters
from iits_mj.road import Route
from iits_mj.road.measured import Lanes, measured_route

PARAMETERS = TruckParameters.load()
PROFILE = SpeedProfile(np.array([0.0, 1000.0, 2000.0]), np.array([15.0, 20.0, 15.0]))
PCC = PccConfig(v_ref=16.0, v_min=12.0, v_max=25.0)
RECEDING = RecedingConfig(time_limit=np.inf)


@pytest.fixture(scope="module")
def route():
    return Route.straight(length=6000.0, speed_limit=22.0)


def ego(route, station=500.0, speed=16.0, time=0.0, **fields):
    offset = float(route.lane_offset(0, station))
    point = route.evaluate(station, offset)
    return EgoState(
        time=time,
        x=float(point.x),
        y=float(point.y),
        yaw=float(point.heading),
        speed=speed,
        station=station,
        offset=offset,
        **fields,
    )


def vehicle(route, station, speed):
    return TrackedVehicle(
        "slow", speed=speed, station=station, offset=float(route.lane_offset(0, station))
    )


def stack_of(route, maker=None, **settings):
    config = PlannerConfig(speed=SpeedConfig(cruise_speed=PCC.v_ref))
    return Stack(route, maker, config, parameters=PARAMETERS, **settings)


class Watcher:
    """Records the reference speeds that the decision maker receives."""

    name = "watcher"

    def __init__(self):
        self.speeds = []

    def reset(self):
        self.speeds.clear()

    def decide(self, context: DecisionContext):
        self.speeds.append(context.reference_speed)
        return Decision.KEEP


def test_without_a_reference_the_stack_cruises(route):
    stack = stack_of(route)
    assert isinstance(stack.reference, CruiseReference)
    stack.plan(Scene(0.0, ego(route)))
    assert stack.reference_speed(3000.0) == PCC.v_ref


def test_a_profile_is_followed_by_the_planner(route):
    stack = stack_of(route, profile=PROFILE)
    assert isinstance(stack.reference, ProfileReference)
    planned = stack.plan(Scene(0.0, ego(route, speed=17.5)))
    assert planned.speed[-1] > 17.8
    assert stack.reference_speed(500.0) == pytest.approx(17.5)


def test_a_stack_has_one_reference(route):
    with pytest.raises(InputError, match="one speed reference"):
        stack_of(route, profile=PROFILE, reference=CruiseReference(15.0))


def test_pcc_plans_once_a_second_and_drives_the_level_at_the_reference_speed(route):
    reference = PccReference(route, PCC, PARAMETERS, RECEDING)
    stack = stack_of(route, reference=reference)
    for k in range(25):
        stack.plan(Scene(0.1 * k, ego(route, station=500.0 + 1.6 * k, time=0.1 * k)))
    report = reference.report()
    assert report.plans == {"optimal": 3}
    assert len(report.solve_time) == 3
    assert report.schedules == 1
    assert abs(report.lag) < 0.2
    assert stack.reference_speed(900.0) == pytest.approx(16.0, abs=0.1)


def test_pcc_takes_the_mass_that_the_truck_reports(route):
    reference = PccReference(route, PCC, PARAMETERS, RECEDING)
    stack = stack_of(route, reference=reference)
    stack.plan(Scene(0.0, ego(route, mass=19_000.0)))
    assert reference.planner.vehicle.mass == 19_000.0
    stack.reset()
    stack.plan(Scene(0.0, ego(route, mass=55_000.0)))
    assert reference.planner.vehicle.mass == 55_000.0
    with pytest.raises(InputError, match="mass is nan"):
        stack.plan(Scene(5.0, ego(route, mass=float("nan"))))


def test_a_slow_vehicle_ahead_lowers_the_reference_but_not_the_speed_without_traffic(route):
    watcher = Watcher()
    reference = PccReference(route, PCC, PARAMETERS, RECEDING)
    stack = stack_of(route, watcher, reference=reference)
    stack.plan(Scene(0.0, ego(route), [vehicle(route, 525.0, 11.0)]))
    assert reference.last.status == "optimal"
    assert stack.reference_speed(600.0) < 15.0
    assert watcher.speeds == [pytest.approx(16.0, abs=0.2)]


def test_a_vehicle_on_a_bridge_above_is_not_followed(route):
    point = route.evaluate(525.0, float(route.lane_offset(0, 525.0)))
    slow = replace(vehicle(route, 525.0, 11.0), x=float(point.x), y=float(point.y))
    speeds = []
    for height in (0.5, 6.0):
        reference = PccReference(route, PCC, PARAMETERS, RECEDING)
        stack = stack_of(route, reference=reference)
        stack.plan(Scene(0.0, ego(route), [replace(slow, z=float(point.z) + height)]))
        speeds.append(stack.reference_speed(600.0))
    assert speeds[0] < 15.0
    assert speeds[1] == pytest.approx(16.0, abs=0.2)


def test_the_table_of_the_traffic_is_made_once_per_cycle(route, monkeypatch):
    made = []
    count = Neighbors.__init__

    def counted(self, *arguments, **settings):
        made.append(self)
        count(self, *arguments, **settings)

    monkeypatch.setattr(Neighbors, "__init__", counted)
    stack = stack_of(route, reference=PccReference(route, PCC, PARAMETERS, RECEDING))
    stack.plan(Scene(0.0, ego(route), [vehicle(route, 525.0, 11.0)]))
    assert len(made) == 1


def test_a_launch_with_pcc_equals_that_of_a_cruise(route):
    speeds = []
    for reference in (PccReference(route, PCC, PARAMETERS, RECEDING), CruiseReference(PCC.v_ref)):
        stack = stack_of(route, reference=reference)
        found = []
        for speed in (0.0, 3.0, 6.0):
            stack.reset()
            found.append(stack.plan(Scene(0.0, ego(route, speed=speed))).speed[-1])
        speeds.append(found)
    assert speeds[0][0] > 2.0
    assert speeds[0] == pytest.approx(speeds[1], abs=0.05)


def test_zones_of_changing_signs_are_in_plan_and_schedule_while_they_hold(route):
    reference = PccReference(route, PCC, PARAMETERS, RECEDING)
    stack = stack_of(route, reference=reference)
    stack.plan(Scene(0.0, ego(route)))
    zones = RoadSignals(None, (SpeedZone(900.0, 1500.0, 9.0),))
    stack.plan(Scene(1.0, ego(route, 516.0, time=1.0), signals=zones))
    assert reference.last.status == "optimal"
    assert reference.at(1200.0) <= 9.0 + 1e-6
    assert float(reference.planner.schedule.speed_at(1200.0)) <= 9.0 + 1e-6
    assert reference.at(2500.0) > 14.0
    assert abs(reference.report().lag) < 1.0
    stack.plan(Scene(2.0, ego(route, 532.0, time=2.0)))
    assert reference.at(1200.0) == pytest.approx(16.0, abs=0.3)
    assert reference.report().schedules == 3


def test_a_zone_of_another_lane_is_not_the_trucks(route):
    reference = PccReference(route, PCC, PARAMETERS, RECEDING)
    zones = RoadSignals(None, (SpeedZone(900.0, 1500.0, 9.0, lane=1),))
    stack_of(route, reference=reference).plan(Scene(0.0, ego(route), signals=zones))
    assert reference.at(1200.0) == pytest.approx(16.0, abs=0.3)


def test_pcc_plans_the_same_speed_in_bends_as_the_trajectory_planner():
    station = np.arange(0.0, 3001.0, 5.0)
    curvature = np.interp(station, [1000.0, 1040.0, 1140.0, 1180.0], [0.0, 1.0, 1.0, 0.0]) / 80.0
    flat = np.zeros(station.size)
    bend = measured_route(station, flat, curvature=curvature, lanes=Lanes(2, 4.0, 22.0))
    reference = PccReference(bend, PCC, PARAMETERS, RECEDING)
    stack = stack_of(bend, reference=reference)
    stack.plan(Scene(0.0, ego(bend, mass=55_000.0)))
    bearable = math.sqrt(stack.planner.config.speed.curve_acceleration * 80.0)
    assert reference.at(1100.0) <= bearable + 0.1
    assert reference.at(1100.0) > 0.9 * bearable
    # The plan slows down shortly before the bend and speeds up after it.
    assert reference.at(900.0) > bearable + 2.0
    assert float(reference.planner.schedule.speed_at(1100.0)) <= bearable + 0.1
    assert reference.at(2000.0) > 14.0


def test_impossible_neighbors_and_masses_are_refused_by_name(route):
    reference = PccReference(route, PCC, PARAMETERS, RECEDING)
    scene = Scene(0.0, ego(route))
    with pytest.raises(InputError, match="gap -30 m"):
        reference.update(scene, lambda: Neighbor("slow", -30.0, 525.0, 0.0, 11.0, 0.0, 4.8, 1.9))
    reference.reset()
    beside = Neighbor("slow", -2.0, 525.0, 0.0, 11.0, 0.0, 4.8, 1.9)
    assert reference.update(scene, lambda: beside).speed.size > 10
    reference.reset()
    with pytest.raises(InputError, match=r"mass \[kg\] = -5\.0"):
        reference.update(Scene(0.0, ego(route, mass=-5.0)), lambda: None)


def test_the_trajectory_brakes_for_a_stopped_vehicle_whatever_the_reference(route):
    reference = PccReference(route, PCC, PARAMETERS, RECEDING)
    stack = stack_of(route, reference=reference)
    planned = stack.plan(Scene(0.0, ego(route), [vehicle(route, 580.0, 0.0)]))
    assert planned.acceleration.min() < -1.0
    assert planned.speed[-1] < 10.0


def test_a_failing_optimizer_does_not_stop_the_stack(route, monkeypatch):
    def fail(task, guess, **settings):
        raise PlanningError("time is up")

    monkeypatch.setitem(METHODS, "interior_point", fail)
    reference = PccReference(route, PCC, PARAMETERS, RECEDING)
    stack = stack_of(route, reference=reference)
    planned = stack.plan(Scene(0.0, ego(route)))
    assert planned.speed == pytest.approx(np.full(planned.speed.size, 16.0), abs=0.1)
    assert reference.report().reasons == {"time is up": 1}


def test_two_drives_with_one_stack_are_the_same(route):
    stack = stack_of(route, reference=PccReference(route, PCC, PARAMETERS, RECEDING))
    scenes = [
        Scene(0.1 * k, ego(route, 500.0 + 1.6 * k, time=0.1 * k), [vehicle(route, 650.0, 15.0)])
        for k in range(12)
    ]
    found = []
    for _ in range(2):
        stack.reset()
        found.append([stack.plan(scene).speed for scene in scenes])
    assert np.array_equal(*found)


def test_numbers_that_are_not_finite_never_reach_the_optimizer(route):
    stack = stack_of(route, reference=PccReference(route, PCC, PARAMETERS, RECEDING))
    with pytest.raises(InputError, match=r"speed \[m/s\] = nan"):
        stack.plan(Scene(0.0, replace(ego(route), speed=float("nan"))))


def test_bad_periods_and_appointments_are_refused(route):
    with pytest.raises(InputError, match="period"):
        PccReference(route, PCC, PARAMETERS, RECEDING, period=0.0)
    with pytest.raises(InputError, match="station is nan"):
        Appointment(float("nan"))


def test_a_written_profile_is_read_back(tmp_path):
    path = tmp_path / "speed.csv"
    path.write_text(
        "station_m,height_m,speed_mps,cruise_speed_mps\n0,1,15,20\n50,1,16.5,20\n", encoding="utf-8"
    )
    found = read_profile(path)
    assert found.station.tolist() == [0.0, 50.0]
    assert found.speed.tolist() == [15.0, 16.5]


def test_a_profile_may_have_a_byte_order_mark_and_empty_rows(tmp_path):
    path = tmp_path / "speed.csv"
    path.write_text("\ufeffstation_m,speed_mps\n\n0,15\n50,16.5\n\n,\n", encoding="utf-8")
    assert read_profile(path).speed.tolist() == [15.0, 16.5]


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("", "columns"),
        ("a,b\n1,2\n3,4\n", "columns"),
        ("station_m,speed_mps\n1,2\n", "2 rows"),
        ("station_m,speed_mps\n1,x\n2,3\n", "not a number in row 1"),
        ("station_m,speed_mps\n1,15\n2,15\n3,x\n", "not a number in row 3"),
        ("station_m,speed_mps\n1\n2,3\n", "not a number"),
        ("station_m,speed_mps\n1,nan\n2,3\n", "finite"),
        ("station_m,speed_mps\n2,15\n1,15\n", "rise"),
        ("station_m,speed_mps\n1,15\n2,0\n", "not allowed"),
        ("station_m,speed_mps\n1,15\n2,90\n", "not allowed"),
    ],
)
def test_unusable_profiles_are_refused_with_the_reason(tmp_path, text, why):
    path = tmp_path / "speed.csv"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(InputError, match=why):
        read_profile(path)


def test_a_missing_profile_and_one_of_another_road_are_refused(tmp_path):
    with pytest.raises(InputError, match="cannot be read"):
        read_profile(tmp_path / "none.csv")
    with pytest.raises(InputError, match="nothing of it lies ahead"):
        check_covers(PROFILE, 2500.0, 6000.0, "profile")
    check_covers(PROFILE, 100.0, 6000.0, "profile")


def test_reports_are_plain_values(route):
    report = PccReference(route, PCC, PARAMETERS, RECEDING).report()
    assert dataclasses.asdict(report)["plans"] == {}
    assert np.isnan(report.lag)
