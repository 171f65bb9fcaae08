import dataclasses

import pytest

from iits_mj.core.errors import BusError
from iits_mj.core.messages import EgoState, TruckReport, XbrMode
from iits_mj.j1939 import ReferenceTorques, StateReceiver, decode, encode, state_to_frames
from iits_mj.j1939.groups import ERC1
from iits_mj.j1939.mapping import reports
from iits_mj.parameters import TruckParameters
from iits_mj.truck import Truck

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
# 1350 N m at the crankshaft are 1512 N m in the cylinders, of 2700 N m.
REPORT = TruckReport(
    accelerator_pedal=0.6,
    brake_pedal=0.0,
    parking_brake=0.0,
    engine_brake=0.2,
    retarder=0.4,
    transmission_mode=0.0,
    xbr_mode=0.0,
    xbr_acceleration_limit=-10.0,
    engine_torque_percent=56.0,
    torque_loss_percent=6.0,
    engine_torque_percent_driver=61.0,
    engine_load_percent=58.0,
    engine_torque_mode=6.0,
    clutch_engagement=1.0,
    input_shaft_speed=124.0,
    propeller_shaft_speed=120.0,
    gear_engaged=10.0,
    gear_ratio=1.633,
    engine_brake_torque=0.0,
    engine_brake_torque_percent_intended=-80.0,
    engine_brake_torque_percent_available=-90.0,
    retarder_torque=0.0,
    retarder_torque_percent_intended=-10.0,
    retarder_torque_percent_available=-55.0,
    reservoir_pressure_front=1000e3,
    reservoir_pressure_rear=960e3,
    reservoir_pressure_trailer=840e3,
    compressor_active=1.0,
    abs_active=0.0,
    abs_operational=1.0,
    asr_engine_active=1.0,
    asr_brake_active=1.0,
    xbr_active=0.0,
    brake_pressure_rear2_left=140e3,
    brake_pressure_rear2_right=145e3,
    wheel_based_speed=22.0,
    wheel_speeds=(22.1, 22.3, 22.0, 22.5, 21.9, 22.4),
    tractor_mass=8_900.0,
    trailer_mass=30_100.0,
    cargo_mass=20_000.0,
    axle_loads=(60.7e3, 94.9e3),
)
TOLERANCE = {
    "z": 0.07,
    "engine_speed": 0.01,
    "engine_torque": 1e-6,
    "fuel_rate": 1e-5,
    "fuel_used": 1e-3,
    "speed": 1e-3,
    "offset": 2e-3,
    "trailer_offset": 2e-3,
}


def test_state_crosses_the_bus_within_the_resolution_of_the_signals():
    receiver = StateReceiver()
    for frame in state_to_frames(STATE, REPORT):
        receiver.receive(frame)
    received = receiver.state()
    for field in dataclasses.fields(STATE):
        sent, got = getattr(STATE, field.name), getattr(received, field.name)
        assert got == pytest.approx(sent, abs=TOLERANCE.get(field.name, 6e-4)), field.name


REPORT_TOLERANCE = {
    "accelerator_pedal": 0.002,
    "input_shaft_speed": 0.01,
    "propeller_shaft_speed": 0.01,
    "gear_ratio": 5e-4,
    "wheel_based_speed": 1e-3,
    "wheel_speeds": 0.01,
    "reservoir_pressure_front": 4e3,
    "reservoir_pressure_rear": 4e3,
    "reservoir_pressure_trailer": 4e3,
    "axle_loads": 2.5,
}


def test_the_report_of_these_tests_has_every_field():
    # No parameter group has the torque at the steering wheel.
    for field in dataclasses.fields(REPORT):
        sent = getattr(REPORT, field.name) not in (None, ())
        assert sent is (field.name != "steering_wheel_torque"), field.name


def test_report_crosses_the_bus_within_the_resolution_of_the_signals():
    receiver = StateReceiver()
    for frame in state_to_frames(STATE, REPORT):
        receiver.receive(frame)
    received = receiver.report()
    for field in dataclasses.fields(REPORT):
        sent, got = getattr(REPORT, field.name), getattr(received, field.name)
        if field.name in ("clutch_engagement", "xbr_mode", "xbr_active"):
            # Only derived quantities are sent: driveline engaged, demand that the brakes execute.
            assert got is None
        else:
            assert got == pytest.approx(sent, abs=REPORT_TOLERANCE.get(field.name, 1e-6))


def test_each_retarder_reports_its_torque_and_that_of_the_engine_acts_at_the_crankshaft():
    braking = dataclasses.replace(
        REPORT,
        engine_torque_percent=0.0,
        engine_brake_torque=726.5,
        retarder_torque=1750.0,
    )
    frames = state_to_frames(STATE, braking)
    said = {f.source: decode(f) for f in frames if decode(f).name == "ERC1"}
    assert said.keys() == {0x0F, 0x10}
    assert said[0x0F].group.number("actual_retarder_torque_percent") == -50.0
    assert said[0x10].group.number("actual_retarder_torque_percent") == -50.0
    receiver = StateReceiver()
    for frame in frames:
        receiver.receive(frame)
    assert receiver.report().retarder_torque == pytest.approx(1750.0)
    assert receiver.state().engine_torque == pytest.approx(-0.06 * 2700.0 - 726.5)


