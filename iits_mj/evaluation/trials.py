"""Trials of decision makers: the task of a trial, its row of figures, and the file of trials.

A row is appended at the end of its trial. A row that was cut off by a kill is removed, and at the
end of the run the file is sorted.
"""

from __future__ import annotations

import csv
import errno
import fcntl
import hashlib
import io
import math
import os
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path

from controllers.decision.policy import SHIPPED, SHIPPED_PRICED
from controllers.decision.prices import Prices
from controllers.decision.quality import Quality
from controllers.decision.trip import SPAWN_PROBABILITY, RewardConfig
from controllers.own_parts import DECISION
from iits_mj.core import tables
from iits_mj.core.errors import InputError
from iits_mj.core.own_parts import source_digest

WORLDS = ("full", "fast")
EMPTY = "empty"
CLOSE = 1.0  # [s] below which a time gap counts as close
LEFT_RANGE = "; the plant left its range: "


@dataclass(frozen=True)
class Task:
    """Settings of one trial.

    Attributes:
      world: "fast", or the plant of the full chain, one of `PLANTS`; density: "empty" is a road
        without traffic.
      traffic_speed: speed limit of the traffic, and the truck's speed at the start [m/s].
      method: the decision maker; weights: digest of its policy, with its prices, or of its own
        file, "" for a shipped rule.
      truck: see `label_of`; payload: [kg]; timestep: of the physics in the full chain [s].
      length_limit, duration_limit: the trip ends after this distance [m] or at the road's end; it
        is cut off after this time [s].
      seed: of the traffic.
      lane_discipline: of the traffic, see `DriveConfig`; keep_right: of the truck, "on" or "off".
    """

    world: str
    density: str
    traffic_speed: float
    method: str
    weights: str
    truck: str
    payload: float
    timestep: float
    length_limit: float
    duration_limit: float
    seed: int
    lane_discipline: str = field(default="free", kw_only=True)
    keep_right: str = field(default="off", kw_only=True)


