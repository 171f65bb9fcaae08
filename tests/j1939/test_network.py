"""Address claims and answers to requests by public facts of J1939."""

from __future__ import annotations

import pytest

from iits_mj.core.errors import BusError
from iits_mj.j1939 import Frame
from iits_mj.j1939.network import (
    ACKNOWLEDGMENT,
    ADDRESS_CLAIMED,
    MOST_ANSWERS,
    ControlUnits,
    Name,
    request,
    truck_addresses,
    unit_names,
)

TESTER = 0xF9
EEC1 = Frame(0x0CF00400, bytes(8))
EEC2 = Frame(0x0CF00300, bytes(8))
ETC2 = Frame(0x18F00503, bytes(8))
# A group that follows as a broadcast.
LONG = 65251


def _groups(pgn: int, source: int) -> list[Frame] | None:
    if pgn == LONG and source in (0xFF, 0):
        return []
    return [f for f in (EEC1, EEC2, ETC2) if f.pgn == pgn and source in (0xFF, f.source)] or None


@pytest.fixture
def units() -> ControlUnits:
    return ControlUnits(unit_names([0, 3, 11]))


def test_claims_carry_the_names_of_all_units_to_the_global_address(units: ControlUnits) -> None:
    claims = units.claims(2.0)
    assert [frame.source for frame in claims] == [0, 3, 11]
    assert {(f.pgn, f.destination, f.priority, f.time) for f in claims} == {(60928, 255, 6, 2.0)}
    assert len({frame.data for frame in claims}) == 3


def test_no_two_units_of_the_truck_have_the_same_name() -> None:
    # Two units of one NAME make each other give up their addresses (J1939-81).
    names = unit_names(sorted(truck_addresses()))
    assert len({name.to_bytes() for name in names.values()}) == len(names) == 7
    assert {address: name.function for address, name in names.items()} == {
        0: 0,
        3: 3,
        11: 9,
        15: 12,
        16: 13,
        47: 35,
        62: 45,
    }
    strangers = unit_names([200, 201, 202])
    assert len({name.to_bytes() for name in strangers.values()}) == 3


def test_name_has_its_fields_at_the_bits_of_j1939_81() -> None:
    name = Name(
        identity=0x12345,
        manufacturer=0x2A,
        ecu_instance=5,
        function_instance=9,
        function=0x0C,
        vehicle_system=0x33,
        vehicle_system_instance=7,
        industry_group=1,
        arbitrary_address=True,
    )
    word = int.from_bytes(name.to_bytes(), "little")
    assert word & 0x1FFFFF == 0x12345
    assert word >> 21 & 0x7FF == 0x2A
    assert word >> 32 & 0x7 == 5
    assert word >> 35 & 0x1F == 9
    assert word >> 40 & 0xFF == 0x0C
    assert word >> 49 & 0x7F == 0x33
    assert word >> 56 & 0xF == 7
    assert word >> 60 & 0x7 == 1
    assert word >> 63 == 1
    with pytest.raises(BusError, match="identity = 2097152: use 0 to 2097151"):
        Name(identity=1 << 21)


def test_request_to_all_is_answered_by_the_units_that_send_the_group(units: ControlUnits) -> None:
    assert units.answer([request(EEC1.pgn, TESTER)], _groups) == [EEC1]
    assert units.answer([request(65262, TESTER)], _groups) == []
    assert units.counts == {"answered": 1}


def test_unit_refuses_a_group_that_it_does_not_send(units: ControlUnits) -> None:
    (refusal,) = units.answer([request(ETC2.pgn, TESTER, 0)], _groups)
    assert (refusal.pgn, refusal.source, refusal.destination) == (ACKNOWLEDGMENT, 0, 255)
    assert refusal.data == bytes([1, 0xFF, 0xFF, 0xFF, TESTER, 0x05, 0xF0, 0x00])
    assert units.answer([request(ETC2.pgn, TESTER, 3)], _groups) == [ETC2]
    assert units.counts == {"refused": 1, "answered": 1}


def test_unit_does_not_refuse_a_group_that_follows_as_a_broadcast(units: ControlUnits) -> None:
    assert units.answer([request(LONG, TESTER, 0)], _groups) == []
    assert units.counts == {"answered": 1}


def test_addresses_are_claimed_on_request(units: ControlUnits) -> None:
    claims = units.answer([request(ADDRESS_CLAIMED, TESTER)], _groups)
    assert [frame.source for frame in claims] == [0, 3, 11]
    one = units.answer([request(ADDRESS_CLAIMED, TESTER, 3)], _groups)
    assert [(frame.pgn, frame.source) for frame in one] == [(ADDRESS_CLAIMED, 3)]


def test_requests_to_others_and_malformed_ones_are_not_answered(units: ControlUnits) -> None:
    to_another = request(EEC1.pgn, TESTER, 0x21)
    too_short = Frame(request(EEC1.pgn, TESTER).can_id, b"\x04\xf0")
    our_own = request(EEC1.pgn, 3)
    assert units.answer([to_another, too_short, our_own, EEC1], _groups) == []
    assert units.counts == {"ignored": 1}


def test_smaller_name_wins_the_address_and_the_unit_stops_sending(units: ControlUnits) -> None:
    mine = units.claims()[1]
    smaller = Frame(mine.can_id, bytes(8))
    (given_up,) = units.answer([smaller], _groups)
    assert (given_up.pgn, given_up.source, given_up.data) == (ADDRESS_CLAIMED, 0xFE, mine.data)
    assert units.lost == {3}
    assert not units.owns(ETC2)
    assert units.owns(EEC1)
    assert units.answer([request(ETC2.pgn, TESTER, 3)], _groups) == []
    assert [frame.source for frame in units.claims()] == [0, 11]
    # On request it claims the null address.
    assert units.answer([request(ADDRESS_CLAIMED, TESTER, 3)], _groups) == [given_up]
    claims = units.answer([request(ADDRESS_CLAIMED, TESTER)], _groups)
    assert [frame.source for frame in claims] == [0, 0xFE, 11]


def test_greater_name_is_answered_with_our_claim(units: ControlUnits) -> None:
    mine = units.claims()[1]
    assert units.answer([Frame(mine.can_id, b"\xff" * 8)], _groups) == [mine]
    assert units.answer([mine], _groups) == []
    assert units.lost == set()


def test_flood_of_requests_gets_a_limited_number_of_answers(units: ControlUnits) -> None:
    flood = [request(ADDRESS_CLAIMED, TESTER)] * 10_000
    assert len(units.answer(flood, _groups)) <= MOST_ANSWERS + 2
    assert units.counts["ignored"] > 9_000
