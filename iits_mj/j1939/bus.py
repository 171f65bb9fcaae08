"""Frames over python-can: a virtual bus in one process, SocketCAN, UDP multicast."""

from __future__ import annotations

import can

from iits_mj.closing import Closing
from iits_mj.errors import BusError
from iits_mj.j1939.frame import Frame
from iits_mj.j1939.python_can import from_can, to_can


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
            self._bus.send(to_can(frame))
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
            frame = from_can(message, time)
            if frame is not None:
                frames.append(frame)

    def close(self) -> None:
        """Leaves the bus."""
        self._bus.shutdown()
