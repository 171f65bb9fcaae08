"""Control units as members of a J1939 network: addresses, claims, answers to requests.

Public facts of SAE J1939-21 and -81: a request (PGN 59904) names a group in three bytes. The sender
of the group answers with the group; an addressed unit that does not send it answers with a negative
acknowledgment (PGN 59392). The unit with the smallest NAME wins a claimed address (PGN 60928); the
others stop sending.
"""

from __future__ import annotations

import functools
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass

from iits_mj.core.errors import BusError, InputError
from iits_mj.j1939.frame import GLOBAL_ADDRESS, Frame, make_id
from iits_mj.j1939.mapping import reports, sender

# Preferred source addresses of the control units on the truck (SAE J1939, table B2).
ENGINE = 0x00
TRANSMISSION = 0x03
BRAKES = 0x0B
ENGINE_RETARDER = 0x0F
DRIVELINE_RETARDER = 0x10
SUSPENSION = 0x2F
STABILITY = 0x3E
# Headway controller: default address of the controller that commands the truck.
CONTROLLER = 0x2A
# Advanced emergency braking system (SAE J1939, table B3): a second sender of XBR.
EMERGENCY_BRAKING = 0xA0
# 254 is the null address and 255 the global address: neither can send a command.
LAST_ADDRESS = 253
NULL_ADDRESS = 0xFE

REQUEST = 59904
ACKNOWLEDGMENT = 59392
ADDRESS_CLAIMED = 60928
# Limit of answers per call: a flood of requests must not cause a flood of answers.
MOST_ANSWERS = 64
_PRIORITY = 6
_REQUEST_LENGTH = 3
_NEGATIVE = 1
_FUNCTION_UNKNOWN = 0xFF
# Functions of control units that all industries share (SAE J1939, table B11).
_FUNCTIONS = {
    ENGINE: 0,
    TRANSMISSION: 3,
    BRAKES: 9,
    ENGINE_RETARDER: 12,
    DRIVELINE_RETARDER: 13,
    SUSPENSION: 35,
    STABILITY: 45,
}
_ON_HIGHWAY = 1

# Returns the answer to a request by PGN and address: None if the unit does not send the group, an
# empty sequence if the frames follow later as a broadcast.
Groups = Callable[[int, int], Sequence[Frame] | None]


@functools.cache
def truck_addresses() -> frozenset[int]:
    """Addresses from which this truck reports."""
    return frozenset(sender(row) for row in reports())


@functools.cache
def foreign_addresses() -> frozenset[int]:
    """All addresses except the truck's own: by default, these senders may command the truck."""
    return frozenset(range(LAST_ADDRESS + 1)) - truck_addresses()


def checked_sources(sources: Iterable[int]) -> frozenset[int]:
    """The addresses as a set; InputError if one is no J1939 address."""
    chosen = tuple(sources)
    for address in chosen:
        if type(address) is not int or not 0 <= address <= LAST_ADDRESS:
            raise InputError(f"source {address!r}: a J1939 address is 0 to {LAST_ADDRESS}")
    return frozenset(chosen)


@dataclass(frozen=True, slots=True)
class Name:
    """The 64-bit NAME of a control unit (SAE J1939-81); the smallest wins an address.

    Attributes:
      identity: number of the unit, 21 bits; manufacturer: SAE's code, 11 bits, 0 for none.
      ecu_instance: 3 bits; function_instance: 5 bits; function: 8 bits, 255 if unknown.
      vehicle_system: 7 bits; vehicle_system_instance: 4 bits.
      industry_group: 3 bits, 1 for on-highway equipment.
      arbitrary_address: whether the unit can use another address.
    """

    identity: int = 0
    manufacturer: int = 0
    ecu_instance: int = 0
    function_instance: int = 0
    function: int = _FUNCTION_UNKNOWN
    vehicle_system: int = 0
    vehicle_system_instance: int = 0
    industry_group: int = _ON_HIGHWAY
    arbitrary_address: bool = False

    def __post_init__(self) -> None:
        for name, bits, _ in _FIELDS:
            if not 0 <= getattr(self, name) < 1 << bits:
                value, limit = getattr(self, name), (1 << bits) - 1
                raise BusError(f"NAME: {name} = {value!r}: use 0 to {limit}")

    def to_bytes(self) -> bytes:
        """The eight bytes of an address claim, least significant first."""
        word = 0
        for name, _, start in _FIELDS:
            word |= int(getattr(self, name)) << start
        return word.to_bytes(8, "little")


# Field, width and first bit of a NAME; bit 48 is reserved.
_FIELDS = (
    ("identity", 21, 0),
    ("manufacturer", 11, 21),
    ("ecu_instance", 3, 32),
    ("function_instance", 5, 35),
    ("function", 8, 40),
    ("vehicle_system", 7, 49),
    ("vehicle_system_instance", 4, 56),
    ("industry_group", 3, 60),
    ("arbitrary_address", 1, 63),
)


