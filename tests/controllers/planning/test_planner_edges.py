"""The planner at its edges: slow crossings, chosen stops, curved roads, the air's drag."""

import dataclasses
import math

import numpy as np
import pytest

from controllers.planning import merging
from controllers.planning.config import LightConfig, PlannerConfig, Powers
from controllers.planning.crossing import crossing_leads
from controllers.planning.following import Lead
from controllers.planning.lane_change import Change
from controllers.planning.planner import Planner
from controllers.planning.predicted_boxes import Poses
from controllers.planning.road_preview import RoadPreview, lane_shift
from controllers.planning.rollover_limits import RollMargins
from controllers.planning.safety import SafetyConfig, conflict, rear_gap_needed
from controllers.planning.speed_caps import with_zones
from controllers.planning.speed_plan import most_urgent
from controllers.planning.speed_reference import check_covers, check_profile
from controllers.planning.stopped_vehicle import way_past
from controllers.planning.stops import LightStop, Stops, _needed
from controllers.planning.tight_bend_yield import TightBends
from controllers.planning.trajectory import Quintic, on_road
from iits_mj.core.errors import InputError
from iits_mj.core.messages import (
    Decision,
    EgoState,
    LightState,
    RoadSignals,
    Scene,
    SpeedProfile,
    SpeedZone,
    TrafficLight,
)
from iits_mj.parameters import TruckParameters
from iits_mj.road import Route
from iits_mj.road.measured import Lanes, measured_route
from tests.controllers.planning.test_crossing import bend
from tests.controllers.scenes import Ideal, car, posed

PARAMETERS = TruckParameters.load()
ROUTE = Route.straight(length=3_000.0, lanes=2)
PREVIEW = RoadPreview(ROUTE)
MARGIN = RollMargins(PARAMETERS, 1.0 / PlannerConfig().change.duration_min).at(30_000.0)


def test_the_drag_is_half_of_density_times_drag_area():
    air = PARAMETERS.aerodynamics
    assert Powers.of(PARAMETERS).drag == pytest.approx(0.5 * air.density * air.drag_area)


def test_the_first_station_that_does_not_rise_is_named():
    stations, speeds = np.array([0.0, 5.0, 5.0, 9.0, 3.0]), np.full(5, 10.0)
    with pytest.raises(InputError, match="do not after 5 m"):
        check_profile(SpeedProfile(stations, speeds), "test")


@pytest.mark.parametrize(("distance", "counts"), [(14.0, True), (18.0, True), (40.0, False)])
def test_a_crawling_truck_sees_a_vehicle_that_stands_across_its_lane(distance, counts):
    station, middle = 1000.0, float(ROUTE.lane_offset(0, 1000.0))
    across = posed(ROUTE, "across", station + distance, middle, 0.5 * math.pi, 0.0, lane=0)
    ego = EgoState(station=station, offset=middle, x=station, y=middle, speed=1.0)
    path = PREVIEW.follow(0, station, 400.0, 150.0)
    leads = crossing_leads(Scene(0.0, ego, (across,)), PREVIEW, PARAMETERS, path, None)
    assert [name for _, name in leads] == (["across"] if counts else [])
    if counts:
        # Front overhang, half of the vehicle's width and the room, to two meters.
        assert distance - 6.5 <= leads[0][0].gap <= distance - 2.0


def test_a_chosen_stop_is_braked_for_by_the_room_that_is_left():
    config = LightConfig()
    light = TrafficLight(station=100.0, state=LightState.YELLOW)
    stop = LightStop(config)
    first = stop.demand(light, 30.0, 15.0)
    assert math.isfinite(first.stop)
    later = stop.demand(light, 45.0, 15.0)
    assert later.deceleration == pytest.approx(_needed(55.0 - config.stop_before, 15.0))
    assert later.deceleration > first.deceleration
    # The choice lasts: too late for a new one.
    assert math.isfinite(stop.demand(light, 70.0, 15.0).stop)
    assert not math.isfinite(LightStop(config).demand(light, 70.0, 15.0).stop)


