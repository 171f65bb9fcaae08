"""Maneuvers at walking pace: a tight turn, and docking in reverse."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import ClassVar

import mujoco
import numpy as np

from iits_mj.core.messages import TransmissionMode
from iits_mj.suite import scene
from iits_mj.suite.physics import BENDING, WITHOUT_GEAR, Observed, Physics, wide
from iits_mj.suite.tasks.base import LINEAR, DrivingTask, tolerance

# The dock's face on the yard's reference line, where the trailer's rear stops [m].
BAY_STATION = 60.0
_BAY_WIDTH, _BAY_LENGTH = 3.6, 18.0


class TightTurn(DrivingTask):
    """Drive a left turn on a road as wide as the swept path that truck regulations allow.

    The outer steer tire may follow an arc of 12.5 m; the Australian PBS (level 1) then allows a
    frontal swing of 0.7 m and a swept path of 7.4 m, which are the road's edges here. Unless the
    tractor goes wide, the semitrailer cuts the corner and leaves the road.
    """

    time_limit = 30.0
    tags = ("hard",)
    target = 2.5
    road = staticmethod(scene.turn)
    steer_max: ClassVar[float] = 5.0 * math.pi
    actions: ClassVar[tuple[str, ...]] = ("drive", "steer")
    # Offsets of the road's edges from its reference line, the path of the steer axle's middle.
    right_edge: ClassVar[float] = -1.95
    left_edge: ClassVar[float] = 5.45
    off_road: ClassVar[float] = -1.0
    observed: ClassVar[dict[str, Observed]] = {
        **WITHOUT_GEAR,
        "offset": Observed(1.0, "m", "steer axle left of the line", "body `tractor`, road"),
        "heading_error": Observed(
            0.5, "rad", "tractor's heading minus the line's", "body `tractor`, road"
        ),
        "trailer_offset": Observed(
            2.0, "m", "trailer's axles left of the line", "site `trailer_axle_center`, road"
        ),
        **wide(BENDING),
        "clearance": Observed(
            1.0, "m", "least distance of the outline from an edge", "bodies, road"
        ),
        "past_entry": Observed(
            10.0, "m", "distance since the start of the turn", "body `tractor`, road"
        ),
    }
    terms: ClassVar[dict[str, str]] = {
        "clear": "0.1 m or more from both edges; 0.1 at 0.6 m less",
        "speed": "2 to 3 m/s; linear to 0 at 2 m/s more or less",
        "along": "heading within 0.6 rad of the line's; 0.1 at 0.8 rad more",
    }

    def initialize_episode(self, physics: Physics) -> None:
        """8 to 18 m before the turn, at 2 to 3 m/s, slightly off the line."""
        station = scene.TURN_ENTRY - self.random.uniform(8.0, 18.0)
        physics.place(station, self.random.uniform(-0.15, 0.15), self.random.uniform(2.0, 3.0))
        super().initialize_episode(physics)

    def clearance(self, physics: Physics) -> float:
        """Returns the least distance of the outline from the road's edges [m], negative beyond."""
        offsets = physics.outline_offsets()
        return float(min(np.min(offsets) - self.right_edge, self.left_edge - np.max(offsets)))

    def past_entry(self, physics: Physics) -> float:
        """Returns the distance since the start of the turn [m], negative before it."""
        return physics.station() - scene.TURN_ENTRY

    def reward_terms(self, physics: Physics) -> dict[str, float]:
        """Returns `clear`: 0.1 m from the edges; `speed`: 2 to 3 m/s; `along`: the heading."""
        low, high = self.target - 0.5, self.target + 0.5
        return {
            "clear": tolerance(self.clearance(physics), 0.1, math.inf, 0.6),
            "speed": tolerance(physics.speed(), low, high, 2.0, **LINEAR),
            "along": tolerance(physics.heading_error(), -0.6, 0.6, 0.8),
        }

    def get_termination(self, physics: Physics) -> float | None:
        """Ends the episode, with discount 0, when the truck is 1 m off the road."""
        return 0.0 if self.clearance(physics) < self.off_road else None


