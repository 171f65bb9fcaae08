"""Frames over python-can: a virtual bus in one process, SocketCAN, UDP multicast, log files."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import can

from iits_mj.closing import Closing
from iits_mj.errors import BusError
from iits_mj.j1939.frame import Frame


class Bus(Closing):
    """A CAN bus that carries `Frame`s; a context manager.

    Args:
      interface: python-can's name: "virtual", "socketcan", "udp_multicast".
      channel: name of the channel; two virtual buses of one process and channel hear each other.

    Raises:
      BusError: the bus cannot be opened here.
    """

    def __init__(self, interface: str = "virtual", channel: str = "iits_mj") -> None:
        self.name = f"{interface}:{channel}"
        try:
            self._bus = can.Bus(interface=interface, channel=channel)
        except (can.CanError, OSError, ValueError, ImportError, NotImplementedError) as error:
            raise BusError(f"CAN bus {self.name} cannot be opened: {error}") from error

    def send(self, frame: Frame) -> None:
        """Sends one frame; BusError when the bus refuses it."""
        try:
            self._bus.send(_to_can(frame))
        except (can.CanError, OSError, ValueError) as error:
            raise BusError(f"CAN bus {self.name} refused {frame.can_id:08X}: {error}") from error

    def receive(self, time: float | None = None) -> list[Frame]:
        """All frames waiting, oldest first; error, remote and 11-bit frames are left out.

        Args:
          time: stamp for the frames [s]; default the bus driver's own stamp.
        """
        frames: list[Frame] = []
        while True:
            try:
                message = self._bus.recv(timeout=0.0)
            except (can.CanError, OSError, ValueError) as error:
                raise BusError(f"CAN bus {self.name} cannot be read: {error}") from error
            if message is None:
                return frames
            frame = _from_can(message, time)
            if frame is not None:
                frames.append(frame)

    def close(self) -> None:
        """Leaves the bus."""
        self._bus.shutdown()


def read_log(path: str | Path) -> Iterator[Frame]:
    """Frames of a log file (.asc, .blf, .log, .csv as python-can reads them), in file order.

    Raises:
      BusError: the file is missing or is not such a log.
    """
    try:
        with can.LogReader(str(path)) as reader:
            for message in reader:
                frame = _from_can(message, None)
                if frame is not None:
                    yield frame
    except (OSError, ValueError, IndexError, can.CanError) as error:
        raise BusError(f"CAN log {str(path)!r} cannot be read: {error}") from error


class LogWriter:
    """Writes frames to a log that CAN tools read; the suffix picks the format (.asc, .blf)."""

    def __init__(self, path: str | Path) -> None:
        self._path = str(path)
        try:
            self._logger = can.Logger(self._path)
        except (OSError, ValueError, can.CanError) as error:
            raise BusError(f"CAN log {self._path!r} cannot be written: {error}") from error

    def write(self, frame: Frame) -> None:
        """Appends one frame."""
        self._logger(_to_can(frame))

    def close(self) -> None:
        """Finishes the file."""
        self._logger.stop()


def _to_can(frame: Frame) -> can.Message:
    return can.Message(
        arbitration_id=frame.can_id, data=frame.data, is_extended_id=True, timestamp=frame.time
    )


def _from_can(message: can.Message, time: float | None) -> Frame | None:
    if not message.is_extended_id or message.is_error_frame or message.is_remote_frame:
        return None
    stamp = message.timestamp if time is None else time
    return Frame(message.arbitration_id, bytes(message.data)[:8], stamp)