@pytest.mark.parametrize("aside", [-1.5, 0.0, 1.5])
def test_a_vehicle_without_a_pose_heads_along_its_course(aside):
    vehicle = dataclasses.replace(car(ROUTE, "car", 1050.0, 1, 10.0), lateral_speed=aside)
    scene = Scene(0.0, EgoState(station=1000.0), (vehicle,))
    found = Poses.of(scene.neighbors, np.array([True]), PREVIEW)
    assert found.to_road[0] == pytest.approx(math.asin(aside / 10.0))


def test_the_headings_of_a_trajectory_are_those_of_its_points_in_a_bend():
    road = bend()
    preview = RoadPreview(road)
    tight = float(preview.station[int(np.abs(preview.curvature).argmax())])
    path = preview.follow(0, tight - 20.0, 100.0, 50.0)
    residual = Quintic.to_zero(tight - 20.0, 60.0, 2.5)
    station = np.arange(tight - 15.0, tight + 20.0, 0.1)
    n = len(station)
    plan = on_road(preview, path, residual, 0.0, station, np.full(n, 5.0), np.zeros(n), 0.1)
    course = np.unwrap(np.arctan2(np.diff(plan.y), np.diff(plan.x)))
    middle = np.unwrap(plan.yaw)
    middle = 0.5 * (middle[1:] + middle[:-1])
    apart = np.angle(np.exp(1j * (course - middle)))
    assert np.median(np.abs(apart)) < 1e-3


def test_only_a_slow_truck_is_braked_harder_than_the_plan_near_a_stop():
    planner = Planner(ROUTE, PlannerConfig(), PARAMETERS)
    ego = EgoState(
        station=1000.0, offset=float(ROUTE.lane_offset(0, 0.0)), speed=9.0, mass=30_000.0
    )
    plan = planner.plan(Scene(0.0, ego, ()))
    planner._last = dataclasses.replace(plan, speed=np.full_like(plan.speed, 8.6))
    found = planner._start(Scene(0.3, ego, ()), 1010.0)
    assert found.speed == pytest.approx(8.6)
    slow = dataclasses.replace(ego, speed=7.9)
    planner._last = dataclasses.replace(plan, speed=np.full_like(plan.speed, 7.5))
    assert planner._start(Scene(0.3, slow, ()), 1010.0).speed == pytest.approx(7.8)


class DriftingLanes:
    """A straight road whose lanes move to the left by 1 m in 100 m."""

    def __init__(self):
        self._route = Route.straight(length=2000.0, lanes=2)
        self.length = self._route.length

    def __getattr__(self, name):
        return getattr(self._route, name)

    def lane_offset(self, lane, station):
        return self._route.lane_offset(lane, station) + 0.01 * np.asarray(station)


def test_a_truck_stays_in_its_lane_where_the_lanes_move_aside():
    road = DriftingLanes()
    ideal = Ideal(road, 100.0, 0, 20.0).run(32.0)
    assert ideal.ego.station > 600.0
    assert ideal.ego.offset == pytest.approx(
        float(road.lane_offset(0, ideal.ego.station)), abs=0.05
    )
    assert {plan.target_lane for plan in ideal.plans} == {0}


# --- parts at their edges -------------------------------------------------------------------


def at(station=1000.0, lane=0, speed=15.0, **fields):
    offset = float(ROUTE.lane_offset(lane, station))
    return EgoState(station=station, offset=offset, speed=speed, mass=30_000.0, **fields)


def test_a_vehicle_at_rest_points_where_its_pose_points():
    vehicle = posed(ROUTE, "still", 1050.0, 0.0, 0.3, 0.0)
    scene = Scene(0.0, at(), (vehicle, dataclasses.replace(vehicle, id="back", speed=-1.0)))
    found = Poses.of(scene.neighbors, np.array([True, True]), PREVIEW)
    assert found.to_road[0] == pytest.approx(0.3)
    assert abs(found.to_road[1]) == pytest.approx(math.pi - 0.3)


