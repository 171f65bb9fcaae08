"""Reports of the truck on the bus in launch, gear changes, braking, reversing and standstill."""

import pytest

from iits_mj.core.errors import BusError
from iits_mj.core.messages import (
    EgoState,
    TransmissionMode,
    TruckReport,
    VehicleCommand,
    XbrEbiMode,
    XbrMode,
)
from iits_mj.core.units import KMH, RPM
from iits_mj.j1939 import (
    Frame,
    StateReceiver,
    Status,
    decode,
    encode,
    pgn_of,
    read_log,
    state_to_frames,
)
from iits_mj.j1939.groups import CCVS1, EEC2, ETC2, VDC2, IitsTrailer
from iits_mj.truck import Truck
from tests.paths import outside

OPERATOR, TRANSMISSION, BRAKES = 1, 6, 10


def truck(payload=0.0, speed=0.0):
    found = Truck.load(payload=payload, visuals=False)
    found.reset(speed=speed)
    return found


def said(subject):
    """Groups by message, ERC1 also by source."""
    groups = {}
    for frame in state_to_frames(subject.observe(), subject.report()):
        decoded = decode(frame)
        groups[decoded.name] = decoded.group
        groups[decoded.name, frame.source] = decoded.group
    return groups


def drive(subject, command, seconds, tick=0.05):
    """Reports of the truck at every tick under one command."""
    subject.command(command)
    found = []
    for _ in range(round(seconds / tick)):
        subject.step(round(tick / subject.model.opt.timestep))
        found.append(said(subject))
    return found


@pytest.fixture(scope="module")
def launch():
    """The empty truck pulls away with half pedal for 12 s."""
    return drive(truck(), VehicleCommand(accelerator_pedal=0.5), 12.0)


def test_clutch_slip_is_nearly_100_percent_at_launch_and_zero_when_engaged(launch):
    slips = [groups["ETC1"].number("clutch_slip_percent") for groups in launch]
    assert slips[0] > 90.0
    engaged = [g["ETC1"] for g in launch if g["ETC1"].number("driveline_engaged") == 1.0]
    assert engaged
    assert max(etc1.number("clutch_slip_percent") for etc1 in engaged) < 2.0


def test_shafts_turn_in_the_ratio_that_the_gearbox_reports(launch):
    for groups in launch[20:]:
        etc1, etc2 = groups["ETC1"], groups["ETC2"]
        if etc1.number("shift_in_process") == 0.0:
            output = etc1.number("output_shaft_speed_rpm")
            geared = etc2.number("actual_gear_ratio") * output
            assert etc1.number("input_shaft_speed_rpm") == pytest.approx(geared, rel=0.01)


def test_current_gear_lags_behind_the_selected_gear_during_a_change(launch):
    gears = [(g["ETC2"].number("current_gear"), g["ETC2"].number("selected_gear")) for g in launch]
    changing = [g for g, (current, wanted) in zip(launch, gears, strict=True) if current < wanted]
    assert len(changing) > 10
    assert all(g["ETC1"].number("shift_in_process") == 1.0 for g in changing)
    assert all(g["EEC1"].number("engine_torque_mode") == TRANSMISSION for g in changing)


def test_driven_wheels_turn_faster_than_the_front_axle_under_traction():
    def lead(pedal):
        found = drive(truck(speed=6.0), VehicleCommand(accelerator_pedal=pedal), 3.0)[-1]["EBC2"]
        rear = found.number("relative_speed_rear1_left_kph")
        return rear / found.number("front_axle_speed_kph")

    assert lead(1.0) - lead(0.0) > 0.005


def test_reported_wheel_speeds_include_brake_slip():
    subject = truck(payload=0.0, speed=20.0)
    found = drive(subject, VehicleCommand(brake_pedal=0.7), 1.5)[-1]
    ground = subject.observe().speed / KMH
    assert 20.0 < ground < 65.0
    front = found["EBC2"].number("front_axle_speed_kph")
    # The slip of a braked tire.
    assert 0.005 < 1.0 - front / ground < 0.3
    assert found["CCVS1"].number("wheel_based_speed_kph") < 0.995 * ground