class Dock(DrivingTask):
    """Back the trailer's rear against the dock, straight and gently; the gearbox is in reverse.

    `drive` above 0 is the pedal and moves the truck backward.
    """

    time_limit = 60.0
    period = 0.5
    brake_max = 1.0
    tags = ("hard",)
    road = staticmethod(scene.yard)
    steer_max: ClassVar[float] = 5.0 * math.pi
    gear_mode: ClassVar[TransmissionMode] = TransmissionMode.REVERSE
    actions: ClassVar[tuple[str, ...]] = ("drive", "steer")
    # The episode fails beyond these: into the dock [m], articulation [rad].
    rammed: ClassVar[float] = -0.3
    jackknifed: ClassVar[float] = 1.3
    observed: ClassVar[dict[str, Observed]] = {
        **WITHOUT_GEAR,
        "speed": replace(WITHOUT_GEAR["speed"], scale=2.0),
        "distance": Observed(20.0, "m", "trailer's rear to the dock", "body `trailer`"),
        "aside": Observed(
            2.0, "m", "trailer's rear left of the bay's middle, seen forward", "body `trailer`"
        ),
        "trailer_heading": Observed(
            0.3, "rad", "trailer's yaw relative to the bay", "body `trailer`"
        ),
        **wide(BENDING),
    }
    terms: ClassVar[dict[str, str]] = {
        "near": "rear within 0.25 m of the dock; linear to 0.1 at 20 m more",
        "aligned": "rear within 0.1 m of the bay's middle; 0.1 at 1.5 m more",
        "straight": "trailer within 0.02 rad of the bay; 0.1 at 0.3 rad more",
        "gentle": "backward no faster than 0.15 m/s, and 0.08 m/s more per meter to go",
    }

    @classmethod
    def edit_spec(cls, spec: mujoco.MjSpec) -> None:
        """Adds dock wall, bumpers and the bay's lines."""
        half = 0.5 * _BAY_WIDTH
        scene.mark(spec, "dock_wall", (BAY_STATION - 0.8, 0.0, 0.6), (0.5, 6.0, 0.6))
        middle = BAY_STATION + 0.5 * _BAY_LENGTH
        for side, sign in (("left", 1.0), ("right", -1.0)):
            bumper = (BAY_STATION - 0.15, 0.9 * sign, 1.0)
            scene.mark(spec, f"dock_bumper_{side}", bumper, (0.15, 0.2, 0.25))
            line = (0.5 * _BAY_LENGTH, 0.08, 0.01)
            scene.mark(spec, f"dock_line_{side}", (middle, half * sign, 0.01), line)

    def initialize_episode(self, physics: Physics) -> None:
        """Rear 15 to 25 m before the dock, up to 1 m to the side, slightly askew, at rest."""
        truck = physics.truck
        rear = truck.footprint.length - truck.footprint.front_overhang
        physics.place(
            BAY_STATION + rear + self.random.uniform(15.0, 25.0),
            self.random.uniform(-1.0, 1.0),
            0.0,
            heading=self.random.uniform(-0.08, 0.08),
            articulation=self.random.uniform(-0.08, 0.08),
        )
        super().initialize_episode(physics)

    def rear(self, physics: Physics) -> tuple[float, float, float]:
        """Returns distance of the trailer's rear to the dock, offset [m] and heading [rad]."""
        x, y, yaw = physics.trailer_rear()
        return x - BAY_STATION, y, yaw

    def distance(self, physics: Physics) -> float:
        """Returns the distance of the trailer's rear to the dock [m], negative inside it."""
        return self.rear(physics)[0]

    def aside(self, physics: Physics) -> float:
        """Returns the offset of the trailer's rear from the bay's middle [m], left positive."""
        return self.rear(physics)[1]

    def trailer_heading(self, physics: Physics) -> float:
        """Returns the trailer's yaw relative to the bay [rad]."""
        return self.rear(physics)[2]

    def reward_terms(self, physics: Physics) -> dict[str, float]:
        """Returns `near` the dock; `aligned`, `straight` in the bay; `gentle`: ever slower."""
        distance, aside, heading = self.rear(physics)
        allowed = 0.15 + min(0.08 * max(distance, 0.0), 1.2)
        return {
            "near": tolerance(distance, -0.1, 0.25, 20.0, sigmoid="linear"),
            "aligned": tolerance(aside, -0.1, 0.1, 1.5),
            "straight": tolerance(heading, -0.02, 0.02, 0.3),
            "gentle": tolerance(physics.speed(), -allowed, 0.1, 0.7),
        }

    def get_termination(self, physics: Physics) -> float | None:
        """Ends the episode, with discount 0, when the truck rams the dock or jackknifes."""
        bent = abs(physics.articulation()) > self.jackknifed
        return 0.0 if self.distance(physics) < self.rammed or bent else None
