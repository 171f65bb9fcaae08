"""The file of trials: rows are added as trials end, half a row is dropped, the end is sorted."""

from __future__ import annotations

import csv
import fcntl
import hashlib
import math
import os
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, fields
from pathlib import Path

from controllers.decision.policy import SHIPPED
from controllers.decision.trip import SPAWN_PROBABILITY, RewardConfig
from iits_mj.core import tables
from iits_mj.core.errors import InputError

# --- Trials of decision makers: what is driven in one, and the row of figures that it gives ---

WORLDS = ("full", "fast")
EMPTY = "empty"
CLOSE = 1.0  # time gap that is called close [s]


@dataclass(frozen=True)
class Task:
    """A trial that is to be driven.

    Attributes:
      world: one of `WORLDS`; density: "empty" is a road without traffic.
      traffic_speed: the traffic's limit, and the truck's speed at the start [m/s].
      method: the decision maker; weights: digest of its policy, "" of a rule.
      payload: of the truck [kg]; timestep: of its physics in the full chain [s].
      length_limit: the trip ends there [m], or at the road's end; duration_limit: cut off [s].
      seed: of the traffic.
    """

    world: str
    density: str
    traffic_speed: float
    method: str
    weights: str
    payload: float
    timestep: float
    length_limit: float
    duration_limit: float
    seed: int


@dataclass(frozen=True)
class Trial(Task):
    """One trip of one decision maker; a figure that its world does not have is nan.

    Attributes:
      speed_loss: mean over time of (v_ref - v) / v_ref.
      speed_error: mean over time of |v_ref - v| [m/s], the reward's.
      changes: carried out; asked: decisions to change; refused: of those; unsafe: of the refused,
        those because of a vehicle.
      collisions: with a vehicle; failures: collision, roll-over, divergence, or cut off by time.
      ended: how, in words.
      time_gap: least time gap to the vehicle ahead [s], while faster than 1 m/s, inf without one.
        One that cuts in counts from where its box reaches into the truck's width.
      close_share: share of the time with a time gap under 1 s.
      box_distance: least to any vehicle, box to box [m]; fuel: [kg].
      distance: [m]; time: of the trip [s]; wall_time: [s]; code: digest of what drove it.
    """

    speed_loss: float
    speed_error: float
    changes: int
    asked: int
    refused: int
    unsafe: int
    collisions: int
    failures: int
    ended: str
    time_gap: float
    close_share: float
    box_distance: float
    fuel: float
    distance: float
    time: float
    wall_time: float
    code: str

    @property
    def task(self) -> Task:
        """What was driven: makes a trial unique."""
        return task_of(self)

    @property
    def reward_rates(self) -> tuple[float, float, float]:
        """Charges for changes, danger and speed, a second, not discounted."""
        if self.time <= 0.0:
            return math.nan, math.nan, math.nan
        config = RewardConfig()
        changes, danger = config.change * self.asked, config.danger * self.unsafe
        return -changes / self.time, -danger / self.time, -config.speed * self.speed_error


def task_of(trial: Task) -> Task:
    """The task in a trial."""
    return Task(
        trial.world,
        trial.density,
        trial.traffic_speed,
        trial.method,
        trial.weights,
        trial.payload,
        trial.timestep,
        trial.length_limit,
        trial.duration_limit,
        trial.seed,
    )


def order_of(task: Task) -> tuple[object, ...]:
    """What rows are sorted by: the paper's cells in its order, trial by trial."""
    cell = [*SPAWN_PROBABILITY, EMPTY].index(task.density), task.traffic_speed
    rest = (task.payload, task.timestep, task.length_limit, task.duration_limit, task.seed)
    return (task.world, *cell, *rest, task.method, task.weights)


def weights_digest(method: str, weights: Path | None) -> str:
    """Twelve hexadecimal digits of a policy's file, the shipped one's without one; "" of a rule.

    Raises:
      InputError: the file cannot be read.
    """
    if method != "ddqn":
        return ""
    path = weights or SHIPPED
    try:
        return hashlib.sha256(path.read_bytes()).hexdigest()[:12]
    except OSError as error:
        raise InputError(f"weights file {str(path)!r} cannot be read: {error.strerror}") from error


def codes_of(trials: Sequence[Trial]) -> list[str]:
    """The versions of the code that drove these trials."""
    return sorted({trial.code for trial in trials})


# --- The file of trials: rows are added as trials end, half a row is dropped, the end is sorted ---

_COLUMNS = [field.name for field in fields(Trial)]
_HEADER = (",".join(_COLUMNS) + "\r\n").encode()
_WHAT = "trials"


def read_trials(path: Path, say: Callable[[str], None]) -> dict[Task, Trial]:
    """The trials of a file by what was driven; none when it does not exist.

    Half a row at its end, left by a process that was killed, is taken out of the file.

    Args:
      path: of the file.
      say: is told of the half row.

    Raises:
      InputError: the file is not one of ours, or cannot be read or mended.
    """
    _mend(path, say)
    return {row.task: row for row in tables.read_rows(path, Trial, _WHAT)}


def write_trials(path: Path, trials: Iterable[Trial]) -> None:
    """Writes the file anew, sorted, so that its bytes do not tell who ended first.

    Raises:
      InputError: it cannot be written.
    """
    tables.write_rows(path, Trial, sorted(trials, key=order_of), _WHAT)


def append_trial(path: Path, trial: Trial) -> None:
    """Adds one row.

    Raises:
      InputError: it cannot be written.
    """
    try:
        with path.open("a", newline="", encoding="utf-8") as stream:
            csv.DictWriter(stream, _COLUMNS).writerow(asdict(trial))
    except OSError as error:
        raise InputError(f"file of {_WHAT} {str(path)!r} cannot be written: {error}") from error


@contextmanager
def alone(path: Path) -> Iterator[None]:
    """Nobody else drives into the same file meanwhile: the last to end would undo the others' rows.

    Raises:
      InputError: somebody does, or nothing can be written there.
    """
    beside = path.with_name(f".{path.name}.lock")
    try:
        stream = beside.open("w")
    except OSError as error:
        raise InputError(f"file of {_WHAT} {str(path)!r} cannot be written: {error}") from error
    with stream:
        try:
            fcntl.flock(stream, fcntl.LOCK_EX | fcntl.LOCK_NB)
            # Whoever was here before may have taken the lock's file away.
            free = os.path.samestat(os.fstat(stream.fileno()), beside.stat())
        except OSError:
            free = False
        if not free:
            raise InputError(
                f"file of {_WHAT} {str(path)!r} is in use by another evaluate: wait, or name "
                "another file"
            )
        try:
            yield
        finally:
            beside.unlink(missing_ok=True)


def _mend(path: Path, say: Callable[[str], None]) -> None:
    try:
        content = path.read_bytes() if path.exists() else b""
        whole = content.rfind(b"\n") + 1
        if whole == len(content):
            return
        if _HEADER.startswith(content):
            path.unlink()
        elif content.startswith(_HEADER):
            with path.open("r+b") as stream:
                stream.truncate(whole)
        else:
            return
    except OSError as error:
        raise InputError(f"file of {_WHAT} {str(path)!r} cannot be read: {error}") from error
    say(f"{str(path)!r} ended with half a row: it was dropped, and is driven again")
