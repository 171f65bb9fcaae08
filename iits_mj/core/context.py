"""Base classes of objects that hold a resource and are used in a `with` block."""

from __future__ import annotations

from types import TracebackType
from typing import Self


class Closing:
    """Closes at the end of its `with` block, also after an exception."""

    def close(self) -> None:
        """Releases the resource; may be called again."""
        raise NotImplementedError

    def abandon(self) -> None:
        """Releases the resource after an exception in the `with` block."""
        self.close()

    def __enter__(self) -> Self:
        return self

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


class Finishing(Closing):
    """Writes a file: closing completes it, an exception in the `with` block abandons it."""

    def abandon(self) -> None:
        """Releases the resource and removes the unfinished file."""
        raise NotImplementedError
