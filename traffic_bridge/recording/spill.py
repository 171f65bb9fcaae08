"""A table that grows for hours in a bounded part of the memory: full pieces go to a file."""

from __future__ import annotations

import tempfile
from typing import Any

import numpy as np
from numpy.typing import NDArray

from iits_mj.errors import InputError

PIECE = 1 << 20  # bytes held in memory


class SpillTable:
    """Rows of one record type, appended one after the other and read as one array.

    Args:
      dtype: of a row, a structured type.

    Raises:
      InputError: the file in the folder for temporary files cannot be written (the disk is full).
    """

    def __init__(self, dtype: np.dtype[Any]) -> None:
        self.dtype = dtype
        self._piece = np.zeros(max(1, PIECE // dtype.itemsize), dtype=dtype)
        self._used = 0
        self._written = 0
        self._file: Any = None

    def __len__(self) -> int:
        return self._written + self._used

    def room(self, count: int) -> NDArray[Any]:
        """The next `count` rows, zeroed, to be filled in place before the next call."""
        if self._used + count > len(self._piece):
            self._flush()
            if count > len(self._piece):
                self._piece = np.zeros(count, dtype=self.dtype)
        rows = self._piece[self._used : self._used + count]
        self._used += count
        return rows

    def append(self, row: tuple[Any, ...]) -> None:
        """Adds one row; an interrupt leaves it out or has it in whole."""
        if self._used == len(self._piece):
            self._flush()
        self._piece[self._used] = row
        self._used += 1

    def array(self) -> NDArray[Any]:
        """All rows so far, shape (n,); those in the file are mapped, not read."""
        if self._written == 0:
            return self._piece[: self._used].copy()
        self._flush()
        return np.memmap(self._file, dtype=self.dtype, mode="r", shape=(self._written,))

    def clear(self) -> None:
        """Forgets all rows; arrays that were handed out stay."""
        self._piece[:] = 0
        self._used = self._written = 0
        if self._file is not None:
            self._file.close()
            self._file = None

    def _flush(self) -> None:
        try:
            if self._file is None:
                self._file = tempfile.TemporaryFile(prefix="iits_mj_recording_")  # noqa: SIM115
            self._file.write(self._piece[: self._used].tobytes())
            self._file.flush()
        except OSError as error:
            raise InputError(
                f"the recording cannot be kept in {tempfile.gettempdir()}: {error.strerror}; "
                "set TMPDIR to a folder with room"
            ) from error
        self._written += self._used
        self._piece[:] = 0
        self._used = 0