@pytest.mark.parametrize(("lane", "allowed"), [(0, 1), (1, 0)])
def test_room_is_kept_for_passing_on_either_side(lane, allowed):
    config = PlannerConfig(lanes=(lane, allowed))
    stops = Stops(PREVIEW, config, PARAMETERS)
    truck = at(lane=lane, speed=5.0)
    scene = Scene(0.0, truck, (car(ROUTE, "stopped", 1060.0, lane, 0.0),))
    path = PREVIEW.follow(lane, 1000.0, 400.0, 150.0)
    gap = scene.neighbors.leader_along_path(path).gap
    assert stops._keeps_room(scene, path, None) == pytest.approx(
        scene.neighbors.front + gap - config.passing.gap
    )
    alone = Stops(PREVIEW, PlannerConfig(lanes=(lane,)), PARAMETERS)
    assert alone._keeps_room(scene, path, None) == math.inf


def test_the_way_past_a_vehicle_ends_at_others_that_stand_on_this_road():
    target = PREVIEW.follow(1, 1000.0, 400.0, 150.0)
    size = float(ROUTE.lane_offset(0, 1000.0) - ROUTE.lane_offset(1, 1000.0))
    config = PlannerConfig().passing

    def way(*vehicles):
        scene = Scene(0.0, at(speed=2.0), (car(ROUTE, "stopped", 1040.0, 0, 0.0), *vehicles))
        return way_past(scene, PREVIEW, PARAMETERS, target, (size, 0.0, 0.0), config)

    assert way() is not None
    blocking = car(ROUTE, "other", 1040.0, 1, 0.0)
    assert way(blocking) is None
    assert way(dataclasses.replace(blocking, speed=3.0)) is not None
    assert way(dataclasses.replace(blocking, speed=-3.0)) is not None
    assert way(dataclasses.replace(blocking, z=8.0)) is not None
    assert way(dataclasses.replace(blocking, station=1400.0)) is not None


def test_the_leader_of_the_lane_being_left_counts_unless_it_is_passed():
    planner = Planner(ROUTE, PlannerConfig(), PARAMETERS)
    path = PREVIEW.follow(1, 1000.0, 400.0, 150.0)
    start, end = (float(ROUTE.lane_offset(lane, 1000.0)) for lane in (0, 1))
    scene = Scene(0.0, at(), (car(ROUTE, "old", 1022.0, 0, 8.0),))
    maneuver = planner.maneuver
    maneuver.residual = Quintic.to_zero(1000.0, 90.0, start - end)
    for passed, count in (("", 1), ("old", 0)):
        maneuver.change = Change(start, end - start, passed)
        assert len(planner._leads(scene, path)[0]) == count
    maneuver.change = Change(start, end - start)
    assert maneuver.origin(scene.ego).lane == 0
    maneuver.residual = None
    assert maneuver.origin(scene.ego) is None


def test_a_braking_leader_of_the_lane_being_left_counts_before_it_is_slower():
    planner = Planner(ROUTE, PlannerConfig(), PARAMETERS)
    path = PREVIEW.follow(1, 1000.0, 400.0, 150.0)
    start, end = (float(ROUTE.lane_offset(lane, 1000.0)) for lane in (0, 1))
    planner.maneuver.residual = Quintic.to_zero(1000.0, 90.0, start - end)
    planner.maneuver.change = Change(start, end - start)
    for braking, counts in ((0.0, False), (-0.5, False), (-5.0, True)):
        old = car(ROUTE, "old", 1015.0, 0, at().speed, acceleration=braking)
        found, _ = planner._leads(Scene(0.0, at(), (old,)), path)
        assert bool(found) == counts


