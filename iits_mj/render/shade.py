"""Where vehicles stand on the road: the shade below them, and the spray behind their wheels."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from iits_mj.core.arrays import FloatArray
from iits_mj.model.visuals.shapes import VISUAL_GROUP
from iits_mj.render import spots
from iits_mj.render.geometry import turn_of
from iits_mj.render.lamps import Signals
from iits_mj.render.weather import Weather

_LIFT = 0.05  # [m] above the road
_REACH = 250.0  # [m] from the eye within which shade and spray are drawn
_DARK, _DARK_INSIDE = 0.42, 0.62
_LONG = 1.8  # [m], least length of a unit
_TIRES = ("rubber", "traffic_dark")


@dataclass(frozen=True)
class _Unit:
    """A rigid unit: its body, the extent of its geoms there [m], and a geom of it."""

    body: int
    root: int
    rear: float
    front: float
    half_width: float
    geom: int


class Shades:
    """The units of all vehicles in a model.

    Args:
      model: with the truck and the traffic's bodies.

    Attributes:
      geom: of each unit, one of its geoms.
    """

    def __init__(self, model: mujoco.MjModel) -> None:
        self._units = _units(model)
        self.geom = np.array([unit.geom for unit in self._units], dtype=np.intp)
        tires = [
            g
            for g, m in enumerate(model.geom_matid.tolist())
            if m >= 0
            and model.material(m).name == "truck_rubber"
            and model.body_dofnum[model.geom_bodyid[g]]
        ]
        self._tires = np.array(tires, dtype=np.intp)
        self._radius = np.array([model.geom_aabb[g, 3:].max() for g in tires])
        self._truck = {int(model.body_rootid[model.geom_bodyid[g]]) for g in tires}

    def update(self, data: mujoco.MjData) -> None:
        """Takes the places of the units."""
        bodies = [unit.body for unit in self._units]
        at, axes = data.xpos[bodies], data.xmat[bodies].reshape(-1, 3, 3)
        self._forward = axes[:, :, 0].copy()
        middle = np.array([0.5 * (unit.front + unit.rear) for unit in self._units])
        self._center = at + middle[:, None] * self._forward
        wheels = data.geom_xpos[self._tires]
        for i, unit in enumerate(self._units):
            if unit.root not in self._truck or not len(wheels):
                continue
            # A truck's units have their origins at couplings: the road is below the tires.
            ahead = self._forward[i, :2] / max(float(np.linalg.norm(self._forward[i, :2])), 1e-9)
            along = (wheels[:, :2] - self._center[i, :2]) @ ahead
            order = np.argsort(along)
            half = 0.5 * (unit.front - unit.rear)
            low, high = np.interp([-half, half], along[order], (wheels[:, 2] - self._radius)[order])
            self._center[i, 2] = 0.5 * (low + high)
            self._forward[i] = [*ahead, (high - low) / max(2.0 * half, 1e-9)]

    def spots(self, eye: FloatArray, inside: NDArray[np.float32]) -> FloatArray:
        """Returns the shade below the units near the eye; `inside`: of geoms, see `Offscreen`."""
        found = [np.empty((0, spots.COLUMNS))]
        for i, unit in enumerate(self._units):
            center = self._center[i] - eye
            if np.abs(center).max() > _REACH:
                continue
            share = min(float(inside[unit.geom]), 1.0)
            half = (0.5 * (unit.front - unit.rear), unit.half_width)
            dark = _DARK + share * (_DARK_INSIDE - _DARK)
            center[2] += _LIFT
            found.append(spots.shade(center, self._forward[i], half, dark))
        return np.concatenate(found)

    def spray(
        self,
        eye: FloatArray,
        axes: FloatArray,
        signals: Mapping[int, Signals],
        time: float,
        weather: Weather,
    ) -> FloatArray:
        """Returns the spray behind the units near the eye.

        Args:
          eye: in the map [m].
          axes: right, up and forward of the camera.
          signals: with the speeds, by the root of the bodies.
          time: [s].
          weather: a wet one.
        """
        found = [np.empty((0, spots.COLUMNS))]
        for i, unit in enumerate(self._units):
            center = self._center[i] - eye
            speed = signals.get(unit.root, Signals()).speed
            if np.abs(center).max() > _REACH or speed <= 0.0:
                continue
            light = np.array(weather.fog) + (0.03 if weather.beams else 0.0)
            rear = center - 0.5 * (unit.front - unit.rear - 1.0) * self._forward[i]
            args = (self._forward[i], speed, time + 0.37 * i, axes, light, weather.wet)
            found.append(spots.spray(rear, *args))
        return np.concatenate(found)


def _units(model: mujoco.MjModel) -> list[_Unit]:
    """Returns the rigid units whose geoms look like a vehicle's, without their wheels."""
    vehicle = {
        m for m in range(model.nmat) if model.material(m).name.startswith(("truck_", "traffic_"))
    }
    geoms: dict[int, list[int]] = {}
    for geom in range(model.ngeom):
        if model.geom_matid[geom] in vehicle and model.geom_group[geom] == VISUAL_GROUP:
            geoms.setdefault(int(model.geom_bodyid[geom]), []).append(geom)
    found = []
    for body, own in geoms.items():
        low, high = np.full(3, np.inf), np.full(3, -np.inf)
        for geom in own:
            turn = turn_of(model, geom)
            middle = model.geom_pos[geom] + turn @ model.geom_aabb[geom, :3]
            half = np.abs(turn) @ model.geom_aabb[geom, 3:]
            low, high = np.minimum(low, middle - half), np.maximum(high, middle + half)
        # Wheels and axles are short.
        if high[0] - low[0] >= _LONG:
            width = min(0.5 * float(high[1] - low[1]), 1.3)
            root = int(model.body_rootid[body])
            found.append(_Unit(body, root, float(low[0]), float(high[0]), width, own[0]))
    return found
