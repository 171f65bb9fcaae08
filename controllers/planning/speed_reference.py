"""Reference speed of the truck: a constant, a profile from a file, or PCC.

The stack requests it once per planning cycle. The trajectory planner keeps limits, curves and
distances whatever the reference is.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Protocol

import numpy as np

from iits_mj.core.errors import InputError
from iits_mj.core.messages import (
    PROFILE_SPEED_MIN,
    Scene,
    SpeedProfile,
    TransmissionMode,
    requests_of,
)
from iits_mj.core.neighbors import Neighbor
from iits_mj.core.tables import read_columns, read_table

_SPEED_MAX = 60.0  # [m/s] of a profile
_PLANNED_MODES = [mode for mode in TransmissionMode if mode is not TransmissionMode.REVERSE]
_GEAR = "gear"
_COLUMNS = (("station_m", "s_m", "s", "station"), ("speed_mps", "v_mps", "v", "speed"))


class SpeedReference(Protocol):
    """Protocol of a reference speed over station, updated every planning cycle."""

    def reset(self) -> None:
        """Prepares for a new drive."""

    def update(self, scene: Scene, find_leader: Callable[[], Neighbor | None]) -> SpeedProfile:
        """The profile to follow from now on.

        Args:
          scene: the truck and the traffic.
          find_leader: returns the vehicle ahead in the lane kept or changed to, None for none.

        Raises:
          InputError: the truck's station, speed or time is not finite.
        """

    def at(self, station: float) -> float:
        """Reference speed at a station now [m/s]."""

    def free(self, station: float) -> float:
        """Reference speed without traffic [m/s], which a lane change can restore."""


class _FixedReference:
    """A reference that stays the same over a drive."""

    def __init__(self, profile: SpeedProfile) -> None:
        self._profile = profile

    def reset(self) -> None:
        """Does nothing: the reference has no state."""

    def update(self, scene: Scene, find_leader: Callable[[], Neighbor | None]) -> SpeedProfile:
        """The same profile always."""
        del scene, find_leader
        return self._profile

    def at(self, station: float) -> float:
        """The profile's speed [m/s]."""
        return self._profile.at(station)

    free = at


class ProfileReference(_FixedReference):
    """A profile that was planned before the drive.

    Raises:
      InputError: see `check_profile`.
    """

    def __init__(self, profile: SpeedProfile) -> None:
        check_profile(profile, "speed profile")
        super().__init__(profile)


class CruiseReference(_FixedReference):
    """One speed everywhere.

    Args:
      speed: [m/s].
      reason: for which the requested reference is not available, or "".
    """

    def __init__(self, speed: float, reason: str = "") -> None:
        super().__init__(SpeedProfile(np.zeros(1), np.full(1, speed)))
        self.reason = reason


def check_profile(profile: SpeedProfile, name: str) -> None:
    """Raises InputError unless stations rise, speeds are 0.5 to 60 m/s, `coast_above` positive."""
    station, speed = profile.station, profile.speed
    if station.ndim != 1 or station.shape != speed.shape or station.size < 2:
        raise InputError(f"{name}: two rows or more with a station and a speed are needed")
    modes = profile.transmission_mode
    if modes is not None and modes.shape != station.shape:
        raise InputError(f"{name}: transmission_mode must have a value for each of its stations")
    if modes is not None and not np.isin(modes, _PLANNED_MODES).all():
        raise InputError(f"{name}: transmission_mode: use drive 0, neutral 1, gear g as 2 + g")
    if not profile.coast_above > 0.0:
        raise InputError(f"{name}: coast_above = {profile.coast_above:g} m/s must be above 0")
    if not (np.isfinite(station).all() and np.isfinite(speed).all()):
        raise InputError(f"{name} holds numbers that are not finite")
    if (np.diff(station) <= 0.0).any():
        where = float(station[int(np.argmax(np.diff(station) <= 0.0))])
        raise InputError(f"{name}: stations must rise, but do not after {where:g} m")
    bad = (speed < PROFILE_SPEED_MIN) | (speed > _SPEED_MAX)
    if bad.any():
        row = int(np.argmax(bad))
        raise InputError(
            f"{name}: {speed[row]:g} m/s at station {station[row]:g} m is not allowed; use "
            f"{PROFILE_SPEED_MIN:g} to {_SPEED_MAX:g}"
        )


def read_profile(path: Path) -> SpeedProfile:
    """A profile from a CSV file with the columns station_m and speed_mps, as `iits-mj pcc` writes.

    An additional column gear has the forward gear from a station to the next one, 0 for neutral.

    Raises:
      InputError: the file cannot be read, lacks a column, has a cell that is not a number (the
        message names the row), a gear that is not 0 to 18, or see `check_profile`.
    """
    header, _ = read_table(path, "speed profile")
    has_gears = any(cell.strip().lower() == _GEAR for cell in header)
    columns = (*_COLUMNS, (_GEAR,)) if has_gears else _COLUMNS
    station, speed, *gears = read_columns(path, "speed profile", columns)
    modes = None
    for gear in gears:
        wrong = gear[~np.isin(gear, np.arange(TransmissionMode.GEAR_18.gear + 1))]
        if wrong.size:
            raise InputError(f"speed profile {str(path)!r}: gear {wrong[0]:g}: use 0 to 18")
        modes = requests_of(gear.astype(np.int64))
    profile = SpeedProfile(station, speed, modes)
    check_profile(profile, f"speed profile {str(path)!r}")
    return profile


def check_covers(profile: SpeedProfile, station: float, length: float, name: str) -> None:
    """Raises InputError if no part of a profile is ahead of a station on a road of a length [m]."""
    first, last = float(profile.station[0]), float(profile.station[-1])
    if not math.isfinite(station) or last <= station or first >= length:
        raise InputError(
            f"{name} has stations {first:g} to {last:g} m: nothing of it lies ahead of station "
            f"{station:g} m on a road of {length:g} m; use a profile of this road"
        )
