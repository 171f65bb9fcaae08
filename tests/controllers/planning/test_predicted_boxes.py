"""Predicted boxes of the traffic, the ground that the truck sweeps, and what crosses it."""

import dataclasses
import math

import numpy as np
import pytest

from controllers.planning.crossing import _crosses, crossing_leads, is_free
from controllers.planning.predicted_boxes import Poses, bodies_along, swept_path, unit_lengths
from controllers.planning.road_preview import RoadPreview
from controllers.planning.trajectory import Quintic, on_road
from iits_mj.core.messages import EgoState, Scene
from iits_mj.parameters import TruckParameters, shipped_trucks
from iits_mj.parameters.mass_state import group_center, static_axle_loads
from iits_mj.road import Route
from iits_mj.road.measured import Lanes, measured_route
from tests.controllers.scenes import car, posed

PARAMETERS = TruckParameters.load()
STRAIGHT = Route.straight(length=3000.0, lanes=2)
PREVIEW = RoadPreview(STRAIGHT)
MIDDLE = float(STRAIGHT.lane_offset(0, 1000.0))
RADIUS = 60.0
STATION = np.arange(0.0, 500.0, 1.0)
CIRCLE = measured_route(
    STATION,
    np.zeros_like(STATION),
    curvature=np.full_like(STATION, 1.0 / RADIUS),
    lanes=Lanes(2, 3.5, 14.0),
)
ROUND = RoadPreview(CIRCLE)


def poses(*vehicles, preview=PREVIEW):
    neighbors = Scene(0.0, EgoState(station=1000.0), vehicles).neighbors
    return Poses.of(neighbors, np.ones(len(vehicles), dtype=bool), preview)


def other(station=1050.0, aside=0.0, course=0.0, speed=4.0, road=STRAIGHT, **fields):
    """A car beside the middle of the right lane."""
    offset = float(road.lane_offset(0, station)) + aside
    return posed(road, "car", station, offset, course, speed, **fields)


# --- the traffic ----------------------------------------------------------------------------


def test_a_vehicle_at_rest_without_a_pose_points_along_the_road():
    found = poses(car(STRAIGHT, "a", 1050.0, 1, 0.0), car(STRAIGHT, "b", 1050.0, 1, -1.0))
    assert found.to_road[0] == 0.0
    assert abs(found.to_road[1]) == pytest.approx(math.pi)


def test_an_oncoming_vehicle_is_also_predicted_along_the_road():
    vehicle = other(100.0, 3.5, math.pi, 8.0, CIRCLE)
    found = poses(vehicle, preview=ROUND).along_road(np.array([0.0, 2.0]), ROUND)
    there = CIRCLE.evaluate(84.0, vehicle.offset)
    assert (found.x[1, 0], found.y[1, 0]) == pytest.approx((float(there.x), float(there.y)))
    assert found.yaw[1, 0] == pytest.approx(float(there.heading) + math.pi)
    assert (found.length[0], found.width[0]) == (vehicle.length, vehicle.width)


# --- the truck ------------------------------------------------------------------------------


def test_the_bodies_lie_about_steer_axle_and_kingpin():
    angle = np.arange(0.0, 3.0 * math.pi, 0.005)
    path = 20.0 * np.column_stack([np.sin(angle), 1.0 - np.cos(angle)])
    lead, towed = swept_path(PARAMETERS, path, 0.0)
    tractor, trailer = PARAMETERS.lead, PARAMETERS.units[1]
    wheelbase = group_center(tractor.axles[1:]) - tractor.axles[0].position
    assert angle[-1] - lead.yaw[-1] == pytest.approx(math.asin(wheelbase / 20.0), abs=3e-3)
    corners = lead.corners[-1]
    forward = np.array([math.cos(lead.yaw[-1]), math.sin(lead.yaw[-1])])
    left = np.array([-forward[1], forward[0]])
    ahead, half = tractor.front_overhang, 0.5 * tractor.width
    assert (corners - path[-1]) @ forward == pytest.approx(
        [ahead, ahead, -wheelbase - 1.0, -wheelbase - 1.0]
    )
    assert (corners - path[-1]) @ left == pytest.approx([half, -half, -half, half])
    along = np.array([math.cos(towed.yaw[-1]), math.sin(towed.yaw[-1])])
    reach = (towed.corners[-1] - towed.origin[-1]) @ along
    front = trailer.front_overhang
    assert reach == pytest.approx([front, front, front - trailer.length, front - trailer.length])


