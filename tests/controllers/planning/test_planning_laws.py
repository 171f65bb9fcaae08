"""Formulas of the planner: gaps, lateral limits, merging, lights, shifts of lanes, towed bodies."""

import math

import numpy as np
import pytest

from controllers.planning.config import LightConfig, MergeConfig, PlannerConfig
from controllers.planning.crossing import _meets, _meets_head_on
from controllers.planning.lane_change import (
    LaneChangeConfig,
    lateral_limit,
    quintic_back,
    quintic_change,
)
from controllers.planning.merging import GapChoice, choose_gap
from controllers.planning.predicted_boxes import Poses, swept_path
from controllers.planning.road_preview import (
    RoadPreview,
    gradient,
    off_tracking,
)
from controllers.planning.rollover_limits import RollMargins, curve_speed_by_roll
from controllers.planning.safety import (
    SafetyConfig,
    conflict,
    front_gap_needed,
    rear_gap_needed,
    stopping_gap,
)
from controllers.planning.speed_caps import with_zones
from controllers.planning.stops import LightStop, _needed
from controllers.planning.trajectory import Quintic, on_road, shortest_to_zero
from controllers.tracking.lateral_model import LateralModel
from iits_mj.core.errors import InputError
from iits_mj.core.messages import EgoState, LightState, Scene, SpeedZone, TrafficLight
from iits_mj.parameters import TruckParameters
from iits_mj.parameters.mass_state import group_center
from iits_mj.road import Route
from tests.controllers.scenes import car

PARAMETERS = TruckParameters.load()
SAFETY = SafetyConfig()
CHANGE = LaneChangeConfig()
ROUTE = Route.straight(length=3_000.0, lanes=2)
PREVIEW = RoadPreview(ROUTE)


# --- gaps -----------------------------------------------------------------------------------


def test_the_stopping_gap_is_the_difference_of_the_stopping_distances():
    assert stopping_gap(20.0, 15.0, 0.5, 5.0, 7.5) == pytest.approx(10.0 + 40.0 - 15.0)
    assert stopping_gap(5.0, 25.0, 0.5, 5.0, 7.5) == 0.0


def test_the_front_gap_is_the_greater_of_comfort_and_safety():
    closing = 6.0
    comfort = SAFETY.front_time_gap * 12.0 + closing**2 / (2.0 * SAFETY.front_deceleration)
    assert front_gap_needed(18.0, 12.0, SAFETY) == pytest.approx(SAFETY.margin + comfort)
    assert front_gap_needed(12.0, 18.0, SAFETY) == pytest.approx(
        SAFETY.margin + SAFETY.front_time_gap * 12.0
    )
    stop = 25.0 * SAFETY.reaction_time + 25.0**2 * (
        0.5 / SAFETY.truck_braking - 0.5 / SAFETY.car_braking
    )
    assert front_gap_needed(25.0, 25.0, SAFETY) == pytest.approx(
        SAFETY.margin + max(stop, SAFETY.front_time_gap * 25.0)
    )


def test_the_rear_gap_is_the_greater_of_comfort_and_safety():
    closing, b = 8.0, SAFETY.rear_deceleration
    comfort = SAFETY.rear_time_gap * 12.0 + SAFETY.rear_reaction_time * closing
    comfort += closing**2 / (2.0 * b)
    stop = stopping_gap(
        20.0, 12.0, SAFETY.driver_reaction_time, SAFETY.driver_braking, SAFETY.truck_braking
    )
    assert rear_gap_needed(12.0, 20.0, SAFETY) == pytest.approx(SAFETY.margin + max(comfort, stop))
    slower = SAFETY.rear_time_gap * 10.0
    assert rear_gap_needed(20.0, 10.0, SAFETY) == pytest.approx(SAFETY.margin + slower)


def scene(*vehicles, speed=15.0, station=1000.0):
    ego = EgoState(
        station=station,
        offset=float(ROUTE.lane_offset(0, station)),
        speed=speed,
        mass=55_000.0,
    )
    return Scene(0.0, ego, vehicles)