@pytest.mark.parametrize(
    ("gap", "speed", "brakes"), [(3.0, 0.0, True), (3.0, 2.0, False), (6.0, 0.0, False)]
)
def test_nearer_than_the_standstill_gap_to_what_stands_the_truck_is_held(gap, speed, brakes):
    # On a descent the truck would roll on: its plan stands and demands nothing.
    ego = dataclasses.replace(at(), speed=0.6)
    other = car(ROUTE, "other", ego.station + 1.4 + gap + 2.4, 0, speed)
    plan = Planner(ROUTE, PlannerConfig(), PARAMETERS).plan(Scene(0.0, ego, (other,)))
    assert (plan.acceleration[-1] < -1.0) == brakes


def test_an_aborted_change_leaves_the_lane_that_it_had_begun_to_enter():
    planner = Planner(ROUTE, PlannerConfig(), PARAMETERS)
    maneuver, ego = planner.maneuver, at()
    path = PREVIEW.follow(1, 1000.0, 400.0, 150.0)
    start, end = (float(ROUTE.lane_offset(lane, 1000.0)) for lane in (0, 1))
    maneuver.residual = Quintic.to_zero(990.0, 90.0, start - end)
    maneuver.change = Change(start, end - start)
    back = maneuver._abort(ego, path, maneuver.change, planner._margins.at(ego.mass))
    assert (back.lane, maneuver.origin(ego).lane) == (0, 1)
    # A car that stands there, near and in the truck's width, is braked for.
    near = dataclasses.replace(car(ROUTE, "near", 1020.0, 1, 0.0), offset=start + 2.0)
    assert planner._leads(Scene(0.0, ego, (near,)), back)[0]


@pytest.mark.parametrize(("begin", "wanted"), [(0, Decision.LEFT), (1, Decision.RIGHT)])
def test_a_change_to_either_side_knows_its_size(begin, wanted):
    planner = Planner(ROUTE, PlannerConfig(), PARAMETERS)
    planner.plan(Scene(0.0, at(lane=begin), ()), wanted)
    width = float(ROUTE.lane_offset(1, 0.0) - ROUTE.lane_offset(0, 0.0))
    assert planner.maneuver.change.size == pytest.approx(width)


@pytest.mark.parametrize(
    ("follower_speed", "short"),
    [(15.1, True), (15.0, True), (14.95, True), (14.8, False), (6.0, False)],
)
def test_a_gap_counts_by_its_length_now_or_at_the_last_time_tried(follower_speed, short):
    # 20 m are free, the truck needs its length and two margins.
    vehicles = (
        car(ROUTE, "leader", 1024.5, 1, 15.0),
        car(ROUTE, "follower", 1000.0, 1, follower_speed),
    )
    neighbors = Scene(0.0, at(), vehicles).neighbors
    safety = PlannerConfig().safety
    needed = 16.5 + 2.0 * safety.margin
    later = 20.0 + (15.0 - follower_speed) * float(merging._TIMES[-1])
    assert (max(20.0, later) < needed) is short
    assert merging._too_short(neighbors, 0, 1, safety) is short


def test_a_profile_covers_up_to_its_last_station():
    rows = SpeedProfile(np.array([100.0, 150.0, 200.0]), np.full(3, 10.0))
    check_covers(rows, 180.0, 300.0, "test")
    check_covers(rows, 120.0, 160.0, "test")


@pytest.mark.parametrize(("shift", "same"), [(1.1, True), (1.3, False)])
def test_a_lane_goes_on_where_its_middle_moves_aside_by_less_than_1_2_m(shift, same):
    class Shifted(DriftingLanes):
        def lane_offset(self, lane, station):
            aside = np.where(np.asarray(station) > 502.0, shift, 0.0)
            return self._route.lane_offset(lane, station) + aside

    path = RoadPreview(Shifted()).follow(0, 450.0, 200.0, 100.0)
    assert (path.end > 600.0) is same