def test_the_units_begin_with_the_headings_given():
    path = np.column_stack([np.linspace(0.0, 12.0, 400), np.zeros(400)])
    lead, towed = swept_path(PARAMETERS, path, 0.4, [-0.2])
    assert (lead.yaw[0], towed.yaw[0]) == (0.4, -0.2)
    assert -0.2 < towed.yaw[-1] < 0.3


def test_the_bodies_on_a_straight_road_stand_behind_each_other():
    path = PREVIEW.follow(0, 1000.0, 400.0, 150.0)
    stations = np.array([1000.0, 1002.0])
    tractor, trailer = bodies_along(PARAMETERS, PREVIEW, path, None, stations)
    body, box = PARAMETERS.lead, PARAMETERS.units[1]
    wheelbase = group_center(body.axles[1:]) - body.axles[0].position
    hitch = PARAMETERS.couplings[0].position - body.axles[0].position
    middle = 0.5 * (body.front_overhang - wheelbase - 1.0)
    assert tractor.x == pytest.approx(stations + middle, abs=1e-6)
    assert trailer.x == pytest.approx(
        stations - hitch + box.front_overhang - 0.5 * box.length, abs=1e-6
    )
    assert tractor.y == pytest.approx(MIDDLE)
    assert (float(tractor.length), float(tractor.width)) == pytest.approx(
        (body.front_overhang + wheelbase + 1.0, body.width)
    )
    assert (float(trailer.length), float(trailer.width)) == pytest.approx((box.length, box.width))
    # A residual moves them aside, the trailer later.
    aside = Quintic.to_zero(1000.0, 60.0, 3.0)
    tractor, trailer = bodies_along(PARAMETERS, PREVIEW, path, aside, np.array([1030.0]))
    assert MIDDLE + 0.5 < float(tractor.y[0]) < float(trailer.y[0]) < MIDDLE + 3.0


# --- what crosses ---------------------------------------------------------------------------


def ego(station=1000.0, speed=1.0, **fields):
    return EgoState(station=station, offset=MIDDLE, x=station, y=MIDDLE, speed=speed, **fields)


def leads(*vehicles, speed=1.0):
    path = PREVIEW.follow(0, 1000.0, 400.0, 150.0)
    return crossing_leads(Scene(0.0, ego(speed=speed), vehicles), PREVIEW, PARAMETERS, path, None)


WALKER = {"length": 0.6, "width": 0.6, "course": 0.5 * math.pi, "aside": -4.0}


@pytest.mark.parametrize("kind", ["pedestrian", "bicycle", "car"])
def test_the_truck_expects_only_vehicles_to_yield(kind):
    found = leads(other(1014.0, speed=1.4, kind=kind, **WALKER), speed=5.0)
    assert bool(found) == (kind != "car")


def test_a_person_who_stands_beside_the_lane_does_not_stop_the_truck():
    beside = WALKER | {"aside": -1.8}
    assert not leads(other(1014.0, speed=0.0, kind="pedestrian", **beside), speed=5.0)
    inside = WALKER | {"aside": -0.5}
    assert leads(other(1014.0, speed=0.0, kind="pedestrian", **inside), speed=5.0)


def test_a_crossing_vehicle_counts_on_another_part_of_the_route():
    crossing = other(1012.0, -6.0, 0.5 * math.pi, 4.0)
    assert leads(crossing, speed=5.0)
    assert leads(dataclasses.replace(crossing, station=2500.0), speed=5.0)


@pytest.mark.parametrize("distance", np.arange(8.1, 19.0, 0.75))
def test_the_truck_stops_before_the_position_at_which_it_touches(distance):
    ((lead, name),) = leads(other(1000.0 + distance, course=0.5 * math.pi, speed=0.0))
    # Positions are 2 m apart; half of it is kept.
    free = distance - 0.5 * other().width - PARAMETERS.lead.front_overhang - 0.4
    assert free > 0.0
    assert lead.gap == pytest.approx(2.0 * math.ceil(free / 2.0) - 1.0)
    assert (name, lead.speed, lead.acceleration, lead.until) == ("car", 0.0, 0.0, math.inf)


def test_a_vehicle_that_touches_the_truck_already_is_no_lead():
    assert leads(other(1001.0, course=0.5 * math.pi, speed=0.0)) == []
    assert leads() == []


@pytest.mark.parametrize(
    ("course", "counts"), [(0.33, False), (0.37, True), (math.pi - 0.37, True), (-0.37, True)]
)
def test_a_standing_vehicle_across_the_road_counts_from_20_degrees(course, counts):
    assert bool(leads(other(1010.0, course=course, speed=0.0))) is counts


