"""The paper's observation: 4 frames x 9 rows x 6 features = 216 numbers in [-1, 1].

Training and driving use the same function. The frames are of now, 1, 2 and 3 seconds ago, in this
order. A frame's rows are the truck, the nearest two vehicles behind, and the nearest six ahead
(nearest first); rows without a vehicle are zero. Features, with their normalization:

| feature         | truck's row                        | other rows                      | /      |
|-----------------|------------------------------------|---------------------------------|--------|
| presence        | 1                                  | 1                               | 1      |
| dx              | road left in its lane, <= 250 m    | its front minus truck's front   | 250 m  |
| dy              | offset from rightmost lane's middle| its offset minus the truck's    | 8 m    |
| relative speed  | own speed                          | its speed minus the truck's     | 40 m/s |
| lateral speed   | own                                | its own                         | 40 m/s |
| reference speed | reference speed                    | reference speed minus its speed | 40 m/s |

The paper gives the number of vehicles, not the range. Its release sees 100 m ahead. A truck that
closes in by 4 m/s covers that in 25 s, and whether a change pays depends on the traffic beyond.
Here the range is 250 m, that of a truck's long-range radar.

Longitudinal distance is measured along the route from front bumper to front bumper. A vehicle is
"ahead" when its front is ahead of the truck's and within 250 m, else "behind" while its front is at
most 50 m behind the *trailer's* rear: a vehicle beside the trailer is behind. Vehicles on no
driving lane of the route (lane -1: other carriageway, parking) are not observed.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from iits_mj.core.errors import InputError
from iits_mj.core.messages import Scene

if TYPE_CHECKING:
    from controllers.decision.base import Observation
    from iits_mj.road import Route

OBSERVATION_VERSION = 2
FRAME_AGES = (0.0, 1.0, 2.0, 3.0)
FEATURES = ("presence", "dx", "dy", "relative_speed", "lateral_speed", "reference_speed")
ROWS = ("ego", "behind1", "behind2", "ahead1", "ahead2", "ahead3", "ahead4", "ahead5", "ahead6")
FRAME_SHAPE = (len(ROWS), len(FEATURES))
OBSERVATION_SIZE = len(FRAME_AGES) * len(ROWS) * len(FEATURES)
RANGE_AHEAD = 250.0
SCALE = np.array([1.0, RANGE_AHEAD, 8.0, 40.0, 40.0, 40.0])
RANGE_BEHIND = 50.0
# Rounded means and deviations of the inputs in drives of the six cells:
# presence, dx, dy, relative speed, lateral speed, reference speed
_TRUCK_USUAL = (0.0, 1.0, 0.25, 0.4, 0.0, 0.4)
_TRUCK_SPREAD = (1.0, 0.3, 0.25, 0.05, 0.01, 0.05)
_OTHERS_USUAL = (0.0, 0.0, 0.0, 0.0, 0.0, 0.1)
_OTHERS_SPREAD = (1.0, 0.3, 0.4, 0.05, 0.01, 0.05)
_BEHIND, _AHEAD = 2, 6
_LANE_PROBE = 25.0
_DY, _LATERAL_SPEED = FEATURES.index("dy"), FEATURES.index("lateral_speed")

Frame = NDArray[np.float32]


def usual_and_spread() -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Returns usual value and spread of the 216 inputs; standardized: (x - usual) / spread."""
    others = len(ROWS) - 1
    usual = np.array([_TRUCK_USUAL, *[_OTHERS_USUAL] * others], np.float32)
    spread = np.array([_TRUCK_SPREAD, *[_OTHERS_SPREAD] * others], np.float32)
    return np.tile(usual.ravel(), len(FRAME_AGES)), np.tile(spread.ravel(), len(FRAME_AGES))


def observe_frame(scene: Scene, route: Route, reference_speed: float) -> Frame:
    """Returns one frame of the observation, shape (9, 6), normalized and clipped to [-1, 1].

    Raises:
      InputError: a number is not finite; the message names it.
    """
    ego = scene.ego
    neighbors = scene.neighbors
    ahead, behind = neighbors.nearest_by_front(RANGE_AHEAD, RANGE_BEHIND)
    rows = np.zeros(FRAME_SHAPE)
    rows[0] = (
        1.0,
        _road_left(route, ego.station, ego.offset),
        ego.offset - float(route.lane_offset(0, ego.station)),
        ego.speed,
        _lateral_speed(scene, route),
        reference_speed,
    )
    for first, found in ((1, behind[:_BEHIND]), (1 + _BEHIND, ahead[:_AHEAD])):
        if found.size:
            speed = neighbors.speed[found]
            columns = rows[first : first + len(found)].T
            columns[0] = 1.0
            columns[1] = neighbors.front_distance[found]
            columns[2] = neighbors.offset[found] - ego.offset
            columns[3] = speed - ego.speed
            columns[4] = neighbors.lateral_speed[found]
            columns[5] = reference_speed - speed
    check_finite(rows)
    return np.minimum(np.maximum(rows / SCALE, -1.0), 1.0).astype(np.float32)