def test_a_conflict_names_the_vehicle_with_the_largest_missing_gap():
    path = PREVIEW.follow(1, 1000.0, 400.0, 200.0)
    near = car(ROUTE, "near", 1030.0, 1, 15.0)
    slow = car(ROUTE, "slow", 1050.0, 1, 5.0)
    neighbors = scene(near).neighbors
    gap, needed = float(neighbors.gap[0]), float(front_gap_needed(15.0, 15.0, SAFETY))
    wide = 2.0 * gap / needed
    text = conflict(scene(near), path, SAFETY, wide)
    assert text == (f"front gap {gap:.1f} m to vehicle near is below {wide * needed:.1f} m")
    assert conflict(scene(near), path, SAFETY, 0.9 * gap / needed) is None
    assert "vehicle slow" in conflict(scene(near, slow), path, SAFETY, wide)
    beside = car(ROUTE, "side", 995.0, 1, 15.0)
    assert conflict(scene(beside), path, SAFETY) == "vehicle side is beside the truck"
    behind = car(ROUTE, "behind", 960.0, 1, 25.0)
    assert conflict(scene(behind), path, SAFETY).startswith("rear gap ")
    here = car(ROUTE, "own", 1030.0, 0, 5.0)
    assert conflict(scene(here), path, SAFETY) is None


def test_a_vehicle_beyond_the_sensors_counts_by_the_speed_limit():
    path = PREVIEW.follow(1, 1000.0, 400.0, 200.0)

    def room(limit, speed):
        unseen = min(limit * (1.0 + SAFETY.speeding), SAFETY.unlimited_speed)
        return SAFETY.margin + stopping_gap(
            unseen,
            speed,
            SAFETY.driver_reaction_time,
            SAFETY.driver_braking,
            SAFETY.truck_braking,
        )

    for limit in (20.0, 30.0, 36.0, 60.0):
        for speed in (3.0, 10.0, 15.0, 20.0):
            found = conflict(scene(speed=speed), path, SAFETY, limit=limit)
            blocked = room(limit, speed) > SAFETY.sight_behind
            assert (found is not None) == blocked
            if found is not None:
                assert f"need a rear gap of {room(limit, speed):.0f} m" in found
    assert conflict(scene(speed=3.0), path, SAFETY, limit=0.0) is None


# --- lateral --------------------------------------------------------------------------------


def test_the_change_may_use_the_least_of_own_share_rest_and_comfort():
    margins = RollMargins(PARAMETERS, 1.0 / CHANGE.duration_min)
    found = margins.at(55_000.0)
    amplified = found.amplified(16.67)
    own = CHANGE.change_share * found.threshold / amplified
    assert lateral_limit(found, 16.67, 0.0, CHANGE) == pytest.approx(own)
    felt = 0.35 * found.threshold
    left = (CHANGE.total_share * found.threshold - felt) / amplified
    assert lateral_limit(found, 16.67, felt, CHANGE) == pytest.approx(left)
    assert lateral_limit(found, 16.67, 0.5 * found.threshold, CHANGE) < 0.0
    empty = margins.at(19_000.0)
    assert lateral_limit(empty, 5.0, 0.0, CHANGE) == CHANGE.comfort_acceleration


def test_a_change_without_lateral_acceleration_left_is_none():
    assert quintic_change(0.0, 4.0, 0.0, 0.0, 16.0, 0.0, CHANGE) is None
    assert quintic_change(0.0, 4.0, 0.0, 0.0, 16.0, 0.05, CHANGE) is None
    slow = quintic_change(0.0, 4.0, 0.0, 0.0, 1.0, 0.8, CHANGE)
    assert slow.length == CHANGE.length_min


@pytest.mark.parametrize(("limit", "jerk"), [(0.6, 1.3), (1.2, 0.6), (3.0, 3.0)])
def test_the_shortest_change_is_a_tenth_of_a_second_longer_than_one_beyond_its_limits(limit, jerk):
    speed, lowest, longest = 16.0, 2.5, 12.0
    found = shortest_to_zero(50.0, 3.5, 0.0, 0.0, speed, limit, jerk, lowest, longest, 10.0)
    peak = found.peak_lateral(speed)
    assert peak[0] <= limit
    assert peak[1] <= jerk
    duration = found.length / speed
    shorter = Quintic.to_zero(50.0, found.length - 0.1 * speed, 3.5).peak_lateral(speed)
    assert duration == pytest.approx(lowest) or shorter[0] > limit or shorter[1] > jerk
    # Peaks of a quintic step: 5.77 w / T^2 and 60 w / T^3.
    assert peak[0] == pytest.approx(10.0 / math.sqrt(3.0) * 3.5 / duration**2, rel=5e-3)
    assert peak[1] == pytest.approx(60.0 * 3.5 / duration**3)


