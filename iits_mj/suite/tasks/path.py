"""Tasks that steer along a path: lane keeping, double lane change, platoon."""

from __future__ import annotations

import abc
import math
from typing import Any, ClassVar

import mujoco
import numpy as np

from controllers.planning.trajectory import Quintic
from iits_mj.core.messages import EgoState
from iits_mj.suite import scene
from iits_mj.suite.physics import BENDING, WITHOUT_GEAR, Observed, Physics
from iits_mj.suite.tasks.base import DrivingTask, tolerance

PATH_PREVIEW = (10.0, 20.0, 35.0, 50.0, 75.0)
# Stations where the track leaves the lane, reaches the other lane, leaves it, and returns [m].
GATES = (250.0, 325.0, 400.0, 475.0)
_CONES = 0.5 * scene.LANE_WIDTH - 0.2
_OUT = Quintic.to_zero(GATES[0], GATES[1] - GATES[0], scene.LANE_WIDTH)
_BACK = Quintic.to_zero(GATES[2], GATES[3] - GATES[2], scene.LANE_WIDTH)
# Gap of a platoon at standstill [m].
STANDSTILL_GAP = 5.0


class PathTask(DrivingTask):
    """A task that steers along a path beside the road's reference line.

    Attributes:
      off_path, trailer_off_path: distance from the path at which the episode ends [m].
      overturned: roll of the tractor at which it ends [rad].
      lane_room: distance of the steer axle from the path with full reward [m].
      sideways: name of the factor of lateral acceleration, and its bound [m/s2].
    """

    tags = ("hard",)
    lane_room: ClassVar[float]
    sideways: ClassVar[tuple[str, float]]
    off_path: ClassVar[float] = 2.0
    trailer_off_path: ClassVar[float] = 2.0
    overturned: ClassVar[float] = 0.3
    actions: ClassVar[tuple[str, ...]] = ("drive", "steer")
    observed: ClassVar[dict[str, Observed]] = {
        **WITHOUT_GEAR,
        "speed_error": Observed(5.0, "m/s", "speed minus the speed to hold", "speed"),
        "lane_error": Observed(1.0, "m", "steer axle left of the path", "body `tractor`, road"),
        "heading_error": Observed(
            0.1, "rad", "tractor's heading minus the path's", "body `tractor`, road"
        ),
        "trailer_error": Observed(
            1.0, "m", "trailer's axle group left of the path", "site `trailer_axle_center`, road"
        ),
        **BENDING,
    }

    # The state for which `_offsets` were computed.
    _ego: EgoState | None = None

    @abc.abstractmethod
    def wanted(self, physics: Physics, station: float) -> float:
        """Returns the offset of the path at a station [m], positive to the left."""

    def lane_error(self, physics: Physics) -> float:
        """Returns the offset of the steer axle from the path [m], left positive."""
        return self._errors(physics)[0]

    def trailer_error(self, physics: Physics) -> float:
        """Returns the offset of the trailer's axle group from the path [m], left positive."""
        return self._errors(physics)[1]

    def _errors(self, physics: Physics) -> tuple[float, float]:
        """Returns offsets of steer axle and trailer from the path, kept until the state changes."""
        ego = physics.ego()
        if ego is not self._ego:
            self._ego = ego
            lane = ego.offset - self.wanted(physics, ego.station)
            behind = self.wanted(physics, physics.trailer_station())
            self._offsets = lane, ego.trailer_offset - behind
        return self._offsets

    def heading_error(self, physics: Physics) -> float:
        """Returns the tractor's heading minus the path's [rad]."""
        station = physics.station()
        slope = self.wanted(physics, station + 0.5) - self.wanted(physics, station - 0.5)
        return physics.heading_error() - math.atan(slope)

    def reward_terms(self, physics: Physics) -> dict[str, float]:
        """Returns `lane`, `trailer`: on the path; `speed`; and small lateral acceleration."""
        room, (name, most) = self.lane_room, self.sideways
        ego, (lane, trailer) = physics.ego(), self._errors(physics)
        return {
            "lane": tolerance(lane, -room, room, 1.0),
            "trailer": tolerance(trailer, -0.4, 0.4, 1.5),
            "speed": tolerance(ego.speed, self.target - 1.0, self.target + 1.0, 8.0),
            name: tolerance(abs(ego.lateral_acceleration), 0.0, most, 2.0),
        }

    def get_termination(self, physics: Physics) -> float | None:
        """Ends the episode, with discount 0, off the path or after a roll-over."""
        lane, trailer = self._errors(physics)
        left = abs(lane) > self.off_path or abs(trailer) > self.trailer_off_path
        return 0.0 if left or abs(physics.roll()) > self.overturned else None


