"""Typed groups to frames and back, by our DBC file, which cantools reads."""

from __future__ import annotations

import functools
import operator
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any, cast

import cantools.database.can

from iits_mj.core.errors import BusError
from iits_mj.j1939 import groups
from iits_mj.j1939.codec import Codec, Signal
from iits_mj.j1939.frame import GLOBAL_ADDRESS, Frame, make_id
from iits_mj.j1939.group import Group, Value, class_name, layouts
from iits_mj.j1939.mapping import Mapping as Row


@dataclass(frozen=True, slots=True)
class Decoded:
    """A frame's content.

    Attributes:
      group: the typed message; source, destination: addresses; time: [s].
    """

    group: Group
    source: int
    destination: int
    time: float

    @property
    def name(self) -> str:
        """Of the message in the DBC."""
        return self.group.MESSAGE


@dataclass(frozen=True, slots=True)
class _Message:
    type: type[Group]
    codec: Codec
    # [s].
    cycle_time: float
    pgn: int
    priority: int
    source: int
    destination: int
    # All fields of a group at once.
    values_of: Callable[[Group], tuple[Value, ...]]

    def group(self, data: bytes) -> Group:
        return self.type(*self.codec.unpack(data))


def message_names() -> tuple[str, ...]:
    """Names of all messages of the DBC."""
    return tuple(_by_name())


def group_type(name: str) -> type[Group]:
    """The typed group of a message; BusError for an unknown name."""
    return _message(name).type


def make_group(name: str, values: Mapping[str, Value]) -> Group:
    """The group of a message from its signals by name; those left out say "not available".

    Raises:
      BusError: unknown message or signal.
    """
    message = _message(name)
    known = [field.name for field in fields(message.type)]
    for signal in values:
        if signal not in known:
            raise BusError(f"message {name} has no signal {signal!r}; it has {known}")
    return message.type(**values)


def pgn_of(name: str) -> int:
    """Parameter group number of a message; BusError for an unknown name."""
    return _message(name).pgn


def cycle_time(name: str) -> float:
    """Period at which a message is sent [s]; BusError for an unknown name."""
    return _message(name).cycle_time


def codec_of(name: str) -> Codec:
    """All signals of a message, in the DBC's order; BusError for an unknown name."""
    return _message(name).codec


def name_of(pgn: int) -> str | None:
    """Of the message with this parameter group number; None where the DBC has none."""
    message = _by_pgn().get(pgn)
    return None if message is None else message.type.MESSAGE


@functools.lru_cache(maxsize=4096)
def identifier(name: str, source: int | None = None, destination: int | None = None) -> int:
    """The 29-bit identifier of a message.

    Args:
      name: of the message.
      source: sender's address; default the DBC's.
      destination: receiver's address; default the DBC's.

    Raises:
      BusError: unknown message, or no address.
    """
    message = _message(name)
    return make_id(
        message.priority,
        message.pgn,
        message.source if source is None else source,
        message.destination if destination is None else destination,
    )


def decode(frame: Frame) -> Decoded | None:
    """The group in a frame, matched by PGN from any source; None for a PGN not in the DBC.

    Raises:
      BusError: the frame has not the length of its group.
    """
    message, source, destination = _addressed(frame.can_id)
    if message is None:
        return None
    return Decoded(message.group(frame.data), source, destination, frame.time)


def unpack(pgn: int, data: bytes) -> Group | None:
    """The group in the bytes of a message of any length; None for a PGN not in the DBC.

    Raises:
      BusError: the bytes have not the length of the group.
    """
    message = _by_pgn().get(pgn)
    return None if message is None else message.group(data)


def encode(
    group: Group,
    *,
    time: float = 0.0,
    source: int | None = None,
    destination: int | None = None,
    saturate: bool = False,
) -> Frame:
    """A frame with this group.

    Args:
      group: one of at most 8 bytes.
      time: of the frame [s].
      source: sender's address; default the DBC's.
      destination: receiver's address; default the DBC's.
      saturate: put a number outside the signal's range at its limit instead of refusing it.

    Raises:
      BusError: a number is not finite or out of range, or a code is not in the signal.
    """
    can_id = identifier(group.MESSAGE, source, destination)
    return Frame(can_id, pack(group, saturate=saturate), time)


def pack(group: Group, *, saturate: bool = False) -> bytes:
    """The bytes of a group of any length; arguments and errors as in `encode`."""
    message = _message(group.MESSAGE)
    return message.codec.pack(message.values_of(group), saturate=saturate)


