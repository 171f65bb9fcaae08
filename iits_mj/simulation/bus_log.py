"""The bus of a drive as a log file: commands and the truck's reports at their rates."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import TYPE_CHECKING

from iits_mj.closing import Closing
from iits_mj.j1939 import Frame as BusFrame
from iits_mj.j1939 import LogWriter
from iits_mj.j1939.truck_sender import TruckSender
from iits_mj.simulation.frame import Frame

if TYPE_CHECKING:
    from iits_mj.simulation.loop import Simulation


class BusLog(Closing):
    """Observer that writes what is said on the truck's bus; used as a context manager.

    Frames stand in the order of time, which begins with the drive at 0. At one instant reports come
    first, then the command that answers them.

    Args:
      path: of the file; its suffix chooses the format.
      simulation: whose bus it is.

    Attributes:
      count: frames written.

    Raises:
      BusError: the file cannot be written, or there is no such format.
    """

    period = 0.01

    def __init__(self, path: Path, simulation: Simulation) -> None:
        self.path = path
        self.count = 0
        self._sender = TruckSender(simulation.truck.parameters)
        self._writer = LogWriter(path)
        self._commands = simulation.path
        self._commands.listen(self._write)

    def observe(self, simulation: Simulation, frame: Frame) -> None:
        """Writes the reports that are due."""
        # Log files keep microseconds, and the sum of many steps is not exact.
        state = dataclasses.replace(frame.ego, time=round(frame.time, 6))
        for report in self._sender.frames(state, simulation.truck.report()):
            self._write(report)

    def close(self) -> None:
        """Finishes the file; the drive may go on."""
        self._commands.forget(self._write)
        self._writer.close()

    def _write(self, frame: BusFrame) -> None:
        self._writer.write(frame)
        self.count += 1
