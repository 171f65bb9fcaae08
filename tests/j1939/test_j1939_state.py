import dataclasses

import pytest

from iits_mj.errors import BusError
from iits_mj.j1939 import StateReceiver, decode, state_to_frames
from iits_mj.messages import EgoState

STATE = EgoState(
    time=12.5,
    x=-1234.567,
    y=98_765.432,
    z=312.0,
    yaw=2.1,
    pitch=-0.03,
    roll=0.01,
    speed=22.2,
    lateral_speed=-0.2,
    acceleration=-1.4,
    lateral_acceleration=0.9,
    yaw_rate=0.05,
    trailer_yaw_rate=0.04,
    articulation=0.12,
    articulation_rate=-0.01,
    steering_wheel_angle=0.26,
    road_wheel_angle=0.0124,
    station=14_999.25,
    offset=-6.0,
    trailer_offset=-6.25,
    gear=11,
    shift_in_process=True,
    engine_speed=125.0,
    engine_torque=1350.0,
    fuel_rate=0.007,
    fuel_used=1.2,
    brake_pressures=(100e3, 100e3, 150e3, 150e3, 200e3),
)
TOLERANCE = {
    "z": 0.07,
    "engine_speed": 0.01,
    "engine_torque": 13.6,
    "fuel_rate": 1e-5,
    "fuel_used": 1e-3,
    "speed": 1e-3,
    "offset": 2e-3,
    "trailer_offset": 2e-3,
}


def test_state_survives_the_bus_up_to_the_signals_steps():
    receiver = StateReceiver()
    for frame in state_to_frames(STATE):
        receiver.receive(frame)
    received = receiver.state()
    for field in dataclasses.fields(STATE):
        sent, got = getattr(STATE, field.name), getattr(received, field.name)
        assert got == pytest.approx(sent, abs=TOLERANCE.get(field.name, 6e-4)), field.name


def test_unknown_quantities_are_sent_as_not_available():
    frames = {decode(f).name: decode(f) for f in state_to_frames(STATE)}
    with pytest.raises(BusError, match="not available"):
        frames["EEC3"].number("nominal_friction_torque_percent")
    with pytest.raises(BusError, match="not available"):
        frames["AIR1"].number("pneumatic_supply_pressure_kpa")


def test_axle_weights_are_one_frame_each():
    frames = state_to_frames(STATE, axle_loads=[60.7e3, 94.9e3])
    weights = [decode(f) for f in frames if decode(f).name == "VW"]
    assert [w.number("axle_location") for w in weights] == [0.0, 16.0]
    assert weights[0].number("axle_weight_kg") == pytest.approx(60.7e3 / 9.81, abs=0.25)


@pytest.mark.parametrize("field", ["x", "yaw", "engine_torque"])
def test_a_state_that_is_not_finite_never_reaches_the_bus(field):
    with pytest.raises(BusError, match=field):
        state_to_frames(dataclasses.replace(STATE, **{field: float("nan")}))
