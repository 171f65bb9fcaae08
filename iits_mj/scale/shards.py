"""What is done, kept in shards: a file for each part of the work, whole or not there at all."""

from __future__ import annotations

import hashlib
import itertools
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, Generic, TypeVar

from iits_mj.errors import InputError
from iits_mj.validation import row_files

Row = TypeVar("Row")
Item = TypeVar("Item")


class Shards(Generic[Row]):
    """A folder of CSV files, each written beside and moved into its place when it is complete.

    Args:
      folder: made when something is kept.
      row_type: dataclass of the rows, of str, int and float.
      what: the rows are, for messages.
    """

    def __init__(self, folder: Path, row_type: type[Row], what: str) -> None:
        self.folder = folder
        self._row_type = row_type
        self._what = what

    def rows(self) -> list[Row]:
        """All rows that are kept, shard by shard.

        Raises:
          InputError: a file is not one of these.
        """
        return list(
            itertools.chain.from_iterable(
                row_files.read_rows(path, self._row_type, self._what) for path in self.files()
            )
        )

    def files(self) -> list[Path]:
        """The shards."""
        return sorted(self.folder.glob("shard-*.csv"))

    def keep(self, tasks: Iterable[Any], rows: Iterable[Row]) -> Path:
        """Writes the rows of some tasks, in the file that is named after the tasks.

        Raises:
          InputError: it cannot be written.
        """
        name = hashlib.sha256(repr(list(tasks)).encode()).hexdigest()[:16]
        path = self.folder / f"shard-{name}.csv"
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise InputError(
                f"folder {str(self.folder)!r} cannot be made: {error.strerror}"
            ) from error
        row_files.write_rows(path, self._row_type, rows, self._what)
        return path

    def clear(self) -> None:
        """Removes the shards, after their rows went elsewhere."""
        for path in self.files():
            path.unlink(missing_ok=True)
        if self.folder.is_dir() and not any(self.folder.iterdir()):
            self.folder.rmdir()


def in_shards(items: Sequence[Item], size: int) -> list[tuple[Item, ...]]:
    """Items in their order, `size` to a shard."""
    return [tuple(items[begin : begin + size]) for begin in range(0, len(items), size)]
