"""Lamps of the truck and the traffic: which are lit, where they are, and the glow about them."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import mujoco
import numpy as np
from numpy.typing import NDArray

from iits_mj.core.arrays import FloatArray
from iits_mj.core.messages import Decision, EgoState, LightState, PlanMode, RoadSignals, Trajectory
from iits_mj.core.vehicles import VehicleFrame
from iits_mj.model.scenery.signs import LAMPS, lamp_of
from iits_mj.render.geometry import turn_of
from iits_mj.render.spots import spots
from traffic_bridge.mirror.articulation import KINGPIN_FROM_FRONT

if TYPE_CHECKING:
    from iits_mj.simulation import DriveFrame

BLINK = 1.5  # [Hz] of direction indicators; UN R48 allows 1 to 2 Hz
# Pressure that releases no brake force yet [Pa], and decelerations from which the lamps show
# endurance braking and a braking car; UN R13, 5.2.1.30: between 0.7 and 1.3 m/s2.
BRAKE_PRESSURE, ENDURANCE, BRAKING = 20e3, 1.3, 0.7
SIDEWAYS = 0.25  # [m/s] of a vehicle that changes lanes
_ASIDE = 0.15  # [m] to which a lane change must still lead
_SAME_PLACE = 4.0  # [m] between a vehicle and the body that shows it

# Where a light may stand before and beyond its stop line, along the route [m], and time
# for which a light that was passed keeps its state [s].
_LIGHT_REACH, _LIGHT_MEMORY = (10.0, 45.0), 15.0

_HEAD, _TAIL, _MARKER, _LEFT, _RIGHT, _RED, _YELLOW, _GREEN = range(8)
_FUNCTIONS = {
    "truck_headlight": _HEAD,
    "truck_tail_light": _TAIL,
    "truck_amber": _MARKER,
    "truck_indicator_left": _LEFT,
    "truck_indicator_right": _RIGHT,
    "traffic_headlamp": _HEAD,
    "traffic_tail_lamp": _TAIL,
    "traffic_indicator_left": _LEFT,
    "traffic_indicator_right": _RIGHT,
    **dict(zip(LAMPS, (_RED, _YELLOW, _GREEN), strict=True)),
}
# Of each function: color of its light, and share of it that is seen from aside.
_COLORS = np.array(
    [
        *[(1.0, 0.96, 0.84), (1.0, 0.06, 0.04), (1.0, 0.55, 0.08), (1.0, 0.55, 0.06)],
        *[(1.0, 0.55, 0.06), (1.0, 0.05, 0.03), (1.0, 0.62, 0.05), (0.1, 1.0, 0.45)],
    ]
)
_ASIDE_SEEN = np.array([0.15, 0.3, 1.0, 0.45, 0.45, 0.1, 0.1, 0.1])
_SHOWN = {
    LightState.RED: _RED,
    LightState.STOP: _RED,
    LightState.YELLOW: _YELLOW,
    LightState.GREEN: _GREEN,
}
_SIZE_MAX = 0.25  # [m]; small lamps side by side count as one
_OFF, _ON, _BRAKE = 0.06, 0.75, 1.9  # emission


@dataclass(frozen=True)
class Signals:
    """What a vehicle shows: whether it brakes, and its direction indicators; speed [m/s].

    `light` is the state of a traffic light.
    """

    brake: bool = False
    left: bool = False
    right: bool = False
    speed: float = 0.0
    light: LightState | None = None


@dataclass(frozen=True)
class Lights:
    """Lit lamps, n of them.

    Attributes:
      at: places relative to the eye; forward: direction of the vehicle, both (n, 3).
      kind: function; brightness: emission; size: half the size [m].
      open: False for tail lamps that a towed unit hides; geom: of each lamp, (n,).
    """

    at: FloatArray
    forward: FloatArray
    kind: NDArray[np.intp]
    brightness: FloatArray
    size: FloatArray
    open: NDArray[np.bool_]
    geom: NDArray[np.intp]


def truck_signals(ego: EgoState, trajectory: Trajectory | None) -> Signals:
    """Returns the truck's signals by its brake pressures, deceleration and planned lane change."""
    brake = max(ego.brake_pressures) > BRAKE_PRESSURE or ego.acceleration < -ENDURANCE
    aside = 0 if trajectory is None else change_of(trajectory, ego.offset)
    return Signals(brake, aside == Decision.LEFT, aside == Decision.RIGHT, ego.speed)


