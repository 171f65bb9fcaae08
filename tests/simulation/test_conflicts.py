import dataclasses
import json
import math

import numpy as np
import pytest

from iits_mj.simulation import DriveConfig, Simulation
from iits_mj.simulation.conflicts import (
    HARDEST_BRAKING,
    RESPONSE,
    SPEEDING_UP,
    SURE_BRAKING,
    ConflictLog,
    post_encroachment_time,
    required_deceleration,
    rss_distance,
)
from tests.paths import ROOT
from traffic_bridge.scenario.conditions import Body

BODY = Body("a", 100.0, 95.0, 0.0, 2.0, 0, 20.0, 20.0, 0.0, 0.0, 0.0, 0.0, 2.5)


def test_drac_stops_the_closing_exactly_at_contact():
    ahead = BODY._replace(front=130.0, rear=125.0, pace=12.0)
    rate = required_deceleration(BODY, ahead)
    time = (20.0 - 12.0) / rate
    assert 20.0 * time - 0.5 * rate * time**2 == pytest.approx(25.0 + 12.0 * time)
    assert required_deceleration(BODY, ahead._replace(pace=20.0)) == 0.0
    assert required_deceleration(BODY, ahead._replace(rear=99.0)) == math.inf


@pytest.mark.parametrize(("speed", "ahead"), [(20.0, 20.0), (25.0, 10.0), (15.0, 0.0)])
def test_the_rss_distance_is_used_up_when_both_stop_after_the_worst_case(speed, ahead):
    gap, front, v, u, t, step = rss_distance(speed, ahead), 0.0, speed, ahead, 0.0, 1e-4
    rear = -gap
    while v > 0.0 or u > 0.0:
        a = SPEEDING_UP if t < RESPONSE else -SURE_BRAKING
        rear += v * step + 0.5 * a * step**2
        front += u * step
        v, u, t = max(v + a * step, 0.0), max(u - HARDEST_BRAKING * step, 0.0), t + step
    assert front - rear == pytest.approx(0.0, abs=0.02)


def test_a_faster_vehicle_ahead_may_be_close():
    assert rss_distance(5.0, 30.0) == 0.0


def rows(actor, truck, inside):
    time = 0.1 * np.arange(len(actor))
    return np.column_stack(
        (time, np.array(actor) + 5.0, actor, truck, np.array(truck) - 16.5, inside)
    )


def test_the_time_after_a_pedestrian_has_left_the_path():
    # It is in the way at 200 m from 1.0 to 3.0 s; the truck's front reaches 200 m at 5.0 s.
    steps = np.arange(100)
    inside = (steps >= 10) & (steps < 30)
    found = post_encroachment_time(rows(np.full(100, 200.0), 100.0 + 2.0 * steps, inside))
    assert found == pytest.approx(5.0 - 3.0)


def test_the_time_of_a_pedestrian_who_enters_behind_the_truck():
    # The truck's rear passes 205 m at 6.075 s; the pedestrian enters at 8 s.
    steps = np.arange(100)
    found = post_encroachment_time(rows(np.full(100, 200.0), 100.0 + 2.0 * steps, steps >= 80))
    assert found == pytest.approx(8.0 - 6.075)


def test_without_a_meeting_there_is_no_time():
    steps = np.arange(30)
    never = post_encroachment_time(rows(np.full(30, 500.0), 2.0 * steps, steps < 0))
    assert math.isnan(never)
    early = post_encroachment_time(rows(np.full(30, 500.0), 2.0 * steps, steps >= 10))
    assert math.isnan(early)


def test_a_log_of_the_example_agrees_with_the_telemetry_of_the_drive():
    config = DriveConfig(
        start_station=300.0,
        duration=25.0,
        traffic_mode="none",
        events=ROOT / "examples/cut_in.toml",
        plant="yaw-sideslip",
        payload=0.0,
    )
    log, gaps = ConflictLog(), []
    with Simulation(config, visuals=False) as simulation:
        simulation.run([log], progress=lambda frame: gaps.append(frame.gap_ahead))
    (conflict,) = log.conflicts()
    assert conflict.actor == "car"
    assert conflict.gap == pytest.approx(min(gaps), abs=1e-6)
    assert 0.0 < conflict.pet < conflict.time_gap + 1.0
    # The car is slower and closer than the safe distance.
    assert conflict.rss_margin < 0.0
    assert 0.0 < conflict.drac < 1.0
    text = json.dumps(log.as_dict(), allow_nan=False)
    assert '"actor": "car"' in text
    assert [event["name"] for event in log.as_dict()["events"]][:2] == ["car", "cut_in"]
    panels = log.panels("time [s]")
    marks = [line for line in panels[0].lines if line.role == "mark"]
    assert [float(line.x[0]) for line in marks] == [record.begun for record in log.records]
    assert dataclasses.asdict(conflict).keys() >= {"gap", "ttc", "drac", "pet"}


def test_the_speed_of_an_impact_is_the_difference_of_both_velocities(tmp_path):
    events = tmp_path / "e.toml"
    events.write_text(
        '[[events]]\nevent = "place_vehicle"\nname = "car"\ngap = 6.0\nspeed = 2.0\n'
        "reactive = false\n"
    )
    config = DriveConfig(
        traffic_mode="none", events=events, plant="yaw-sideslip", speed_planner="cruise"
    )
    log = ConflictLog()
    with Simulation(config, visuals=False) as simulation:
        summary = simulation.run([log])
        impact, last = simulation.impact, simulation.frame.ego
    assert impact.vehicle == "car"
    assert impact.time <= last.time <= impact.time + 0.1
    # Within the last 100 ms the truck brakes by less than 1 m/s.
    assert last.speed - 2.0 <= impact.speed == summary.impact_speed <= last.speed - 2.0 + 1.0
    assert summary.as_dict()["impact_speed_mps"] == impact.speed
    assert any(name == "impact speed" for name, _ in summary.rows())
    assert log.deceleration == log.as_dict()["greatest_deceleration_mps2"] > 1.0
