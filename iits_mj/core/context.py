"""`with` for whatever holds something: a bus, a simulation, a film."""

from __future__ import annotations

from types import TracebackType
from typing import Self


class Closing:
    """Closes at the end of its `with` block, whatever happened inside."""

    def close(self) -> None:
        """Gives back what is held; may be called again."""
        raise NotImplementedError

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()


class Finishing(Closing):
    """Writes a file: closing completes it, an exception inside the `with` block abandons it."""

    def abandon(self) -> None:
        """Gives back what is held and leaves no half-written file."""
        raise NotImplementedError

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if kind is None:
            self.close()
        else:
            self.abandon()