def _path_terms(
    lane_room: float, sideways: tuple[str, float], path: str, speed: str
) -> dict[str, str]:
    """Returns the meaning of the factors of `PathTask.reward_terms`."""
    name, most = sideways
    return {
        "lane": f"steer axle within {lane_room:g} m of the {path}; 0.1 at 1 m more",
        "trailer": "trailer's axles within 0.4 m of it; 0.1 at 1.5 m more",
        "speed": f"within 1 m/s of {speed}; 0.1 at 8 m/s more",
        name: f"lateral acceleration within {most:g} m/s2; 0.1 at 2 m/s2 more",
    }


class LaneKeep(PathTask):
    """Keep truck and trailer in the right lane of a winding road at 20 m/s.

    The lane is 0.73 m wider than the truck on each side; the episode ends 2 m off its middle.
    """

    time_limit = 60.0
    target = 20.0
    road = staticmethod(scene.winding)
    lane_room = 0.15
    sideways = ("comfort", 1.5)
    observed: ClassVar[dict[str, Observed]] = {
        **PathTask.observed,
        "curvature_ahead": Observed(
            0.002, "1/m", "here and 25, 50, 100 m ahead, left positive", "road", 4
        ),
    }
    terms: ClassVar[dict[str, str]] = _path_terms(lane_room, sideways, "path", "20 m/s")

    def wanted(self, physics: Physics, station: float) -> float:
        """Returns the offset of the right lane's middle [m]."""
        return float(physics.route.lane_offset(0, station))

    def initialize_episode(self, physics: Physics) -> None:
        """At a random place, within 0.3 m of the lane's middle, at 17 to 21 m/s."""
        station = self.random.uniform(30.0, 2_500.0)
        offset = self.wanted(physics, station) + self.random.uniform(-0.3, 0.3)
        physics.place(station, offset, self.random.uniform(17.0, 21.0))
        super().initialize_episode(physics)

    def curvature_ahead(self, physics: Physics) -> list[float]:
        """Returns the road's curvature here and 25, 50, 100 m ahead [1/m], four numbers."""
        return physics.curvature_ahead((0.0, 25.0, 50.0, 100.0))


class LaneChange(PathTask):
    """Change to the left lane within 75 m, and back 75 m later, at 60 km/h and laden.

    The track is a longer form of the track of ISO 3888-1, which is for cars at 80 km/h; the
    semitrailer reaches about 1.5 m/s2.
    """

    time_limit = 30.0
    target = 60.0 / 3.6
    road = staticmethod(scene.flat)
    lane_room = 0.2
    sideways = ("upright", 2.0)
    trailer_off_path = 2.5
    observed: ClassVar[dict[str, Observed]] = {
        **PathTask.observed,
        "roll": Observed(0.05, "rad", "of the tractor, right side down positive", "body `tractor`"),
        "lateral_acceleration": Observed(
            2.0, "m/s2", "of the steer axle, without gravity", "sensor `tractor_acceleration`"
        ),
        "path_ahead": Observed(
            4.0, "m", "offset of the path 10, 20, 35, 50, 75 m ahead, relative to here", "track", 5
        ),
    }
    terms: ClassVar[dict[str, str]] = _path_terms(lane_room, sideways, "track", "60 km/h")

    @classmethod
    def edit_spec(cls, spec: mujoco.MjSpec) -> None:
        """Adds cones along both sides of the three lanes of the track."""
        lanes = (
            (170.0, GATES[0], 0.0),
            (GATES[1], GATES[2], scene.LANE_WIDTH),
            (GATES[3], 560.0, 0.0),
        )
        for number, (start, end, middle) in enumerate(lanes):
            for station in np.arange(start, end + 1.0, 15.0):
                for side in (-1.0, 1.0):
                    name = f"cone{number}_{station:g}_{'left' if side > 0 else 'right'}"
                    scene.cone(spec, name, station, middle + side * _CONES)

    def wanted(self, physics: Physics, station: float) -> float:
        """Returns the offset of the track's middle [m], quintic between the lanes."""
        del physics
        return float(_BACK.evaluate(station)[0] - _OUT.evaluate(station)[0])

    def initialize_episode(self, physics: Physics) -> None:
        """10 to 60 m before the track leaves the lane, at 54 to 60 km/h, slightly off it."""
        station = GATES[0] - self.random.uniform(10.0, 60.0)
        physics.place(station, self.random.uniform(-0.2, 0.2), self.random.uniform(15.0, 16.7))
        super().initialize_episode(physics)

    def path_ahead(self, physics: Physics) -> list[float]:
        """Returns the offset of the path 10 to 75 m ahead, relative to here [m], five numbers."""
        station = physics.station()
        here = self.wanted(physics, station)
        return [self.wanted(physics, station + d) - here for d in PATH_PREVIEW]


