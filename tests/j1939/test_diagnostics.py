import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from iits_mj.core.errors import BusError
from iits_mj.j1939 import (
    ActiveFaults,
    ComponentIdentification,
    Fault,
    SoftwareIdentification,
    Status,
    VehicleIdentification,
    pack,
    read_group,
)
from iits_mj.j1939.groups import EC1, RC

NO_FAULT = bytes.fromhex("00ff00000000ffff")


def test_vehicle_identification_ends_at_the_asterisk():
    group = read_group(65260, b"TESTVIN0123456789*")
    assert group == VehicleIdentification("TESTVIN0123456789")
    assert group.to_bytes() == b"TESTVIN0123456789*"
    assert read_group(65260, b"TESTVIN0123456789\xff\xff") == group


def test_missing_fields_of_component_identification_are_empty():
    assert read_group(65259, b"MAKE1*M-1*123*7*") == ComponentIdentification(
        "MAKE1", "M-1", "123", "7"
    )
    assert read_group(65259, b"MAKE1*M-1 * **") == ComponentIdentification("MAKE1", "M-1", "", "")
    assert read_group(65259, b"MAKE1*M-1*1R100 ") == ComponentIdentification(
        "MAKE1", "M-1", "1R100"
    )


def test_software_identification_has_the_stated_number_of_fields():
    assert read_group(65242, b"\x0249_02*0040**junk*") == SoftwareIdentification(("49_02", "0040"))
    assert read_group(65242, b"\x03A*B") == SoftwareIdentification(("A", "B"))
    assert read_group(65242, b"\x00") == SoftwareIdentification(())


def test_invalid_texts_are_replaced_or_refused():
    assert read_group(65260, b"A\x07B\xe9C*").vehicle_identification_number == "A?B?C"
    with pytest.raises(BusError, match="vehicle_identification_number"):
        VehicleIdentification("A*B").to_bytes()
    with pytest.raises(BusError, match="at most 200"):
        VehicleIdentification("A" * 201).to_bytes()
    with pytest.raises(BusError, match="serial_number"):
        ComponentIdentification(serial_number="ü").to_bytes()
    with pytest.raises(BusError, match="at most 250"):
        SoftwareIdentification(("A",) * 251).to_bytes()
    with pytest.raises(BusError, match="SOFT has 0 bytes"):
        read_group(65242, b"")


words = st.text("ABC123 -_.", max_size=20).map(str.strip)


@settings(max_examples=100, deadline=None)
@given(st.lists(words, min_size=4, max_size=4), st.lists(words, max_size=8).map(tuple))
def test_identifications_are_read_back_unchanged(fields, versions):
    for group in (
        VehicleIdentification(fields[0]),
        ComponentIdentification(*fields),
        SoftwareIdentification(versions),
    ):
        assert read_group(group.PGN, group.to_bytes()) == group


def test_a_unit_without_faults_sends_one_frame():
    faults = read_group(65226, NO_FAULT)
    assert faults.faults == ()
    assert faults.malfunction_lamp == 0.0
    assert faults.flash_malfunction_lamp is Status.NOT_AVAILABLE
    assert faults.to_bytes() == NO_FAULT


def test_fault_codes_known_answers():
    # Amber lamp; SPN 100 (oil pressure) too low (FMI 1), five times.
    faults = read_group(65226, bytes.fromhex("04ff64000105ffff"))
    assert faults.amber_warning_lamp == 1.0
    assert faults.red_stop_lamp == 0.0
    assert faults.faults == (Fault(spn=100, fmi=1, occurrences=5),)
    # 19 bits of SPN: 0x7FFFE; FMI 31; count not available; the old conversion.
    (fault,) = read_group(65226, bytes.fromhex("00fffeffffff")).faults
    assert fault == Fault(0x7FFFE, 31, Status.NOT_AVAILABLE, old_conversion=True)


