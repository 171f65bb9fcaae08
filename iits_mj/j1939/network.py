"""Control units as members of a J1939 network: they claim their addresses and answer requests.

Public facts of SAE J1939-21 and -81: a request (PGN 59904) names a group in three bytes; who sends
that group answers with it, who is asked by address and does not send it answers with a negative
acknowledgment (PGN 59392). An address belongs to whoever claims it (PGN 60928) with the smallest
NAME; the others fall silent.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass

from iits_mj.core.errors import BusError
from iits_mj.j1939 import addresses
from iits_mj.j1939.frame import GLOBAL_ADDRESS, Frame, make_id

REQUEST = 59904
ACKNOWLEDGMENT = 59392
ADDRESS_CLAIMED = 60928
NULL_ADDRESS = 0xFE
# Answers in one call; a flood of requests must not become one of ours.
MOST_ANSWERS = 64
_PRIORITY = 6
_REQUEST_LENGTH = 3
_NEGATIVE = 1
_FUNCTION_UNKNOWN = 0xFF
# Functions of control units that every industry shares (SAE J1939, table B11).
_FUNCTIONS = {
    addresses.ENGINE: 0,
    addresses.TRANSMISSION: 3,
    addresses.BRAKES: 9,
    addresses.ENGINE_RETARDER: 12,
    addresses.DRIVELINE_RETARDER: 13,
    addresses.SUSPENSION: 35,
    addresses.STABILITY: 45,
}
_ON_HIGHWAY = 1

# None: that unit does not send it; no frames: they come later, since they are many.
Groups = Callable[[int, int], Sequence[Frame] | None]


@dataclass(frozen=True, slots=True)
class Name:
    """A control unit's 64-bit NAME (SAE J1939-81); the smaller one wins an address.

    Attributes:
      identity: number of the unit, 21 bits; manufacturer: code given by SAE, 11 bits, 0 for none.
      ecu_instance: 3 bits; function_instance: 5 bits; function: 8 bits, 255 for none in the table.
      vehicle_system: 7 bits; vehicle_system_instance: 4 bits.
      industry_group: 3 bits, 1 for on-highway equipment.
      arbitrary_address: whether the unit can take another address.
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
    """Addresses to the NAMEs of the truck's units at them, no two alike.

    Args:
      units: addresses.
      identity: of the truck, 21 bits; two trucks on one bus need two.
    """
    names: dict[int, Name] = {}
    seen: Counter[int] = Counter()
    for address in units:
        function = _FUNCTIONS.get(address, _FUNCTION_UNKNOWN)
        names[address] = Name(identity, function=function, function_instance=seen[function])
        seen[function] += 1
    return names


class ControlUnits:
    """The network side of several control units in one program.

    Args:
      names: address to NAME.

    Attributes:
      lost: addresses that somebody with a smaller NAME has taken; nothing may be sent from them.
      counts: "answered" and "refused" requests, "contested" claims, and what was "ignored".
    """

    def __init__(self, names: Mapping[int, Name]) -> None:
        self._names = dict(names)
        self.lost: set[int] = set()
        self.counts: Counter[str] = Counter()

    def claims(self, time: float = 0.0) -> list[Frame]:
        """The claims of all addresses that are ours, to be sent before anything else."""
        return [_claim(a, name, time) for a, name in self._names.items() if a not in self.lost]

    def owns(self, frame: Frame) -> bool:
        """Whether this frame may be sent by one of the units."""
        return frame.source in self._names and frame.source not in self.lost

    def answer(self, frames: Iterable[Frame], groups: Groups, time: float = 0.0) -> list[Frame]:
        """Frames to be sent in answer to these.

        Args:
          frames: of the bus, of any kind.
          groups: frames of a group by PGN and source address (255: of all units), None when it
            is not sent from there; no frames when they will come later.
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
        wanted = int.from_bytes(frame.data, "little")
        target = frame.destination
        if target != GLOBAL_ADDRESS and target not in self._names:
            return []
        if wanted == ADDRESS_CLAIMED:
            self.counts["answered"] += 1
            return self._claimed(target, time)
        if target in self.lost:
            return []
        found = groups(wanted, target)
        if found is not None:
            self.counts["answered"] += 1
            return [frame for frame in found if self.owns(frame)]
        if target == GLOBAL_ADDRESS:
            # Nobody refuses what everybody was asked.
            return []
        self.counts["refused"] += 1
        return [_refusal(wanted, target, frame.source, time)]

    def _claimed(self, target: int, time: float) -> list[Frame]:
        """Claims of the units asked, which say so when they have lost their address."""
        return [
            _claim(NULL_ADDRESS if address in self.lost else address, name, time)
            for address, name in self._names.items()
            if target in (GLOBAL_ADDRESS, address)
        ]

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
    """The frame that asks for a group.

    Raises:
      BusError: a number is out of its range.
    """
    if not 0 <= pgn < 1 << 18:
        raise BusError(f"PGN {pgn!r}: use 0 to {(1 << 18) - 1}")
    can_id = make_id(_PRIORITY, REQUEST, source, destination)
    return Frame(can_id, pgn.to_bytes(3, "little"), time)


def _claim(address: int, name: Name, time: float) -> Frame:
    return Frame(make_id(_PRIORITY, ADDRESS_CLAIMED, address), name.to_bytes(), time)


def _refusal(pgn: int, source: int, asked_by: int, time: float) -> Frame:
    data = bytes([_NEGATIVE, 0xFF, 0xFF, 0xFF, asked_by]) + pgn.to_bytes(3, "little")
    return Frame(make_id(_PRIORITY, ACKNOWLEDGMENT, source), data, time)