def test_a_bend_that_is_already_there_does_not_forbid_every_change():
    bend = 2.0 / 16.0**2
    args = (0.0, 3.5, 0.0, bend, 16.0)
    found = shortest_to_zero(*args, 0.8, 5.0, 2.5, 12.0, 10.0)
    assert found.peak_lateral(16.0)[0] <= 1.05 * 2.0 + 1e-9
    assert shortest_to_zero(*args, 0.8, 0.01, 2.5, 12.0, 10.0) is None


def test_the_way_back_is_bounded_by_the_road_but_never_missing():
    free = quintic_back(0.0, 2.0, 0.0, 0.0, 16.0, CHANGE)
    assert free.peak_lateral(16.0)[0] <= CHANGE.abort_acceleration
    tight = quintic_back(0.0, 2.0, 0.0, 0.0, 16.0, CHANGE, 0.5)
    assert tight.peak_lateral(16.0)[0] <= 0.5
    assert tight.length > free.length
    least = quintic_back(0.0, 2.0, 0.0, 0.0, 16.0, CHANGE, -1.0)
    assert least.peak_lateral(16.0)[0] <= 0.25 * CHANGE.abort_acceleration
    assert least.length > tight.length
    assert quintic_back(0.0, 0.1, 0.0, 0.0, 20.0, CHANGE).length == pytest.approx(50.0)
    far = quintic_back(0.0, 900.0, 0.0, 0.0, 16.0, CHANGE)
    assert far.length == pytest.approx(3.0 * CHANGE.duration_max * 16.0)
    assert far.evaluate(0.0)[0] == pytest.approx(900.0)


def test_the_trajectory_is_the_path_plus_the_quintic_over_time():
    path = PREVIEW.follow(1, 1000.0, 400.0, 200.0)
    residual = Quintic.to_zero(1000.0, 80.0, -3.0, 0.01)
    station = np.linspace(1000.0, 1100.0, 51)
    speed, pull = np.full(51, 20.0), np.zeros(51)
    plan = on_road(PREVIEW, path, residual, 7.0, station, speed, pull, 0.1, reason="why")
    assert plan.time == pytest.approx(7.0 + 0.1 * np.arange(51))
    value, slope, bend, _ = residual.evaluate(station)
    middle = float(ROUTE.lane_offset(1, 1000.0))
    assert plan.offset == pytest.approx(middle + value)
    assert np.tan(plan.yaw) == pytest.approx(slope, abs=1e-9)
    bent = bend / (1.0 + slope**2) ** 1.5
    assert plan.curvature[1:-1] == pytest.approx(bent[1:-1], abs=2e-4)
    assert plan.reason == "why"
    # At standstill the curvature is that of the offset curve.
    at_rest = on_road(PREVIEW, path, residual, 0.0, np.full(3, 1030.0), speed[:3], pull[:3], 0.1)
    assert at_rest.curvature == pytest.approx(np.full(3, residual.evaluate(1030.0)[2]))


# --- road -----------------------------------------------------------------------------------


def test_slopes_agree_with_numpys_gradient():
    values = np.random.default_rng(3).normal(size=12)
    assert gradient(values, 2.5) == pytest.approx(np.gradient(values, 2.5))


def test_off_tracking_at_walking_pace_is_half_the_sum_of_the_squared_lengths():
    model = LateralModel.of(PARAMETERS, 55_000.0, 0.1)
    slow, fast = off_tracking(model, 0.3), off_tracking(model, 30.0)
    base = group_center(PARAMETERS.lead.axles[1:]) - PARAMETERS.lead.axles[0].position
    hitch = PARAMETERS.couplings[0].position - PARAMETERS.lead.axles[0].position
    trailer = group_center(PARAMETERS.units[1].axles)
    expected = 0.5 * (base**2 - (base - hitch) ** 2 + trailer**2)
    assert slow == pytest.approx(expected, rel=0.15)
    assert fast < 0.0 < slow


def test_a_bend_with_cross_slope_bears_its_roll_limit():
    speed = curve_speed_by_roll(np.array([0.01, -0.01, 0.01]), np.array([0.0, 0.0, -0.05]), 1.5)
    assert speed[:2] == pytest.approx(math.sqrt(1.5 / 0.01))
    felt = speed[2] ** 2 * 0.01 + 9.81 * math.tan(-0.05)
    assert felt == pytest.approx(1.5, rel=1e-3)