def change_of(trajectory: Trajectory, offset: float) -> Decision:
    """Returns the side to which a lane change leads from an offset [m]; KEEP without one."""
    if trajectory.mode is not PlanMode.LANE_CHANGE or not len(trajectory.offset):
        return Decision.KEEP
    way = float(trajectory.offset[-1]) - offset
    if abs(way) < _ASIDE:
        return Decision.KEEP
    return Decision.LEFT if way > 0.0 else Decision.RIGHT


class RoadLights:
    """The lamps of the map's traffic lights.

    Args:
      model: with the road's scenery.

    Attributes:
      lamps: each by the number of its geom.
    """

    def __init__(self, model: mujoco.MjModel) -> None:
        names = ((geom, model.geom(geom).name) for geom in range(model.ngeom))
        self.lamps = {geom: lamp for geom, name in names if (lamp := lamp_of(name))}
        self._seen: dict[int, tuple[float, LightState]] = {}

    def states(self, signals: RoadSignals, time: float) -> dict[int, LightState]:
        """Returns the states of the lights by the numbers of their lamps' geoms.

        Where the lamps of the map are not known, as without SUMO, these are the lights at the next
        stop line of the route and at the last ones.

        Args:
          signals: that the driver sees.
          time: of the drive [s].
        """
        if signals.lamps:
            shown = {one.signal: one.state for one in signals.lamps}
            return {g: shown[one.signal] for g, one in self.lamps.items() if one.signal in shown}
        light, (before, beyond) = signals.light, _LIGHT_REACH
        for geom, lamp in self.lamps.items():
            if light is not None and -before <= lamp.station - light.station <= beyond:
                self._seen[geom] = time, light.state
        return {
            geom: state
            for geom, (since, state) in self._seen.items()
            if 0.0 <= time - since < _LIGHT_MEMORY
        }

    def lit(self, signals: RoadSignals, time: float) -> set[int]:
        """Returns the geoms of the lamps that are lit; see `states`."""
        states, lamps = self.states(signals, time).items(), self.lamps
        return {g for g, state in states if _FUNCTIONS[lamps[g].material] == _SHOWN[state]}


