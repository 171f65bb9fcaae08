"""Traffic lights and changing limits, with a truck that follows its plan exactly."""

import dataclasses
import math

import numpy as np
import pytest

from controllers.planning.config import PlannerConfig, SpeedConfig
from controllers.planning.crossing import is_free
from controllers.planning.planner import Planner
from iits_mj.core.errors import InputError
from iits_mj.core.messages import (
    EgoState,
    LightState,
    RoadSignals,
    Scene,
    SpeedZone,
    TrackedVehicle,
    TrafficLight,
)
from iits_mj.parameters import TruckParameters
from iits_mj.road import Route
from tests.controllers.scenes import advanced, car

ROUTE = Route.straight(length=3000.0)
LINE = 700.0
GREEN, YELLOW, RED = LightState.GREEN, LightState.YELLOW, LightState.RED
ARROW = LightState.STOP


def cycle(*phases, start=0.0, known=True):
    """A light that goes through (state, duration) phases from a time; the last one stays."""

    def at(time):
        left = time - start
        for (state, duration), (following, _) in zip(
            phases, (*phases[1:], phases[-1]), strict=True
        ):
            if left < duration:
                if known and math.isfinite(duration):
                    return TrafficLight(LINE, state, duration - left, following)
                return TrafficLight(LINE, state)
            left -= duration
        return TrafficLight(LINE, phases[-1][0])

    return at


def drive(duration, light=None, speed=16.67, station=300.0, zones=(), vehicles=()):
    """States of a truck on the right lane."""
    planner = Planner(ROUTE, PlannerConfig(speed=SpeedConfig(cruise_speed=speed)))
    offset = float(ROUTE.lane_offset(0, station))
    ego = EgoState(station=station, offset=offset, speed=speed, mass=55_000.0)
    states = []
    for _ in range(round(10 * duration)):
        front = ego.station + 1.4
        ahead = light(ego.time) if light and front <= LINE else None
        signals = RoadSignals(ahead, zones)
        plan = planner.plan(Scene(ego.time, ego, vehicles, signals=signals))
        states.append(ego)
        ego = advanced(ego, plan)
    return states


def passed(states):
    """Time at which the front crosses the line."""
    return next((s.time for s in states if s.station + 1.4 > LINE), math.inf)


@pytest.mark.parametrize("speed", [6.0, 11.0, 16.67, 22.0])
def test_the_truck_stops_at_a_red_light_within_1_m_before_the_line(speed):
    states = drive(60.0, cycle((RED, math.inf)), speed, station=LINE - 15.0 * speed)
    assert states[-1].speed < 0.01
    assert 0.0 < LINE - (states[-1].station + 1.4) < 1.0
    assert min(s.acceleration for s in states) > -1.5


def test_the_truck_restarts_on_green():
    light = cycle((RED, 40.0), (GREEN, math.inf), known=False)
    states = drive(65.0, light, station=500.0)
    assert 40.0 < passed(states) < 45.0
    assert states[-1].speed > 10.0


@pytest.mark.parametrize(("distance", "stops"), [(30.0, False), (60.0, False), (95.0, True)])
def test_at_yellow_the_truck_stops_if_2_m_per_s2_are_enough_and_passes_otherwise(distance, stops):
    # From 60 km/h with 0.5 s until the brakes bite, 2 m/s2 need 78 m.
    station = LINE - 1.4 - distance
    light = cycle((YELLOW, 4.0), (RED, math.inf))
    states = drive(25.0, light, station=station)
    assert (passed(states) == math.inf) is stops
    if stops:
        assert 0.0 < LINE - (states[-1].station + 1.4) < 1.0
        assert min(s.acceleration for s in states) > -2.6
    else:
        assert passed(states) < 4.0
        assert min(s.speed for s in states) > 16.0


def test_no_truck_passes_a_line_at_red_after_a_yellow_of_5_s():
    for distance in np.arange(10.0, 150.0, 20.0):
        light = cycle((YELLOW, 5.0), (RED, math.inf))
        when = passed(drive(9.0, light, station=LINE - 1.4 - distance))
        assert when < 5.0 or when == math.inf, f"yellow seen {distance} m before the line"


def test_the_truck_stops_gently_for_a_green_that_ends_before_it_arrives():
    light = cycle((GREEN, 12.0), (YELLOW, 4.0), (RED, math.inf))
    states = drive(45.0, light)
    assert passed(states) == math.inf
    assert min(s.acceleration for s in states) > -1.3


def test_a_light_far_away_does_not_slow_the_truck():
    states = drive(4.0, cycle((RED, 200.0), (GREEN, math.inf)), station=300.0)
    assert min(s.speed for s in states) > 16.6


def test_the_truck_approaches_a_red_of_known_end_slowly_and_passes_it_rolling():
    states = drive(40.0, cycle((RED, 32.0), (GREEN, math.inf)))
    assert 32.0 < passed(states) < 38.0
    assert min(s.speed for s in states) > 8.0
    assert min(s.acceleration for s in states) > -1.2