def test_only_the_motion_of_a_reversing_truck_is_signed():
    subject = truck()
    command = VehicleCommand(accelerator_pedal=0.3, transmission_mode=TransmissionMode.REVERSE)
    found = drive(subject, command, 8.0)[-1]
    speed = subject.observe().speed
    assert speed < -0.8
    assert found["IITS_MOTION"].number("forward_speed") == pytest.approx(speed, abs=2e-3)
    for message, signal in (
        ("CCVS1", "wheel_based_speed_kph"),
        ("EBC2", "front_axle_speed_kph"),
    ):
        assert found[message].number(signal) == pytest.approx(-speed / KMH, rel=0.05)
    assert found["ETC1"].number("output_shaft_speed_rpm") > 10.0
    assert found["ETC1"].number("input_shaft_speed_rpm") > 100.0
    assert found["ETC2"].number("current_gear") == -1.0
    assert found["ETC2"].number("current_range") == int.from_bytes(b" R", "little")
    assert found["ETC2"].number("actual_gear_ratio") > 1.0
    assert subject.report().propeller_shaft_speed < 0.0


def test_xbr_braking_is_reported_by_the_brakes_and_not_as_a_pressed_pedal():
    command = VehicleCommand(accelerator_pedal=0.5, xbr_demand=-1.5, xbr_mode=XbrMode.MAXIMUM)
    found = drive(truck(speed=20.0), command, 1.0)[-1]
    assert found["EBC5"].number("foundation_brake_use") == 1.0
    assert found["EBC5"].number("xbr_active_control_mode") == 3.0
    assert found["EBC5"].number("xbr_system_state") == 0.0
    assert found["EBC5"].number("xbr_acceleration_limit") == pytest.approx(-10.0)
    assert found["CCVS1"].number("brake_switch") == 0.0
    assert found["EBC1"].number("ebs_brake_switch") == 0.0
    # The pedal is pressed but has no effect.
    assert found["EEC1"].number("engine_torque_mode") == BRAKES
    assert found["EEC1"].number("engine_control_source_address") == 0x0B
    assert found["EEC1"].number("driver_demand_torque_percent") > 30.0
    assert found["EEC1"].number("actual_engine_torque_percent") < 10.0


def test_retarder_reports_whether_driver_or_brakes_demand_its_torque():
    lever = drive(truck(speed=20.0), VehicleCommand(retarder=0.4), 1.5)[-1]["ERC1", 0x10]
    assert lever.number("retarder_torque_mode") == OPERATOR
    assert lever.number("retarder_control_source_address") == 0x10
    assert lever.number("retarder_selection_percent") == pytest.approx(40.0)
    wanted = 0.4 * lever.number("available_retarder_torque_percent")
    assert lever.number("driver_demand_retarder_torque_percent") == pytest.approx(wanted, abs=1.0)
    command = VehicleCommand(
        xbr_demand=-1.5, xbr_mode=XbrMode.MAXIMUM, xbr_ebi_mode=XbrEbiMode.INTEGRATION
    )
    brakes = drive(truck(payload=36e3, speed=20.0), command, 1.5)[-1]["ERC1", 0x10]
    assert brakes.number("retarder_torque_mode") == BRAKES
    assert brakes.number("driver_demand_retarder_torque_percent") == 0.0
    assert brakes.number("intended_retarder_torque_percent") < -10.0


def test_fuel_economy_is_at_its_limit_in_overrun_and_zero_at_idle():
    coasting = drive(truck(speed=20.0), VehicleCommand(), 2.0)[-1]["LFE1"]
    assert coasting.number("engine_fuel_rate_l_per_h") == 0.0
    assert coasting.number("instantaneous_fuel_economy_km_per_l") == pytest.approx(125.5, abs=0.01)
    idling = drive(truck(), VehicleCommand(parking_brake=1.0), 2.0)[-1]["LFE1"]
    assert 1.5 < idling.number("engine_fuel_rate_l_per_h") < 4.0
    assert idling.number("instantaneous_fuel_economy_km_per_l") == pytest.approx(0.0, abs=0.01)
    pulling = drive(truck(payload=36e3, speed=22.0), VehicleCommand(accelerator_pedal=0.4), 4.0)
    assert 0.5 < pulling[-1]["LFE1"].number("instantaneous_fuel_economy_km_per_l") < 5.0


