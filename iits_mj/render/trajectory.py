"""The planned trajectory as a ribbon on the road, coloured by what the planner is doing."""

from __future__ import annotations

import mujoco
import numpy as np
from numpy.typing import NDArray

from iits_mj.messages import PlanMode, Trajectory

MODE_COLORS: dict[PlanMode, tuple[float, float, float]] = {
    PlanMode.LANE_KEEPING: (0.10, 0.78, 0.62),
    PlanMode.LANE_CHANGE: (1.00, 0.66, 0.10),
    PlanMode.ABORT: (1.00, 0.40, 0.10),
    PlanMode.EMERGENCY: (0.95, 0.10, 0.12),
}
HALF_WIDTH = 0.22  # [m]
LIFT = 0.07
PIECES_MAX = 60
PIECE_LENGTH = 2.0
HIDDEN_START = 2.2  # [m] ahead of the first point that lie below the cab


def add_trajectory(scene: mujoco.MjvScene, trajectory: Trajectory, time: float) -> int:
    """Draws the rest of a trajectory, from `time` on, into a scene.

    Args:
      scene: filled by `mjv_updateScene`; geoms are added behind those it has.
      trajectory: to draw.
      time: now [s].

    Returns:
      Number of geoms added; as many as there is room for.
    """
    points = _ribbon_points(trajectory, time)
    color = MODE_COLORS.get(trajectory.mode, MODE_COLORS[PlanMode.LANE_KEEPING])
    added = 0
    count = max(len(points) - 1, 1)
    for index in range(len(points) - 1):
        if scene.ngeom >= scene.maxgeom:
            break
        start, end = points[index], points[index + 1]
        step = end - start
        length = float(np.linalg.norm(step))
        if length < 1e-6:
            continue
        x = step / length
        y = np.array([-x[1], x[0], 0.0]) / max(np.hypot(x[0], x[1]), 1e-9)
        matrix = np.column_stack([x, y, np.cross(x, y)])
        fade = 0.85 - 0.6 * index / count
        geom = scene.geoms[scene.ngeom]
        mujoco.mjv_initGeom(
            geom,
            mujoco.mjtGeom.mjGEOM_BOX,
            np.array([0.5 * length + 0.01, HALF_WIDTH, 0.012]),
            0.5 * (start + end),
            matrix.ravel(),
            np.array([*(0.85 * value for value in color), fade], dtype=np.float32),
        )
        geom.emission = 0.25
        geom.category = mujoco.mjtCatBit.mjCAT_DECOR
        scene.ngeom += 1
        added += 1
    return added


def _ribbon_points(trajectory: Trajectory, time: float) -> NDArray[np.float64]:
    """Points (n, 3) along the rest of the trajectory, about 2 m apart."""
    path = np.stack([trajectory.x, trajectory.y, trajectory.z], axis=-1)
    if len(path) < 2 or not np.all(np.isfinite(path)):
        return np.empty((0, 3))
    steps = np.linalg.norm(np.diff(path, axis=0), axis=1)
    way = np.concatenate([[0.0], np.cumsum(steps)])
    start = float(np.interp(time, trajectory.time, way)) + HIDDEN_START
    if way[-1] - start < PIECE_LENGTH:
        return np.empty((0, 3))
    count = min(PIECES_MAX, int((way[-1] - start) / PIECE_LENGTH)) + 1
    wanted = np.linspace(start, way[-1], count)
    points = np.stack([np.interp(wanted, way, path[:, i]) for i in range(3)], axis=-1)
    points[:, 2] += LIFT
    return points
