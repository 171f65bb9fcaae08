"""Frames to `EgoState` and `TruckReport`: the controller's side of the bus."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable
from typing import TypeAlias

from iits_mj.errors import BusError
from iits_mj.j1939.configuration import ConfigurationReceiver
from iits_mj.j1939.database import decode
from iits_mj.j1939.frame import Frame
from iits_mj.j1939.group import Group, Status, Value
from iits_mj.j1939.group_maker import fields_getter
from iits_mj.j1939.groups import VW
from iits_mj.j1939.mapping import Mapping, commands, reports, sender
from iits_mj.j1939.quantities import ReferenceTorques, to_report, to_state
from iits_mj.messages import EgoState, TruckReport
from iits_mj.units import GRAVITY

_REFERENCES = ReferenceTorques()


class StateReceiver:
    """Builds the truck's state from its frames, for a controller on the other end of a bus.

    A signal that says "error" or "not available" leaves the last value as it is. Any source is
    heard, but for EEC2, which is a command where it does not come from the engine, ERC1, which two
    retarders send, and our own messages, whose numbers every maker may use. A real truck does not
    send those: speed, acceleration and gear then come from EBC2 or CCVS1, VDC2 and ETC2; pose and
    route stay as they were.

    Args:
      mass: of the combination [kg], until CVW has told it.
      references: of the percent torques, until EC1 and RC have told them.

    Attributes:
      malformed: frames of known groups that were left out, because they have not the group's length
        or no finite time.
    """

    def __init__(self, mass: float = 55_000.0, references: ReferenceTorques = _REFERENCES) -> None:
        self._base = EgoState(mass=mass)
        self._configuration = ConfigurationReceiver(references)
        self._found: dict[str, float] = {}
        self._axle_loads: dict[int, float] = {}
        self.malformed = 0

    def receive(self, frame: Frame) -> bool:
        """Takes any frame; returns True when it told something about the state. Never raises."""
        try:
            decoded = decode(frame)
        except BusError:
            self.malformed += 1
            return False
        if decoded is None:
            # Packets of a long message are in no group of the DBC.
            return self._configuration.receive(frame)
        if not math.isfinite(frame.time):
            self.malformed += 1
            return False
        told = False
        group = decoded.group
        fetch, rows = _rows().get(decoded.name, _NO_ROWS)
        for value, (quantity, scale, source) in zip(fetch(group), rows, strict=True):
            if source is not None and source != decoded.source:
                continue
            if not isinstance(value, Status):
                self._found[quantity] = value * scale
                told = True
        if isinstance(group, VW):
            told = self._weigh(group) or told
        if told:
            self._found["time"] = frame.time
        return told

    def state(self) -> EgoState:
        """The state as far as frames have told it; fields never reported keep their defaults."""
        return to_state(self._found, self._configuration.references, self._base)

    def report(self) -> TruckReport:
        """The same for what the control units say beside; None where nothing was heard."""
        loads = tuple(self._axle_loads[axle] for axle in sorted(self._axle_loads))
        return to_report(self._found, self._configuration.references, loads)

    def _weigh(self, group: VW) -> bool:
        place, weight = group.axle_location, group.axle_weight_kg
        if isinstance(place, Status) or isinstance(weight, Status):
            return False
        self._axle_loads[int(place) >> 4] = weight * GRAVITY
        return True


# How the signals of a message are fetched, and for each its quantity, the SI units in one unit of
# it, and whom alone it is taken from.
_Rows: TypeAlias = tuple[
    Callable[[Group], tuple[Value, ...]], tuple[tuple[str, float, int | None], ...]
]
_NO_ROWS: _Rows = (lambda _group: (), ())


@functools.cache
def _rows() -> dict[str, _Rows]:
    """What is read back, by message."""
    commanded = {row.message for row in commands()}
    found: dict[str, list[tuple[Mapping, int | None]]] = {}
    for row in reports():
        bound = row.message in commanded or row.message.startswith("IITS_")
        source = sender(row) if bound else row.address
        if row.back:
            found.setdefault(row.message, []).append((row, source))
    return {
        message: (
            fields_getter([row.signal for row, _ in rows]),
            tuple((row.quantity, row.scale, source) for row, source in rows),
        )
        for message, rows in found.items()
    }
