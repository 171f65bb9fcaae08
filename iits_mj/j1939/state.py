"""`EgoState` and `TruckReport` to frames and back: what the truck reports."""

from __future__ import annotations

import functools

from iits_mj.errors import BusError
from iits_mj.j1939.database import decode, encode, make_group
from iits_mj.j1939.frame import Frame
from iits_mj.j1939.group import Status
from iits_mj.j1939.groups import VW
from iits_mj.j1939.mapping import Mapping, reports
from iits_mj.j1939.quantities import ReferenceTorques, flatten, to_report, to_state
from iits_mj.messages import EgoState, TruckReport
from iits_mj.units import GRAVITY

_NOTHING = TruckReport()
_REFERENCES = ReferenceTorques()


def state_to_frames(
    state: EgoState,
    report: TruckReport = _NOTHING,
    references: ReferenceTorques = _REFERENCES,
) -> list[Frame]:
    """The frames that report a state; what the truck does not know is sent as "not available".

    Args:
      state: as `Truck.observe` gives it.
      report: as `Truck.report` gives it.
      references: of the percent torques.

    Raises:
      BusError: a value is not finite.
    """
    quantities = flatten(state, report, references)
    messages: dict[tuple[str, int | None], dict[str, float]] = {}
    for row in reports():
        value = quantities[row.quantity]
        signals = messages.setdefault((row.message, row.address), {})
        if value is not None:
            signals[row.signal] = value / row.scale
    frames = [
        encode(make_group(name, signals), time=state.time, source=source, saturate=True)
        for (name, source), signals in messages.items()
    ]
    # The axle's number stands in the high nibble of its location.
    weights = [
        VW(axle_location=i << 4, axle_weight_kg=load / GRAVITY)
        for i, load in enumerate(report.axle_loads)
    ]
    return frames + [encode(w, time=state.time, saturate=True) for w in weights]


class StateReceiver:
    """Builds the truck's state from its frames, for a controller on the other end of a bus.

    Args:
      mass: of the combination [kg], which no message carries as such.
      references: of the percent torques.
    """

    def __init__(self, mass: float = 55_000.0, references: ReferenceTorques = _REFERENCES) -> None:
        self._base = EgoState(mass=mass)
        self._references = references
        self._found: dict[str, float] = {}
        self._axle_loads: dict[int, float] = {}

    def receive(self, frame: Frame) -> bool:
        """Takes one frame; returns True when it told something about the state.

        Raises:
          BusError: the frame of a known group is too short.
        """
        decoded = decode(frame)
        if decoded is None:
            return False
        told = False
        for row in _rows_back().get(decoded.name, ()):
            if row.address not in (None, decoded.source):
                continue
            value = getattr(decoded.group, row.signal)
            if not isinstance(value, Status):
                self._found[row.quantity] = value * row.scale
                told = True
        if isinstance(decoded.group, VW):
            try:
                axle = int(decoded.group.number("axle_location")) >> 4
                self._axle_loads[axle] = decoded.group.number("axle_weight_kg") * GRAVITY
                told = True
            except BusError:
                return False
        if told:
            self._found["time"] = frame.time
        return told

    def state(self) -> EgoState:
        """The state as far as frames have told it; fields never reported keep their defaults."""
        return to_state(self._found, self._references, self._base)

    def report(self) -> TruckReport:
        """The same for what the control units say beside; None where nothing was heard."""
        loads = tuple(self._axle_loads[axle] for axle in sorted(self._axle_loads))
        return to_report(self._found, self._references, loads)


@functools.cache
def _rows_back() -> dict[str, tuple[Mapping, ...]]:
    """Rows from which quantities are read back, by message."""
    rows = [row for row in reports() if row.back]
    return {
        name: tuple(row for row in rows if row.message == name)
        for name in dict.fromkeys(row.message for row in rows)
    }
