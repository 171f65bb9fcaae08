"""Tight bends in which the trailer leaves its lane: vehicles that the truck waits for."""

import math

import numpy as np
import pytest

from controllers.planning.planner import Planner
from controllers.planning.predicted_boxes import Poses
from controllers.planning.road_preview import RoadPreview
from controllers.planning.tight_bend_yield import BEND_SPEED, DECELERATION, HARD, TightBends
from iits_mj.core.messages import (
    EgoState,
    LightState,
    RoadSignals,
    Scene,
    TrafficLight,
)
from iits_mj.parameters import TruckParameters
from iits_mj.road.measured import Lanes, measured_route
from tests.controllers.planning.test_crossing import bend
from tests.controllers.scenes import advanced, car, posed

ROAD = bend()
FREE = 235.0


def oncoming(name, station, speed, **fields):
    """A car in the opposite lane, 3.5 m beside the truck's."""
    offset = float(ROAD.lane_offset(0, station)) + 3.5
    return posed(ROAD, name, station, offset, math.pi, speed, **fields)


def drive(vehicles, duration, station=190.0, speed=3.0, signals=None):
    """Planner, states and plans of a truck that follows its plans exactly."""
    planner, states, plans = Planner(ROAD), [], []
    offset = float(ROAD.lane_offset(0, station))
    ego = EgoState(station=station, offset=offset, speed=speed, mass=19e3)
    for _ in range(round(10 * duration)):
        time = ego.time
        signs = signals(time) if signals else RoadSignals()
        plan = planner.plan(Scene(time, ego, vehicles(time), signals=signs))
        states.append(ego)
        plans.append(plan)
        ego = advanced(ego, plan)
    return planner, states, plans


def test_the_truck_turns_before_a_stream_that_can_stop_gently():
    def stream(time):
        # One vehicle after the other, each far enough away to stop.
        return (oncoming(f"c{int(time)}", 290.0 - 6.0 * (time % 1.0), 6.0),)

    _, states, plans = drive(stream, 35.0)
    stood = [state for state in states if state.speed < 0.05]
    assert len(stood) > 5
    assert max(state.station for state in stood) < 202.0
    assert any("which approaches" in plan.reason for plan in plans)
    assert states[-1].station > FREE


def test_a_truck_that_has_waited_long_makes_no_vehicle_brake_hard():
    def stream(time):
        return (oncoming(f"c{int(time)}", 275.0 - 14.0 * (time % 1.0), 14.0),)

    _, states, plans = drive(stream, 40.0)
    assert states[-1].speed < 0.05
    assert states[-1].station < 202.0
    assert "which approaches" in plans[-1].reason


def test_time_at_a_red_light_does_not_count_as_waiting_for_others():
    def light(time):
        state = LightState.RED if time < 20.0 else LightState.GREEN
        return RoadSignals(light=TrafficLight(station=199.0, state=state))

    def stream(time):
        return (oncoming(f"c{int(time)}", 290.0 - 6.0 * (time % 1.0), 6.0),)

    _, _, plans = drive(stream, 21.0, signals=light)
    assert "which approaches" in plans[-1].reason


def test_the_truck_waits_for_a_vehicle_stopped_on_the_trailers_ground():
    _, states, plans = drive(lambda time: (oncoming("van", 222.0, 0.0),), 60.0)
    assert states[-1].station < 202.0
    assert "van, which has stopped in the way" in plans[-1].reason


@pytest.mark.parametrize("place", [216.0, 219.0, 222.0])
def test_in_the_bend_the_truck_stops_before_its_trailer_touches_a_vehicle(place):
    def vehicles(time):
        # It appears when the truck is in the bend.
        return (oncoming("late", place, 0.0),) if time > 5.0 else ()

    planner, states, plans = drive(vehicles, 40.0, station=197.0)
    assert 205.0 < states[-1].station < FREE
    assert states[-1].speed < 0.05
    assert "late is in the trailer" in plans[-1].reason
    last = states[-1]
    path = planner.preview.follow(planner.lane(Scene(0.0, last)), last.station, 400.0, 150.0)
    sweep = TightBends(planner.preview, TruckParameters.load()).ahead(path, last)
    around = Scene(0.0, EgoState(), [oncoming("late", place, 0.0)]).neighbors
    there = Poses.of(around, np.array([True]), planner.preview).ahead(np.zeros(1))
    row = round(states[-1].station - sweep.first)
    near = np.any([unit.touch(there, 0.1)[:, 0] for unit in sweep.units], axis=0)
    # The trailer would be too near further on, but is not here.
    assert near[row:].any()
    assert not near[row]


# --- one call at a time ---------------------------------------------------------------------


