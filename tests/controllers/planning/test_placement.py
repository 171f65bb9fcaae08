"""The trailer stays inside the lane where the tractor is placed for it."""

import numpy as np
import pytest

from controllers.planning.planner import Planner
from controllers.planning.predicted_boxes import swept_path
from controllers.planning.road_preview import RoadPreview, lane_shift, off_tracking
from controllers.tracking.lateral_model import LateralModel
from iits_mj.analytic import Kinematic
from iits_mj.core.messages import EgoState, Scene
from iits_mj.parameters import TruckParameters, shipped_trucks
from iits_mj.road.measured import Lanes, measured_route

PARAMETERS = TruckParameters.load()


def bend(radius, width, clothoid=40.0, turn=1.2, lanes=1):
    """A road with one bend to the left (negative radius: right) between straights."""
    arc = abs(turn * radius)
    station = np.arange(0.0, 300.0 + 2.0 * clothoid + arc + 300.0, 5.0)
    knots = np.cumsum([300.0, clothoid, arc, clothoid])
    curvature = np.interp(station, knots, np.array([0.0, 1.0, 1.0, 0.0]) / radius)
    flat = np.zeros_like(station)
    return measured_route(station, flat, curvature=curvature, lanes=Lanes(lanes, width, 8.0))


def margins(route, shifted):
    """Least room between bodies and lane edges [m]: (tractor, trailer), walking pace."""
    preview = RoadPreview(route)
    if shifted:
        preview.shift = lane_shift(preview, PARAMETERS, 55e3, 1.3)
    lane = preview.follow(0, 200.0, route.length, 150.0)
    station = np.arange(200.0, route.length - 200.0, 0.25)
    point = route.evaluate(station, lane.driven_at(station))
    path = np.column_stack([point.x, point.y])
    tractor, trailer = swept_path(PARAMETERS, path, float(point.heading[0]))
    inside = (station > 250.0) & (station < route.length - 250.0)
    room = []
    for corners in (tractor.corners, trailer.corners, sides(trailer)):
        places = [
            route.locate(float(x), float(y), float(s))
            for s, quad in zip(station[inside][::8], corners[inside][::8], strict=True)
            for x, y in quad
        ]
        room.append(min(_room(lane, s, offset) for s, offset in places))
    return room[0], min(room[1:])


def sides(trailer):
    """Points of the trailer's sides over its axle group, which run innermost."""
    left = np.column_stack([-np.sin(trailer.yaw), np.cos(trailer.yaw)])
    half = 0.5 * PARAMETERS.units[1].width
    return np.stack([trailer.group + half * left, trailer.group - half * left], axis=1)


def _room(lane, station, offset):
    return lane.half_width - abs(offset - float(lane.offset_at(station)))


@pytest.mark.parametrize("radius", [60.0, 120.0, 250.0, 600.0])
def test_slow_off_tracking_is_that_of_the_kinematic_model(radius):
    gain = off_tracking(LateralModel.of(PARAMETERS, 55e3, 0.1), 0.5)
    exact = -Kinematic.from_parameters(PARAMETERS).off_tracking(radius)
    assert gain / radius == pytest.approx(exact, rel=0.06)


def test_the_trailer_runs_inside_when_slow_and_outside_when_fast():
    model = LateralModel.of(PARAMETERS, 55e3, 0.1)
    gains = [off_tracking(model, speed) for speed in (1.0, 8.0, 16.0, 24.0)]
    assert gains == sorted(gains, reverse=True)
    assert gains[0] > 0.0 > gains[-1]


@pytest.mark.parametrize("radius", [100.0, -100.0])
def test_on_a_ramp_of_100_m_both_units_stay_inside_a_lane_of_3_5_m(radius):
    tractor, trailer = margins(bend(radius, 3.5), shifted=True)
    assert tractor > 0.15
    assert trailer > 0.15
    assert margins(bend(radius, 3.5), shifted=False)[1] < trailer - 0.1


def test_in_a_junction_of_25_m_the_tractor_uses_the_room_of_its_lane():
    # A trailer of 7.9 m cannot stay inside: the best position of the tractor is at the edge.
    tractor, trailer = margins(bend(25.0, 4.5, clothoid=10.0), shifted=True)
    assert tractor > 0.0
    assert trailer > margins(bend(25.0, 4.5, clothoid=10.0), shifted=False)[1] + 0.5


def test_both_sides_have_about_the_same_room_in_a_steady_bend():
    route = bend(80.0, 4.0, turn=2.0)
    preview = RoadPreview(route)
    preview.shift = lane_shift(preview, PARAMETERS, 55e3, 1.3)
    shift = float(preview.shift[0, preview.index(420.0)])
    slow = off_tracking(LateralModel.of(PARAMETERS, 55e3, 0.1), 0.5) / 80.0
    assert shift == pytest.approx(-0.5 * slow, rel=0.05)


def test_the_plan_in_a_bend_is_shifted_and_as_smooth_as_the_road():
    route = bend(100.0, 3.75)
    planner = Planner(route)
    lane = planner.preview.follow(0, 330.0, 100.0)
    ego = EgoState(station=330.0, offset=float(lane.driven_at(330.0)), speed=8.0)
    plan = planner.plan(Scene(0.0, ego))
    middle = np.asarray(route.lane_offset(0, plan.station))
    assert -0.25 < (plan.offset - middle)[-1] < -0.1
    assert np.abs(np.diff(plan.curvature)).max() < 2e-3
    assert np.abs(plan.curvature).max() < 1.15 / 100.0


def test_a_lane_as_narrow_as_the_truck_has_no_room_to_shift_in():
    assert lane_shift_max(bend(100.0, 2.8)) == 0.0


def lane_shift_max(route):
    return float(np.abs(lane_shift(RoadPreview(route), PARAMETERS, 55e3, 1.3)).max())


def test_swept_path_of_a_circle_settles_at_the_kinematic_radii():
    radius, kinematic = 40.0, Kinematic.from_parameters(PARAMETERS)
    angle = np.arange(0.0, 6.0, 0.1 / radius)
    path = radius * np.column_stack([np.cos(angle), np.sin(angle)])
    _, trailer = swept_path(PARAMETERS, path, 0.5 * np.pi)
    settled = float(np.hypot(*trailer.group[-1]))
    assert settled - radius == pytest.approx(kinematic.off_tracking(radius), abs=0.01)
    assert np.allclose(np.hypot(*(trailer.origin - path).T), 3.6)


@pytest.mark.parametrize("name", shipped_trucks())
def test_slow_off_tracking_of_every_truck_is_that_of_its_tractrix(name):
    truck, radius = TruckParameters.load(name), 120.0
    model = LateralModel.of(truck, truck.gross_mass(truck.payload_max), 0.1)
    angle = np.arange(0.0, 2.0, 0.2 / radius)
    path = radius * np.column_stack([np.cos(angle), np.sin(angle)])
    inside = radius - float(np.hypot(*swept_path(truck, path, 0.5 * np.pi)[-1].group[-1]))
    # The model's tires slip a little, as axles of a group scrub.
    assert off_tracking(model, 0.5) / radius == pytest.approx(inside, rel=0.08, abs=0.02)