def test_a_light_that_turns_green_is_approached_slowly_to_the_end():
    config = LightConfig()
    stop = LightStop(config)

    def light(wait):
        return TrafficLight(
            station=100.0,
            state=LightState.RED,
            next_state=LightState.GREEN,
            next_switch=wait,
        )

    assert stop.demand(light(3.0), 40.0, 10.0).speed > config.slow_speed
    # The change is put off: the truck still rolls slowly to the line.
    late = stop.demand(light(60.0), 60.0, 8.0)
    assert late.speed == config.slow_speed
    assert late.deceleration >= config.yellow_deceleration


def test_a_light_that_has_let_the_truck_go_is_braked_for_gently_again():
    config = LightConfig()
    stop = LightStop(config)
    hard = stop.demand(TrafficLight(station=100.0, state=LightState.RED), 70.0, 10.0)
    assert hard.deceleration > config.deceleration
    assert not math.isfinite(
        stop.demand(TrafficLight(station=100.0, state=LightState.GREEN), 71.0, 9.0).stop
    )
    again = stop.demand(TrafficLight(station=100.0, state=LightState.RED), 71.0, 3.0)
    assert again.deceleration == pytest.approx(
        max(config.deceleration, _needed(29.0 - config.stop_before - config.reaction_time * 3, 3.0))
    )


def test_in_a_narrow_lane_the_waiting_place_lies_before_the_swept_ground():
    preview = RoadPreview(bend(width=2.6))
    bends = TightBends(preview, PARAMETERS)
    sweep = bends.ahead(preview.follow(0, 190.0, 400.0, 150.0), EgoState(station=190.0))
    begin, _ = bends._bends[0]
    assert sweep.begin == pytest.approx(min(begin, sweep.first) - 1.5)


def test_a_quintic_begins_straight_unless_told_otherwise():
    assert Quintic.to_zero(0.0, 50.0, 3.0).coefficients[:3] == (3.0, 0.0, 0.0)


def test_an_emergency_that_fades_still_brakes_at_least_as_hard_as_one_begins():
    planner = Planner(ROUTE, PlannerConfig(), PARAMETERS)
    speed = planner.config.speed
    wanted = speed.emergency_release + 0.05
    assert speed.emergency_share * wanted < speed.emergency_onset
    path = PREVIEW.follow(0, 1000.0, 400.0, 150.0)
    scene, cap = Scene(0.0, at(), ()), np.full(len(path.station), 30.0)

    def plan(gap):
        (_, _, acceleration), _ = planner._roll_out(scene, path, [Lead(gap, 4.0)], cap, False)
        return acceleration

    gaps = np.arange(10.0, 60.0, 0.25)
    urgencies = [most_urgent([Lead(gap, 4.0)], 15.0, speed) for gap in gaps.tolist()]
    middle = float(gaps[int(np.argmin(np.abs(np.array(urgencies) - wanted)))])
    first = plan(middle)[0]
    planner._emergency = True
    assert plan(middle)[0] == pytest.approx(-speed.emergency_onset)
    assert first > -speed.emergency_onset


@pytest.mark.parametrize(("more", "aborts"), [(-1.0, False), (1.0, True)])
def test_a_change_is_aborted_only_where_the_old_lane_leaves_room_to_stop(more, aborts):
    planner = Planner(ROUTE, PlannerConfig(), PARAMETERS)
    maneuver, merge = planner.maneuver, planner.config.merge
    truck = at(speed=15.0)
    start, end = (float(ROUTE.lane_offset(lane, 1000.0)) for lane in (0, 1))
    maneuver.residual = Quintic.to_zero(1000.0, 90.0, start - end)
    maneuver.change = Change(start, end - start)
    scene = Scene(0.0, truck, (car(ROUTE, "fast", 980.0, 1, 25.0),))
    path = PREVIEW.follow(1, 1000.0, 400.0, 150.0)
    room = 15.0**2 / (2.0 * merge.stop_deceleration) + merge.room + more
    ends = dataclasses.replace(PREVIEW.follow(0, 1000.0, 400.0, 150.0), end=1000.0 + room)
    maneuver._origin = lambda ego, change: ends
    assert maneuver._must_abort(scene, path, maneuver.change) is aborts
    # Later, when the change is nearly complete, it goes on.
    late = dataclasses.replace(truck, station=1000.0 + 75.0)
    assert not maneuver._must_abort(dataclasses.replace(scene, ego=late), path, maneuver.change)