class Bend:
    """The bend with its sweep; `stop` is one call of `demand`."""

    def __init__(self):
        self.preview = RoadPreview(ROAD)
        self.bends = TightBends(self.preview, TruckParameters.load())
        self.path = self.preview.follow(0, 190.0, 400.0, 150.0)
        self.sweep = self.bends.ahead(self.path, self.truck())

    def truck(self, station=190.0, speed=0.0):
        return EgoState(
            station=station, offset=float(ROAD.lane_offset(0, 190.0)), speed=speed, mass=19e3
        )

    def demand(self, *vehicles, time=0.0, light=None, **truck):
        scene = Scene(time, self.truck(**truck), vehicles, signals=RoadSignals(light=light))
        return self.bends.demand(scene, self.path, np.full(len(self.path.station), 20.0))

    def stop(self, *vehicles, **moment):
        return self.demand(*vehicles, **moment)[1]


@pytest.fixture
def at_bend():
    return Bend()


BLOCKING = oncoming("van", 222.0, 0.0)


def test_the_truck_drives_through_the_bend_at_walking_pace(at_bend):
    sweep, station = at_bend.sweep, at_bend.path.station
    cap, stop, reason = at_bend.demand()
    assert (stop, reason) == (math.inf, "")
    inside = (station > sweep.begin) & (station < sweep.last)
    assert cap[inside] == pytest.approx(BEND_SPEED)
    assert cap[station > sweep.last] == pytest.approx(20.0)
    before = station < sweep.begin
    first = station[inside][0]
    braked = np.minimum(
        20.0, np.sqrt(BEND_SPEED**2 + 2.0 * DECELERATION * (first - station)[before])
    )
    assert cap[before] == pytest.approx(braked, rel=0.1)


def test_the_truck_waits_at_the_beginning_of_the_swept_ground_or_where_it_can_stop(at_bend):
    sweep = at_bend.sweep
    assert at_bend.stop(BLOCKING, station=150.0, speed=5.0) == sweep.begin
    # Seen late: where the truck stops at its greatest deceleration, before the ground.
    late = sweep.begin + 1.0
    assert at_bend.stop(BLOCKING, station=late, speed=2.0) == pytest.approx(
        late + 2.0**2 / (2.0 * HARD)
    )
    most = sweep.first - 3.0**2 / (2.0 * HARD) - 0.01
    assert at_bend.stop(BLOCKING, station=most, speed=3.0) == pytest.approx(sweep.first, abs=0.02)


def test_the_time_that_the_truck_stands_for_others_is_summed_up(at_bend):
    waited = []
    for time, truck, light in (
        (10.0, {}, None),
        (10.5, {}, None),
        (11.5, {"speed": 0.29}, None),
        # A truck that moves, or stands at a closed light, does not wait for others.
        (12.5, {"speed": 0.31}, None),
        (13.5, {}, TrafficLight(station=150.0, state=LightState.RED)),
        (14.5, {}, TrafficLight(station=150.0, state=LightState.GREEN)),
        # Nor does time turn back.
        (14.0, {}, None),
    ):
        at_bend.demand(BLOCKING, time=time, light=light, **truck)
        waited.append(at_bend.bends._waited)
    assert waited == pytest.approx([0.0, 0.5, 1.5, 1.5, 1.5, 2.5, 2.5])
    # Without a vehicle in the way time does not count; beyond the bend all begins again.
    at_bend.demand(time=20.0)
    assert at_bend.bends._waited == pytest.approx(2.5)
    at_bend.demand(time=21.0, station=at_bend.sweep.last + 1.0)
    assert (at_bend.bends._waited, at_bend.bends._seen) == (0.0, None)


@pytest.mark.parametrize(
    ("before", "at_line"), [(-0.5, False), (0.5, True), (11.5, True), (12.5, False)]
)
def test_a_line_shortly_before_the_bend_is_the_place_to_wait_at(at_bend, before, at_line):
    overhang = Scene(0.0, EgoState()).footprint.front_overhang
    place = at_bend.sweep.begin - before
    light = TrafficLight(station=place + overhang + 0.5, state=LightState.GREEN)
    stop = at_bend.stop(BLOCKING, light=light, station=160.0)
    assert stop == pytest.approx(place if at_line else at_bend.sweep.begin)


def test_at_a_closed_light_near_the_bend_the_light_is_the_reason(at_bend):
    sweep = at_bend.sweep

    def stop(line, state=LightState.RED, **truck):
        light = TrafficLight(station=line, state=state)
        return at_bend.demand(BLOCKING, light=light, **truck)[1:]

    assert stop(sweep.begin - 1.0, station=160.0) == (math.inf, "")
    assert stop(sweep.begin - 11.9, station=160.0) == (math.inf, "")
    assert stop(sweep.begin - 12.1, station=160.0)[0] == sweep.begin
    assert stop(sweep.begin + 12.1, station=160.0)[0] == sweep.begin
    assert stop(sweep.begin - 1.0, LightState.GREEN, station=160.0)[0] < sweep.begin
    # The front is beyond the line: a standing truck stays, a moving one goes on to its place.
    beyond = {"station": sweep.begin - 1.0}
    where, reason = stop(sweep.begin - 3.0, **beyond)
    assert (where, "beyond the line" in reason) == (sweep.begin - 1.0, True)
    assert "van" in stop(sweep.begin - 3.0, speed=0.31, **beyond)[1]


