"""Hidden parameters of the simulated truck must come back from the frames of its bus.

Speeds have 1 % of white noise; the other signals have the resolution of the frames.
"""

import numpy as np
import pytest

from iits_mj.core.messages import VehicleCommand
from iits_mj.identification import from_frames, identify, overlay, read, write_toml
from iits_mj.identification.engine import with_engine
from iits_mj.identification.log import with_grade
from iits_mj.identification.replay import replay
from iits_mj.j1939 import LogWriter
from iits_mj.parameters import TruckParameters
from tests.identification.synthetic_drives import LONGITUDINAL, drive, frames
from tests.identification.truck_drives import hidden_truck, hill_drive, hills

PARAMETERS = TruckParameters.load()
PAYLOAD = 11_000.0
_DEAD_TIMES = {"steer": 0.15, "drive": 0.2, "trailer": 0.25}
HIDDEN = {
    "tires": {"*": {"rolling_resistance": 0.0075}},
    "aerodynamics": {"drag_area": 5.2},
    "units": {
        unit.name: {
            "axles": {
                axle.name.removeprefix(f"{unit.name}_"): {
                    "brake": {
                        "torque_per_pressure": 0.85 * axle.brake.torque_per_pressure,
                        "dead_time": dead_time,
                        "build_up_time_constant": dead_time + 0.1,
                    }
                }
                for axle in unit.axles
                for dead_time in [_DEAD_TIMES[axle.tire]]
            }
        }
        for unit in PARAMETERS.units
    },
}
LINE = PARAMETERS.air_brake.trailer_line_delay
TRUTH = {
    "mass": (PARAMETERS.gross_mass(PAYLOAD), 0.05),
    "rolling_resistance": (0.0075, 0.05),
    "drag_area": (5.2, 0.05),
    "brake_gain": (0.85, 0.05),
    "front_dead_time": (0.15, 0.05),
    "drive_dead_time": (0.2, 0.05),
    "trailer_dead_time": (0.25 + LINE, 0.05),
    "front_build_up_time": (0.25, 0.1),
    "drive_build_up_time": (0.3, 0.1),
    "trailer_build_up_time": (0.35, 0.1),
    "torque_map_scale": (1.0, 0.05),
    "engine_drag_scale": (1.0, 0.05),
    "shift_cut_time": (PARAMETERS.gearbox.shift_cut_time, 0.05),
}


@pytest.fixture(scope="module")
def recorded():
    """Rows of the hidden truck's drive over hills, and the road's grade."""
    station, grade, route = hills()
    truck = hidden_truck(PAYLOAD, HIDDEN, route, speed=12.0)
    return drive(truck, hill_drive(), 450.0), station, grade


@pytest.fixture(scope="module")
def log(recorded):
    rows, station, grade = recorded
    return with_grade(
        from_frames(frames(rows, PARAMETERS, LONGITUDINAL), PARAMETERS), station, grade
    )


@pytest.fixture(scope="module")
def found(log):
    return identify(log, PARAMETERS)


@pytest.mark.parametrize("name", TRUTH)
def test_hidden_parameter_comes_back(found, name):
    truth, tolerance = TRUTH[name]
    estimate = found[name]
    assert estimate.identifiable, estimate.reason
    assert estimate.value == pytest.approx(truth, rel=tolerance)
    assert estimate.half_width < 0.15 * truth


def test_a_straight_drive_does_not_show_cornering(found):
    for kind in ("steer", "drive", "trailer"):
        estimate = found[f"cornering_coefficient_{kind}"]
        assert not estimate.identifiable
        assert "lacks yaw_rate" in estimate.reason


def test_truck_with_identified_values_repeats_the_drive(found, log, tmp_path):
    path = tmp_path / "identified.toml"
    write_toml(found, path)
    after = replay(log, path)
    assert after.accuracy() > 97.0


@pytest.mark.slow
def test_truck_with_half_its_payload_and_shipped_values_does_not_repeat_the_drive(log):
    before = replay(log, PARAMETERS, 0.5 * PARAMETERS.payload_max)
    assert before.accuracy() < 95.0


def test_overlay_has_only_the_identified_parameters(found):
    tree = overlay(found)
    brake = tree["units"]["trailer"]["axles"]["axle3"]["brake"]
    assert set(brake) == {"torque_per_pressure", "dead_time", "build_up_time_constant"}
    # The control line's delay is a parameter of its own.
    assert brake["dead_time"] == pytest.approx(0.25, abs=0.02)
    assert all(set(tire) == {"rolling_resistance"} for tire in tree["tires"].values())
    loaded = TruckParameters.load(overlay=tree)
    assert loaded.engine.pedal_map.values.shape == PARAMETERS.engine.pedal_map.values.shape


def test_candump_log_equals_its_frames(recorded, tmp_path):
    rows, _, _ = recorded
    part = frames(rows[:1000], PARAMETERS, {**LONGITUDINAL, "IITS_ATTITUDE": 0.1})
    path = tmp_path / "drive.log"
    writer = LogWriter(path)
    for frame in part:
        writer.write(frame)
    writer.close()
    direct = from_frames(part, PARAMETERS)
    shown = read(path, PARAMETERS)
    assert set(shown.signals) == set(direct.signals) >= {"grade", "engine_torque", "speed"}
    for name in direct.signals:
        assert shown[name] == pytest.approx(direct[name])
        assert shown.series(name).time == pytest.approx(direct.series(name).time, abs=1e-5)


def test_crankshaft_torque_comes_back_from_the_indicated_torque_on_the_bus(recorded, log):
    rows, _, _ = recorded
    time = np.array([state.time for state, _, _ in rows])
    torque = np.array([state.engine_torque for state, _, _ in rows])
    steady = np.abs(np.gradient(torque, time)) < 50.0
    error = log.at("engine_torque", time[steady]) - torque[steady]
    # A bit is 27 N m.
    assert abs(error.mean()) < 5.0
    assert np.abs(error).max() < 15.0


@pytest.mark.slow
def test_hidden_engine_comes_back():
    values = {
        "torque_map_scale": 0.9,
        "engine_drag_scale": 1.25,
        "boost_lag": 0.7,
        "torque_rise_rate": 450.0,
    }
    _, _, route = hills()
    truck = hidden_truck(20_000.0, with_engine(PARAMETERS, values), route, speed=8.0)

    def command(time, state):
        phase = time % 27.0
        pedal = 0.9 if phase < 12.0 else 0.5 if phase < 16.0 else 0.0 if phase < 23.0 else 0.7
        return VehicleCommand(accelerator_pedal=pedal if state.speed < 24.0 else 0.0)

    log = from_frames(frames(drive(truck, command, 170.0), PARAMETERS, LONGITUDINAL), PARAMETERS)
    result = identify(log, PARAMETERS, groups=("engine",))
    for name, truth in values.items():
        assert result[name].identifiable, result[name].reason
        assert result[name].value == pytest.approx(truth, rel=0.05)
