"""Where vehicles are between two steps of the traffic, and poses as MuJoCo takes them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from iits_mj.core.arrays import FloatArray
from traffic_bridge.frame import COLUMNS, VehicleFrame
from traffic_bridge.modes.observation import TIGHT_TURN

# x, y, z, yaw, pitch, roll, yaw_rate, speed, acceleration, lateral_speed.
STATE = COLUMNS[:10]

CRAWL = 0.1  # [m/s] below which speed, lateral speed and yaw rate say nothing about a direction

PACE_BAND = 0.1  # beyond 1 +- this, a pace is not believed
NOWHERE = 1e12  # [m]


def state_of(frame: VehicleFrame, rows: NDArray[np.intp]) -> FloatArray:
    """The columns named by `STATE` of some vehicles, shape (len(STATE), n)."""
    return np.asarray(frame.values.T[: len(STATE), rows])


def trend(state: FloatArray, last: FloatArray, step_length: float) -> FloatArray:
    """What vehicles did in the last step that their present state does not say.

    The pace is how far they came, as a fraction of what their speed says. Neighboring lanes in a
    bend share SUMO's positions but not their length, which makes some per mille; a recording whose
    speeds are those of the instant, not SUMO's, differs by a dt/2. The way beside the road's
    reference line climbs more than the road where the cross slope changes.

    Args:
      state: of n vehicles, see `STATE`, shape (10, n).
      last: the same a step before, its x `NOWHERE` for who is new, shape (10, n).
      step_length: of the traffic [s].

    Returns:
      Pace, pitch rate and roll rate [rad/s], and how much steeper than the pitch the way was,
      shape (4, n); 1, 0, 0, 0 where the pace is far from 1: a vehicle is new or was put elsewhere.
    """
    due = step_length * np.maximum(np.hypot(state[7], state[9]), CRAWL)
    change = state - last
    way = np.hypot(change[0], change[1])
    found = np.empty((4, due.size))
    found[0] = way / due
    strange = np.abs(found[0] - 1.0) > PACE_BAND
    way[strange] = 1.0
    found[1:3] = change[4:6] / step_length
    found[3] = change[2] / way + np.tan(state[4] - 0.5 * change[4])
    if strange.any():
        found[:, strange] = ((1.0,), (0.0,), (0.0,), (0.0,))
    return found


def moved(state: FloatArray, trend: FloatArray, elapsed: float, step_length: float) -> FloatArray:
    """Where vehicles are some time after (or before) a frame.

    Acceleration and rates stay as they are. SUMO's default scheme, semi-implicit Euler, moves a
    vehicle by v(k+1) dt in step k+1, so v(k) is the mean speed of the step that ended, and the
    speed at its end is half a step's gain higher: v(k) + a dt/2. With a constant acceleration the
    result meets SUMO's next position, v dt + a dt^2 on, and its last one, v dt back.

    Args:
      state: of n vehicles, see `STATE`, shape (10, n).
      trend: see `trend`, shape (4, n).
      elapsed: time since the frame [s], negative for before.
      step_length: of the traffic [s].

    Returns:
      x, y, z [m], yaw, pitch, roll [rad], shape (6, n).
    """
    yaw, pitch, yaw_rate, speed, acceleration, lateral = state[[3, 4, 6, 7, 8, 9]]
    way = elapsed * trend[0] * (speed + 0.5 * acceleration * (step_length + elapsed))
    if elapsed > 0.0:
        # Braking ends at standstill: nobody rolls backwards because of the last step.
        way = np.maximum(way, 0.0)
    turn = elapsed * yaw_rate
    # The arc is taken as its chord: shorter by less than 1e-3 at 1.5 rad/s.
    chord = yaw + 0.5 * turn
    if lateral.any():
        # Speed is along the lane, and a slow vehicle's box turns less than its way.
        slide = np.arctan2(lateral, np.maximum(speed, CRAWL))
        chord = chord + slide - np.arctan2(lateral, np.maximum(speed, TIGHT_TURN))
        way = np.where(speed > CRAWL, way / np.cos(slide), way)
    found = state[:6].copy()
    found[0] += way * np.cos(chord)
    found[1] += way * np.sin(chord)
    tilt = elapsed * trend[1:3]
    # Pitch is positive nose down (ISO 8855); roads are measured in the plane.
    found[2] += way * (trend[3] - np.tan(pitch + 0.5 * tilt[0]))
    found[3] += turn
    found[4:] += tilt
    return found


def quaternions(angles: FloatArray) -> FloatArray:
    """Quaternions (4, n), w first, of intrinsic rotations by yaw, pitch, roll (3, n) [rad]."""
    half = 0.5 * angles
    trig = np.empty((2, *half.shape))
    np.cos(half, out=trig[0])
    np.sin(half, out=trig[1])
    # cos and sin of pitch times those of roll: cc, cs, sc, ss.
    products = (trig[:, None, 1] * trig[None, :, 2]).reshape(4, -1)
    c, s = products * trig[0, 0], products * trig[1, 0]
    found = np.empty((4, half.shape[1]))
    np.add(c[0], s[3], out=found[0])
    np.subtract(c[1], s[2], out=found[1])
    np.add(c[2], s[1], out=found[2])
    np.subtract(s[0], c[3], out=found[3])
    return found
