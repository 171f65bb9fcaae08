"""CAN frames, their J1939 identifiers (public facts of SAE J1939-21), and message checksums."""

from __future__ import annotations

import functools
from dataclasses import dataclass

from iits_mj.core.errors import BusError

GLOBAL_ADDRESS = 0xFF
# Parameter groups with a lower format byte are sent to one address.
_FIRST_BROADCAST_FORMAT = 240


@dataclass(frozen=True, slots=True, init=False)
class Frame:
    """One extended data frame: 29-bit identifier, up to 8 bytes, and its time on the bus [s]."""

    can_id: int
    data: bytes
    time: float

    def __init__(self, can_id: int, data: bytes, time: float = 0.0) -> None:
        """Raises BusError if the identifier or the bytes are too long."""
        if can_id >> 29:
            raise BusError(f"identifier {can_id:#x}: J1939 uses 29 bits")
        if len(data) > 8:
            raise BusError(f"frame {can_id:08X} has {len(data)} bytes: at most 8 allowed")
        _set_can_id(self, can_id)
        _set_data(self, data)
        _set_time(self, time)

    @property
    def priority(self) -> int:
        """0 (highest) to 7."""
        return self.can_id >> 26

    @property
    def pgn(self) -> int:
        """Parameter group number, without the destination."""
        return _parts(self.can_id)[0]

    @property
    def source(self) -> int:
        """Address of the sender."""
        return self.can_id & 0xFF

    @property
    def destination(self) -> int:
        """Address of the receiver; 255 is the global address."""
        return _parts(self.can_id)[1]


# Half the time of a frozen dataclass's own constructor; frames are created in great numbers.
_set_can_id, _set_data, _set_time = (
    vars(Frame)[name].__set__ for name in ("can_id", "data", "time")
)


def make_id(priority: int, pgn: int, source: int, destination: int = GLOBAL_ADDRESS) -> int:
    """The 29-bit identifier; broadcast groups ignore the destination.

    Raises:
      BusError: a part is out of its range.
    """
    limits = ((priority, 7), (pgn, 0x3FFFF), (source, 0xFF), (destination, 0xFF))
    names = ("priority", "PGN", "source", "destination")
    for name, (value, limit) in zip(names, limits, strict=True):
        if not 0 <= value <= limit:
            raise BusError(f"{name} {value!r} of a J1939 identifier: use 0 to {limit}")
    group = pgn if _is_broadcast(pgn) else (pgn & 0x3FF00) | destination
    return priority << 26 | group << 8 | source


@functools.lru_cache(maxsize=4096)
def _parts(can_id: int) -> tuple[int, int]:
    """Parameter group number and destination."""
    number = (can_id >> 8) & 0x3FFFF
    if _is_broadcast(number):
        return number, GLOBAL_ADDRESS
    return number & 0x3FF00, number & 0xFF


def _is_broadcast(number: int) -> bool:
    return (number >> 8) & 0xFF >= _FIRST_BROADCAST_FORMAT


def xbr_checksum(frame: Frame) -> int:
    """4-bit checksum of an XBR frame (SPN 3188) or of our steering command.

    ((sum >> 4) + sum) & 0x0F, as brake makers' guides publish it.
    """
    total = _sum(frame)
    return (total >> 4) + total & 0x0F


def tsc1_checksum(frame: Frame) -> int:
    """3-bit checksum of a TSC1 frame (SPN 4207).

    (((sum >> 6) & 0x03) + (sum >> 3) + sum) & 0x07, as engine makers' guides publish it.
    """
    total = _sum(frame)
    return ((total >> 6) & 0x03) + (total >> 3) + total & 0x07


def counter_and_checksum(frame: Frame) -> tuple[int, int]:
    """Counter (bits 1 to 4) and checksum (bits 5 to 8) of byte 8."""
    return frame.data[7] & 0x0F, frame.data[7] >> 4


def with_byte8(frame: Frame, counter: int, checksum: int) -> Frame:
    """A copy of the frame with counter and checksum in byte 8."""
    last = bytes([checksum << 4 | counter & 0x0F])
    return Frame(frame.can_id, frame.data[:7] + last, frame.time)


def _sum(frame: Frame) -> int:
    """Sum of data bytes 1 to 7, the message counter and the four bytes of the identifier."""
    return sum(frame.data[:7]) + (frame.data[7] & 0x0F) + sum(frame.can_id.to_bytes(4, "little"))