@pytest.mark.parametrize(
    ("aside", "speed", "station", "counts"),
    [
        (0.0, 5.0, 1030.0, True),
        (0.0, 0.49, 1030.0, False),
        (0.0, 0.51, 1015.0, True),
        (0.0, 5.0, 985.0, False),
        (2.1, 5.0, 1030.0, True),
        (2.3, 5.0, 1030.0, False),
        (-2.3, 5.0, 1030.0, False),
    ],
)
def test_an_oncoming_vehicle_counts_in_the_truck_s_way_only(aside, speed, station, counts):
    half = 0.5 * (other().width + PARAMETERS.units[1].width)
    assert 2.1 < half < 2.3
    vehicle = other(station, aside, math.pi, speed)
    assert bool(leads(vehicle, speed=5.0)) is counts


def test_only_vehicles_on_the_truck_s_level_and_within_reach_count():
    across = other(1010.0, course=0.5 * math.pi, speed=0.0)
    assert leads(across)
    assert not leads(dataclasses.replace(across, z=across.z + 6.0))
    # Slow, the truck looks at 3 m/s over 4 s and 10 m: 22 m ahead.
    assert leads(other(1021.0, course=0.5 * math.pi, speed=0.0))
    assert not leads(other(1028.0, course=0.5 * math.pi, speed=0.0))
    # At 20 m/s its braking distance of 154 m and 10 m.
    assert leads(other(1160.0, course=0.5 * math.pi, speed=0.0), speed=20.0)
    assert not leads(other(1172.0, course=0.5 * math.pi, speed=0.0), speed=20.0)


@pytest.mark.parametrize(
    ("vehicle", "free"),
    [
        (other(1015.0, -20.0, 0.5 * math.pi, 4.0), False),
        # It drives away, along the lane, or is not there within 8 s.
        (other(1015.0, -20.0, -0.5 * math.pi, 4.0), True),
        (other(1015.0, -20.0, 0.34, 4.0), True),
        (other(1015.0, -40.0, 0.5 * math.pi, 4.0), True),
        (other(1015.0, -36.0, 0.5 * math.pi, 4.0), False),
        (other(1015.0, 0.0, 0.5 * math.pi, 0.4), True),
        (other(1015.0, 0.0, 0.5 * math.pi, 0.6), False),
        # Behind the line and beyond 30 m of it others pass freely.
        (other(992.0, -20.0, 0.5 * math.pi, 4.0), True),
        (other(1038.0, -20.0, 0.5 * math.pi, 4.0), True),
        (other(1033.0, -20.0, 0.5 * math.pi, 4.0), False),
        (other(1015.0, 36.0, -0.5 * math.pi, 4.0), False),
    ],
)
def test_behind_a_green_arrow_the_way_is_free_if_nothing_crosses_it_soon(vehicle, free):
    assert is_free(Scene(0.0, ego(990.0), (vehicle,)), PREVIEW, 1000.0) is free
    assert is_free(Scene(0.0, ego(990.0), (other(1200.0), vehicle)), PREVIEW, 1000.0) is free


# --- the curve of a plan --------------------------------------------------------------------


@pytest.mark.parametrize("aside", [0.0, 3.0, -3.0])
def test_on_a_circle_a_plan_beside_the_middle_has_the_curvature_of_its_own_circle(aside):
    path = ROUND.follow(0, 200.0, 100.0, 50.0)
    path = dataclasses.replace(path, offset=np.full_like(path.offset, aside))
    for way in (0.5, 0.0):
        station = 200.0 + way * np.arange(30)
        plan = on_road(ROUND, path, None, 3.0, station, np.full(30, 5.0 * way), np.zeros(30), 0.1)
        assert plan.curvature == pytest.approx(1.0 / (RADIUS - plan.offset), rel=1e-3)
        assert plan.time == pytest.approx(3.0 + 0.1 * np.arange(30))