class ObservationHistory:
    """Stores frames by time and stacks those of now, 1, 2 and 3 seconds ago.

    In the first 3 s the oldest frame replaces those that do not exist yet.
    """

    def __init__(self) -> None:
        self._times: deque[float] = deque()
        self._frames: deque[Frame | Callable[[], Frame]] = deque()

    def reset(self) -> None:
        """Removes all frames."""
        self._times.clear()
        self._frames.clear()

    def add(self, time: float, frame: Frame | Callable[[], Frame]) -> None:
        """Adds the frame of a time [s], which must be later than that of the last frame.

        A function that returns the frame is called when an observation needs it first: a drive adds
        ten frames a second, of which its decisions use one.

        Raises:
          InputError: wrong shape, a value that is not finite, or time not increasing.
        """
        if isinstance(frame, np.ndarray):
            _check_frame(frame)
        if not math.isfinite(time) or (self._times and time <= self._times[-1]):
            raise InputError(f"observation frame at time {time}: must be later than the last frame")
        self._times.append(time)
        self._frames.append(frame)
        while len(self._times) > 1 and self._times[1] < time - FRAME_AGES[-1] - 1e-6:
            self._times.popleft()
            self._frames.popleft()

    def observation(self) -> Observation:
        """Returns the observation at the last frame's time, float32 of shape (216,).

        Raises:
          InputError: no frame was added yet, or see `add`.
        """
        if not self._times:
            raise InputError("observation requested before any frame was added: call add first")
        apart = np.abs(np.subtract.outer(self._times[-1] - np.array(FRAME_AGES), self._times))
        stack = [self._frame(index) for index in apart.argmin(axis=1).tolist()]
        return np.concatenate([frame.ravel() for frame in stack]).astype(np.float32)

    def _frame(self, index: int) -> Frame:
        frame = self._frames[index]
        if not isinstance(frame, np.ndarray):
            frame = self._frames[index] = frame()
            _check_frame(frame)
        return frame


def _check_frame(frame: Frame) -> None:
    """Raises InputError for another shape or a value that is not finite."""
    if frame.shape != FRAME_SHAPE:
        raise InputError(f"observation frame has shape {frame.shape}: must be {FRAME_SHAPE}")
    check_finite(frame)


def observation(frames: list[Frame]) -> Observation:
    """Stacks four frames, newest first (now, 1, 2, 3 s ago), to float32 of shape (216,).

    For callers that store frames themselves; `ObservationHistory` gives the same numbers.
    """
    if len(frames) != len(FRAME_AGES):
        raise InputError(f"observation of {len(frames)} frames: must be {len(FRAME_AGES)}")
    history = ObservationHistory()
    for age, frame in reversed(list(zip(FRAME_AGES, frames, strict=True))):
        history.add(-age, frame)
    return history.observation()


def mirrored(observation: NDArray[np.floating], width: float) -> Observation:
    """Returns the observation with left and right exchanged, float32 of the same shape.

    Args:
      observation: shape (..., 216).
      width: between the middles of the rightmost and the leftmost lane [m].
    """
    rows = np.array(observation, np.float32).reshape(-1, len(FRAME_AGES), *FRAME_SHAPE)
    rows[..., [_DY, _LATERAL_SPEED]] *= -1.0
    rows[..., 0, _DY] += width / SCALE[_DY]
    return rows.reshape(np.shape(observation))


def check_finite(values: NDArray[np.floating]) -> None:
    """Raises InputError for the first number that is not finite, naming its feature.

    Accepts a frame, shape (9, 6), or observations by frame, shape (n, 4, 9, 6).
    """
    finite = np.isfinite(values)
    if finite.all():
        return
    first = np.argwhere(~finite)[0]
    row, feature = first[-2:]
    age = f", {FRAME_AGES[first[1]]:g} s ago," if first.size == 4 else ""
    raise InputError(
        f"observation: {FEATURES[feature]} of row {ROWS[row]}{age} is {values[tuple(first)]}: "
        "must be finite"
    )


def _road_left(route: Route, station: float, offset: float) -> float:
    """Returns the distance to the end of the lane or road, in steps of 25 m, at most 250 m."""
    lane = route.lane_at(station, offset)
    distance = 0.0
    while distance < RANGE_AHEAD:
        ahead = station + distance + _LANE_PROBE
        if ahead > route.length or (lane >= 0 and not route.lane_exists(lane, ahead)):
            return distance
        distance += _LANE_PROBE
    return RANGE_AHEAD


def _lateral_speed(scene: Scene, route: Route) -> float:
    """Returns the speed across the road, positive to the left [m/s]."""
    ego = scene.ego
    angle = ego.yaw - float(route.evaluate(ego.station, 0.0).heading)
    return ego.speed * math.sin(angle) + ego.lateral_speed * math.cos(angle)