def _message(name: str) -> _Message:
    message = _by_name().get(name)
    if message is None:
        raise BusError(f"message {name!r} is not in the DBC; there are {list(_by_name())}")
    return message


@functools.lru_cache(maxsize=4096)
def _addressed(can_id: int) -> tuple[_Message | None, int, int]:
    frame = Frame(can_id, b"")
    return _by_pgn().get(frame.pgn), frame.source, frame.destination


@functools.cache
def _by_name() -> dict[str, _Message]:
    return {layout.name: _compile(layout) for layout in layouts().messages}


@functools.cache
def _by_pgn() -> dict[int, _Message]:
    return {message.pgn: message for message in _by_name().values()}


def _compile(layout: cantools.database.can.Message) -> _Message:
    frame = Frame(layout.frame_id, b"")
    kind: type[Group] | None = getattr(groups, class_name(layout.name), None)
    names = [signal.name for signal in layout.signals]
    if kind is None or [field.name for field in fields(kind)] != names:
        raise BusError(
            f"groups.py does not have {layout.name}'s fields: run python tools/j1939_groups.py"
        )
    _check(layout)
    return _Message(
        kind,
        Codec(layout.name, layout.length, map(Signal.of, layout.signals)),
        (layout.cycle_time or 0) * 1e-3,
        frame.pgn,
        frame.priority,
        frame.source,
        frame.destination if frame.pgn < 0xF000 else GLOBAL_ADDRESS,
        operator.attrgetter(*names),
    )


def _check(layout: cantools.database.can.Message) -> None:
    """Raises BusError when a signal is not an unsigned field of Intel order beside the others."""
    free = 0
    for signal in layout.signals:
        foreign = signal.is_signed or signal.is_float or signal.byte_order != "little_endian"
        if foreign or signal.start < free or signal.start + signal.length > 8 * layout.length:
            raise BusError(
                f"{layout.name}.{signal.name}: an unsigned field of Intel order is wanted"
            )
        free = signal.start + signal.length


# --- Messages of the program to the bytes of messages of the bus, by the rows of `signals.csv` ---


@dataclass(frozen=True, slots=True)
class FieldOf:
    """A quantity that is a field of one of the sources, which are counted from 0."""

    source: int
    name: str

    def __call__(self, *sources: object) -> float | None:
        """The field."""
        return cast("float | None", getattr(sources[self.source], self.name))


class DataMaker:
    """Makes the bytes of one message; what nobody knows says "not available".

    Args:
      message: name in the DBC.
      rows: what it carries.
      quantities: how to find a row's quantity in the sources of a call, SI units; None is "not
        available".
      extra: signals that each call tells itself, instead of their rows.
      saturate: put a number outside its signal's range at its limit instead of refusing it.
    """

    def __init__(
        self,
        message: str,
        rows: Iterable[Row],
        quantities: Mapping[str, Callable[..., float | None]],
        *,
        extra: Sequence[str] = (),
        saturate: bool = False,
    ) -> None:
        # Plain fields of a source are fetched at once, which takes half the time.
        plain: dict[int, list[tuple[str, Row]]] = {}
        derived: list[tuple[Callable[..., float | None], Row]] = []
        for row in rows:
            if row.signal in extra:
                continue
            quantity = quantities[row.quantity]
            if isinstance(quantity, FieldOf):
                plain.setdefault(quantity.source, []).append((quantity.name, row))
            else:
                derived.append((quantity, row))
        self._plain = [
            (source, _fields_getter([name for name, _ in part])) for source, part in plain.items()
        ]
        self._derived = [quantity for quantity, _ in derived]
        ordered = [row for part in plain.values() for _, row in part] + [row for _, row in derived]
        units = {row.signal: row.scale for row in ordered} | dict.fromkeys(extra, 1.0)
        self._codec = codec_of(message).part(units)
        self._saturate = saturate

    def __call__(self, *sources: object, extra: Sequence[Value] = ()) -> bytes:
        """The bytes of the message from its sources; `extra` in the units of the DBC.

        Raises:
          BusError: a number is not finite, or out of range and not to be put at the limit.
        """
        values: list[Value | None] = []
        for source, fetch in self._plain:
            values += fetch(sources[source])
        for quantity in self._derived:
            values.append(quantity(*sources))
        values += extra
        return self._codec.pack(values, saturate=self._saturate)


def _fields_getter(names: list[str]) -> Callable[[Any], tuple[Any, ...]]:
    """Fetches fields as a tuple, a single one, too."""
    if len(names) > 1:
        return operator.attrgetter(*names)
    (name,) = names
    return lambda source: (getattr(source, name),)
