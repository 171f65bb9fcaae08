"""Stores the rows of finished tasks in shards: one complete file for each group of tasks."""

from __future__ import annotations

import functools
import hashlib
import itertools
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Generic, TypeVar

from iits_mj.core import tables
from iits_mj.core.errors import Error, InputError
from iits_mj.core.process_pool import TasksError, run_all

Row = TypeVar("Row")
Item = TypeVar("Item")


class Shards(Generic[Row]):
    """A folder of CSV files, each moved into place when it is complete.

    Args:
      folder: created with the first file.
      row_type: dataclass of the rows, of str, int and float.
      what: name of the rows in messages.
    """

    def __init__(self, folder: Path, row_type: type[Row], what: str) -> None:
        self.folder = folder
        self._row_type = row_type
        self._what = what

    def rows(self) -> list[Row]:
        """Returns the rows of all shards.

        Raises:
          InputError: a file is not a shard of these rows.
        """
        return list(
            itertools.chain.from_iterable(
                tables.read_rows(path, self._row_type, self._what) for path in self.files()
            )
        )

    def files(self) -> list[Path]:
        """Returns the files of the shards."""
        return sorted(self.folder.glob("shard-*.csv"))

    def keep(self, tasks: Iterable[Any], rows: Iterable[Row]) -> Path:
        """Writes the rows of some tasks to a file that is named after the tasks.

        Raises:
          InputError: the file cannot be written.
        """
        name = hashlib.sha256(repr(list(tasks)).encode()).hexdigest()[:16]
        path = self.folder / f"shard-{name}.csv"
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise InputError(
                f"folder {str(self.folder)!r} cannot be made: {error.strerror}"
            ) from error
        tables.write_rows(path, self._row_type, rows, self._what)
        return path

    def clear(self) -> None:
        """Removes the shards."""
        for path in self.files():
            path.unlink(missing_ok=True)
        if self.folder.is_dir() and not any(self.folder.iterdir()):
            self.folder.rmdir()


def in_shards(items: Sequence[Item], size: int) -> list[tuple[Item, ...]]:
    """Returns items in shards of `size`, in their order."""
    return [tuple(items[begin : begin + size]) for begin in range(0, len(items), size)]


Task = TypeVar("Task")


@dataclass(frozen=True)
class Plan(Generic[Task, Row]):
    """Description of tasks that run in shards.

    Attributes:
      work: makes a task's row; picklable, and the row depends on the task alone.
      task_of: returns the task of a row.
      describe: describes a task in a few words.
      what: name of the tasks in messages.
      size: number of tasks in a shard.
    """

    work: Callable[[Task], Row]
    task_of: Callable[[Row], Task]
    describe: Callable[[Task], str]
    what: str
    size: int


def run_sharded(
    plan: Plan[Task, Row],
    tasks: Sequence[Task],
    shards: Shards[Row],
    keep: Callable[[Sequence[Row]], None],
    jobs: int,
    make_pool: Callable[[int], Executor] | None = None,
) -> None:
    """Runs the tasks that no shard contains yet, and passes all rows to `keep`.

    One worker runs the tasks of a shard, which is stored completely or not at all.

    Args:
      plan: of the tasks.
      tasks: all different.
      shards: that store the rows.
      keep: called with the stored rows, then with those of each shard as it ends.
      jobs: number of workers.
      make_pool: of workers; default: processes of this machine.

    Raises:
      TasksError: some tasks failed; the rows of all others are stored.
    """
    wanted = set(tasks)
    before = {plan.task_of(row): row for row in shards.rows()}
    found = [before[task] for task in tasks if task in before]
    if found:
        keep(found)
    missing = [task for task in tasks if task not in before]
    faults: list[str] = []

    def note(outcome: _Outcome) -> None:
        faults.extend(outcome.faults)
        rows = [row for row in outcome.rows if plan.task_of(row) in wanted]
        if rows:
            shards.keep(outcome.tasks, rows)
            keep(rows)

    run_all(
        in_shards(missing, plan.size),
        jobs,
        functools.partial(_work, plan=plan),
        note,
        lambda shard: _described(shard, plan.describe),
        what=plan.what,
        make_pool=make_pool,
    )
    if faults:
        raise TasksError(
            f"{len(faults)} {plan.what} could not be done: {'; '.join(faults)}; the others are "
            "stored: repeat the command to run these again"
        )


@dataclass(frozen=True)
class _Outcome:
    tasks: tuple[Any, ...]
    rows: list[Any]
    faults: list[str]


def _work(shard: tuple[Any, ...], plan: Plan[Any, Any]) -> _Outcome:
    """Runs a shard's tasks; a task that fails does not stop the others."""
    rows, faults = [], []
    for task in shard:
        try:
            rows.append(plan.work(task))
        except Error as error:
            faults.append(f"{plan.describe(task)}: {error}")
    return _Outcome(shard, rows, faults)


def _described(shard: Iterable[Any], describe: Callable[[Any], str]) -> str:
    first, *rest = (describe(task) for task in shard)
    return f"{first} and {len(rest)} more" if rest else first
