"""A python-can interface that fails on demand, as the driver of a removed device."""

from __future__ import annotations

import can


class Medium:
    """State of all buses of the interface, set by the tests.

    Attributes:
      openable, readable, writable: whether these operations work.
      off: whether the controller reports bus-off.
      waiting: messages to receive, or errors to raise.
      written: sent messages; opened, closed: number of times.
    """

    def __init__(self) -> None:
        self.openable = self.readable = self.writable = True
        self.off = False
        self.waiting: list[can.Message | Exception] = []
        self.written: list[can.Message] = []
        self.opened = self.closed = 0


class FailingBus(can.BusABC):
    """A bus of the interface; tests replace `medium`."""

    medium = Medium()

    def __init__(self, channel: object = "", **kwargs: object) -> None:
        if not self.medium.openable:
            raise can.CanInitializationError("no such device")
        super().__init__(channel)
        self.medium.opened += 1

    @property
    def state(self) -> can.BusState:
        return can.BusState.ERROR if self.medium.off else can.BusState.ACTIVE

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        if not self.medium.writable:
            raise can.CanOperationError("network is down", 100)
        self.medium.written.append(msg)

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        if not self.medium.readable:
            raise can.CanOperationError("network is down", 100)
        if not self.medium.waiting:
            return None, False
        found = self.medium.waiting.pop(0)
        if isinstance(found, Exception):
            raise found
        return found, False

    def shutdown(self) -> None:
        super().shutdown()
        self.medium.closed += 1
        if not self.medium.openable:
            raise OSError("device is gone")
