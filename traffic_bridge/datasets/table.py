"""Reads tables as columns, with errors that name file, line and column.

pyarrow reads the files and is imported only for them. pandas would need the same checks for these
errors.
"""

from __future__ import annotations

import importlib
import re
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
from numpy.typing import NDArray

from iits_mj.core.arrays import BoolArray, FloatArray, IntArray
from iits_mj.core.errors import InputError

_THOUSANDS = r"^\s*-?\d{1,3}(,\d{3})+(\.\d+)?\s*$"


def load(module: str, path: object) -> Any:
    """A module of pyarrow for reading a file; InputError if pyarrow is not installed."""
    try:
        return importlib.import_module(f"pyarrow.{module}" if module else "pyarrow")
    except ImportError as error:
        raise InputError(
            f"data set {path}: reading it needs pyarrow: pip install 'iits-mj[data]'"
        ) from error


def plain(name: str) -> str:
    """A column's name in lower case without spaces and underscores, for comparison."""
    return re.sub(r"[\s_]", "", name.strip().lower())


class Table:
    """Columns of text or numbers.

    Args:
      path: the file, for messages.
      columns: name as in the file and values, n of each: pyarrow arrays, or numpy arrays of numbers
        or text.
      where: the row of an index in words, as in "line 12".

    Attributes:
      path, where: as given.
      rows: how many.

    Raises:
      InputError: there are no rows.
    """

    def __init__(self, path: Path, columns: dict[str, Any], where: Callable[[int], str]) -> None:
        self.path = path
        self.where = where
        self._columns = {plain(name): (name, values) for name, values in columns.items()}
        self.rows = len(next(iter(columns.values()))) if columns else 0
        if self.rows == 0:
            raise InputError(f"data set {path}: no rows")

    @property
    def names(self) -> list[str]:
        """The columns' names as in the file."""
        return [name for name, _ in self._columns.values()]

    def has(self, *names: str) -> bool:
        """Whether there is a column of one of these names."""
        return any(plain(name) in self._columns for name in names)

    def name(self, *names: str) -> str:
        """The column's name in the file; InputError if it has no such column."""
        return self._find(names)[0]

    def numbers(self, *names: str, finite: bool = True) -> FloatArray:
        """A column of finite numbers, shape (n,).

        Args:
          *names: its possible spellings.
          finite: whether every value must be finite; otherwise missing values become NaN.

        Raises:
          InputError: it is not there, or a value is not a finite number.
        """
        name, values = self._find(names)
        if isinstance(values, np.ndarray) and values.dtype.kind in "fiu":
            numbers = values.astype(np.float64)
        else:
            numbers = self._cast(name, values, finite)
        if finite:
            self.must(np.isfinite(numbers), name, numbers, "must be a finite number")
        return numbers

    def integers(self, *names: str) -> IntArray:
        """A column of whole numbers, shape (n,); InputError as of `numbers`."""
        numbers = self.numbers(*names)
        whole = (numbers == np.round(numbers)) & (np.abs(numbers) < 2**53)
        self.must(whole, self.name(*names), numbers, "must be a whole number")
        return numbers.astype(np.int64)

    def texts(self, *names: str) -> NDArray[np.str_]:
        """A column as text, shape (n,), missing values empty; InputError if there is none."""
        _, values = self._find(names)
        if isinstance(values, np.ndarray):
            return values.astype(str)
        return np.array(values.cast("string").fill_null("").to_pylist(), dtype=str)

    def must(self, good: BoolArray, name: str, column: Any, what: str) -> None:
        """Raises InputError for the first value that is not good."""
        wrong = np.flatnonzero(~good)
        if wrong.size:
            k = int(wrong[0])
            value = column[k]
            shown = f"{value:g}" if isinstance(value, (float, np.floating)) else repr(str(value))
            raise InputError(
                f"data set {self.path}, {self.where(k)}, column {name!r}: {shown}: {what}"
            )

    def _find(self, names: Sequence[str]) -> tuple[str, Any]:
        for name in names:
            if plain(name) in self._columns:
                return self._columns[plain(name)]
        there = ", ".join(self.names)
        raise InputError(f"data set {self.path}: no column {names[0]!r}; it has {there[:300]}")

    def _cast(self, name: str, values: Any, finite: bool) -> FloatArray:
        if isinstance(values, np.ndarray):
            try:
                return np.where(values == "", "nan", values).astype(np.float64)
            except ValueError:
                self._refuse_text(name, values.tolist())
        pyarrow, compute = load("", self.path), load("compute", self.path)
        types = pyarrow.types
        if types.is_dictionary(values.type):
            values = values.cast(values.type.value_type)
        if types.is_string(values.type) or types.is_large_string(values.type):
            values = compute.utf8_trim_whitespace(values)
            grouped = compute.fill_null(compute.match_substring_regex(values, _THOUSANDS), False)
            if compute.any(grouped).as_py():
                bare = compute.replace_substring(values, ",", "")
                values = compute.if_else(grouped, bare, values)
            if not finite:
                values = compute.if_else(compute.equal(values, ""), None, values)
        try:
            values = values.cast("float64")
        except pyarrow.ArrowInvalid:
            self._refuse_text(name, values.to_pylist())
        except pyarrow.ArrowNotImplementedError as error:
            raise InputError(
                f"data set {self.path}, column {name!r}: {values.type}, must be numbers"
            ) from error
        if values.null_count and finite:
            self._refuse(int(values.is_null().to_numpy(zero_copy_only=False).argmax()), name, None)
        return np.asarray(values.to_numpy(), dtype=np.float64)

    def _refuse_text(self, name: str, values: list[Any]) -> NoReturn:
        for row, value in enumerate(values):
            try:
                float(value)
            except (TypeError, ValueError):
                self._refuse(row, name, value)
        raise InputError(f"data set {self.path}, column {name!r}: not readable as numbers")

    def _refuse(self, row: int, name: str, value: Any) -> NoReturn:
        missing = value is None or not str(value).strip()
        what = "is missing" if missing else f"{str(value)[:40]!r} is not a number"
        raise InputError(
            f"data set {self.path}, {self.where(row)}, column {name!r}: {what}"
        ) from None