@pytest.mark.parametrize("payload", [0.0, 36e3])
def test_weights_on_the_bus_are_those_of_the_truck(payload):
    subject = truck(payload)
    subject.command(parking_brake=1.0)
    subject.step(1000)
    frames = state_to_frames(subject.observe(), subject.report())
    weights = [d.group for d in map(decode, frames) if d.name == "VW"]
    gross = said(subject)["CVW"].number("gross_combination_weight_kg")
    assert gross == 19_000.0 + payload
    assert said(subject)["CVW"].number("powered_vehicle_weight_kg") == 8_900.0
    assert sum(w.number("axle_weight_kg") for w in weights) == pytest.approx(gross, rel=0.005)
    assert weights[0].number("cargo_weight_kg") == payload
    assert weights[0].number("trailer_weight_kg") == 10_100.0 + payload


def test_receiver_reads_the_mass_from_the_bus():
    receiver = StateReceiver()
    for frame in state_to_frames(EgoState(mass=27_340.0)):
        receiver.receive(frame)
    assert receiver.state().mass == 27_340.0


def test_speed_gear_and_acceleration_are_read_without_our_own_messages():
    receiver = StateReceiver()
    receiver.receive(encode(CCVS1(wheel_based_speed_kph=72.0), source=0x27))
    receiver.receive(encode(ETC2(current_gear=11), source=3))
    receiver.receive(encode(VDC2(longitudinal_acceleration=-1.5), source=0x0B))
    state = receiver.state()
    assert state.speed == pytest.approx(20.0, abs=1e-3)
    assert state.gear == 11
    assert state.acceleration == pytest.approx(-1.5)


def test_a_controllers_pedal_is_no_report_of_the_engine():
    receiver = StateReceiver()
    command = EEC2(accelerator_pedal_position_percent=80.0)
    assert not receiver.receive(encode(command, source=0x2A))
    assert receiver.report().accelerator_pedal is None
    assert receiver.receive(encode(command, source=0x00))
    assert receiver.report().accelerator_pedal == pytest.approx(0.8)


def test_status_codes_keep_the_last_value():
    receiver = StateReceiver()
    receiver.receive(encode(CCVS1(wheel_based_speed_kph=36.0)))
    for code in (Status.ERROR, Status.NOT_AVAILABLE):
        assert not receiver.receive(encode(CCVS1(wheel_based_speed_kph=code)))
    assert receiver.report().wheel_based_speed == pytest.approx(10.0)


def test_relative_speed_of_a_locked_wheel_saturates_at_the_signal_limit():
    report = TruckReport(wheel_speeds=(20.0, 20.0, 0.0, 20.0, 20.0, 20.0))
    groups = {d.name: d.group for d in map(decode, state_to_frames(EgoState(), report))}
    assert groups["EBC2"].number("relative_speed_rear1_left_kph") == pytest.approx(-7.8125)
    assert groups["EBC2"].number("relative_speed_rear1_right_kph") == 0.0


def test_neutral_has_no_ratio():
    subject = truck()
    subject.command(transmission_mode=TransmissionMode.NEUTRAL)
    subject.step(1000)
    with pytest.raises(BusError, match="not available"):
        said(subject)["ETC2"].number("actual_gear_ratio")
    assert said(subject)["ETC2"].number("current_gear") == 0.0


def test_a_message_of_another_manufacturer_with_our_pgn_is_ignored():
    receiver = StateReceiver()
    assert not receiver.receive(encode(IitsTrailer(articulation=0.5), source=0x0B))
    assert receiver.receive(encode(IitsTrailer(articulation=0.5)))
    assert receiver.state().articulation == pytest.approx(0.5, abs=1e-4)


def test_malformed_frames_are_counted_and_ignored():
    receiver = StateReceiver()
    sound = encode(CCVS1(wheel_based_speed_kph=36.0))
    assert not receiver.receive(Frame(sound.can_id, sound.data[:3]))
    assert not receiver.receive(Frame(sound.can_id, sound.data, float("nan")))
    assert receiver.malformed == 2
    assert receiver.state() == EgoState()


def test_state_of_a_real_truck_is_read_from_its_recorded_frames():
    receiver, speeds = StateReceiver(), []
    for frame in read_log(outside("j1939/KWTruck.txt")):
        receiver.receive(frame)
        if frame.pgn == pgn_of("EEC1"):
            speeds.append(receiver.state().engine_speed / RPM)
    # Parked, revved up to 2060 rpm, then turned off.
    assert 2040.0 < max(speeds) < 2070.0
    report = receiver.report()
    assert report.parking_brake == 1.0
    assert report.wheel_based_speed == 0.0
    assert report.gear_engaged == 0.0
    assert receiver.state().engine_speed == 0.0
    assert receiver.malformed == 0