def test_the_truck_passes_a_light_that_turns_red_too_late_to_stop():
    states = drive(10.0, cycle((RED, math.inf)), station=LINE - 1.4 - 15.0)
    assert passed(states) < 1.5


def test_a_leader_before_the_line_still_counts():
    standing = (car(ROUTE, "first", LINE - 3.0, 0, 0.0),)
    states = drive(35.0, cycle((RED, math.inf)), station=500.0, vehicles=standing)
    assert LINE - 12.0 < states[-1].station + 1.4 < LINE - 5.4 - 2.0


def test_the_truck_keeps_a_changing_limit_from_its_sign_to_its_end():
    zones = (SpeedZone(600.0, 900.0, 12.0), SpeedZone(700.0, 800.0, 8.0, lane=0))
    states = drive(70.0, station=450.0, zones=zones)
    speed = {s.station: s.speed for s in states}
    inside = [v for station, v in speed.items() if 600.0 <= station < 900.0]
    narrow = [v for station, v in speed.items() if 700.0 <= station < 800.0]
    assert max(inside) <= 12.15
    assert max(narrow) <= 8.15
    assert states[-1].speed > 13.0


def test_a_limit_of_another_lane_does_not_apply():
    states = drive(10.0, zones=(SpeedZone(400.0, 3000.0, 5.0, lane=1),))
    assert min(s.speed for s in states) > 16.0


def test_a_limit_may_be_higher_than_the_map_s():
    road = Route.straight(length=2000.0, speed_limit=10.0)
    planner = Planner(road)
    ego = EgoState(station=200.0, offset=float(road.lane_offset(0, 200.0)), speed=10.0)
    signals = RoadSignals(zones=(SpeedZone(0.0, 2000.0, 15.0),))
    assert planner.plan(Scene(0.0, ego, signals=signals)).speed[-1] > 11.0


def test_a_truck_that_creeps_to_a_red_line_seen_late_stops():
    states = drive(12.0, cycle((RED, math.inf)), 0.6, station=LINE - 1.4 - 0.7)
    assert passed(states) == math.inf
    assert states[-1].speed < 0.01


def test_at_a_green_arrow_the_truck_stops_first_and_then_continues():
    states = drive(40.0, cycle((ARROW, math.inf)), 11.0, station=LINE - 120.0)
    stood = [s.time for s in states if s.speed < 0.01 and s.station + 1.4 > LINE - 1.5]
    assert stood[-1] - stood[0] >= 1.0 - 0.15
    assert stood[-1] < passed(states) < math.inf


def test_at_a_green_arrow_the_truck_waits_for_a_crossing_vehicle():
    way = ROUTE.evaluate(LINE + 15.0, 0.0)
    x, y, yaw = float(way.x), float(way.y), float(way.heading) + 0.5 * math.pi
    place = x - 60.0 * math.cos(yaw), y - 60.0 * math.sin(yaw)
    ego = EgoState(station=LINE - 2.2, offset=float(ROUTE.lane_offset(0, LINE)))
    crossing = TrackedVehicle("c", x=place[0], y=place[1], yaw=yaw, speed=10.0, lane=-1)
    preview = Planner(ROUTE).preview
    assert not is_free(Scene(0.0, ego, (crossing,)), preview, LINE)
    gone = dataclasses.replace(crossing, yaw=yaw + math.pi)
    assert is_free(Scene(0.0, ego, (gone,)), preview, LINE)


def test_the_plan_uses_the_power_of_the_given_truck():
    shipped = TruckParameters.load()
    engine = shipped.engine
    weak = dataclasses.replace(engine, full_load_torque=0.5 * engine.full_load_torque)
    planner = Planner(ROUTE, parameters=dataclasses.replace(shipped, engine=weak))
    ordinary = Planner(ROUTE, parameters=shipped)
    ratio = planner.config.speed.powers.power / ordinary.config.speed.powers.power
    assert ratio == pytest.approx(0.5)


@pytest.mark.parametrize(
    "signals",
    [
        RoadSignals(TrafficLight(math.nan, RED)),
        RoadSignals(TrafficLight(LINE, RED, math.nan)),
        RoadSignals(TrafficLight(LINE, "red")),
        RoadSignals(zones=(SpeedZone(0.0, 100.0, math.nan),)),
        RoadSignals(zones=(SpeedZone(math.nan, 100.0, 10.0),)),
        RoadSignals(zones=(SpeedZone(0.0, 100.0, 0.0),)),
    ],
)
def test_signals_with_invalid_values_are_refused(signals):
    ego = EgoState(station=600.0, offset=float(ROUTE.lane_offset(0, 600.0)), speed=10.0)
    with pytest.raises(InputError, match=r"traffic light|speed zone"):
        Planner(ROUTE).plan(Scene(0.0, ego, signals=signals))
