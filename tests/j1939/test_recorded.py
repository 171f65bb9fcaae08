"""Frames recorded on real trucks; the tests need outside data."""

import csv
import itertools

import pytest

from iits_mj.j1939 import (
    CommandReceiver,
    Failure,
    LogWriter,
    cycle_time,
    decode,
    pgn_of,
    read_log,
    summarize,
    write_table,
)
from tests.paths import DATA, needs

# A truck at standstill whose engine is revved by the pedal, and a truck with its engine off.
KENWORTH = DATA / "j1939/KWTruck.txt"
LOGGER = DATA / "j1939/SampleTruckData.bin"
ENGINE, GEARBOX, BRAKES, EXHAUST_BRAKE = 0x00, 0x03, 0x0B, 0x29

pytestmark = [needs("j1939/KWTruck.txt"), needs("j1939/SampleTruckData.bin")]


@pytest.fixture(scope="module")
def kenworth():
    return list(read_log(KENWORTH))


@pytest.fixture(scope="module")
def revved(kenworth):
    return summarize(kenworth)


@pytest.fixture(scope="module")
def standing():
    return summarize(read_log(LOGGER))


def signal(summary, name, field, source, destination=255):
    return summary.traffic[pgn_of(name), source, destination].signals[field]


def texts(summary, pgn, field, source):
    return summary.traffic[pgn, source, 255].signals[field].texts


def test_every_frame_of_both_files_is_read(revved, standing):
    for summary, frames in ((revved, 34_980), (standing, 145_278)):
        # The long messages are readings of their own.
        readings = sum(traffic.count for traffic in summary.traffic.values())
        assert readings == frames + summary.transport.messages
        assert not any(traffic.invalid for traffic in summary.traffic.values())
    # Two groups come in long messages only.
    assert len({pgn for pgn, *_ in standing.traffic} - {65251, 65259}) == 57


def test_revved_engine_of_a_real_truck_reads_near_2060_rpm(revved):
    speed = signal(revved, "EEC1", "engine_speed_rpm", ENGINE)
    assert speed.minimum == 0.0
    assert speed.maximum == pytest.approx(2060.0, abs=5.0)


def test_stopped_engine_and_wheels_of_a_real_truck_read_zero(standing):
    speed = signal(standing, "EEC1", "engine_speed_rpm", ENGINE)
    assert (speed.minimum, speed.maximum, speed.missing) == (0.0, 0.0, 0)
    for name, field in (("EBC2", "front_axle_speed_kph"), ("CCVS1", "wheel_based_speed_kph")):
        source = BRAKES if name == "EBC2" else ENGINE
        wheels = signal(standing, name, field, source)
        assert (wheels.minimum, wheels.maximum) == (0.0, 0.0)


def test_wheels_read_almost_zero_while_the_engine_is_revved_at_standstill(revved):
    assert signal(revved, "EBC2", "front_axle_speed_kph", BRAKES).maximum == 0.0
    # From the gearbox output, which the converter turns for a moment.
    assert signal(revved, "CCVS1", "wheel_based_speed_kph", ENGINE).maximum < 0.5
    assert signal(revved, "ETC1", "output_shaft_speed_rpm", GEARBOX).maximum < 15.0


def test_input_shaft_of_a_torque_converter_follows_the_engine(kenworth):
    last, slip = {}, []
    for frame in kenworth:
        decoded = decode(frame) if frame.pgn in (pgn_of("EEC1"), pgn_of("ETC1")) else None
        if decoded is not None:
            last[decoded.name] = decoded.group
            if "EEC1" in last and decoded.name == "ETC1":
                engine = last["EEC1"].number("engine_speed_rpm")
                shaft = decoded.group.number("input_shaft_speed_rpm")
                slip += [shaft / engine] if engine > 1500.0 else []
    assert len(slip) > 200
    assert 0.95 < min(slip) < max(slip) < 1.05


def test_pedal_of_a_real_truck_moves_from_0_to_part_throttle(revved):
    pedal = signal(revved, "EEC2", "accelerator_pedal_position_percent", ENGINE)
    assert (pedal.minimum, pedal.maximum) == (0.0, pytest.approx(40.8))


def test_exhaust_brake_of_a_real_truck_reports_no_torque_and_itself_in_control(revved):
    brakes = [source for pgn, source, _ in revved.traffic if pgn == pgn_of("ERC1")]
    assert brakes == [EXHAUST_BRAKE]
    torque = signal(revved, "ERC1", "actual_retarder_torque_percent", EXHAUST_BRAKE)
    assert (torque.minimum, torque.maximum) == (0.0, 0.0)
    control = signal(revved, "ERC1", "retarder_control_source_address", EXHAUST_BRAKE)
    assert (control.minimum, control.maximum) == (EXHAUST_BRAKE, EXHAUST_BRAKE)


@pytest.mark.parametrize(
    ("name", "source"),
    [
        ("EEC1", ENGINE),
        ("ETC1", GEARBOX),
        ("ETC2", GEARBOX),
        ("EBC1", BRAKES),
        ("EBC2", BRAKES),
        ("CCVS1", ENGINE),
        ("LFE1", ENGINE),
        ("ERC1", EXHAUST_BRAKE),
    ],
)
def test_a_real_truck_sends_at_the_rates_of_our_dbc(revved, name, source):
    period = revved.traffic[pgn_of(name), source, 255].period
    assert period == pytest.approx(cycle_time(name), rel=0.01)