def test_the_road_ahead_of_a_standing_or_reversing_truck_is_felt_for_a_meter():
    curved = RoadPreview(ROUTE)
    curved.curvature = np.where(curved.station > 999.0, 0.004, 0.0)
    planner = Planner(ROUTE, PlannerConfig(), PARAMETERS)
    planner.maneuver.preview = curved
    assert planner.maneuver._felt(1000.0, -200.0, 10.0) == pytest.approx(0.4, rel=1e-3)
    assert planner.maneuver._felt(900.0, 50.0, 10.0) == pytest.approx(0.0, abs=1e-9)
    assert planner.maneuver._felt(900.0, 120.0, 10.0) == pytest.approx(0.4, rel=1e-3)


def test_a_change_that_would_run_into_a_bend_is_planned_for_its_acceleration():
    def size_of(begin):
        curved = RoadPreview(ROUTE)
        curved.curvature = np.where(curved.station > begin, 1.0 / 450.0, 0.0)
        planner = Planner(ROUTE, PlannerConfig(), PARAMETERS)
        planner.maneuver.preview = curved
        path, target = (PREVIEW.follow(lane, 1000.0, 400.0, 150.0) for lane in (0, 1))
        assert planner.maneuver._begin(at(), path, target, 25.0, MARGIN) == ""
        return planner.maneuver.residual.length

    change = PlannerConfig().change
    reach = change.duration_min * 25.0
    free = size_of(2900.0)
    assert size_of(1000.0 + 0.5 * reach) > free
    assert size_of(1000.0 + max(free, reach) + 30.0) == free


@pytest.mark.parametrize("speed", [-5.0, 0.0])
def test_a_vehicle_that_reverses_behind_the_truck_needs_no_gap_to_stop(speed):
    safety = PlannerConfig().safety
    assert rear_gap_needed(0.0, speed, safety) == pytest.approx(
        safety.margin + max(safety.rear_time_gap * speed, 0.0)
    )


@pytest.mark.parametrize(("limit", "fast"), [(25.0, False), (60.0, True)])
def test_an_unseen_vehicle_drives_somewhat_above_the_limit_at_most(limit, fast):
    safety = SafetyConfig(sight_behind=120.0)
    path = PREVIEW.follow(1, 1000.0, 400.0, 150.0)
    unseen = min(limit * (1.0 + safety.speeding), safety.unlimited_speed)
    assert (unseen == safety.unlimited_speed) is fast
    text = conflict(Scene(0.0, at(speed=1.0), ()), path, safety, limit=limit)
    assert (f"{unseen:.0f} m/s" in text) if fast else (text is None)


def test_a_speed_zone_replaces_the_limit_and_only_lowers_it_just_outside():
    path = PREVIEW.follow(0, 1000.0, 400.0, 150.0)
    limit = float(path.speed_limit[0])
    for zone, near in ((8.0, 8.0), (60.0, limit)):
        found = with_zones(path, (SpeedZone(1001.0, 1101.0, zone),)).speed_limit
        at_row = dict(zip(path.station.tolist(), found.tolist(), strict=True))
        assert at_row[1005.0] == at_row[1100.0] == zone
        assert at_row[1000.0] == at_row[1105.0] == pytest.approx(near)
        assert at_row[995.0] == at_row[1110.0] == limit
    assert with_zones(path, (SpeedZone(1001.0, 1101.0, 8.0, lane=1),)).speed_limit.min() == limit


def test_the_limit_of_a_zone_may_be_walking_pace_but_not_zero():
    path = PREVIEW.follow(0, 1000.0, 400.0, 150.0)
    assert with_zones(path, (SpeedZone(1000.0, 1100.0, 0.5),)).speed_limit.min() == 0.5
    with pytest.raises(InputError, match="speed zone of 0"):
        with_zones(path, (SpeedZone(1000.0, 1100.0, 0.0),))