def test_a_curve_across_a_circle_heads_along_its_points():
    path = ROUND.follow(0, 200.0, 100.0, 50.0)
    residual = Quintic.to_zero(200.0, 50.0, 3.5)
    station = np.arange(205.0, 245.0, 0.05)
    n = len(station)
    plan = on_road(ROUND, path, residual, 0.0, station, np.full(n, 5.0), np.zeros(n), 0.1)
    course = np.unwrap(np.arctan2(np.diff(plan.y), np.diff(plan.x)))
    yaw = np.unwrap(plan.yaw)
    apart = np.angle(np.exp(1j * (course - 0.5 * (yaw[1:] + yaw[:-1]))))
    assert apart == pytest.approx(0.0, abs=2e-4)
    # At rest the curvature is that of the offset curve, for small angles.
    rest = np.full(3, 236.0)
    still = on_road(ROUND, path, residual, 0.0, rest, np.zeros(3), np.zeros(3), 0.1)
    stretch = 1.0 - still.offset[0] / RADIUS
    bent = float(residual.evaluate(236.0)[2])
    assert abs(bent) > 1e-3
    assert still.curvature == pytest.approx(1.0 / RADIUS / stretch + bent / stretch**2, rel=1e-3)


def test_a_crossing_vehicle_counts_until_half_a_second_after_its_last_contact():
    times = np.linspace(0.0, 4.0, 17)
    touch = np.zeros((20, 17), dtype=bool)
    touch[5:7, 8:11] = True
    one = poses(other(speed=10.0, course=0.5 * math.pi))
    lead = _crosses(touch, one, ego(speed=5.0), times, None)
    assert (lead.gap, lead.until) == (9.0, 3.0)
    touch[6, 16] = True
    assert _crosses(touch, one, ego(speed=5.0), times, None).until == math.inf
    # One that can stop gently, or that the truck does not meet, is no lead.
    assert _crosses(touch, poses(other(speed=5.0)), ego(speed=5.0), times, None) is None
    assert _crosses(touch, one, ego(speed=15.0), times, None) is None


@pytest.mark.parametrize("name", shipped_trucks())
def test_every_unit_settles_on_the_circle_of_its_tractrix(name):
    truck, radius = TruckParameters.load(name), 40.0
    angle = np.arange(0.0, 4.0 * math.pi, 0.004)
    path = radius * np.column_stack([np.sin(angle), 1.0 - np.cos(angle)])
    tracks = swept_path(truck, path, 0.0)
    hitches = [*(coupling.position for coupling in truck.couplings), 0.0]
    away = radius
    for track, length, hitch in zip(tracks, unit_lengths(truck), hitches, strict=True):
        assert np.hypot(*(track.origin[-1] - [0.0, radius])) == pytest.approx(away, abs=0.01)
        away = math.sqrt(away**2 - length**2)
        assert np.hypot(*(track.group[-1] - [0.0, radius])) == pytest.approx(away, abs=0.01)
        away = math.hypot(away, length - hitch)


@pytest.mark.parametrize("name", shipped_trucks())
def test_the_bodies_of_a_straight_combination_end_at_its_rear(name):
    truck, path = TruckParameters.load(name), PREVIEW.follow(0, 1000.0, 400.0, 150.0)
    boxes = bodies_along(truck, PREVIEW, path, None, np.array([1000.0]))
    assert len(boxes) == len(truck.units)
    rear = min(float(box.x[0] - 0.5 * box.length) for box in boxes)
    assert rear == pytest.approx(1000.0 - truck.rear, abs=1e-6)


@pytest.mark.parametrize("name", ["b_double", "a_double"])
def test_a_longer_combination_has_settled_on_a_bend_before_the_first_position(name):
    truck, path = TruckParameters.load(name), ROUND.follow(0, 250.0, 100.0, 240.0)
    boxes = bodies_along(truck, ROUND, path, None, np.array([250.0, 255.0]))
    center = CIRCLE.evaluate(0.0, RADIUS)
    away = [np.hypot(box.x - float(center.x), box.y - float(center.y)) for box in boxes]
    for distance in away:
        assert distance[0] == pytest.approx(distance[1], abs=0.05)


def test_a_lifted_axle_does_not_count_for_the_path_of_the_truck():
    truck = TruckParameters.load("tractor_semitrailer_6x2")
    lifted, loads = unit_lengths(truck, 0.0), static_axle_loads(truck, 0.0)
    (front,), rear = truck.lead.groups(0.0)
    assert (loads == 0.0).any()
    assert lifted[0] == pytest.approx(rear[0].position - front.position)
    assert lifted[0] != pytest.approx(unit_lengths(truck)[0], abs=0.1)
    path = np.column_stack([np.arange(0.0, 60.0, 0.2), np.zeros(300)])
    group = swept_path(truck, path, 0.0, payload=0.0)[0].group
    assert path[-1, 0] - group[-1, 0] == pytest.approx(lifted[0])
