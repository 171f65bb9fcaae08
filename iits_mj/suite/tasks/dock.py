"""Reverse the semitrailer into a loading bay."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import ClassVar

import mujoco
import numpy as np
from dm_control.utils import rewards

from iits_mj.core.messages import TransmissionMode
from iits_mj.suite import scene
from iits_mj.suite.physics import BENDING, WITHOUT_GEAR, Observed, Physics, wide
from iits_mj.suite.tasks.base import DrivingTask, Observations

# The dock's face: the trailer's rear is to stop there, on the yard's reference line [m].
BAY_STATION = 60.0
_BAY_WIDTH, _BAY_LENGTH = 3.6, 18.0


class Dock(DrivingTask):
    """Back the trailer's rear against the dock, straight and gently; the gearbox is in reverse.

    `drive` above 0 is the pedal and moves the truck backward.
    """

    steer_max: ClassVar[float] = 5.0 * math.pi
    gear_mode: ClassVar[TransmissionMode] = TransmissionMode.REVERSE
    actions: ClassVar[tuple[str, ...]] = ("drive", "steer")
    # Beyond these the episode has failed: into the dock [m], articulation [rad].
    rammed: ClassVar[float] = -0.3
    jackknifed: ClassVar[float] = 1.3
    observed: ClassVar[dict[str, Observed]] = {
        **WITHOUT_GEAR,
        "speed": replace(WITHOUT_GEAR["speed"], scale=2.0),
        "distance": Observed(20.0, "m", "trailer's rear to the dock", "body `trailer`"),
        "aside": Observed(
            2.0, "m", "trailer's rear left of the bay's middle, seen forward", "body `trailer`"
        ),
        "trailer_heading": Observed(0.3, "rad", "trailer's yaw against the bay", "body `trailer`"),
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
        """Dock wall, bumpers and the bay's lines."""
        half = 0.5 * _BAY_WIDTH
        scene.mark(spec, "dock_wall", (BAY_STATION - 0.8, 0.0, 0.6), (0.5, 6.0, 0.6))
        middle = BAY_STATION + 0.5 * _BAY_LENGTH
        for side, sign in (("left", 1.0), ("right", -1.0)):
            bumper = (BAY_STATION - 0.15, 0.9 * sign, 1.0)
            scene.mark(spec, f"dock_bumper_{side}", bumper, (0.15, 0.2, 0.25))
            line = (0.5 * _BAY_LENGTH, 0.08, 0.01)
            scene.mark(spec, f"dock_line_{side}", (middle, half * sign, 0.01), line)

    def initialize_episode(self, physics: Physics) -> None:
        """Rear 15 to 25 m before the dock, up to 1 m aside, a little askew, at rest."""
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
        """Trailer's rear: distance to the dock, left of the bay's middle [m], heading [rad]."""
        x, y, yaw = physics.trailer_rear()
        return x - BAY_STATION, y, yaw

    def get_observation(self, physics: Physics) -> Observations:
        """Speed (negative backward), engine, brakes, the trailer's rear, the bend, steering."""
        distance, aside, heading = self.rear(physics)
        found = super().get_observation(physics)
        found["distance"] = np.array([distance])
        found["aside"] = np.array([aside])
        found["trailer_heading"] = np.array([heading])
        found["articulation"] = np.array([physics.articulation()])
        found["yaw_rate"] = np.array([physics.yaw_rate()])
        found["steering_wheel_angle"] = np.array([physics.steering_wheel_angle()])
        return found

    def reward_terms(self, physics: Physics) -> dict[str, float]:
        """`near`: the dock; `aligned`, `straight`: in the bay; `gentle`: slow, most so at last."""
        distance, aside, heading = self.rear(physics)
        allowed = 0.15 + min(0.08 * max(distance, 0.0), 1.2)
        near = rewards.tolerance(distance, (-0.1, 0.25), margin=20.0, sigmoid="linear")
        return {
            "near": float(near),
            "aligned": float(rewards.tolerance(aside, (-0.1, 0.1), margin=1.5)),
            "straight": float(rewards.tolerance(heading, (-0.02, 0.02), margin=0.3)),
            "gentle": float(rewards.tolerance(physics.speed(), (-allowed, 0.1), margin=0.7)),
        }

    def get_termination(self, physics: Physics) -> float | None:
        """Ends the episode, with discount 0, when the dock is rammed or the truck jackknifed."""
        distance = self.rear(physics)[0]
        bent = abs(physics.articulation()) > self.jackknifed
        return 0.0 if distance < self.rammed or bent else None