@dataclass(frozen=True)
class Trial(Task):
    """Figures of one trip of one decision maker; nan where its world does not measure a figure.

    Attributes:
      speed_loss: mean over time of (v_ref - v) / v_ref.
      speed_error: mean over time of |v_ref - v| [m/s], as in the reward.
      changes: completed lane changes; asked: decisions to change; refused: decisions that the
        planner refused; unsafe: decisions that it refused because of a vehicle.
      collisions: with a vehicle; failures: collision, roll-over, divergence, or time limit.
      ended: reason of the trip's end, in words; then, each after `LEFT_RANGE`, the limits of the
        plant's validity that were exceeded.
      time_gap: least time gap to the vehicle ahead while faster than 1 m/s [s], inf without one.
        A vehicle that cuts in counts as soon as its box overlaps the truck's width.
      close_share: share of time with a time gap below `CLOSE`.
      box_distance: least distance to any vehicle, box to box [m]; fuel: [kg].
      distance: [m]; time: of the trip [s]; wall_time: [s]; code: digest of the code of the drive.
      imposed_brakings: changes whose new follower braked hard, see `Quality`; imposed_deceleration:
        hardest braking of the new follower of a change, mean over the trip's changes [m/s2], nan
        without a change.
      collision_time_front, collision_time_rear, change_time_gap_front, change_time_gap_rear: least
        at the start of a change [s], inf without one, see `Quality`.
      right_share: share of the time in the right lane; beside_share: share of the time with a
        vehicle beside the truck.
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
    # Trials of earlier versions lack these figures.
    imposed_brakings: float = math.nan
    imposed_deceleration: float = math.nan
    collision_time_front: float = math.nan
    collision_time_rear: float = math.nan
    change_time_gap_front: float = math.nan
    change_time_gap_rear: float = math.nan
    right_share: float = math.nan
    beside_share: float = math.nan

    @property
    def task(self) -> Task:
        """The task, which identifies the trial."""
        return Task(**{field.name: getattr(self, field.name) for field in fields(Task)})

    @property
    def reward_rates(self) -> tuple[float, float, float]:
        """Rewards of changes, danger and speed per second, not discounted."""
        if self.time <= 0.0:
            return math.nan, math.nan, math.nan
        config = RewardConfig()
        changes, danger = config.change * self.asked, config.danger * self.unsafe
        return -changes / self.time, -danger / self.time, -config.speed * self.speed_error


def quality_columns(quality: Quality, changes: int, time: float) -> dict[str, float]:
    """Returns the columns of a trial that describe its quality.

    Args:
      quality: of the trip.
      changes: completed.
      time: of the trip [s].
    """
    least = (
        *("collision_time_front", "collision_time_rear"),
        *("change_time_gap_front", "change_time_gap_rear"),
    )
    return {
        "imposed_brakings": float(quality.imposed_brakings),
        "imposed_deceleration": quality.imposed_deceleration / changes if changes else math.nan,
        **{name: getattr(quality, name) for name in least},
        "right_share": quality.right_time / time if time > 0.0 else math.nan,
        "beside_share": quality.beside_time / time if time > 0.0 else math.nan,
    }


def weights_digest(method: str, weights: Path | None, prices: Prices | None = None) -> str:
    """Twelve hexadecimal digits of the file of a policy or of an own decision maker.

    Other prices of the policy for every price give other digits.

    It is "" for a shipped rule.

    Args:
      method: the decision maker.
      weights: file of the policy; default: the shipped policy.
      prices: of the policy for every price.

    Raises:
      InputError: the file cannot be read.
    """
    if method != "ddqn":
        return source_digest(method) if DECISION.is_own(method) else ""
    path = weights or (SHIPPED if prices is None else SHIPPED_PRICED)
    at = "" if prices is None else repr(prices)
    try:
        return hashlib.sha256(path.read_bytes() + at.encode()).hexdigest()[:12]
    except OSError as error:
        raise InputError(f"weights file {str(path)!r} cannot be read: {error.strerror}") from error


def codes_of(trials: Sequence[Trial]) -> list[str]:
    """Digests of the versions of the code of these trials."""
    return sorted({trial.code for trial in trials})


_COLUMNS = [field.name for field in fields(Trial)]
_HEADER = (",".join(_COLUMNS) + "\r\n").encode()
_WHAT = "trials"


def read_trials(path: Path, say: Callable[[str], None]) -> dict[Task, Trial]:
    """The trials of a file by their tasks; none if the file does not exist.

    The incomplete last row of a killed process is removed from the file.

    Args:
      path: of the file.
      say: gets a message about the incomplete row.

    Raises:
      InputError: the file is not a file of trials, or cannot be read or repaired.
    """
    _repair(path, say)
    return {row.task: row for row in tables.read_rows(path, Trial, _WHAT)}


def write_trials(path: Path, trials: Iterable[Trial]) -> None:
    """Writes the file in sorted order, so that its bytes do not depend on the order of the trials.

    Raises:
      InputError: the file cannot be written.
    """
    tables.write_rows(path, Trial, sorted(trials, key=_order), _WHAT)


def append_trial(path: Path, trial: Trial) -> None:
    """Appends one row, or nothing.

    Raises:
      InputError: the file cannot be written.
    """
    row = io.StringIO(newline="")
    csv.DictWriter(row, _COLUMNS).writerow(asdict(trial))
    content = row.getvalue().encode()
    try:
        with path.open("ab", buffering=0) as stream:
            size = stream.seek(0, os.SEEK_END)
            try:
                if stream.write(content) != len(content):
                    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
            except OSError:
                stream.truncate(size)
                raise
    except OSError as error:
        raise _unwritable(path, error) from error


@contextmanager
def locked(path: Path) -> Iterator[None]:
    """Locks the file against other runs, whose rows the end of this run would delete.

    Raises:
      InputError: another run uses the file, or the folder cannot be written.
    """
    lock = path.with_name(f".{path.name}.lock")
    try:
        stream = lock.open("w")
    except OSError as error:
        raise _unwritable(path, error) from error
    with stream:
        try:
            fcntl.flock(stream, fcntl.LOCK_EX | fcntl.LOCK_NB)
            # A run that ended meanwhile may have removed the lock file.
            free = os.path.samestat(os.fstat(stream.fileno()), lock.stat())
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
            lock.unlink(missing_ok=True)


def _unwritable(path: Path, error: OSError) -> InputError:
    return InputError(f"file of {_WHAT} {str(path)!r} cannot be written: {error}")


def _order(task: Task) -> tuple[object, ...]:
    """Sort key of the rows: the paper's order of cells, then trial by trial."""
    cell = [*SPAWN_PROBABILITY, EMPTY].index(task.density), task.traffic_speed
    rest = (
        task.truck,
        task.payload,
        task.timestep,
        task.length_limit,
        task.duration_limit,
        task.seed,
    )
    rules = task.lane_discipline, task.keep_right
    return (task.world, *rules, *cell, *rest, task.method, task.weights)


def _repair(path: Path, say: Callable[[str], None]) -> None:
    """Removes an incomplete last row."""
    try:
        content = path.read_bytes() if path.exists() else b""
        whole = content.rfind(b"\n") + 1
        if whole == len(content):
            return
        header = content[: content.find(b"\n") + 1]
        if _HEADER.startswith(content):
            path.unlink()
        elif tables.are_columns(header.decode(errors="replace").strip().split(","), Trial):
            with path.open("r+b") as stream:
                stream.truncate(whole)
        else:
            return
    except OSError as error:
        raise InputError(f"file of {_WHAT} {str(path)!r} cannot be read: {error}") from error
    say(f"{str(path)!r} ended with an incomplete row: it was removed, and is driven again")