def test_zones_lower_and_raise_the_limit_between_their_ends():
    path = PREVIEW.follow(0, 1000.0, 400.0, 200.0)
    zones = (SpeedZone(1100.0, 1200.0, 10.0), SpeedZone(1150.0, 1180.0, 5.0))
    limit = with_zones(path, zones).speed_limit
    at = dict(zip(path.station.tolist(), limit.tolist(), strict=True))
    assert (at[1100.0], at[1150.0], at[1165.0], at[1200.0]) == (10.0, 5.0, 5.0, 10.0)
    assert at[1000.0] == path.speed_limit[0] == at[1300.0]
    assert with_zones(path, ()) is path
    with pytest.raises(InputError, match="limit"):
        with_zones(path, (SpeedZone(0.0, 10.0, 0.0),))


# --- merging --------------------------------------------------------------------------------


def test_without_traffic_the_truck_keeps_its_speed_to_merge():
    target, config = PREVIEW.follow(1, 1000.0, 400.0, 200.0), MergeConfig()
    choice = choose_gap(scene(), target, 1400.0, 0.5, 20.0, SAFETY, config)
    assert choice == GapChoice(0.0, 15.0, ("", ""))
    # The lane ends before the truck could leave it.
    near = 1000.0 + 1.4 + 15.0 * config.crossing_time
    assert choose_gap(scene(), target, near - 0.5, 0.5, 20.0, SAFETY, config) is None
    assert choose_gap(scene(), target, near + 0.5, 0.5, 20.0, SAFETY, config) is not None


def test_the_truck_brakes_to_the_gap_behind_a_car_beside_it():
    target, config = PREVIEW.follow(1, 1000.0, 400.0, 200.0), MergeConfig()
    beside = car(ROUTE, "beside", 990.0, 1, 15.0)
    follower = car(ROUTE, "follower", 880.0, 1, 15.0)
    choice = choose_gap(scene(beside, follower), target, 1500.0, 0.0, 20.0, SAFETY, config)
    assert choice.ends in (("beside", "follower"), ("beside", ""), ("follower", ""))
    assert -config.deceleration <= choice.acceleration < 0.0
    assert config.speed_min <= choice.speed < 15.0


def test_the_cap_of_a_gap_brakes_at_its_rate_down_to_its_speed():
    path = PREVIEW.follow(0, 1000.0, 400.0, 100.0)
    cap = GapChoice(-0.5, 10.0, ("", "")).cap(path, 1000.0, 15.0)
    at = dict(zip(path.station.tolist(), cap.tolist(), strict=True))
    assert at[950.0] == at[1000.0] == 15.0
    assert at[1050.0] == pytest.approx(math.sqrt(15.0**2 - 50.0))
    assert at[1300.0] == 10.0
    assert GapChoice(0.5, 20.0, ("", "")).cap(path, 1000.0, 15.0) is None
    assert GapChoice(0.0, 15.0, ("", "")).cap(path, 1000.0, 15.0) is not None


# --- lights ---------------------------------------------------------------------------------

LIGHT = LightConfig()


def light(state, station=100.0, **fields):
    return TrafficLight(station=station, state=state, **fields)


@pytest.mark.parametrize("state", [LightState.YELLOW, LightState.RED])
def test_the_truck_stops_exactly_where_the_braking_is_allowed(state):
    most = LIGHT.yellow_deceleration if state is LightState.YELLOW else LIGHT.red_deceleration
    speed = 15.0
    room = speed**2 / (2.0 * most) + LIGHT.reaction_time * speed + 0.3
    for spare, stops in ((-0.2, False), (0.2, True)):
        demand = LightStop(LIGHT).demand(light(state, 500.0), 500.0 - room - spare, speed)
        assert math.isfinite(demand.stop) == stops
        if stops:
            assert demand.stop == 500.0 - LIGHT.stop_before
            wanted = _needed(room + spare - LIGHT.stop_before - LIGHT.reaction_time * speed, speed)
            assert demand.deceleration == pytest.approx(min(wanted, LIGHT.red_deceleration))
            assert demand.reason == f"{state.value} light in {room + spare - 0.8:.0f} m"


def test_far_away_the_truck_brakes_gently_and_out_of_sight_not_at_all():
    demand = LightStop(LIGHT).demand(light(LightState.RED, 290.0), 0.0, 15.0)
    assert demand.deceleration == LIGHT.deceleration
    assert LightStop(LIGHT).demand(light(LightState.RED, 300.0), 0.0, 15.0).stop == math.inf
    behind = light(LightState.RED, 100.0 - LIGHT.overshoot - 0.1)
    assert LightStop(LIGHT).demand(behind, 100.0, 0.0).stop == math.inf


