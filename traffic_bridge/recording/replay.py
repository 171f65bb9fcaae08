"""Recorded vehicles at any time, interpolated between the recorded frames."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from iits_mj.core.angles import wrap_angles
from iits_mj.core.arrays import FloatArray
from iits_mj.core.errors import InputError
from iits_mj.core.messages import RoadSignals
from iits_mj.core.vehicles import COLUMNS, VehicleFrame
from traffic_bridge.recording.recording import Recording, ranks

EXACT = 1e-6  # [s]: this near to a recorded frame the frame itself is returned
# Columns with a continuous rate; the others, except the sizes, are interpolated linearly.
SMOOTH = ("x", "y", "z", "yaw", "station", "offset")
_SMOOTH = [COLUMNS.index(name) for name in SMOOTH]
_PLACE = 3  # the first three of them are the position
_YAW = SMOOTH.index("yaw")
_FULL_YAW = COLUMNS.index("yaw")
# Steepest rate at a frame, relative to the chords beside it, of a monotone cubic: F. N. Fritsch
# and R. E. Carlson, "Monotone piecewise cubic interpolation", SIAM J. Numer. Anal. 17 (1980).
STEEPEST = 3.0


class _Segment(NamedTuple):
    """The vehicles between two frames.

    Attributes:
      begin, end: [s]; first, last: the vehicles that are in both frames, there.
      rates: of the smooth columns at both, each of shape (len(SMOOTH), n) [1/s].
    """

    begin: float
    end: float
    first: VehicleFrame
    last: VehicleFrame
    rates: tuple[FloatArray, FloatArray]


class InterpolatedRecording:
    """The frames of a recording as functions of time.

    At a recorded time the recorded values are returned unchanged. Between two frames a vehicle that
    is in both moves on a cubic Hermite curve. Its rate at a frame is that of the parabola through
    the frame and its neighbors (exact at constant acceleration, also with uneven steps), limited
    after Fritsch and Carlson so that a standing vehicle does not oscillate. So position, yaw,
    station and offset have a continuous rate. A vehicle appears and disappears at a recorded frame.

    Args:
      recording: with at least one frame, times increasing.

    Attributes:
      recording: as given.

    Raises:
      InputError: there is no frame.
    """

    def __init__(self, recording: Recording) -> None:
        if len(recording) == 0:
            raise InputError("the recording has no frames")
        self.recording = recording
        self._times = recording.time - recording.time[0]
        self._ranks = ranks(recording.ids)
        self._at: tuple[int, VehicleFrame] | None = None
        self._between: tuple[int, _Segment] | None = None

    @property
    def duration(self) -> float:
        """From the first to the last frame [s]."""
        return float(self._times[-1])

    def at(self, time: float) -> VehicleFrame:
        """The vehicles at a time since the first frame [s]; an empty frame outside the recording.

        Raises:
          InputError: the time is not finite.
        """
        if not math.isfinite(time):
            raise InputError(f"time {time!r}: must be finite")
        if not -EXACT <= time <= self.duration + EXACT:
            return VehicleFrame.empty()
        k = int(np.searchsorted(self._times, time + EXACT, side="right")) - 1
        if abs(time - self._times[k]) <= EXACT or k + 1 == len(self._times):
            if self._at is None or self._at[0] != k:
                self._at = k, self.recording.frames[k]
            return self._at[1]
        if self._between is None or self._between[0] != k:
            self._between = k, self._segment(k)
        return _evaluate(self._between[1], time)

    def signals_at(self, time: float) -> RoadSignals:
        """The traffic lights at a time since the first frame [s]; see `Recording.signals_at`."""
        return self.recording.signals_at(
            int(np.searchsorted(self._times, time + 1e-9, "right")) - 1
        )

    def _rows(self, k: int) -> tuple[int, NDArray[np.int32]]:
        start = self.recording.start
        low = int(start[k])
        return low, self.recording.vehicle[low : int(start[k + 1])]

    def _segment(self, k: int) -> _Segment:
        """The curves between frame k and the next."""
        frames, times = self.recording.frames, self._times
        (_, one), (_, two) = self._rows(k), self._rows(k + 1)
        common, in_one, in_two = np.intersect1d(one, two, assume_unique=True, return_indices=True)
        order = np.argsort(self._ranks[common])
        who = common[order]
        first, last = frames[k].select(in_one[order]), frames[k + 1].select(in_two[order])
        begin, end = float(times[k]), float(times[k + 1])
        start, goal = first.values.T[_SMOOTH], last.values.T[_SMOOTH]
        width = end - begin
        chord = _step(start, goal) / width
        before = self._chords(k - 1, who, start, chord, sign=-1)
        after = self._chords(k + 2, who, goal, chord, sign=1)
        early = begin - float(times[k - 1]) if k > 0 else width
        late = float(times[k + 2]) - end if k + 2 < len(times) else width
        rates = _rate(before, chord, early, width), _rate(chord, after, width, late)
        return _Segment(begin, end, first, last, rates)

    def _chords(
        self, k: int, who: NDArray[np.int32], here: FloatArray, otherwise: FloatArray, sign: int
    ) -> FloatArray:
        """Mean rates from frame k to the values `here` (sign -1), or from them to frame k (+1).

        A vehicle that is not in that frame has the rate `otherwise`.
        """
        chords = otherwise.copy()
        if not 0 <= k < len(self._times):
            return chords
        low, there = self._rows(k)
        _, mine, its = np.intersect1d(who, there, assume_unique=True, return_indices=True)
        columns = self.recording.columns[:, low : low + len(there)][_SMOOTH][:, its]
        near = self._times[k + 1] if sign < 0 else self._times[k - 1]
        step = _step(columns, here[:, mine]) if sign < 0 else _step(here[:, mine], columns)
        chords[:, mine] = step / abs(float(self._times[k] - near))
        return chords


def _step(start: FloatArray, goal: FloatArray) -> FloatArray:
    """Differences of the smooth columns; that of the yaw is within half a turn."""
    step = goal - start
    step[_YAW] = wrap_angles(step[_YAW])
    return step


def _rate(before: FloatArray, after: FloatArray, early: float, late: float) -> FloatArray:
    """Rates at a frame between two steps with the given mean rates and durations."""
    rate = (late * before + early * after) / (early + late)
    least = np.minimum(_length(before), _length(after))
    length = _length(rate)
    limit = np.divide(STEEPEST * least, length, out=np.ones_like(length), where=length > 0.0)
    return rate * np.minimum(limit, 1.0)


def _length(rates: FloatArray) -> FloatArray:
    return np.sqrt((rates[:_PLACE] ** 2).sum(axis=0))


def _evaluate(segment: _Segment, time: float) -> VehicleFrame:
    """The vehicles within a segment."""
    width = segment.end - segment.begin
    t = (time - segment.begin) / width
    near = segment.first if t < 0.5 else segment.last
    a, b = segment.first.values.T, segment.last.values.T
    columns = a + t * (b - a)
    start = a[_SMOOTH]
    step = _step(start, b[_SMOOTH])
    columns[_SMOOTH] = (
        start
        + step * (t * t * (3.0 - 2.0 * t))
        + segment.rates[0] * (width * t * (1.0 - t) ** 2)
        + segment.rates[1] * (width * t * t * (t - 1.0))
    )
    columns[_FULL_YAW] = wrap_angles(columns[_FULL_YAW])
    return VehicleFrame(near.ids, near.kinds, near.lanes, columns)