def test_default_percent_torques_are_those_of_the_shipped_truck():
    shipped = ReferenceTorques.of(TruckParameters.load())
    for field in dataclasses.fields(shipped):
        default = getattr(ReferenceTorques(), field.name)
        assert default == pytest.approx(getattr(shipped, field.name), rel=1e-3)


def test_a_truck_without_retarder_reports_none():
    frames = state_to_frames(STATE, REPORT, ReferenceTorques(retarder=0.0))
    said = next(decode(f) for f in frames if decode(f).name == "ERC1" and f.source == 0x10)
    with pytest.raises(BusError, match="not available"):
        said.group.number("actual_retarder_torque_percent")


def test_every_row_of_the_table_names_sensors_or_controls_of_the_model():
    model = Truck.load(visuals=False).model
    names = {model.sensor(i).name for i in range(model.nsensor)}
    names |= {model.actuator(i).name for i in range(model.nactuator)}
    sizes = {model.sensor(i).name: model.sensor(i).dim[0] for i in range(model.nsensor)}
    for row in reports():
        for element in row.elements:
            name, _, place = element.rstrip("]").partition("[")
            assert name in names, row.quantity
            assert not place or int(place) < sizes[name], row.quantity
    # Masses are parameters of the truck, not sensors.
    bare = {row.quantity for row in reports() if not row.elements}
    assert bare == {"mass", "tractor_mass", "trailer_mass", "cargo_mass"}


def test_retarder_of_another_address_is_ignored():
    receiver = StateReceiver()
    frame = encode(ERC1(actual_retarder_torque_percent=-50.0), source=0x29)
    assert not receiver.receive(frame)
    assert receiver.report().retarder_torque is None


@pytest.mark.parametrize(
    ("mode", "active", "pedal", "code"),
    [
        (XbrMode.OFF, 0.0, 0.0, 0.0),
        (XbrMode.OFF, 0.0, 0.3, 1.0),
        (XbrMode.ADDITION, 1.0, 0.3, 2.0),
        (XbrMode.MAXIMUM, 1.0, 0.0, 3.0),
    ],
)
def test_brakes_report_the_source_of_the_executed_demand(mode, active, pedal, code):
    report = dataclasses.replace(REPORT, xbr_mode=mode, xbr_active=active, brake_pedal=pedal)
    said = {decode(f).name: decode(f) for f in state_to_frames(STATE, report)}
    assert said["EBC5"].group.number("xbr_active_control_mode") == code
    assert said["EBC1"].group.number("ebs_brake_switch") == float(pedal > 0.0)


def test_reports_of_the_truck_agree_with_its_state():
    truck = Truck.load(payload=0.0, visuals=False)
    truck.reset(speed=15.0)
    truck.command(brake_pedal=0.25)
    truck.step(100)
    receiver = StateReceiver()
    state, report = truck.observe(), truck.report()
    for frame in state_to_frames(state, report):
        receiver.receive(frame)
    assert receiver.report().brake_pedal == pytest.approx(0.25, abs=0.002)
    assert len(receiver.report().axle_loads) == 6
    assert sum(receiver.report().axle_loads) == pytest.approx(19_000 * 9.81, rel=0.02)
    assert receiver.state().speed == pytest.approx(state.speed, abs=1e-3)
    # The resolution of both percentages is one percent of the reference torque.
    assert receiver.state().engine_torque == pytest.approx(state.engine_torque, abs=27.0)


def test_unknown_quantities_are_sent_as_not_available():
    frames = {decode(f).name: decode(f) for f in state_to_frames(STATE)}
    with pytest.raises(BusError, match="not available"):
        frames["ERC1"].group.number("actual_retarder_torque_percent")
    with pytest.raises(BusError, match="not available"):
        frames["EEC3"].group.number("nominal_friction_torque_percent")
    with pytest.raises(BusError, match="not available"):
        frames["AIR1"].group.number("pneumatic_supply_pressure_kpa")


def test_axle_weights_are_one_frame_each():
    frames = state_to_frames(STATE, REPORT)
    weights = [decode(f) for f in frames if decode(f).name == "VW"]
    assert [w.group.number("axle_location") for w in weights] == [0.0, 16.0]
    assert weights[0].group.number("axle_weight_kg") == pytest.approx(60.7e3 / 9.81, abs=0.25)


@pytest.mark.parametrize("field", ["x", "yaw", "engine_torque"])
def test_a_state_that_is_not_finite_is_refused(field):
    with pytest.raises(BusError, match=field):
        state_to_frames(dataclasses.replace(STATE, **{field: float("nan")}))


@pytest.mark.parametrize(
    "change", [{"retarder_torque": float("nan")}, {"axle_loads": (1.0, float("inf"))}]
)
def test_a_report_that_is_not_finite_is_refused(change):
    with pytest.raises(BusError, match=next(iter(change))):
        state_to_frames(STATE, dataclasses.replace(REPORT, **change))