def unit_names(units: Iterable[int], identity: int = 0) -> dict[int, Name]:
    """The NAMEs of the truck's units by address, all different.

    Args:
      units: addresses.
      identity: of the truck, 21 bits; trucks on the same bus need different ones.
    """
    names: dict[int, Name] = {}
    seen: Counter[int] = Counter()
    for address in units:
        function = _FUNCTIONS.get(address, _FUNCTION_UNKNOWN)
        names[address] = Name(identity, function=function, function_instance=seen[function])
        seen[function] += 1
    return names


class ControlUnits:
    """Address claims and answers to requests for several control units in one program.

    Args:
      names: address to NAME.

    Attributes:
      lost: addresses that another unit won with a smaller NAME; nothing may be sent from them.
      counts: "answered" and "refused" requests, "contested" claims, and "ignored" frames.
    """

    def __init__(self, names: Mapping[int, Name]) -> None:
        self._names = dict(names)
        self.lost: set[int] = set()
        self.counts: Counter[str] = Counter()

    def claims(self, time: float = 0.0) -> list[Frame]:
        """The claims of all addresses that are not lost, to be sent before any other frame."""
        return [_claim(a, name, time) for a, name in self._names.items() if a not in self.lost]

    def owns(self, frame: Frame) -> bool:
        """Whether one of the units may send this frame."""
        return frame.source in self._names and frame.source not in self.lost

    def answer(self, frames: Iterable[Frame], groups: Groups, time: float = 0.0) -> list[Frame]:
        """The answers to requests and claims.

        Args:
          frames: of the bus, of any kind.
          groups: returns the frames of a group by PGN and source address (255: of all units); see
            `Groups`.
          time: of the answers [s].
        """
        answers: list[Frame] = []
        for frame in frames:
            pgn = frame.pgn
            if pgn not in (ADDRESS_CLAIMED, REQUEST):
                continue
            if len(answers) >= MOST_ANSWERS:
                self.counts["ignored"] += 1
            elif pgn == ADDRESS_CLAIMED:
                answers += self._contest(frame, time)
            elif frame.source not in self._names:
                answers += self._respond(frame, groups, time)
        return answers

    def _respond(self, frame: Frame, groups: Groups, time: float) -> list[Frame]:
        if len(frame.data) != _REQUEST_LENGTH:
            self.counts["ignored"] += 1
            return []
        pgn = int.from_bytes(frame.data, "little")
        target = frame.destination
        if target != GLOBAL_ADDRESS and target not in self._names:
            return []
        if pgn == ADDRESS_CLAIMED:
            self.counts["answered"] += 1
            # A unit that lost its address claims the null address.
            return [
                _claim(NULL_ADDRESS if address in self.lost else address, name, time)
                for address, name in self._names.items()
                if target in (GLOBAL_ADDRESS, address)
            ]
        if target in self.lost:
            return []
        found = groups(pgn, target)
        if found is not None:
            self.counts["answered"] += 1
            return [frame for frame in found if self.owns(frame)]
        if target == GLOBAL_ADDRESS:
            # A request to all units is never refused.
            return []
        self.counts["refused"] += 1
        data = bytes([_NEGATIVE, 0xFF, 0xFF, 0xFF, frame.source]) + frame.data
        return [Frame(make_id(_PRIORITY, ACKNOWLEDGMENT, target), data, time)]

    def _contest(self, frame: Frame, time: float) -> list[Frame]:
        ours = self._names.get(frame.source)
        if ours is None or frame.source in self.lost or len(frame.data) != 8:
            return []
        mine, theirs = ours.to_bytes(), frame.data
        if mine == theirs:
            return []
        self.counts["contested"] += 1
        if int.from_bytes(mine, "little") < int.from_bytes(theirs, "little"):
            return [_claim(frame.source, ours, time)]
        self.lost.add(frame.source)
        return [_claim(NULL_ADDRESS, ours, time)]


def request(pgn: int, source: int, destination: int = GLOBAL_ADDRESS, time: float = 0.0) -> Frame:
    """The frame that requests a group; BusError if a number is out of range."""
    if not 0 <= pgn < 1 << 18:
        raise BusError(f"PGN {pgn!r}: use 0 to {(1 << 18) - 1}")
    can_id = make_id(_PRIORITY, REQUEST, source, destination)
    return Frame(can_id, pgn.to_bytes(3, "little"), time)


def _claim(address: int, name: Name, time: float) -> Frame:
    return Frame(make_id(_PRIORITY, ADDRESS_CLAIMED, address), name.to_bytes(), time)
