"""`EgoState` and `TruckReport` to the truck's frames, and back for its controller."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable
from dataclasses import dataclass

from iits_mj.core.errors import BusError
from iits_mj.core.messages import EgoState, TruckReport
from iits_mj.core.units import GRAVITY
from iits_mj.j1939.configuration import ConfigurationReceiver, ConfigurationSender
from iits_mj.j1939.database import Codec, codec_of, cycle_time, identifier, name_of, pgn_of
from iits_mj.j1939.frame import GLOBAL_ADDRESS, Frame
from iits_mj.j1939.groups import Status
from iits_mj.j1939.mapping import DataMaker, SignalRow, commands, reports, sender
from iits_mj.j1939.quantities import (
    ReferenceTorques,
    check_finite,
    quantities,
    to_report,
    to_state,
)
from iits_mj.j1939.schedule import Schedule, spread
from iits_mj.parameters import TruckParameters

_NO_STATE, _NO_REPORT = EgoState(), TruckReport()
_REFERENCES = ReferenceTorques()
_AXLES = 6  # of the shipped truck


@dataclass(frozen=True, slots=True)
class _Report:
    """A message of one control unit, and the function that makes the bytes of its frames."""

    message: str
    pgn: int
    source: int
    can_id: int
    contents: Callable[[EgoState, TruckReport, ReferenceTorques], list[bytes]]

    def frames(
        self, state: EgoState, report: TruckReport, references: ReferenceTorques
    ) -> list[Frame]:
        contents = self.contents(state, report, references)
        return [Frame(self.can_id, data, state.time) for data in contents]


def state_to_frames(
    state: EgoState,
    report: TruckReport = _NO_REPORT,
    references: ReferenceTorques = _REFERENCES,
) -> list[Frame]:
    """All frames that report a state; unknown quantities are sent as "not available".

    Args:
      state: of `Truck.observe`.
      report: of `Truck.report`.
      references: of the percent torques.

    Raises:
      BusError: a value is not finite.
    """
    check_finite(state, report)
    return [frame for sent in _reports() for frame in sent.frames(state, report, references)]


class StateSender:
    """Sends the reports of the truck's control units, each message at its own rate.

    The rates are those of the DBC. Standard groups are spread over ticks of 10 ms; our own, which
    together describe the truck's motion, are sent at the same instant. The first call sends the
    messages without an offset; within 0.1 s, every message is sent at least once.

    Args:
      references: of the percent torques.
      axles: of the truck; VW has a frame for each.
    """

    def __init__(self, references: ReferenceTorques = _REFERENCES, axles: int = _AXLES) -> None:
        self._references = references
        periods = [cycle_time(sent.message) for sent in _reports()]
        self._schedule = Schedule(periods, _offsets(axles))

    def frames(self, state: EgoState, report: TruckReport = _NO_REPORT) -> list[Frame]:
        """The frames that have become due at the state's time.

        Raises:
          BusError: a value is not finite.
          InputError: the state's time is not finite.
        """
        due = self._schedule.due(state.time)
        check_finite(state, report)
        sent = [_reports()[place] for place in due]
        return [frame for one in sent for frame in one.frames(state, report, self._references)]

    def answer(
        self, pgn: int, address: int, state: EgoState, report: TruckReport = _NO_REPORT
    ) -> list[Frame]:
        """The frames that answer a request (PGN 59904); none for a group that no unit sends.

        Args:
          pgn: of the requested group.
          address: of the requested control unit; 255 for all.
          state: at present.
          report: at present.

        Raises:
          BusError: a value is not finite.
        """
        check_finite(state, report)
        return [
            frame
            for sent in _reports()
            if sent.pgn == pgn and address in (sent.source, GLOBAL_ADDRESS)
            for frame in sent.frames(state, report, self._references)
        ]


@functools.cache
def _reports() -> tuple[_Report, ...]:
    """All messages of all senders, in the order of `signals.csv`."""
    found = []
    for message, address in dict.fromkeys((row.message, sender(row)) for row in reports()):
        rows = [r for r in reports() if (r.message, sender(r)) == (message, address)]
        contents = _weights(rows) if message == "VW" else _single(rows)
        can_id = identifier(message, address)
        found.append(_Report(message, pgn_of(message), address, can_id, contents))
    return tuple(found)


@functools.cache
def _offsets(axles: int) -> tuple[float, ...]:
    """Offsets of the reports of a truck [s]; our own messages share one offset."""
    own = [sent.message for sent in _reports() if sent.message.startswith("IITS_")]
    others = [sent.message for sent in _reports() if sent.message not in own]
    weights = [len(own), *(axles if message == "VW" else 1 for message in others)]
    first, *rest = spread([cycle_time(message) for message in (own[0], *others)], weights)
    offsets = iter(rest)
    return tuple(first if sent.message in own else next(offsets) for sent in _reports())


def _single(rows: list[SignalRow]) -> Callable[..., list[bytes]]:
    make = DataMaker(rows[0].message, rows, quantities(), saturate=True)
    return lambda *sources: [make(*sources)]


def _weights(rows: list[SignalRow]) -> Callable[..., list[bytes]]:
    """VW: a frame per axle; the high nibble of its location is the axle's index from the front."""
    load = next(row for row in rows if row.quantity == "axle_load")
    extra = ("axle_location", load.signal)
    make = DataMaker("VW", rows, quantities(), extra=extra, saturate=True)

    def contents(state: EgoState, report: TruckReport, references: ReferenceTorques) -> list[bytes]:
        return [
            make(state, report, references, extra=(axle << 4, force / load.scale))
            for axle, force in enumerate(report.axle_loads)
        ]

    return contents