class Lamps:
    """The lamps in a model.

    A geom is a lamp by its material. A mesh with lamps on both sides counts as two.

    Args:
      model: with the truck and the traffic's bodies.
    """

    def __init__(self, model: mujoco.MjModel) -> None:
        self._model = model
        function = {
            number: _FUNCTIONS[name]
            for number in range(model.nmat)
            if (name := model.material(number).name) in _FUNCTIONS
        }
        self.geom = np.array(
            [g for g, m in enumerate(model.geom_matid.tolist()) if m in function], dtype=np.intp
        )
        kinds = np.array([function[model.geom_matid[g]] for g in self.geom], dtype=np.intp)
        self.function = kinds
        self.owner = model.body_rootid[model.geom_bodyid[self.geom]]
        # Traffic lights by the numbers of their geoms, which stand for an owner: -1 and less.
        self._road = RoadLights(model)
        lamps = self._road.lamps
        roots = self.owner.tolist()
        self._owners = [
            -1 - g if g in lamps else root
            for g, root in zip(self.geom.tolist(), roots, strict=True)
        ]
        turns = [turn_of(model, geom) for geom in self.geom.tolist()]
        places = [_places(model, g, t) for g, t in zip(self.geom.tolist(), turns, strict=True)]
        # The body's forward direction in the geom's frame: meshes are turned to their inertia.
        self._ahead = np.array([turn[0] for turn in turns]).reshape(-1, 3)
        for k, (geom, turn) in enumerate(zip(self.geom.tolist(), turns, strict=True)):
            if geom in lamps:
                facing = lamps[geom].facing
                self._ahead[k] = turn.T @ [math.cos(facing), math.sin(facing), 0.0]
        self._index = np.repeat(np.arange(len(places)), [len(p) for p in places])
        both = np.concatenate(places) if places else np.empty((0, 4))
        self._local, self._size = both[:, :3], both[:, 3]
        self._open = ~self._behind_towed()[self._index]
        self._traffic = [
            body for body in np.unique(self.owner).tolist() if model.body_mocapid[body] >= 0
        ]

    def _behind_towed(self) -> NDArray[np.bool_]:
        """Returns which geoms are tail lamps with a towed unit behind them."""
        model, depth = self._model, np.zeros(self._model.nbody, dtype=int)
        for body in range(1, model.nbody):
            depth[body] = depth[model.body_parentid[body]] + 1
        place, owners = depth[model.geom_bodyid[self.geom]], self.owner.tolist()
        last = {owner: place[self.owner == owner].max() for owner in set(owners)}
        hidden = [
            at < last[owner] or model.body(owner).name.endswith("_tractor")
            for at, owner in zip(place.tolist(), owners, strict=True)
        ]
        return np.array(hidden, dtype=bool) & (self.function == _TAIL)

    def signals(self, data: mujoco.MjData, frame: DriveFrame) -> dict[int, Signals]:
        """Returns the signals of the shown vehicles by the root of their bodies.

        The traffic lights have negative numbers.
        """
        root = int(self._model.body("tractor").rootid[0])
        found = {root: truck_signals(frame.ego, frame.trajectory)}
        states = self._road.states(frame.scene.signals, frame.time)
        found |= {-1 - geom: Signals(light=state) for geom, state in states.items()}
        vehicles = VehicleFrame.of(frame.scene.vehicles)
        if not len(vehicles) or not self._traffic:
            return found
        x, y, yaw, speed, braking, aside, length = vehicles.columns(
            *("x", "y", "yaw", "speed", "acceleration", "lateral_speed", "length")
        )
        # Bodies have moved on since the traffic's last step.
        way = speed * max(frame.time - frame.scene.time, 0.0)
        way = way + np.where(
            np.array(vehicles.kinds) == "articulated", 0.5 * length - KINGPIN_FROM_FRONT, 0.0
        )
        at = np.stack([x + way * np.cos(yaw), y + way * np.sin(yaw)], axis=1)
        bodies = data.xpos[self._traffic, :2]
        apart = np.linalg.norm(bodies[:, None] - at[None], axis=2)
        nearest = apart.argmin(axis=1)
        for k, body in enumerate(self._traffic):
            i = int(nearest[k])
            if apart[k, i] < _SAME_PLACE:
                found[body] = Signals(
                    bool(braking[i] < -BRAKING),
                    bool(aside[i] > SIDEWAYS),
                    bool(aside[i] < -SIDEWAYS),
                    float(speed[i]),
                )
        return found

    def brightness(self, signals: Mapping[int, Signals], time: float, *, on: bool) -> FloatArray:
        """Returns the emission of each geom in `geom`; `on`: whether lamps are switched on."""
        flash = (time * BLINK) % 1.0 < 0.5
        rest = _ON if on else _OFF
        found = np.empty(len(self.geom))
        for i, (kind, owner) in enumerate(zip(self.function, self._owners, strict=True)):
            shown = signals.get(owner, Signals())
            if kind in (_LEFT, _RIGHT):
                active = shown.left if kind == _LEFT else shown.right
                found[i] = _BRAKE if active and flash else _OFF
            elif kind >= _RED:
                lit = shown.light is not None and _SHOWN[shown.light] == kind
                found[i] = _BRAKE if lit else _OFF
            elif kind == _TAIL and shown.brake:
                found[i] = _BRAKE
            elif kind == _HEAD:
                found[i] = 2.0 if on else 0.25
            else:
                found[i] = rest
        return found

    def lights(self, places: FloatArray, brightness: FloatArray) -> Lights:
        """Returns the lit lamps.

        Args:
          places: rotation and position of all geoms, (ngeom, 3, 4).
          brightness: of the geoms in `geom`.
        """
        lit = brightness[self._index] > 0.3
        index = self._index[lit]
        of = places[self.geom[index]]
        at = np.einsum("nij,nj->ni", of[:, :, :3], self._local[lit]) + of[:, :, 3]
        forward = np.einsum("nij,nj->ni", of[:, :, :3], self._ahead[index])
        bright = brightness[index]
        kind, size = self.function[index], self._size[lit]
        return Lights(at, forward, kind, bright, size, self._open[lit], self.geom[index])


def _places(model: mujoco.MjModel, geom: int, turn: FloatArray) -> FloatArray:
    """Returns middle, in the geom's frame, and half the size of each lamp of a geom [m], (n, 4)."""
    mesh = int(model.geom_dataid[geom])
    if mesh < 0:
        return np.array([[0.0, 0.0, 0.0, float(model.geom_size[geom].max())]])
    first, count = model.mesh_vertadr[mesh], model.mesh_vertnum[mesh]
    points = model.mesh_vert[first : first + count].astype(float)
    seen = points @ turn.T + model.geom_pos[geom]
    # Lamps are apart by more than their size: one for each corner of a coarse grid.
    cells = np.round(seen / np.array([0.8, 0.8, 0.6])).astype(int)
    _, which = np.unique(cells, axis=0, return_inverse=True)
    which = which.ravel()
    lamps = [points[which == k] for k in range(which.max() + 1)]
    sizes = [min(0.5 * float(np.ptp(p, axis=0).max()), _SIZE_MAX) for p in lamps]
    return np.array([[*p.mean(axis=0), size] for p, size in zip(lamps, sizes, strict=True)])


