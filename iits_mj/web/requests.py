"""What viewers ask for, in a queue that the simulation's thread empties between two cycles."""

from __future__ import annotations

import queue
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from iits_mj.core.errors import InputError

Handler = Callable[[Any], None]


@dataclass(frozen=True, slots=True)
class Request:
    """A wish of a viewer.

    Attributes:
      name: of what to do; value: how, plain data.
    """

    name: str
    value: Any = None


@dataclass(frozen=True, slots=True)
class Applied:
    """A request that was applied at a simulation time [s]."""

    time: float
    request: Request


class Requests:
    """A queue of requests from many threads to one.

    Attributes:
      applied: what was applied, in order; the same requests at the same times give the same drive.
    """

    def __init__(self) -> None:
        self._queue: queue.SimpleQueue[Request] = queue.SimpleQueue()
        self.applied: list[Applied] = []

    def put(self, name: str, value: Any = None) -> None:
        """Adds a request; may be called from every thread."""
        self._queue.put(Request(name, value))

    @property
    def empty(self) -> bool:
        """Whether no request is waiting."""
        return self._queue.empty()

    def apply(
        self, handlers: Mapping[str, Handler], time: float, timeout: float | None = None
    ) -> list[str]:
        """Applies all waiting requests.

        Args:
          handlers: by the requests' names.
          time: of the simulation [s].
          timeout: to wait for a first request [s]; None: not at all.

        Returns:
          Why requests could not be applied, in words.
        """
        refused: list[str] = []
        wait = timeout
        while True:
            try:
                request = self._queue.get(wait is not None, wait)
            except queue.Empty:
                return refused
            wait = None
            handler = handlers.get(request.name)
            if handler is None:
                refused.append(f"{request.name!r} is not possible here")
                continue
            try:
                handler(request.value)
            except InputError as error:
                refused.append(str(error))
            else:
                self.applied.append(Applied(time, request))