def test_a_slow_truck_stops_before_a_red_line_however_near():
    near = light(LightState.RED, 100.4)
    assert math.isfinite(LightStop(LIGHT).demand(near, 100.0, 1.9).stop)
    assert LightStop(LIGHT).demand(near, 100.0, 2.1).stop == math.inf
    yellow = light(LightState.YELLOW, 100.4)
    assert LightStop(LIGHT).demand(yellow, 100.0, 1.9).stop == math.inf
    assert math.isfinite(LightStop(LIGHT).demand(yellow, 100.0, 0.2).stop)


def test_a_green_that_ends_before_the_truck_arrives_is_stopped_for():
    green = {"next_state": LightState.YELLOW, "next_switch": 10.0}
    for room, stops in ((155.0, True), (149.0, False)):
        found = LightStop(LIGHT).demand(light(LightState.GREEN, room, **green), 0.8, 15.0)
        assert math.isfinite(found.stop) == (room - 1.6 > 150.0) == stops
    # A truck at rest counts with the slow speed.
    found = LightStop(LIGHT).demand(light(LightState.GREEN, 20.0, **green), 0.0, 0.0)
    assert found.stop == math.inf


@pytest.mark.parametrize(("speed", "room", "switch"), [(15.0, 140.0, 12.0), (15.0, 250.0, 12.0)])
def test_a_red_with_a_known_end_is_reached_after_its_end_and_the_reserve(speed, room, switch):
    red = light(
        LightState.RED, room + LIGHT.stop_before, next_state=LightState.GREEN, next_switch=switch
    )
    demand = LightStop(LIGHT).demand(red, 0.0, speed)
    left, b = switch + LIGHT.arrival_reserve, LIGHT.arrival_deceleration
    arriving = demand.speed
    if speed * left <= room:
        assert arriving == pytest.approx(room / left)
    else:
        lost = speed - arriving
        assert arriving * left + lost**2 / (2.0 * b) == pytest.approx(room)
    assert demand.deceleration >= LIGHT.yellow_deceleration


def test_the_needed_deceleration_is_infinite_without_room():
    assert _needed(10.0, 10.0) == 5.0
    assert _needed(0.0, 1.0) == math.inf


# --- predictions ----------------------------------------------------------------------------


def poses(**fields):
    values = {
        "x": 0.0,
        "y": 0.0,
        "yaw": 0.5,
        "to_road": 0.0,
        "speed": 10.0,
        "braking": 0.0,
        "yaw_rate": 0.0,
        "station": 100.0,
        "offset": 2.0,
        "length": 4.5,
        "width": 1.8,
    }
    return Poses(**{name: np.array([value]) for name, value in (values | fields).items()})


def test_a_braking_vehicle_is_predicted_to_stop_and_stay():
    ways = poses(braking=2.0).distance(np.array([0.0, 1.0, 4.0, 5.0, 9.0]))[:, 0]
    assert ways == pytest.approx([0.0, 9.0, 24.0, 25.0, 25.0])
    steady = poses().distance(np.array([3.0]))
    assert steady[0, 0] == 30.0


def test_a_turning_vehicle_is_predicted_on_its_circle():
    times = np.array([0.0, 1.0, 2.5])
    boxes = poses(yaw_rate=0.4).ahead(times)
    radius, angle = 10.0 / 0.4, 0.4 * times
    x = radius * (np.sin(0.5 + angle) - np.sin(0.5))
    y = radius * (np.cos(0.5) - np.cos(0.5 + angle))
    assert boxes.x[:, 0] == pytest.approx(x)
    assert boxes.y[:, 0] == pytest.approx(y)
    assert boxes.yaw[:, 0] == pytest.approx(0.5 + angle)
    # At a crawl its turn rate does not count.
    slow = poses(speed=0.4, yaw_rate=0.4).ahead(times)
    assert slow.yaw[:, 0] == pytest.approx(np.full(3, 0.5))


