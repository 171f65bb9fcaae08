"""Frames to `EgoState` and `TruckReport`: the controller's side of the bus."""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass

from iits_mj.core.errors import BusError
from iits_mj.core.messages import EgoState, TruckReport
from iits_mj.core.units import GRAVITY
from iits_mj.j1939.configuration import ConfigurationReceiver
from iits_mj.j1939.database import Codec, codec_of, name_of
from iits_mj.j1939.frame import Frame
from iits_mj.j1939.groups import Status, Value
from iits_mj.j1939.mapping import SignalRow, commands, reports, sender
from iits_mj.j1939.quantities import ReferenceTorques, to_report, to_state

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
        picks = _picks(frame.can_id)
        if picks is None:
            # Packets of a long message are in no group of the DBC.
            return self._configuration.receive(frame)
        try:
            values = picks.codec.unpack(frame.data)
        except BusError:
            self.malformed += 1
            return False
        if not math.isfinite(frame.time):
            self.malformed += 1
            return False
        told = False
        for quantity, value in zip(picks.quantities, values, strict=True):
            if isinstance(value, float):
                self._found[quantity] = value
                told = True
        if picks.axle is not None:
            told = self._weigh(*picks.axle.unpack(frame.data)) or told
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

    def _weigh(self, place: Value, weight: Value) -> bool:
        if isinstance(place, Status) or isinstance(weight, Status):
            return False
        self._axle_loads[int(place) >> 4] = weight
        return True


@dataclass(frozen=True, slots=True)
class _Picks:
    """What is taken from the frames of one identifier.

    Attributes:
      codec: of the signals that are read, in SI units; quantities: their names.
      axle: of place and weight, where the frame is an axle's.
    """

    codec: Codec
    quantities: tuple[str, ...]
    axle: Codec | None


@functools.lru_cache(maxsize=4096)
def _picks(can_id: int) -> _Picks | None:
    """None for a group that is not in the DBC."""
    frame = Frame(can_id, b"")
    message = name_of(frame.pgn)
    if message is None:
        return None
    rows = [row for row, source in _rows().get(message, ()) if source in (None, frame.source)]
    codec = codec_of(message)
    return _Picks(
        codec.part({row.signal: row.scale for row in rows}),
        tuple(row.quantity for row in rows),
        codec.part({"axle_location": 1.0, "axle_weight_kg": GRAVITY}) if message == "VW" else None,
    )


@functools.cache
def _rows() -> dict[str, list[tuple[SignalRow, int | None]]]:
    """What is read back, by message, and whom alone it is taken from."""
    commanded = {row.message for row in commands()}
    found: dict[str, list[tuple[SignalRow, int | None]]] = {}
    for row in reports():
        bound = row.message in commanded or row.message.startswith("IITS_")
        if row.back:
            source = sender(row) if bound else row.address
            found.setdefault(row.message, []).append((row, source))
    return found