def test_long_messages_of_a_real_bus_are_whole(revved, standing):
    assert revved.transport.messages == 42
    assert not revved.transport.failures
    # Three of 394 broadcasts lack a packet in the log; no unit answers the 38 requests to send,
    # which the engine aborts; some packets are in the log twice.
    assert standing.transport.messages == 391
    assert standing.transport.failures == {
        Failure.REPLACED: 3,
        Failure.ABORTED: 38,
        Failure.REPEATED: 29,
    }


def test_vehicle_identification_of_a_real_truck_has_the_right_check_digit(revved):
    (vin,) = texts(revved, 65260, "vehicle_identification_number", ENGINE)
    assert len(vin) == 17
    # 49 CFR 565: letters stand for digits, the 9th character is the weighted sum modulo 11.
    values = dict(zip("ABCDEFGHJKLMNPRSTUVWXYZ", "12345678123457923456789", strict=True))
    digits = [int(values.get(c, c)) for c in vin]
    weights = (8, 7, 6, 5, 4, 3, 2, 10, 0, 9, 8, 7, 6, 5, 4, 3, 2)
    remainder = sum(d * w for d, w in zip(digits, weights, strict=True)) % 11
    assert vin[8] == "0123456789X"[remainder]


def test_units_of_a_real_truck_identify_their_manufacturers(revved, standing):
    makes = {source: texts(revved, 65259, "make", source) for source in (0x00, 0x03, 0x0B, 0x31)}
    assert makes == {0x00: ["CMMNS"], 0x03: ["ALLSN"], 0x0B: ["BNDWS"], 0x31: ["PACCR"]}
    assert len(revved.traffic[65242, ENGINE, 255].signals) == 6
    assert texts(standing, 65259, "model", 0xFE) == ["SSS-MaxxForce"]


def test_faults_of_a_real_brake_controller_are_those_of_its_sensors(standing):
    faults = standing.traffic[65226, BRAKES, 255]
    assert faults.count == 315
    assert faults.signals["amber_warning_lamp"].maximum == 1.0
    spns = {faults.signals[f"fault_{i}_spn"].maximum for i in range(1, 8)}
    # Wheel speed sensors of the front and the rear axle.
    assert {789, 790, 791, 792} < spns
    assert "fault_8_spn" not in faults.signals


def test_engine_configuration_of_a_real_truck_has_idle_speed_and_torque(revved, standing):
    for summary, torque, idle in ((revved, 1109.0, 775.0), (standing, 2187.0, 600.0)):
        reference = signal(summary, "EC1", "reference_engine_torque_nm", ENGINE)
        assert (reference.minimum, reference.maximum) == (torque, torque)
        assert signal(summary, "EC1", "engine_speed_point_1_rpm", ENGINE).maximum == idle
        assert 0.5 < signal(summary, "EC1", "engine_moment_of_inertia_kg_m2", ENGINE).maximum < 4.0


def test_retarder_configuration_of_a_real_truck_names_an_exhaust_brake(revved):
    fields = revved.traffic[pgn_of("RC"), EXHAUST_BRAKE, 255].signals
    assert fields["retarder_type"].maximum == 4.0
    assert fields["retarder_location"].maximum == 1.0
    assert fields["reference_retarder_torque_nm"].maximum == 450.0
    torques = [fields[f"retarder_torque_point_{i}_percent"].maximum for i in range(1, 6)]
    assert all(-100.0 < torque < 0.0 for torque in torques)


def test_a_real_bus_commands_only_the_pedal(kenworth):
    # Its gearbox sends torque control to the engine, which is no retarder of ours.
    receiver = CommandReceiver()
    assert any(frame.pgn == 0 and frame.destination == 0 for frame in kenworth)
    for frame in kenworth:
        receiver.receive(frame)
    assert set(receiver.accepted) <= {"EEC2"}
    assert receiver.command(kenworth[-1].time).retarder == 0.0


@pytest.mark.parametrize("suffix", [".asc", ".blf", ".log", ".trc"])
def test_recorded_frames_are_written_and_read_back_unchanged(kenworth, tmp_path, suffix):
    part = kenworth[:5000]
    with LogWriter(tmp_path / f"real{suffix}") as writer:
        for frame in part:
            writer.write(frame)
    assert list(read_log(tmp_path / f"real{suffix}")) == part


def test_table_of_a_real_log_has_known_and_unknown_frames(tmp_path):
    frames = list(itertools.islice(read_log(LOGGER), 3000))
    path = tmp_path / "table.csv"
    summary = write_table(frames, path)
    with path.open(newline="") as file:
        rows = list(csv.DictReader(file))
    unknown = [row for row in rows if row["status"] == "unknown group"]
    known = {0xEC00, 0xEB00, 65226}
    assert len(unknown) == sum(decode(f) is None and f.pgn not in known for f in frames)
    assert {row["unit"] for row in unknown} == {"hex"}
    assert len({row["pgn"] for row in rows}) == len({key[0] for key in summary.traffic})