def test_a_vehicle_counts_if_it_leaves_the_ground_after_the_truck_arrives(at_bend):
    def least(speed, station):
        """The nearest of the oncoming vehicles that the truck waits for."""
        for place in np.arange(226.0, 330.0, 0.25):
            if (
                "approaches"
                in at_bend.demand(
                    oncoming("car", float(place), speed), station=station, speed=BEND_SPEED
                )[2]
            ):
                return place
        return None

    first = at_bend.sweep.first
    # The truck arrives after 9 s; the others have 8 s to leave the ground.
    nine = first - 9.0 * BEND_SPEED
    slow, fast = least(6.0, nine), least(9.0, nine)
    assert fast - slow == pytest.approx(8.0 * 3.0, abs=0.5)
    assert least(6.0, first - 7.0 * BEND_SPEED) - slow == pytest.approx(-2.0 * 6.0, abs=0.5)


def test_a_vehicle_that_arrives_after_the_trailer_is_not_waited_for(at_bend):
    def farthest(speed, station, own):
        places = np.arange(230.0, 420.0, 0.5)
        waits = [
            "approaches"
            in at_bend.demand(oncoming("car", float(p), speed), station=station, speed=own)[2]
            for p in places
        ]
        return float(places[np.flatnonzero(waits)[-1]])

    # From a meter before the ground, the last of it is left after 11.3 s, with a margin 12.3 s.
    station = at_bend.sweep.first - 1.0 - BEND_SPEED**2 / (2.0 * HARD)
    leaves = (at_bend.sweep.last - station) / BEND_SPEED + 1.0
    assert leaves < 15.0
    quick, slow = farthest(8.0, station, BEND_SPEED), farthest(5.0, station, BEND_SPEED)
    assert quick - slow == pytest.approx(3.0 * leaves, abs=2.5)
    # A truck at rest reaches 3 m/s at 0.5 m/s2 and takes 3 s longer; 15 s are looked ahead.
    rest = farthest(5.0, station, 0.0)
    assert rest - slow == pytest.approx(5.0 * (15.0 - leaves), abs=2.5)


def test_in_the_bend_the_truck_stops_just_before_a_vehicle_touches_its_path(at_bend):
    sweep, van = at_bend.sweep, oncoming("van", 215.0, 0.0)
    around = Scene(0.0, EgoState(), [van]).neighbors
    there = Poses.of(around, np.array([True]), at_bend.preview).ahead(np.zeros(1))

    def touched(room):
        near = np.any([unit.touch(there, room)[:, 0] for unit in sweep.units], axis=0)
        return sweep.first + float(np.flatnonzero(near)[0])

    # At rest 0.1 m are kept, and 4 m of the path are looked at.
    first = touched(0.1)
    assert first > sweep.first + 5.0
    assert at_bend.stop(station=first - 3.0) == math.inf
    assert at_bend.stop(van, station=first - 3.9) == pytest.approx(first - 0.5)
    assert at_bend.stop(van, station=first - 4.1) == math.inf
    assert at_bend.stop(van, station=first - 0.6) == pytest.approx(first - 0.5)
    # Nearer than that it stays where it is. A stop does not help against a vehicle at the truck.
    assert at_bend.stop(van, station=first - 0.4) == pytest.approx(first - 0.4)
    assert at_bend.stop(van, station=first + 0.1) == math.inf
    # At 2.8 m/s 0.084 m more are kept, and 4.9 m more looked at.
    first = touched(0.184)
    assert at_bend.stop(van, station=first - 5.0, speed=2.8) == pytest.approx(first - 0.5)


def test_vehicles_in_the_trucks_own_lane_and_far_away_are_left_to_others(at_bend):
    own = car(ROAD, "own", 222.0, 0, 0.0)
    assert at_bend.stop(own, station=160.0) == math.inf
    assert (
        at_bend.stop(oncoming("far", at_bend.sweep.first + 151.0, 20.0), station=190.0) == math.inf
    )
    names, found = at_bend.bends._others(
        at_bend.sweep,
        Scene(
            0.0,
            at_bend.truck(),
            (
                own,
                BLOCKING,
                oncoming("near", at_bend.sweep.first + 149.0, 5.0),
                oncoming("far", at_bend.sweep.first + 151.0, 5.0),
            ),
        ),
        at_bend.path,
    )
    assert sorted(names) == ["near", "van"]
    assert len(found.x) == 2


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_tight_bends_to_both_sides_are_found(side):
    station = np.arange(0.0, 300.0, 1.0)
    curvature = np.where((station >= 200.0) & (station < 214.0), side / 9.25, 0.0)
    road = measured_route(
        station, np.zeros_like(station), curvature=curvature, lanes=Lanes(1, 3.5, 14.0)
    )
    ((begin, over),) = TightBends(RoadPreview(road), TruckParameters.load())._bends
    assert begin == pytest.approx(200.0, abs=5.0)
    assert over == pytest.approx(214.0, abs=5.0)