def test_a_vehicle_that_crawls_as_its_brakes_fade_stops_at_once():
    lead = Lead(10.0, 1e-4, -4e-4)
    assert lead.at(5.0) == pytest.approx((1e-5, 0.0))
    assert Lead(10.0, 0.0, -3.0).at(1.0) == (0.0, 0.0)


@pytest.mark.parametrize(
    ("vehicles", "returns"),
    [
        ((), True),
        ((car(ROUTE, "beside", 995.0, 0, 15.0),), False),
        ((car(ROUTE, "near", 1005.5, 0, 15.0),), False),
        ((car(ROUTE, "ahead", 1009.5, 0, 15.0),), True),
        ((car(ROUTE, "ahead", 1009.5, 0, 15.0), car(ROUTE, "beside", 995.0, 0, 15.0)), False),
    ],
)
def test_the_truck_returns_to_its_lane_only_if_that_is_free(vehicles, returns):
    planner = Planner(ROUTE, PlannerConfig(), PARAMETERS)
    origin = PREVIEW.follow(0, 1000.0, 400.0, 150.0)
    scene = Scene(0.0, dataclasses.replace(at(), offset=at().offset + 1.0), vehicles)
    assert planner.maneuver._can_return(scene, origin) is returns


def test_a_reset_forgets_the_stop_chosen_at_a_light():
    stops = Stops(PREVIEW, PlannerConfig(), PARAMETERS)
    path = PREVIEW.follow(0, 1000.0, 400.0, 150.0)
    cap = np.full(len(path.station), 20.0)

    def look(front, state):
        light = TrafficLight(station=1100.0, state=state)
        ego = at(front - 1.4)
        stops.look(Scene(0.0, ego, (), signals=RoadSignals(light=light)), path, cap, None)
        return math.isfinite(stops.light.stop)

    assert look(1030.0, LightState.YELLOW)
    # The choice lasts where a new one would be too late, until the reset.
    assert look(1075.0, LightState.YELLOW)
    stops.reset()
    assert not look(1075.0, LightState.YELLOW)


def test_off_tracking_counts_up_to_the_speed_that_the_lane_allows():
    def shift(limit):
        road = RoadPreview(Route.straight(length=3_000.0, lanes=2, speed_limit=limit))
        road.curvature = np.full_like(road.station, 1.0 / 300.0)
        road.half_width = np.full_like(road.half_width, 9.0)
        return float(lane_shift(road, PARAMETERS, 55_000.0, 1.3)[0, 300])

    # At speed the trailer moves outward, so the shift to the outside is smaller.
    assert abs(shift(25.0)) < abs(shift(3.0))


@pytest.mark.parametrize(("bound", "speed"), [(100.0, 15.0), (9.0, 9.0)])
def test_the_motion_to_a_gap_lowers_the_speed_and_never_raises_it(bound, speed):
    class Gap:
        def cap(self, path, station, now):
            return np.full(len(path.station), bound)

    found = []
    for gap in (None, Gap()):
        planner = Planner(ROUTE, PlannerConfig(), PARAMETERS)
        planner._choose_gap = lambda step, scene, cap, path, gap=gap: gap
        found.append(planner.plan(Scene(0.0, at(), ())).speed)
    if bound > speed:
        assert found[1] == pytest.approx(found[0])
    else:
        assert found[1][-1] < 11.0 < found[0][-1]


@pytest.mark.parametrize("station", [989.0, 995.0])
def test_the_gap_of_the_last_cycle_is_kept_while_another_is_hardly_better(station):
    target, config = PREVIEW.follow(1, 1000.0, 400.0, 200.0), PlannerConfig()
    scene = Scene(0.0, at(), (car(ROUTE, "beside", station, 1, 15.0),))

    def ends(last):
        given = None if last is None else merging.GapChoice(0.0, 15.0, last)
        arguments = scene, target, 1500.0, 0.3, 20.0, config.safety, config.merge
        return merging.choose_gap(*arguments, given).ends

    before, behind = ("", "beside"), ("beside", "")
    assert ends(None) == (before if station < 992.0 else behind)
    assert ends(before) == before
    assert ends(behind) == behind


