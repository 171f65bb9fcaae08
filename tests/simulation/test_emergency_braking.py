"""Emergency braking in a drive: on the bus, in the telemetry and in the summary."""

import csv
import json

import numpy as np
import pytest

from controllers.emergency_braking import EmergencyState
from iits_mj.core.errors import InputError
from iits_mj.core.messages import VehicleCommand, XbrMode
from iits_mj.core.units import KMH
from iits_mj.j1939 import CommandReceiver, CommandSender
from iits_mj.j1939.command import EmergencySender, with_emergency
from iits_mj.j1939.database import decode
from iits_mj.j1939.network import EMERGENCY_BRAKING
from iits_mj.road import Route
from iits_mj.simulation import DriveConfig, Simulation, Telemetry
from iits_mj.simulation.lock_step import Observer
from iits_mj.validation.aeb.drives import BlindPlanner
from traffic_bridge import EventSim, PlaceVehicle, TrafficConfig

AEBS1 = 61487


def blind_drive(commands="direct", aeb="on"):
    """A stack that sees no vehicle drives at 60 km/h towards a standing car."""
    config = DriveConfig(
        traffic_mode="none", speed=60.0 * KMH, start_speed=60.0 * KMH, start_station=300.0,
        speed_planner="cruise", decision="keep", duration=9.0, aeb=aeb, commands=commands,
        planner=BlindPlanner,
    )  # fmt: skip
    events = (PlaceVehicle(name="car", gap=70.0, relative_lane=0, speed=0.0),)
    return Simulation(
        config,
        traffic=lambda road, footprint: EventSim(
            road, TrafficConfig(events=events, footprint=footprint)
        ),
        route=Route.straight(length=1000.0),
        visuals=False,
    )


class Senders(Observer):
    reads_bus = True

    def __init__(self):
        self.seen, self.stages = set(), []

    def sent(self, frame):
        self.seen.add((frame.source, frame.pgn))
        if frame.pgn == AEBS1:
            self.stages.append((frame.time, decode(frame).group))


def test_the_stronger_demand_wins_on_the_direct_path():
    mild = VehicleCommand(xbr_demand=-2.0, xbr_mode=XbrMode.MAXIMUM)
    assert with_emergency(mild, -6.0).xbr_demand == -6.0
    assert with_emergency(mild, -1.0) is mild
    assert with_emergency(mild, 0.0) is mild


def test_on_the_bus_the_emergency_braking_has_priority_and_ends():
    receiver, driver, guard = CommandReceiver(), CommandSender(), EmergencySender()
    mild = VehicleCommand(xbr_demand=-2.0, xbr_mode=XbrMode.MAXIMUM)
    demands = {}
    for k, demand in enumerate([0.0, -6.0, -6.0, 0.0, 0.0]):
        time = 0.02 * k
        for frame in driver.frames(mild, time) + guard.frames(demand, time):
            assert receiver.receive(frame)
        demands[k] = receiver.command(time).xbr_demand
    assert demands == {
        k: pytest.approx(v, abs=1e-3) for k, v in enumerate([-2.0, -6.0, -6.0, -2.0, -2.0])
    }
    assert receiver.senders["XBR"] == [0x2A, EMERGENCY_BRAKING]
    with pytest.raises(InputError, match="xbr_demand"):
        guard.frames(-11.0, 0.2)


@pytest.mark.parametrize("commands", ["direct", "j1939"])
def test_a_blind_planner_is_stopped_before_the_car(commands):
    with blind_drive(commands) as simulation:
        senders = Senders()
        summary = simulation.run([senders])
    assert not summary.collision
    assert summary.aeb.brakings == 1
    assert summary.aeb.warnings >= 1
    assert 0.3 < summary.closest_gap < 6.0
    assert (EMERGENCY_BRAKING, AEBS1) in senders.seen
    times, groups = zip(*senders.stages, strict=True)
    # Every 50 ms, in commands that are 20 ms apart.
    assert np.diff(times).mean() == pytest.approx(0.05, abs=0.002)
    order = list(dict.fromkeys(round(group.aebs_state) for group in groups))
    assert order[:4] == [3, 5, 6, 7]  # ready, warning, with braking, emergency braking
    for group in groups:
        braking = group.aebs_state in (5, 6, 7)
        assert group.relevant_object_detected or group.aebs_state != 5
        assert group.collision_warning_level == (0 if not braking else 1 + (group.aebs_state > 5))
    assert min(group.time_to_collision for group in groups) < 2.0


def test_without_it_the_blind_planner_hits_the_car():
    with blind_drive(aeb="off") as simulation:
        senders = Senders()
        summary = simulation.run([senders])
        assert not senders.stages
        assert simulation.impact.vehicle == "car"
    assert summary.collision
    assert summary.aeb is None
    assert "aeb" not in summary.as_dict()


def test_a_drive_with_it_reports_its_state(tmp_path):
    path = tmp_path / "telemetry.csv"
    with Telemetry(path) as telemetry, blind_drive() as simulation:
        summary = simulation.run([telemetry])
    with path.open() as file:
        rows = list(csv.DictReader(file))
    states = [row["aeb_state [-]"] for row in rows]
    order = ["standby", "warning", "partial braking", "emergency braking"]
    assert [states.index(name) for name in order] == sorted(states.index(name) for name in order)
    braking = rows[states.index("emergency braking")]
    assert braking["aeb_target [-]"] == "car"
    assert float(braking["aeb_demand [m/s2]"]) <= -4.0
    values = json.loads(json.dumps(summary.as_dict()))["aeb"]
    assert values["brakings"] == 1
    assert values["braking_time_s"] > 2.0
    assert "AEB" in summary.to_text()


def test_telemetry_without_it_has_no_columns_of_it():
    config = DriveConfig(traffic_mode="none", duration=1.0, speed_planner="cruise", decision="keep")
    with Telemetry(None) as telemetry, Simulation(config, visuals=False) as simulation:
        simulation.run([telemetry])
        assert simulation.emergency is None
    assert not [name for name in telemetry.names if name.startswith("aeb")]


def test_a_drive_repeats_with_it():
    with blind_drive() as simulation:
        first = [simulation.cycle().ego for _ in range(40)]
        simulation.reset()
        assert simulation.emergency.state is EmergencyState.OFF
        assert [simulation.cycle().ego for _ in range(40)] == first


def test_the_option_is_on_or_off():
    with pytest.raises(InputError, match="aeb"):
        DriveConfig(aeb="maybe")
