"""Where vehicles are between two steps of the traffic, and poses as MuJoCo takes them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from traffic_bridge.frame import COLUMNS, VehicleFrame
from traffic_bridge.observation import TIGHT_TURN

FloatArray = NDArray[np.float64]

# x, y, z, yaw, pitch, roll, yaw_rate, speed, acceleration, lateral_speed.
STATE = COLUMNS[:10]

CRAWL = 0.1  # [m/s] below which speed, lateral speed and yaw rate say nothing about a direction

PACE_BAND = 0.1  # beyond 1 +- this, a pace is not believed
NOWHERE = [1e12, 1e12]  # [m]


def state_of(frame: VehicleFrame, rows: NDArray[np.intp]) -> FloatArray:
    """The columns named by `STATE` of some vehicles, shape (len(STATE), n)."""
    return np.asarray(frame.values.T[: len(STATE), rows])


def pace(state: FloatArray, last: FloatArray, step_length: float) -> FloatArray:
    """How far vehicles came in the last step, as a fraction of what their speed says.

    Neighboring lanes in a bend share SUMO's positions but not their length, which makes some
    per mille; a recording whose speeds are those of the instant, not SUMO's, differs by a dt/2.

    Args:
      state: of n vehicles, see `STATE`, shape (10, n).
      last: where they were a step before, `NOWHERE` for who is new, shape (n, 2) [m].
      step_length: of the traffic [s].

    Returns:
      Shape (n,); 1 where that is far from the truth (a vehicle was put elsewhere).
    """
    due = step_length * np.maximum(np.hypot(state[7], state[9]), CRAWL)
    found = np.hypot(state[0] - last[:, 0], state[1] - last[:, 1]) / due
    return np.where(np.abs(found - 1.0) < PACE_BAND, found, 1.0)


def moved(
    state: FloatArray, pace: FloatArray | float, elapsed: float, step_length: float
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Where vehicles are some time after (or before) a frame.

    Acceleration and yaw rate stay as they are. SUMO's default scheme, semi-implicit Euler, moves a
    vehicle by v(k+1) dt in step k+1, so v(k) is the mean speed of the step that ended, and the
    speed at its end is half a step's gain higher: v(k) + a dt/2. With a constant acceleration the
    result meets SUMO's next position, v dt + a dt^2 on, and its last one, v dt back.

    Args:
      state: of n vehicles, see `STATE`, shape (10, n).
      pace: of each vehicle, see `pace`, shape (n,) or ().
      elapsed: time since the frame [s], negative for before.
      step_length: of the traffic [s].

    Returns:
      x, y, z [m] and yaw [rad], each of shape (n,).
    """
    x, y, z, yaw, pitch, _, yaw_rate, speed, acceleration, lateral = state
    if elapsed == 0.0:
        return x, y, z, yaw
    way = elapsed * pace * (speed + 0.5 * acceleration * (step_length + elapsed))
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
    # Pitch is positive nose down (ISO 8855); roads are measured in the plane.
    return (
        x + way * np.cos(chord),
        y + way * np.sin(chord),
        z - way * np.tan(pitch),
        yaw + turn,
    )


def quaternions(yaw: FloatArray, pitch: FloatArray, roll: FloatArray) -> FloatArray:
    """Quaternions (n, 4), w first, of intrinsic z-y-x rotations by angles of shape (n,) [rad]."""
    half = 0.5 * np.stack((yaw, pitch, roll))
    (cy, cp, cr), (sy, sp, sr) = np.cos(half), np.sin(half)
    cpcr, spsr, cpsr, spcr = cp * cr, sp * sr, cp * sr, sp * cr
    found = np.empty((yaw.size, 4))
    found[:, 0] = cpcr * cy + spsr * sy
    found[:, 1] = cpsr * cy - spcr * sy
    found[:, 2] = spcr * cy + cpsr * sy
    found[:, 3] = cpcr * sy - spsr * cy
    return found


def on_plane(
    position: FloatArray, quaternion: FloatArray, ahead: FloatArray, turn: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Points of the road's plane under vehicles, and rotations in it.

    Args:
      position: of n vehicles, shape (n, 3) [m].
      quaternion: how they lie on the road, shape (n, 4).
      ahead: distance of the point, in the direction of the first turn [m], shape (n,).
      turn: angles against the vehicle, about the plane's normal [rad], shape (k, n).

    Returns:
      Points (n, 3) [m] and quaternions (k, n, 4).
    """
    w, x, y, z = quaternion.T
    c, s = np.cos(0.5 * turn), np.sin(0.5 * turn)
    turned = np.stack((w * c - z * s, x * c + y * s, y * c - x * s, z * c + w * s), axis=-1)
    w, x, y, z = turned[0].T
    direction = np.column_stack(
        (1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y + w * z), 2.0 * (x * z - w * y))
    )
    return position + ahead[:, None] * direction, turned