def test_an_oncoming_vehicle_is_predicted_along_the_road_against_its_direction():
    boxes = poses(station=900.0, speed=20.0).along_road(np.array([0.0, 2.0]), PREVIEW)
    point = ROUTE.evaluate(np.array([900.0, 860.0]), np.array([2.0, 2.0]))
    assert boxes.x[:, 0] == pytest.approx(point.x)
    assert boxes.y[:, 0] == pytest.approx(point.y)
    assert np.cos(boxes.yaw[:, 0] - point.heading) == pytest.approx([-1.0, -1.0])


def test_the_towed_units_settle_on_their_circles():
    radius, angles = 30.0, np.linspace(0.0, 8.0, 1600)
    path = radius * np.column_stack([np.sin(angles), 1.0 - np.cos(angles)])
    lead, towed = swept_path(PARAMETERS, path, 0.0)
    tractor, trailer = PARAMETERS.lead, PARAMETERS.units[1]
    base = group_center(tractor.axles[1:]) - tractor.axles[0].position
    hitch = PARAMETERS.couplings[0].position - tractor.axles[0].position
    length = group_center(trailer.axles)
    center = np.array([0.0, radius])
    kingpin = float(np.hypot(*(towed.origin[-1] - center)))
    assert kingpin == pytest.approx(math.sqrt(radius**2 - base**2 + (base - hitch) ** 2), abs=0.01)
    axle = float(np.hypot(*(towed.group[-1] - center)))
    assert axle == pytest.approx(math.sqrt(kingpin**2 - length**2), abs=0.02)
    corners = lead.corners[-1]
    assert np.hypot(*(corners[0] - corners[1])) == pytest.approx(tractor.width)
    assert np.hypot(*(corners[1] - corners[2])) == pytest.approx(
        tractor.front_overhang + base + 1.0
    )
    sides = towed.corners[-1]
    assert np.hypot(*(sides[0] - sides[1])) == pytest.approx(trailer.width)
    assert np.hypot(*(sides[1] - sides[2])) == pytest.approx(trailer.length)
    nose = 0.5 * (sides[0] + sides[1]) - towed.origin[-1]
    assert np.hypot(*nose) == pytest.approx(trailer.front_overhang)


def test_on_a_straight_path_the_bar_decays_exponentially_to_the_course():
    path = np.column_stack([np.linspace(0.0, 60.0, 121), np.zeros(121)])
    lead, _ = swept_path(PARAMETERS, path, 0.3)
    tractor = PARAMETERS.lead
    base = group_center(tractor.axles[1:]) - tractor.axles[0].position
    expected = 2.0 * np.arctan(math.tan(0.15) * np.exp(-path[:, 0] / base))
    assert lead.yaw == pytest.approx(expected)


def test_the_lead_at_a_meeting_point_is_where_both_arrive_together():
    # Four positions, 2 m apart; the oncoming vehicle is at the third one now.
    touch = np.zeros((4, 17), dtype=bool)
    touch[2:, 0] = True
    ego = EgoState(speed=12.0)
    lead = _meets_head_on(touch, poses(speed=6.0), ego)
    assert lead.gap == pytest.approx(4.0 * 12.0 / 18.0)
    assert lead.speed == 0.0
    touch[0, 0] = True
    assert _meets_head_on(touch, poses(), ego) is None
    assert _meets_head_on(np.zeros((4, 17), dtype=bool), poses(), ego) is None
    later = np.zeros((4, 17), dtype=bool)
    later[3, 5] = True
    assert _meets_head_on(later, poses(speed=4.0), ego).gap == pytest.approx(8.0 * 12.0 / 16.0)


def test_truck_and_vehicle_meet_within_half_a_second_also_when_the_truck_speeds_up():
    times = np.linspace(0.0, 4.0, 17)

    def touch(row, moment):
        """Contact at one position of the truck, 2 m apart, and one time, 0.25 s apart."""
        found = np.zeros((40, 17), dtype=bool)
        found[row, moment] = True
        return found

    assert _meets(touch(10, 8), 10.0, times)
    assert _meets(touch(12, 8), 10.0, times)
    assert _meets(touch(8, 8), 10.0, times)
    assert not _meets(touch(15, 8), 10.0, times)
    assert not _meets(touch(5, 8), 10.0, times)
    # From rest the truck is 0.35 t^2 ahead: 5.6 m after 4 s.
    assert _meets(touch(3, 16), 0.0, times)
    assert not _meets(touch(6, 16), 0.0, times)


def test_settings_of_the_planner_are_positive():
    with pytest.raises(InputError, match="horizon"):
        PlannerConfig(horizon=0.05)