def test_seven_faults_take_thirty_bytes():
    faults = tuple(Fault(600 + i, i, i) for i in range(7))
    group = ActiveFaults(red_stop_lamp=1.0, malfunction_lamp=Status.ERROR, faults=faults)
    data = group.to_bytes()
    assert len(data) == 30
    assert read_group(65226, data) == group


def test_invalid_faults_are_refused():
    for fault in (Fault(1 << 19, 0), Fault(1, 32), Fault(1, 1, 127), Fault(-1, 1)):
        with pytest.raises(BusError, match=r"fault's \w+ = "):
            ActiveFaults(faults=(fault,)).to_bytes()
    with pytest.raises(BusError, match="protect_lamp = 2"):
        ActiveFaults(protect_lamp=2.0).to_bytes()
    with pytest.raises(BusError, match="5 bytes"):
        read_group(65226, NO_FAULT[:5])


lamps = st.sampled_from([0.0, 1.0, Status.ERROR, Status.NOT_AVAILABLE])
some_faults = st.builds(
    Fault,
    st.integers(1, (1 << 19) - 2),
    st.integers(0, 31),
    st.integers(0, 126) | st.just(Status.NOT_AVAILABLE),
    st.booleans(),
)


@settings(max_examples=100, deadline=None)
@given(st.lists(lamps, min_size=8, max_size=8), st.lists(some_faults, max_size=12).map(tuple))
def test_faults_are_read_back_unchanged(switches, faults):
    group = ActiveFaults(*switches, faults)
    assert read_group(65226, group.to_bytes()) == group


def test_reference_torque_is_bytes_20_and_21_of_the_engine_configuration():
    data = bytearray(b"\xff" * 39)
    data[19:21] = (2200).to_bytes(2, "little")
    assert read_group(65251, bytes(data)) == EC1(reference_engine_torque_nm=2200.0)
    assert pack(EC1(reference_engine_torque_nm=2200.0)) == bytes(data)


def test_torque_points_of_the_engine_are_three_bytes_each():
    data = bytearray(b"\xff" * 39)
    data[:15] = b"".join(
        round(speed * 8).to_bytes(2, "little") + bytes([percent + 125])
        for speed, percent in ((600, 40), (800, 60), (1000, 90), (1400, 100), (1900, 75))
    )
    group = read_group(65251, bytes(data))
    points = [
        (
            group.number(f"engine_speed_point_{i}_rpm"),
            group.number(f"engine_torque_point_{i}_percent"),
        )
        for i in range(1, 6)
    ]
    assert points == [(600, 40), (800, 60), (1000, 90), (1400, 100), (1900, 75)]


def test_older_and_newer_engine_configurations_are_shorter_and_longer():
    group = EC1(reference_engine_torque_nm=2200.0, torque_control_upper_limit_percent=100.0)
    data = pack(group)
    assert read_group(65251, data[:28]) == group
    assert read_group(65251, data + b"\x00\x00") == group
    with pytest.raises(BusError, match="EC1 has 27 bytes: at least 28"):
        read_group(65251, data[:27])


def test_retarder_configuration_known_answer():
    group = RC(retarder_type=1.0, retarder_location=3.0, reference_retarder_torque_nm=3200.0)
    data = bytearray(b"\xff" * 19)
    data[0] = 0x31
    data[16:18] = (3200).to_bytes(2, "little")
    assert pack(group) == bytes(data)
    assert read_group(65249, bytes(data)) == group
    with pytest.raises(BusError, match="RC has 18 bytes"):
        read_group(65249, bytes(data[:18]))


@settings(max_examples=200, deadline=None)
@given(
    st.sampled_from([65226, 65242, 65249, 65251, 65259, 65260, 61444, 65000]),
    st.binary(max_size=60),
)
def test_any_bytes_give_a_group_or_a_typed_error(pgn, data):
    try:
        group = read_group(pgn, data)
    except BusError:
        return
    assert (group is None) == (pgn == 65000)
