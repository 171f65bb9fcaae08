"""A swarm: vehicles on the lanes around a body, as many as there is room for."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from typing import NamedTuple

import numpy as np

from iits_mj.core.arrays import BoolArray, FloatArray
from iits_mj.core.vehicles import TrackedVehicle
from iits_mj.road import RoadMap
from iits_mj.road.road_frames import RoadFrames
from traffic_bridge.scenario.actions import Swarm
from traffic_bridge.scenario.conditions import ROUNDING, Body, Situation

STEP = 10.0  # [m] between the places of a lane
BETWEEN = 2.5  # [m]: vehicles that are farther apart across the road are in different lanes
STANDING = 8.0  # [m] between the centers of two vehicles, besides the way of a time gap
TIME_GAP = 1.0  # [s] (judgement: a dense but stable traffic)
PERIOD = 1.0  # [s] between two times at which vehicles join a swarm
LEFT_BEHIND = 1.05  # of the ellipse's size: a vehicle beyond it is taken away


class LanePlaces(NamedTuple):
    """Places on the driving lanes of a road: x, y [m], heading [rad] of each, and its lane."""

    x: FloatArray
    y: FloatArray
    heading: FloatArray
    lanes: list[str]


# Adds a vehicle by name, lane, point, type and speed; returns it, or None if it has no room.
Join = Callable[[str, str, tuple[float, float], str, float], TrackedVehicle | None]


class RunningSwarm:
    """The vehicles of a swarm.

    Args:
      event: its settings.
      random: decides their places and types.
      road_map: the map.
      join: adds a vehicle; remove: takes one away by its name.
    """

    def __init__(
        self,
        event: Swarm,
        random: np.random.Generator,
        road_map: RoadMap,
        join: Join,
        remove: Callable[[str], None],
    ) -> None:
        self._event, self._random = event, random
        self._join, self._remove = join, remove
        self._places = SwarmPlaces(road_map)
        assert event.mix is not None
        weights = np.array(list(event.mix.values()))
        self._types, self._shares = list(event.mix), weights / weights.sum()
        self._names: list[str] = []
        self._made, self._due = 0, 0.0

    def update(self, situation: Situation) -> None:
        """Takes vehicles away that have left the ellipse, and adds others, once a second."""
        event, center = self._event, situation.find(self._event.to)
        if center is None or situation.time < self._due - ROUNDING:
            return
        self._due = situation.time + PERIOD
        bodies = situation.bodies
        # A vehicle that reached the end of its road is gone already.
        there = [name for name in self._names if name in bodies]
        x, y = (np.array([getattr(bodies[n], axis) for n in there]) for axis in ("x", "y"))
        inside = in_ellipse(event, center, x, y, LEFT_BEHIND).tolist()
        for name in (name for name, kept in zip(there, inside, strict=True) if not kept):
            self._remove(name)
        self._names = [name for name, kept in zip(there, inside, strict=True) if kept]
        if len(self._names) < event.count:
            self._add(situation, center)

    def leave(self) -> None:
        """Takes all vehicles away."""
        for name in self._names:
            self._remove(name)

    def _add(self, situation: Situation, center: Body) -> None:
        event = self._event
        places = self._places.around(event, center)
        bodies = [*situation.bodies.values()]
        if situation.truck is not None:
            bodies.append(situation.truck)
        for number in self._random.permutation(len(places.lanes)).tolist():
            if len(self._names) >= event.count:
                break
            if not is_free(places, number, bodies, event.speed):
                continue
            kind = str(self._random.choice(self._types, p=self._shares))
            name = f"{event.name}.{self._made}"
            point = float(places.x[number]), float(places.y[number])
            row = self._join(name, places.lanes[number], point, kind, event.speed)
            if row is None:
                continue
            self._names.append(name)
            self._made += 1
            half, speed = 0.5 * row.length, row.speed
            ends = row.station + half, row.station - half, row.offset, row.width
            motion = speed, speed, 0.0, row.x, row.y, row.yaw, half
            bodies.append(Body(name, *ends, row.lane, *motion))


class SwarmPlaces:
    """The places of a map where vehicles of a swarm can be."""

    def __init__(self, road_map: RoadMap) -> None:
        self._map = road_map
        self._frames = RoadFrames(road_map)
        self._known: dict[str, LanePlaces] = {}
        # Both ends of each road: x and y [m].
        self._ends = {
            name: road.plan.evaluate([0.0, road.length])
            for name, road in road_map.roads.items()
            if road.junction is None
        }

    def around(self, event: Swarm, center: Body) -> LanePlaces:
        """Returns the places in the ring of an event around a body."""
        reach = math.hypot(event.half_length, event.half_width) + abs(event.ahead)
        near = []
        for name, line in self._ends.items():
            away = np.hypot(np.asarray(line.x) - center.x, np.asarray(line.y) - center.y)
            if float(away.min()) < reach + self._map.roads[name].length:
                near.append(self._of_road(name))
        x, y, heading = (
            np.concatenate([np.zeros(0), *(each[k] for each in near)]) for k in range(3)
        )
        inside = in_ellipse(event, center, x, y) & (
            np.hypot(x - center.x, y - center.y) >= event.inner
        )
        lanes = [lane for each in near for lane in each.lanes]
        chosen = [lane for lane, kept in zip(lanes, inside, strict=True) if kept]
        return LanePlaces(x[inside], y[inside], heading[inside], chosen)

    def _of_road(self, name: str) -> LanePlaces:
        if name not in self._known:
            frame, road = self._frames[name], self._map.roads[name]
            rows: list[tuple[float, float, float]] = []
            lanes: list[str] = []
            for number, section in enumerate(road.sections):
                first, last = frame.span(number)
                s = np.arange(first + 0.5 * STEP, last, STEP)
                for lane in (each for each in section.lanes if each.is_driving):
                    sense = road.travel(lane.id)
                    if lane.id == 0 or not road.has_lanes(sense):
                        continue
                    point = frame.surface(s, frame.center(lane.id, s, number))
                    heading = point.heading + (0.0 if sense > 0 else math.pi)
                    rows.extend(zip(point.x, point.y, heading, strict=True))
                    lanes.extend([f"{name}_{lane.id}"] * len(s))
            table = np.array(rows, dtype=float).reshape(-1, 3)
            self._known[name] = LanePlaces(table[:, 0], table[:, 1], table[:, 2], lanes)
        return self._known[name]


def in_ellipse(
    event: Swarm, center: Body, x: FloatArray, y: FloatArray, size: float = 1.0
) -> BoolArray:
    """Returns whether points are in the ellipse of an event, made larger by a factor."""
    cosine, sine = math.cos(center.yaw), math.sin(center.yaw)
    dx, dy = x - center.x, y - center.y
    ahead = (dx * cosine + dy * sine - event.ahead) / event.half_length
    aside = (dy * cosine - dx * sine) / event.half_width
    inside: BoolArray = ahead**2 + aside**2 <= size**2
    return inside


def is_free(places: LanePlaces, number: int, bodies: Iterable[Body], speed: float) -> bool:
    """Returns whether no body is in a lane's place, nor within a time gap before and behind it."""
    x, y, heading = (float(column[number]) for column in places[:3])
    cosine, sine = math.cos(heading), math.sin(heading)
    for body in bodies:
        dx, dy = body.x - x, body.y - y
        room = STANDING + 0.5 * body.length + TIME_GAP * max(speed, body.speed)
        if abs(dy * cosine - dx * sine) < BETWEEN and abs(dx * cosine + dy * sine) < room:
            return False
    return True