class TruckSender:
    """Sends reports and configurations of a truck, each message at its own rate.

    Args:
      parameters: of the truck, for its percent torques and configurations.
    """

    def __init__(self, parameters: TruckParameters) -> None:
        self._reports = StateSender(ReferenceTorques.of(parameters), len(parameters.axles))
        self._configurations = ConfigurationSender(parameters)

    def frames(self, state: EgoState, report: TruckReport) -> list[Frame]:
        """The frames that have become due at the state's time.

        Raises:
          BusError: a value is not finite.
          InputError: the state's time is not finite.
        """
        return self._reports.frames(state, report) + self._configurations.frames(state.time)

    def answer(
        self, pgn: int, address: int, state: EgoState, report: TruckReport
    ) -> list[Frame] | None:
        """The answer of a unit (255: of all) to a request; None if it does not send the group.

        A configuration follows as a broadcast among the next `frames`.

        Raises:
          BusError: a value is not finite.
        """
        if self._configurations.repeat(pgn, address):
            return []
        return self._reports.answer(pgn, address, state, report) or None


class StateReceiver:
    """Builds the truck's state from its frames, for a controller at the other end of a bus.

    A signal with "error" or "not available" keeps its last value. Frames are accepted from any
    source, with three exceptions: EEC2, which is a command unless the engine sends it; ERC1, which
    two retarders send; our own messages, whose PGNs any manufacturer may use. A real truck does not
    send our own messages: speed, acceleration and gear are then those of EBC2 or CCVS1, VDC2 and
    ETC2; pose and route keep their values.

    Args:
      mass: of the combination [kg], until CVW is received.
      references: of the percent torques, until EC1 and RC are received.

    Attributes:
      malformed: number of frames of known groups that were ignored because of their length or a
        time that is not finite.
    """

    def __init__(
        self, mass: float = _NO_STATE.mass, references: ReferenceTorques = _REFERENCES
    ) -> None:
        self._base = EgoState(mass=mass)
        self._configuration = ConfigurationReceiver(references)
        self._found: dict[str, float] = {}
        self._axle_loads: dict[int, float] = {}
        self.malformed = 0

    def receive(self, frame: Frame) -> bool:
        """Receives any frame; returns whether it contains a part of the state. Never raises."""
        picks = _picks(frame.can_id)
        if picks is None:
            # The DBC does not contain the packets of long messages.
            return self._configuration.receive(frame)
        try:
            values = picks.codec.unpack(frame.data) if math.isfinite(frame.time) else None
        except BusError:
            values = None
        if values is None:
            self.malformed += 1
            return False
        known = False
        for quantity, value in zip(picks.quantities, values, strict=True):
            if isinstance(value, float):
                self._found[quantity] = value
                known = True
        if picks.axle is not None:
            place, weight = picks.axle.unpack(frame.data)
            if not isinstance(place, Status) and not isinstance(weight, Status):
                self._axle_loads[int(place) >> 4] = weight
                known = True
        if known:
            self._found["time"] = frame.time
        return known

    def state(self) -> EgoState:
        """The received state; fields that were never received keep their defaults."""
        return to_state(self._found, self._configuration.references, self._base)

    def report(self) -> TruckReport:
        """The received report of the control units; fields that were never received are None."""
        loads = tuple(self._axle_loads[axle] for axle in sorted(self._axle_loads))
        return to_report(self._found, self._configuration.references, loads)


@dataclass(frozen=True, slots=True)
class _Picks:
    """The signals that are read from the frames of one identifier.

    Attributes:
      codec: of these signals, in SI units; quantities: their names.
      axle: codec of location and weight of an axle, for VW.
    """

    codec: Codec
    quantities: tuple[str, ...]
    axle: Codec | None


@functools.lru_cache(maxsize=4096)
def _picks(can_id: int) -> _Picks | None:
    """The signals to read; None for a group that is not in the DBC."""
    frame = Frame(can_id, b"")
    message = name_of(frame.pgn)
    if message is None:
        return None
    rows = [row for row, source in _read_back().get(message, ()) if source in (None, frame.source)]
    codec = codec_of(message)
    return _Picks(
        codec.part({row.signal: row.scale for row in rows}),
        tuple(row.quantity for row in rows),
        codec.part({"axle_location": 1.0, "axle_weight_kg": GRAVITY}) if message == "VW" else None,
    )


@functools.cache
def _read_back() -> dict[str, list[tuple[SignalRow, int | None]]]:
    """The rows that are read back, by message, each with its only source or None for any source."""
    commanded = {row.message for row in commands()}
    found: dict[str, list[tuple[SignalRow, int | None]]] = {}
    for row in reports():
        bound = row.message in commanded or row.message.startswith("IITS_")
        if row.back:
            source = sender(row) if bound else row.address
            found.setdefault(row.message, []).append((row, source))
    return found
