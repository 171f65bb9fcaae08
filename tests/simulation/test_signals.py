"""A drive reports lights and changed limits to the stack, and the truck obeys them."""

import dataclasses

import pytest

from iits_mj.core.messages import (
    EgoFootprint,
    EgoState,
    LightState,
    PlanMode,
    RoadSignals,
    SpeedZone,
)
from iits_mj.road import RoadMap, Route
from iits_mj.simulation import DriveConfig, Simulation
from iits_mj.simulation.frame import read_signals
from iits_mj.simulation.summary import SummaryBuilder
from iits_mj.simulation.traffic_flow import FlowMeter
from tests.paths import outside
from traffic_bridge import InterSim, PureSim, Recorder, TrafficConfig

MAP = "xodr/esmini_fabriksgatan_traffic_lights.xodr"
STOP_LINE = 104.75  # [m], before the light's pole at 109 m
ROUTE = Route.straight(length=2000.0)


def test_an_empty_road_has_no_signals():
    assert read_signals(None, EgoState(), ROUTE, EgoFootprint()) == RoadSignals()


def test_changed_limits_near_the_truck_are_reported_in_their_order():
    with Recorder(PureSim(ROUTE, TrafficConfig(density="empty"))) as traffic:
        traffic.reset()
        signals = traffic.traffic.signals
        signals.set_speed_limit(12.0, 300.0, 600.0)
        number = signals.set_speed_limit(8.0, 400.0, 500.0, lane=1)
        signals.set_speed_limit(5.0, 1500.0, 1600.0)
        ego = EgoState(station=250.0, offset=float(ROUTE.lane_offset(0, 250.0)))
        reported = read_signals(traffic, ego, ROUTE, EgoFootprint()).zones
        assert reported == (SpeedZone(300.0, 600.0, 12.0), SpeedZone(400.0, 500.0, 8.0, 1))
        signals.lift_speed_limit(number)
        assert len(read_signals(traffic, ego, ROUTE, EgoFootprint()).zones) == 1


@pytest.fixture(scope="module")
def at_the_light():
    """Frames of a drive to a light that is red for 20 s, then green."""
    config = DriveConfig(
        map=outside(MAP),
        density="empty",
        duration=32.0,
        start_station=40.0,
        start_speed=8.0,
        speed=10.0,
    )

    def inter(route, footprint):
        traffic = TrafficConfig(density="empty", footprint=footprint)
        return InterSim(route, traffic)

    frames = []
    with Simulation(config, traffic=inter, visuals=False) as simulation:
        signals = simulation.traffic.signals
        (light,) = signals.lights()
        signals.set_state(light, "r")
        while not simulation.ended:
            frames.append(simulation.cycle())
            if abs(simulation.time - 20.0) < 0.05:
                signals.set_state(light, "G")
    return frames


def test_the_truck_stops_at_a_red_light_within_1_m_before_its_line(at_the_light):
    stood = [f for f in at_the_light if f.ego.speed < 0.05 and f.time < 20.0]
    assert stood
    assert stood[-1].scene.signals.light.state is LightState.RED
    assert 0.0 < STOP_LINE - (stood[-1].ego.station + 1.4) < 1.0


def test_a_stop_line_is_reported_until_the_front_is_well_past_it():
    route = RoadMap.from_opendrive(outside(MAP)).route()
    with PureSim(route, TrafficConfig(density="empty")) as traffic:
        traffic.reset()
        (light,) = traffic.signals.lights()
        reported = {}
        for letter, past in (("r", 2.0), ("r", 6.0), ("s", -5.0)):
            traffic.signals.set_state(light, letter)
            ego = EgoState(station=STOP_LINE + past - 1.4)
            reported[letter, past] = read_signals(traffic, ego, route, EgoFootprint()).light
    assert reported["r", 2.0].state is LightState.RED
    assert reported["r", 6.0] is None
    assert reported["s", -5.0].state is LightState.STOP


def test_red_lights_run_and_emergency_brakings_are_counted_and_named(at_the_light):
    def summary(frames):
        builder = SummaryBuilder(FlowMeter(ROUTE))
        for frame in frames:
            builder.add(frame)
        last = frames[-1]
        return builder.build(
            last, wall_time=1.0, ended="", collision=False, failed=False, fuel=0.0, warnings={},
            road_surface="smooth", unsure_decisions=0,
        )  # fmt: skip

    kept = summary(at_the_light)
    assert (kept.red_lights_run, kept.first_red_light, kept.emergency_brakings) == (0, None, 0)
    red = dataclasses.replace(at_the_light[0].scene.signals.light, state=LightState.RED)
    reported = RoadSignals(red)
    frames = [
        dataclasses.replace(
            frame,
            scene=dataclasses.replace(frame.scene, signals=reported),
            trajectory=dataclasses.replace(frame.trajectory, mode=PlanMode.EMERGENCY),
        )
        for frame in at_the_light
    ]
    run = summary(frames)
    assert (run.red_lights_run, run.emergency_brakings) == (1, 1)
    assert run.as_dict()["first_red_light_s"] > 20.0
    assert "red lights run" in run.to_text()


def test_the_truck_continues_on_green(at_the_light):
    passed = next(f.time for f in at_the_light if f.ego.station + 1.4 > STOP_LINE + 0.5)
    assert 20.0 < passed < 26.0
    assert at_the_light[-1].ego.speed > 2.0