def read_parquet(path: Path) -> Table:
    """The table of a Parquet file.

    Raises:
      InputError: pyarrow is not installed, or the file cannot be read.
    """
    pyarrow, parquet = load("", path), load("parquet", path)
    try:
        content = parquet.read_table(path)
        columns = {name: content[name].combine_chunks() for name in content.column_names}
    except (OSError, pyarrow.ArrowException, UnicodeDecodeError) as error:
        raise InputError(f"data set {path}: not a readable Parquet file: {error}") from error
    return Table(path, columns, lambda row: f"row {row + 1}")


def read_csv(path: Path, delimiter: str) -> Table:
    """The table of a CSV file with a header, possibly compressed; values stay text until used.

    Raises:
      InputError: pyarrow is not installed, or the file is not a table.
    """
    pyarrow, csv = load("", path), load("csv", path)
    try:
        with pyarrow.input_stream(path, compression="detect") as stream:
            reader = csv.open_csv(
                stream,
                # Rows are counted only when they are read in one thread.
                read_options=csv.ReadOptions(use_threads=False),
                parse_options=csv.ParseOptions(delimiter=delimiter),
            )
            names = reader.schema.names
        if len({plain(name) for name in names}) != len(names):
            raise InputError(f"data set {path}: a column's name occurs twice: {', '.join(names)}")
        with pyarrow.input_stream(path, compression="detect") as stream:
            content = csv.read_csv(
                stream,
                read_options=csv.ReadOptions(use_threads=False),
                parse_options=csv.ParseOptions(delimiter=delimiter, ignore_empty_lines=False),
                convert_options=csv.ConvertOptions(
                    column_types={name: pyarrow.string() for name in names},
                    strings_can_be_null=False,
                ),
            )
    except (OSError, pyarrow.ArrowException, UnicodeDecodeError) as error:
        raise InputError(f"data set {path}: not a readable table: {error}") from error
    columns = {name: content[name].combine_chunks() for name in content.column_names}
    return Table(path, columns, lambda row: f"line {row + 2}")


def read_text(path: Path, names: Sequence[str]) -> Table:
    """The table of a text file of numbers without a header.

    Args:
      path: the file.
      names: of the columns.

    Raises:
      InputError: a line has another number of values, or a value is not a number.
    """
    try:
        numbers = np.loadtxt(path, ndmin=2, comments=None)
    except (OSError, ValueError) as error:
        raise InputError(
            f"data set {path}{_first_wrong(path, len(names))}: not a readable table"
        ) from error
    if numbers.shape[1] != len(names):
        raise InputError(
            f"data set {path}: {numbers.shape[1]} columns; without a header {len(names)} are known"
        )
    columns = dict(zip(names, np.ascontiguousarray(numbers.T), strict=True))
    return Table(path, columns, lambda row: f"line {row + 1}")


def _first_wrong(path: Path, count: int) -> str:
    """The first line without `count` numbers, in words."""
    with path.open(errors="replace") as file:
        for number, line in enumerate(file, start=1):
            words = line.split()
            if words and len(words) != count:
                return f", line {number}: {len(words)} values, not {count}"
            for word in words:
                try:
                    float(word)
                except ValueError:
                    return f", line {number}: {word[:40]!r} is not a number"
    return ""
