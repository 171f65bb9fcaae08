"""Frames to `EgoState` and `TruckReport`: the controller's side of the bus."""

from __future__ import annotations

import functools
import math

from iits_mj.errors import BusError
from iits_mj.j1939.configuration import ConfigurationReceiver
from iits_mj.j1939.database import decode
from iits_mj.j1939.frame import Frame
from iits_mj.j1939.group import Status
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
        if self._configuration.receive(frame):
            return True
        try:
            decoded = decode(frame)
        except BusError:
            self.malformed += 1
            return False
        if decoded is None:
            return False
        if not math.isfinite(frame.time):
            self.malformed += 1
            return False
        told = False
        group = decoded.group
        for row, source in _rows().get(decoded.name, ()):
            if source not in (None, decoded.source):
                continue
            value = getattr(group, row.signal)
            if not isinstance(value, Status):
                self._found[row.quantity] = value * row.scale
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


@functools.cache
def _rows() -> dict[str, tuple[tuple[Mapping, int | None], ...]]:
    """Rows from which quantities are read back, and whom alone they are taken from, by message."""
    commanded = {row.message for row in commands()}
    found: dict[str, tuple[tuple[Mapping, int | None], ...]] = {}
    for row in reports():
        bound = row.message in commanded or row.message.startswith("IITS_")
        source = sender(row) if bound else row.address
        if row.back:
            found[row.message] = (*found.get(row.message, ()), (row, source))
    return found