def _seen(lights: Lights) -> FloatArray:
    """Returns the cosine between each lamp's direction and the direction to the eye."""
    distance = np.maximum(np.linalg.norm(lights.at, axis=1), 0.5)
    cosine = -np.einsum("ij,ij->i", lights.at, lights.forward) / distance
    cosine = cosine * np.where(lights.kind == _TAIL, -1.0, 1.0)
    both = (lights.kind == _LEFT) | (lights.kind == _RIGHT)
    return np.where(both, np.abs(cosine), cosine)


def glow(lights: Lights, axes: FloatArray, strength: float) -> FloatArray:
    """Returns the glow of lamps as spots, see `iits_mj.render.spots`; places relative to the eye.

    Args:
      lights: as of `Lamps.lights`.
      axes: right, up and forward of the camera, rows of (3, 3).
      strength: of the weather, 0 to 1.
    """
    kind, brightness, seen = lights.kind, lights.brightness, _seen(lights)
    distance = np.maximum(np.linalg.norm(lights.at, axis=1), 0.5)
    to_eye = -lights.at / distance[:, None]
    least = _ASIDE_SEEN[kind]
    share = np.where(kind == _MARKER, 1.0, np.clip((seen + 0.15) / 1.15, 0.0, 1.0) ** 2)
    share = np.where(seen > -0.15, least + (1.0 - least) * share, 0.0)
    share = np.where(kind == _MARKER, 0.5, share)
    gain = strength * share * np.minimum(brightness, 1.6)
    size = np.where(kind == _MARKER, np.minimum(lights.size, 0.07), lights.size)
    radius = size * (2.2 + 3.2 * strength) * np.sqrt(np.minimum(brightness, 2.0))
    # Far lamps stay as large as a pixel or two.
    radius = np.maximum(radius, 0.0022 * distance)
    # In front of the lamp's own glass.
    center = lights.at + to_eye * np.minimum(0.35, 0.5 * distance)[:, None]
    color = _COLORS[kind] * gain[:, None]
    chosen = gain > 0.02
    return spots(
        center[chosen],
        radius[chosen, None] * axes[0],
        radius[chosen, None] * axes[1],
        color[chosen],
        0.0,
    )


def beams(lights: Lights, count: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Returns place, direction and color of the beams nearest to the eye, `count` at most."""
    head = np.flatnonzero(lights.kind == _HEAD)
    # Both lamps of a vehicle are one beam from its middle.
    _, first, beam = np.unique(lights.geom[head], return_index=True, return_inverse=True)
    total = np.bincount(beam)[:, None]
    middle = np.stack([np.bincount(beam, lights.at[head, i]) for i in range(3)], axis=1) / total
    near = np.argsort(np.linalg.norm(middle, axis=1))[:count]
    tilted = lights.forward[head[first]][near] - [0.0, 0.0, math.tan(math.radians(0.6))]
    tilted /= np.maximum(np.linalg.norm(tilted, axis=1, keepdims=True), 1e-9)
    return middle[near], tilted, np.tile(2.8 * _COLORS[_HEAD], (len(near), 1))


def glints(
    lights: Lights, axes: FloatArray, strength: float, count: int
) -> tuple[FloatArray, FloatArray]:
    """Returns place and color of the lamps that a wet road mirrors, `count` at most."""
    seen, large = _seen(lights), lights.size > 0.08
    ahead = (lights.at @ axes[2] > 0.0) & (lights.kind != _MARKER) & (seen > 0.05)
    ahead &= large & lights.open
    chosen = np.flatnonzero(ahead)
    chosen = chosen[np.argsort(np.linalg.norm(lights.at[chosen], axis=1))[:count]]
    gain = strength * np.minimum(lights.brightness[chosen], 1.6) * np.clip(seen[chosen], 0.0, 1.0)
    return lights.at[chosen], _COLORS[lights.kind[chosen]] * gain[:, None]
