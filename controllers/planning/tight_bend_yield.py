"""Tight bends in which the trailer leaves its lane: the truck drives slowly, and waits for others.

Before such a bend the ground that the truck will sweep is compared with every vehicle that is or
will be there before the trailer has left it. The truck waits before the bend until the ground is
free. A stopped vehicle occupies the ground under it only. At first the truck expects no vehicle to
brake for it; the longer it has waited, the harder it expects others to brake, up to a comfortable
deceleration, so that it does not wait for ever. In the bend it stops before it touches a vehicle
that is in its way after all.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from controllers.planning.following import braking_profile
from controllers.planning.predicted_boxes import Poses, bodies_along, unit_lengths
from controllers.planning.road_preview import LanePath, RoadPreview
from iits_mj.core.arrays import BoolArray, FloatArray
from iits_mj.core.boxes import Boxes
from iits_mj.core.messages import EgoState, LightState, Scene
from iits_mj.core.neighbors import ALONG
from iits_mj.parameters import TruckParameters
from iits_mj.parameters.mass_state import payload_of

# Only bends below this radius count [m].
_RADIUS = 35.0
# A body beyond its lane by more than this is in the way of others [m].
_BEYOND = 0.2
# Speed in the bend, at which steering is exact and slip is small [m/s].
BEND_SPEED = 3.0
# Spacing of the truck's predicted positions [m].
_STEP = 1.0
# Swept stretch before and behind the bend: the trailer is back in its lane a little more than the
# truck's length behind it [m]; a truck that is longer than `_LENGTH` needs twice the excess more.
_BEFORE, _AFTER, _LENGTH = 15.0, 45.0, 20.0
# The truck responds to a bend from this distance [m].
_SIGHT = 80.0
# Vehicles within this distance of a bend count [m].
_AROUND = 150.0
# Room to a moving vehicle and to a stopped one [m].
_ROOM, _ROOM_STOPPED = 0.5, 0.35
# Room in the bend at rest [m], its increase by speed [s], and distance left by a stop there [m].
_ROOM_INSIDE, _ROOM_GAIN, _SHORT = 0.1, 0.03, 0.5
# A vehicle slower than this is stopped [m/s].
_STOPPED = 0.5
# Deceleration that the truck expects of others: increase by the time waited [m/s3], greatest value
# before the truck starts and after, when it would otherwise stop half-way [m/s2]; reaction time of
# others [s].
_ASKS, _ASKS_MOST, _ASKS_UNDER_WAY, _REACTION = 0.3, 0.75, 2.5, 0.75
# Acceleration of the truck when it starts [m/s2].
_SETS_OUT = 0.5
# Within this distance of the waiting place a truck that moves on free ground has started [m].
_NEAR = 2.0
# Times at which others are predicted in the bend, and before it [s].
_SOON = np.array([0.0, 0.5, 1.0])
_TIMES = np.linspace(0.0, 15.0, 31)
# A stop line this near before the bend is the waiting place, at this distance from the line [m]. A
# line without a light is set back by up to 12 m, and the bend of a wide junction begins inside it:
# between the line and the bend, vehicles that turn into the truck's road need the ground.
_LINE_NEAR, _TO_LINE, _OPEN_LINE_NEAR = 12.0, 0.5, 30.0
# A slower truck has come to rest before a stop [m/s].
RESTS = 0.3
# The truck does not wait for a vehicle that leaves the ground this long before it arrives [s].
_EARLY = 1.0
# Braking towards the waiting place and the bend's speed, and greatest one for a vehicle seen late,
# positive [m/s2].
DECELERATION, HARD = 0.8, 2.0


@dataclass(frozen=True)
class Sweep:
    """The part of a bend in which the truck's bodies leave the lane.

    Attributes:
      begin: station of the steer axle at the waiting place [m].
      first, last: stations of the steer axle between which a body is beyond the lane [m].
      units: boxes of the units from `first` on, a meter apart.
    """

    begin: float
    first: float
    last: float
    units: tuple[Boxes, ...]


class TightBends:
    """The tight bends of a road, and the time that the truck has waited before one."""

    def __init__(self, preview: RoadPreview, parameters: TruckParameters) -> None:
        self.preview = preview
        self._parameters = parameters
        self._after = _AFTER + 2.0 * max(parameters.length - _LENGTH, 0.0)
        tight = np.abs(preview.curvature) > 1.0 / _RADIUS
        edges = np.flatnonzero(np.diff(np.concatenate([[0], tight.astype(int), [0]])))
        self._bends: list[tuple[float, float]] = []
        for start, end in edges.reshape(-1, 2):
            begin, over = float(preview.station[start]), float(preview.station[end - 1])
            if self._bends and begin - self._bends[-1][1] < self._after:
                begin = self._bends.pop()[0]
            self._bends.append((begin, over))
        self._known: dict[tuple[float, int, tuple[float, ...]], Sweep | None] = {}
        self.reset()

    def reset(self) -> None:
        """Clears the time waited."""
        self._waited = 0.0
        self._set_out = False
        self._seen: float | None = None

    def ahead(self, path: LanePath, ego: EgoState) -> Sweep | None:
        """The present or next bend in which the trailer leaves the lane of a path, or None."""
        for begin, over in self._bends:
            if begin - _SIGHT < ego.station < over + self._after:
                payload = payload_of(self._parameters, ego.mass)
                key = begin, path.lane, unit_lengths(self._parameters, payload)
                if key not in self._known:
                    self._known[key] = self._sweep(path, begin, over, payload)
                sweep = self._known[key]
                if sweep is not None and ego.station < sweep.last:
                    return sweep
        return None

    def demand(
        self, scene: Scene, path: LanePath, cap: FloatArray
    ) -> tuple[FloatArray, float, str]:
        """Bound on the speed, station of the steer axle's stop [m] or infinity, and the reason.

        Args:
          scene: the truck, the traffic and the signs.
          path: of the lane.
          cap: bound on the speed so far, shape of path.station [m/s].
        """
        ego = scene.ego
        sweep = self.ahead(path, ego)
        if sweep is None:
            self.reset()
            return cap, math.inf, ""
        inside = (path.station > sweep.begin) & (path.station < sweep.last)
        bound = np.where(inside, BEND_SPEED, 100.0)
        cap = np.minimum(cap, braking_profile(path.station, bound, DECELERATION))
        if ego.station > sweep.first - ego.speed**2 / (2.0 * HARD):
            return cap, *self._inside(sweep, scene, path)
        other = self._waits_for(sweep, scene, path)
        light = scene.signals.light
        closed = light is not None and light.state is not LightState.GREEN
        # Time at a closed light is no time waited for others.
        if other and not closed and ego.speed < RESTS and self._seen is not None:
            self._waited += max(scene.time - self._seen, 0.0)
        self._seen = scene.time
        if light is not None and closed and abs(sweep.begin - light.station) < _LINE_NEAR:
            # The stop of the light itself is the exact one.
            if scene.neighbors.front <= light.station:
                return cap, math.inf, ""
            if ego.station < sweep.first and ego.speed < RESTS:
                return cap, ego.station, "stopped beyond the line of a light that is not green"
        # A truck at rest can still let an oncoming vehicle pass that starts at the same time.
        starts = ego.station > sweep.begin - _NEAR and ego.speed > RESTS
        self._set_out = not other and starts
        if not other:
            return cap, math.inf, ""
        nearest = ego.station + ego.speed**2 / (2.0 * HARD)
        begin = sweep.begin
        lines = [(station, _OPEN_LINE_NEAR) for station in scene.signals.lines]
        if light is not None:
            lines.append((light.station, _LINE_NEAR))
        for station, near in lines:
            # A stop line shortly before the bend is the place to wait at.
            line = station - scene.footprint.front_overhang - _TO_LINE
            begin = line if sweep.begin - near < line < begin else begin
        stop = max(begin, min(nearest, sweep.first))
        return cap, stop, f"waiting for {other}: the trailer needs its ground in the bend"

    def _waits_for(self, sweep: Sweep, scene: Scene, path: LanePath) -> str:
        """The vehicle in the way before the truck enters a bend, in words; "" for none."""
        ego = scene.ego
        names, found = self._others(sweep, scene, path)
        if not names:
            return ""
        kinds = dict(zip(scene.neighbors.ids, scene.neighbors.kinds, strict=True))
        late = 0.5 * max(BEND_SPEED - ego.speed, 0.0) ** 2 / (_SETS_OUT * BEND_SPEED)
        enters = max(sweep.first - ego.station, 0.0) / BEND_SPEED
        leaves = (sweep.last - ego.station) / BEND_SPEED + late
        times = _TIMES[: 1 + int(np.searchsorted(_TIMES, max(leaves + _EARLY, 1.0)))]
        matters = times >= min(max(enters - _EARLY, 0.0), times[-1])
        for index, name in enumerate(names):
            if kinds[name] == "pedestrian":
                continue  # they stop and turn within a step: `crossing_leads` has them
            one = found.one(index)
            if one.speed[0] < _STOPPED:
                there = one.ahead(np.zeros(1))
                if any(unit.touch(there, _ROOM_STOPPED).any() for unit in sweep.units):
                    return f"{name}, which has stopped in the way"
                continue
            for guess in self._guesses(one, times):
                touched = np.zeros(len(times), dtype=bool)
                for unit in sweep.units:
                    touched |= unit.touch(guess, _ROOM)[:, :, 0].any(axis=0)
                if (touched & matters).any() and not self._yields(one, times, touched):
                    return f"{name}, which approaches"
        return ""

    def _yields(self, one: Poses, times: FloatArray, touched: BoolArray) -> bool:
        """Whether a vehicle can stop before the swept ground at the deceleration expected now."""
        first = int(touched.argmax())
        speed = float(one.speed[0])
        asks = _ASKS_UNDER_WAY if self._set_out else min(_ASKS * self._waited, _ASKS_MOST)
        left = float(one.distance(times[first : first + 1])[0, 0]) - _REACTION * speed
        return first > 0 and speed**2 < 2.0 * asks * left

    def _inside(self, sweep: Sweep, scene: Scene, path: LanePath) -> tuple[float, str]:
        """Station of the steer axle's stop in the bend [m] or infinity, and the reason."""
        ego = scene.ego
        names, found = self._others(sweep, scene, path)
        if not names:
            return math.inf, ""
        ahead = np.arange(len(sweep.units[0].x)) * _STEP + sweep.first - ego.station
        # A slower truck needs less room beside a vehicle.
        room = _ROOM_INSIDE + _ROOM_GAIN * min(ego.speed, BEND_SPEED)
        # The last place that the truck has reached: the next one may touch where it stops.
        here = max(int(np.searchsorted(ahead, 0.0, side="right")) - 1, 0)
        soon = (ahead > 0.0) & (ahead < ego.speed**2 / (2.0 * DECELERATION) + 4.0)
        for index, name in enumerate(names):
            for guess in self._guesses(found.one(index), _SOON):
                touched = np.zeros(len(ahead), dtype=bool)
                for unit in sweep.units:
                    touched |= unit.touch(guess, room)[:, :, 0].any(axis=1)
                rows = np.flatnonzero(touched & soon)
                # Stopping does not help against a vehicle that is already at the truck.
                if rows.size and not touched[here]:
                    stop = ego.station + max(float(ahead[rows[0]]) - _SHORT, 0.0)
                    return stop, f"{name} is in the trailer's path in the bend"
        return math.inf, ""

    def _guesses(self, one: Poses, times: FloatArray) -> list[Boxes]:
        """Predicted boxes of a vehicle at its turn rate; of an oncoming one also along the road."""
        guesses = [one.ahead(times)]
        if abs(float(one.to_road[0])) > np.pi - ALONG:
            guesses.append(one.along_road(times, self.preview))
        return guesses

    def _others(self, sweep: Sweep, scene: Scene, path: LanePath) -> tuple[list[str], Poses]:
        """Names and poses of the vehicles near a bend that are not in the truck's own lane."""
        neighbors = scene.neighbors
        along = np.abs(neighbors.station - sweep.first) < _AROUND
        # Where the route comes back to this junction, a vehicle here may have a far station.
        x, y = float(sweep.units[0].x[0]), float(sweep.units[0].y[0])
        here = neighbors.posed & (np.hypot(neighbors.x - x, neighbors.y - y) < _AROUND)
        near = neighbors.on_level(self.preview) & (along | here)
        found = Poses.of(neighbors, near, self.preview)
        own = along[near] & (np.abs(found.to_road) < ALONG)
        own &= np.abs(found.offset - path.offset_at(found.station)) < path.half_width
        names = [neighbors.ids[i] for i in np.flatnonzero(near)[~own]]
        return names, found.only(~own)

    def _sweep(self, path: LanePath, begin: float, over: float, payload: float) -> Sweep | None:
        """The part of a bend in which the bodies leave the lane of a path, None for none."""
        first, last = begin - _BEFORE, min(over + self._after, self.preview.route.length)
        stations = np.arange(max(first, 0.0), last, _STEP)
        units = bodies_along(self._parameters, self.preview, path, None, stations, payload)
        middle = np.arange(stations[0] - 40.0, stations[-1] + 10.0, 0.5)
        point = self.preview.route.evaluate(middle, path.offset_at(middle))
        line = np.column_stack([point.x, point.y])
        beyond = np.zeros(len(stations), dtype=bool)
        for unit in units:
            for along in np.linspace(-0.5, 0.5, 9):
                for side in (-0.5, 0.5):
                    x = unit.x + along * unit.length * np.cos(unit.yaw)
                    y = unit.y + along * unit.length * np.sin(unit.yaw)
                    x = x - side * unit.width * np.sin(unit.yaw)
                    y = y + side * unit.width * np.cos(unit.yaw)
                    apart = np.hypot(x[:, None] - line[:, 0], y[:, None] - line[:, 1]).min(axis=1)
                    beyond |= apart > path.half_width + _BEYOND
        if not beyond.any():
            return None
        rows = np.flatnonzero(beyond)
        kept = slice(int(rows[0]), int(rows[-1]) + 1)
        start = float(stations[rows[0]])
        return Sweep(
            begin=min(begin, start) - 1.5,
            first=start,
            last=float(stations[rows[-1]]),
            units=tuple(unit.part(kept) for unit in units),
        )
