import math

import numpy as np
import pytest

from iits_mj.core.errors import InputError
from iits_mj.model.road_table import friction_table
from iits_mj.simulation import DriveConfig, Simulation
from iits_mj.simulation.redrive import redrive

EVENTS = """
[[events]]
event = "friction"
friction = 0.3
friction_right = 0.6
split = 1.5
start = 250.0
end = 300.0
at_time = 0.5
until = 1.5

[[events]]
event = "wind"
speed = 30.0
direction = 90.0
duration = 2.0
at_time = 1.0

[[events]]
event = "puncture"
wheel = "tractor_axle1_left"
when = {measure = "time", above = 0.3}

[[events]]
event = "brake_leak"
circuit = "drive"
at_time = 0.2

[[events]]
event = "stuck_speed_sensor"
wheel = "tractor_axle2_right"
at_time = 0.1
"""


def config(tmp_path, text=EVENTS, **more):
    path = tmp_path / "events.toml"
    path.write_text(text)
    given = {"start_station": 200.0, "duration": 4.0, "traffic_mode": "none", "payload": 0.0}
    return DriveConfig(**(given | {"events": path} | more))


def test_friction_wind_and_faults_act_on_the_truck_and_a_reset_undoes_them(tmp_path):
    with Simulation(config(tmp_path), visuals=False) as simulation:
        truck = simulation.truck
        friction, station = friction_table(truck.model)
        base, state = friction.copy(), truck.data.plugin_state.copy()
        assert not truck.model.opt.wind.any()
        patch = (station >= 250.0) & (station < 300.0)
        winds = []
        for step in range(1, 36):
            simulation.cycle()
            time = 0.1 * step
            wind = truck.model.opt.wind
            winds.append(float(np.linalg.norm(wind)))
            lasts = 0.5 - 1e-9 <= time < 1.5 - 1e-9
            expected = (0.3, 0.6, 1.5) if lasts else base[patch][0]
            assert friction[patch] == pytest.approx(np.tile(expected, (patch.sum(), 1)))
            assert np.array_equal(friction[~patch], base[~patch])
            if step == 20:
                # From the left: it blows to the right of the truck.
                yaw = simulation.frame.ego.yaw
                left = np.array([-math.sin(yaw), math.cos(yaw), 0.0])
                assert wind @ left == pytest.approx(-30.0, abs=0.1)
        assert max(winds) == pytest.approx(30.0, abs=1e-9)
        assert winds[4] == winds[-1] == 0.0
        assert not truck.faults.abs_operational
        assert (
            truck.report().reservoir_pressure_rear < 0.6 * truck.report().reservoir_pressure_front
        )
        assert [r.event.kind for r in simulation.events] == [
            *("stuck_speed_sensor", "brake_leak", "puncture", "friction", "wind")
        ]
        first = simulation.frame
        simulation.reset()
        assert np.array_equal(friction, base)
        assert not truck.model.opt.wind.any()
        assert np.array_equal(truck.data.plugin_state, state)
        assert not simulation.events
        for _ in range(35):
            simulation.cycle()
        assert simulation.frame.ego == first.ego


def test_a_gust_pushes_the_truck_to_its_lee_side(tmp_path):
    gust = '[[events]]\nevent = "wind"\nspeed = 30.0\ndirection = 90.0\nat_time = 0.5\n'
    yaw_rates = []
    for text in (gust, gust.replace("speed = 30.0", "speed = 0.0")):
        with Simulation(config(tmp_path, text), visuals=False) as simulation:
            for _ in range(20):
                simulation.cycle()
            yaw_rates.append(simulation.frame.ego.offset)
    assert yaw_rates[0] < yaw_rates[1] - 0.01


def test_a_fault_of_an_unknown_part_is_refused_before_the_drive(tmp_path):
    text = '[[events]]\nevent = "puncture"\nwheel = "wheel_9"\nat_time = 100.0\n'
    with pytest.raises(InputError, match="event puncture: wheel 'wheel_9' is not known"):
        Simulation(config(tmp_path, text), visuals=False)


def test_a_drive_with_events_is_driven_again_bit_for_bit(tmp_path):
    story = """
[[events]]
event = "place_vehicle"
name = "car"
gap = 25.0
relative_lane = 1

[[events]]
event = "cut_in"
actor = "car"
speed_difference = -4.0
when = {measure = "time", above = 1.0}
"""
    drive = config(tmp_path, EVENTS + story, duration=6.0)
    with Simulation(drive, visuals=False, record=True) as simulation:
        simulation.run()
        recording = simulation._recorder.recording
    assert recording.meta["mode"] == "EventSim"
    again = redrive(recording, "recording", None)
    assert again.frames == len(recording) == 61
