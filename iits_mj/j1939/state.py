"""`EgoState` and `TruckReport` to frames: what the truck reports, and when."""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import dataclass

from iits_mj.core.messages import EgoState, TruckReport
from iits_mj.j1939.configuration import ConfigurationSender
from iits_mj.j1939.database import cycle_time, identifier, pgn_of
from iits_mj.j1939.frame import GLOBAL_ADDRESS, Frame
from iits_mj.j1939.mapping import DataMaker, SignalRow, reports, sender
from iits_mj.j1939.quantities import ReferenceTorques, check_finite, quantities
from iits_mj.j1939.schedule import Schedule, spread
from iits_mj.parameters import TruckParameters

_NOTHING = TruckReport()
_REFERENCES = ReferenceTorques()
# Frames of VW at a time.
_AXLES = 6


@dataclass(frozen=True, slots=True)
class _Report:
    """A message that one control unit sends, and how the bytes of its frames are made."""

    message: str
    pgn: int
    source: int
    can_id: int
    contents: Callable[[EgoState, TruckReport, ReferenceTorques], list[bytes]]

    def frames(
        self, state: EgoState, report: TruckReport, references: ReferenceTorques, time: float
    ) -> list[Frame]:
        return [Frame(self.can_id, data, time) for data in self.contents(state, report, references)]


def state_to_frames(
    state: EgoState,
    report: TruckReport = _NOTHING,
    references: ReferenceTorques = _REFERENCES,
) -> list[Frame]:
    """All frames that report a state; what the truck does not know is sent as "not available".

    Args:
      state: as `Truck.observe` gives it.
      report: as `Truck.report` gives it.
      references: of the percent torques.

    Raises:
      BusError: a value is not finite.
    """
    check_finite(state, report)
    return [
        frame for sent in _reports() for frame in sent.frames(state, report, references, state.time)
    ]


class StateSender:
    """The truck's reports, each at its own rate, as its control units send them.

    The rates are the DBC's. Groups of the standard are spread over ticks of 10 ms; our own, which
    together describe the truck's motion, go out at the same instant. The first call sends what
    has no offset, the first 0.1 s everything once.

    Args:
      references: of the percent torques.
    """

    def __init__(self, references: ReferenceTorques = _REFERENCES) -> None:
        self._references = references
        periods = [cycle_time(sent.message) for sent in _reports()]
        self._schedule = Schedule(periods, _offsets())

    def frames(self, state: EgoState, report: TruckReport = _NOTHING) -> list[Frame]:
        """The frames that are due at the state's time, none twice.

        Raises:
          BusError: a value is not finite.
          InputError: the state's time is not finite.
        """
        due = self._schedule.due(state.time)
        check_finite(state, report)
        sent = _reports()
        return [
            frame
            for place in due
            for frame in sent[place].frames(state, report, self._references, state.time)
        ]

    def answer(
        self,
        pgn: int,
        address: int,
        state: EgoState,
        report: TruckReport = _NOTHING,
    ) -> list[Frame]:
        """The frames that answer a request (PGN 59904), none for a group that is not sent.

        Args:
          pgn: that is asked for.
          address: of the control unit that is asked; 255 asks all.
          state: as it is now.
          report: as it is now.

        Raises:
          BusError: a value is not finite.
        """
        check_finite(state, report)
        return [
            frame
            for sent in _reports()
            if sent.pgn == pgn and address in (sent.source, GLOBAL_ADDRESS)
            for frame in sent.frames(state, report, self._references, state.time)
        ]


@functools.cache
def _reports() -> tuple[_Report, ...]:
    """Every message of every sender, in the order of `signals.csv`."""
    found = []
    for message, address in dict.fromkeys((row.message, sender(row)) for row in reports()):
        rows = [r for r in reports() if (r.message, sender(r)) == (message, address)]
        contents = _weights(rows) if message == "VW" else _single(rows)
        can_id = identifier(message, address)
        found.append(_Report(message, pgn_of(message), address, can_id, contents))
    return tuple(found)


@functools.cache
def _offsets() -> tuple[float, ...]:
    """Of the reports [s]. Our own count as one message, so that they stay together."""
    own = [sent.message for sent in _reports() if sent.message.startswith("IITS_")]
    others = [sent.message for sent in _reports() if sent.message not in own]
    weights = [len(own), *(_AXLES if message == "VW" else 1 for message in others)]
    first, *rest = spread([cycle_time(message) for message in (own[0], *others)], weights)
    offsets = iter(rest)
    return tuple(first if sent.message in own else next(offsets) for sent in _reports())


def _single(rows: list[SignalRow]) -> Callable[..., list[bytes]]:
    make = DataMaker(rows[0].message, rows, quantities(), saturate=True)
    return lambda *sources: [make(*sources)]


def _weights(rows: list[SignalRow]) -> Callable[..., list[bytes]]:
    """VW: a frame an axle, whose number from the front stands in the high nibble of its place."""
    load = next(row for row in rows if row.quantity == "axle_load")
    extra = ("axle_location", load.signal)
    make = DataMaker("VW", rows, quantities(), extra=extra, saturate=True)

    def contents(state: EgoState, report: TruckReport, references: ReferenceTorques) -> list[bytes]:
        return [
            make(state, report, references, extra=(axle << 4, force / load.scale))
            for axle, force in enumerate(report.axle_loads)
        ]

    return contents


# --- Everything that the truck says on its bus by itself: reports and configurations ---


class TruckSender:
    """The frames of a truck, each message at its own rate.

    Args:
      parameters: of the truck, for its percent torques and configurations.
    """

    def __init__(self, parameters: TruckParameters) -> None:
        self._reports = StateSender(ReferenceTorques.of(parameters))
        self._configurations = ConfigurationSender(parameters)

    def frames(self, state: EgoState, report: TruckReport) -> list[Frame]:
        """The frames that are due at the state's time, none twice.

        Raises:
          BusError: a value is not finite.
          InputError: the state's time is not finite.
        """
        return self._reports.frames(state, report) + self._configurations.frames(state.time)

    def answer(
        self, pgn: int, address: int, state: EgoState, report: TruckReport
    ) -> list[Frame] | None:
        """What a unit (255: all of them) says now with a group; None when it never does.

        A configuration comes later, as a broadcast among `frames`.

        Raises:
          BusError: a value is not finite.
        """
        if self._configurations.repeat(pgn, address):
            return []
        return self._reports.answer(pgn, address, state, report) or None