@pytest.mark.parametrize(("begin", "end"), [(0, 1), (1, 0)])
def test_a_passed_vehicle_that_moves_off_ends_the_pass_only_near_its_own_lane(begin, end):
    planner = Planner(ROUTE, PlannerConfig(), PARAMETERS)
    lane, target = (float(ROUTE.lane_offset(i, 1000.0)) for i in (begin, end))
    origin = PREVIEW.follow(begin, 1000.0, 400.0, 150.0)
    vehicle = car(ROUTE, "passed", 1040.0, begin, 5.0)
    assert vehicle.speed > planner.config.passing.moves
    free = origin.half_width - 0.5 * Scene(0.0, at()).footprint.width
    for aside, ends in ((free - 0.05, True), (free + 0.05, False)):
        truck = dataclasses.replace(
            at(speed=2.0), offset=lane + math.copysign(aside, target - lane)
        )
        scene = Scene(0.0, truck, (vehicle,))
        assert planner.maneuver._drives_on(scene, origin, "passed") is ends
        slow = dataclasses.replace(vehicle, speed=0.1)
        assert not planner.maneuver._drives_on(Scene(0.0, truck, (slow,)), origin, "passed")
        assert not planner.maneuver._drives_on(scene, origin, "another")


def test_a_vehicle_in_the_way_is_named_before_one_that_may_come():
    safety = SafetyConfig(sight_behind=50.0)
    path = PREVIEW.follow(1, 1000.0, 400.0, 150.0)
    beside = Scene(0.0, at(), (car(ROUTE, "side", 995.0, 1, 15.0),))
    assert conflict(beside, path, safety, limit=40.0) == "vehicle side is beside the truck"
    near = Scene(0.0, at(), (car(ROUTE, "near", 1006.0, 1, 15.0),))
    assert conflict(near, path, safety, limit=40.0).startswith("front gap")
    assert "in sight" in conflict(Scene(0.0, at(), ()), path, safety, limit=40.0)
    assert conflict(Scene(0.0, at(), ()), path, safety) is None


def test_the_way_back_is_gentler_in_a_bend():
    def length(curvature):
        curved = RoadPreview(ROUTE)
        curved.curvature = np.full_like(curved.station, curvature)
        planner = Planner(ROUTE, PlannerConfig(), PARAMETERS)
        planner.maneuver.preview = curved
        return planner.maneuver._back(at(speed=25.0), 3.0, 0.0, 0.0, MARGIN).length

    assert length(1.0 / 450.0) > length(0.0)


@pytest.mark.parametrize(("between", "count"), [(30.0, 1), (60.0, 2)])
def test_bends_shortly_after_each_other_are_one(between, count):
    station = np.arange(0.0, 500.0, 1.0)
    first = (station >= 200.0) & (station < 214.0)
    second = (station >= 214.0 + between) & (station < 228.0 + between)
    curvature = np.where(first, 1.0 / 9.25, 0.0) - np.where(second, 1.0 / 9.25, 0.0)
    road = measured_route(
        station, np.zeros_like(station), curvature=curvature, lanes=Lanes(1, 3.5, 14.0)
    )
    bends = TightBends(RoadPreview(road), PARAMETERS)._bends
    assert len(bends) == count
    assert bends[-1][1] == pytest.approx(228.0 + between, abs=5.0)


def test_the_preview_of_a_long_road_has_10_000_rows():
    preview = RoadPreview(Route.straight(length=100_000.0, lanes=1))
    assert preview.step == pytest.approx(10.0)
    assert len(preview.station) == 10_001
    assert preview.nearest_lane(100.0, 99.0) == 0