class Platoon(LaneKeep):
    """Keep the right lane of a winding road, and the gap to the truck ahead or the set speed.

    It is not a task of the suite: `iits_mj.envs.platoon` places the trucks and sets the speeds.

    Args:
      ahead: physics of the truck ahead; None for the first truck.
      time_gap: to the truck ahead [s], in addition to 5 m.
      random: seed or `numpy.random.RandomState`.

    Attributes:
      target: speed to hold [m/s]: the set speed, or that of the truck ahead.
    """

    observed: ClassVar[dict[str, Observed]] = {
        **LaneKeep.observed,
        "speed_error": Observed(
            5.0, "m/s", "speed minus the set speed, or minus that of the truck ahead", "speeds"
        ),
        "gap_error": Observed(
            10.0, "m", "gap ahead minus the gap to keep; 0 for the first", "bodies `tractor`, road"
        ),
        "gap": Observed(30.0, "m", "to the rear of the truck ahead; 0 for the first", "the same"),
        "acceleration_ahead": Observed(
            2.0, "m/s2", "of the truck ahead; 0 for the first", "sensor `tractor_acceleration`"
        ),
    }
    terms: ClassVar[dict[str, str]] = {
        name: meaning for name, meaning in LaneKeep.terms.items() if name != "speed"
    } | {
        "spacing": "gap within 1 m of the gap to keep, 0.1 at 10 m more; for the first, speed "
        "within 1 m/s of the set speed, 0.1 at 8 m/s more",
    }

    def __init__(self, ahead: Physics | None, time_gap: float, random: Any = None) -> None:
        super().__init__(random=random)
        self._ahead = ahead
        self._time_gap = time_gap

    def wanted_gap(self, speed: float) -> float:
        """Returns the gap to keep to the truck ahead [m] at a speed [m/s]."""
        return STANDSTILL_GAP + self._time_gap * speed

    def gap(self, physics: Physics) -> float:
        """Returns the gap from the bumper to the truck ahead [m]; 0 for the first truck."""
        if self._ahead is None:
            return 0.0
        footprint = self._ahead.truck.footprint
        rear = self._ahead.station() + footprint.front_overhang - footprint.length
        return rear - physics.station() - physics.truck.footprint.front_overhang

    def gap_error(self, physics: Physics) -> float:
        """Returns the gap minus the gap to keep [m]; 0 for the first truck."""
        if self._ahead is None:
            return 0.0
        return self.gap(physics) - self.wanted_gap(physics.speed())

    def acceleration_ahead(self, physics: Physics) -> float:
        """Returns the acceleration of the truck ahead [m/s2]; 0 for the first truck."""
        del physics
        return 0.0 if self._ahead is None else self._ahead.acceleration()

    def values(self, physics: Physics) -> list[float]:
        """Returns the observations; the target becomes the speed of the truck ahead."""
        if self._ahead is not None:
            self.target = self._ahead.speed()
        return super().values(physics)

    def reward_terms(self, physics: Physics) -> dict[str, float]:
        """Returns `lane`, `trailer`, `comfort` of `LaneKeep`; `spacing` replaces `speed`."""
        found = super().reward_terms(physics)
        speed = found.pop("speed")
        if self._ahead is None:
            return {**found, "spacing": speed}
        return {**found, "spacing": tolerance(self.gap_error(physics), -1.0, 1.0, 10.0)}
