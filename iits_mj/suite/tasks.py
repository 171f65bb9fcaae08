"""The tasks of the domain `truck`. A reward is the product of named tolerances in [0, 1]."""

from __future__ import annotations

import abc
import collections
import math
from typing import Any, ClassVar

import numpy as np
from dm_control.suite import base
from dm_control.utils import rewards
from dm_env import specs
from numpy.typing import NDArray

from iits_mj.messages import VehicleCommand, XbrMode
from iits_mj.suite.physics import Physics

FloatArray = NDArray[np.float64]

# Full negative "drive" asks the brakes for this deceleration [m/s2].
BRAKE_MAX = 4.0
# Full "steer" turns the steering wheel by this angle [rad].
STEER_MAX = 0.5 * math.pi
PREVIEW = (25.0, 50.0, 100.0, 200.0, 400.0)


class DrivingTask(base.Task, abc.ABC):
    """What all tasks share.

    | action  | range   | meaning                                                          |
    |---------|---------|------------------------------------------------------------------|
    | `drive` | -1 .. 1 | above 0: accelerator pedal; below: XBR demand down to -4 m/s2      |
    | `steer` | -1 .. 1 | steering-wheel angle up to 90 degrees, left positive (where used) |

    Attributes:
      scales: size by which each observation is divided for a learner; same keys as observations.
    """

    actions: ClassVar[tuple[str, ...]] = ("drive",)
    scales: ClassVar[dict[str, float]] = {
        "speed": 25.0,
        "acceleration": 2.0,
        "gear": 12.0,
        "engine_speed": 220.0,
        "engine_torque": 2700.0,
        "brake_pressure": 8e5,
    }

    def action_spec(self, physics: Physics) -> specs.BoundedArray:
        """One number in [-1, 1] for each of `actions`."""
        del physics
        shape = (len(self.actions),)
        return specs.BoundedArray(shape, np.float64, -1.0, 1.0, name="\t".join(self.actions))

    def before_step(self, action: Any, physics: Physics) -> None:
        """Turns the action into the truck's command; values outside [-1, 1] are clipped."""
        values = np.clip(np.asarray(action, dtype=float).ravel(), -1.0, 1.0)
        named = dict(zip(self.actions, values.tolist(), strict=True))
        drive = named["drive"]
        physics.command(
            VehicleCommand(
                accelerator_pedal=max(drive, 0.0),
                xbr_demand=BRAKE_MAX * min(drive, 0.0),
                xbr_mode=XbrMode.MAXIMUM if drive < 0.0 else XbrMode.OFF,
                steering_wheel_angle=STEER_MAX * named.get("steer", 0.0),
            )
        )

    def after_step(self, physics: Physics) -> None:
        """Nothing to do: the truck's paint does not show the reward."""

    def get_observation(self, physics: Physics) -> collections.OrderedDict[str, FloatArray]:
        """What the truck's own instruments show, SI units, each of shape (1,)."""
        return collections.OrderedDict(
            speed=np.array([physics.speed()]),
            acceleration=np.array([physics.acceleration()]),
            gear=np.array([float(physics.gear())]),
            engine_speed=np.array([physics.engine_speed()]),
            engine_torque=np.array([physics.engine_torque()]),
            brake_pressure=np.array([physics.brake_pressure()]),
        )

    @abc.abstractmethod
    def reward_terms(self, physics: Physics) -> dict[str, float]:
        """Named factors of the reward, each in [0, 1]."""

    def get_reward(self, physics: Physics) -> float:
        """Product of the terms."""
        return float(np.prod(list(self.reward_terms(physics).values())))


class Cruise(DrivingTask):
    """Hold 20 m/s over hills, smoothly."""

    target = 20.0
    scales: ClassVar[dict[str, float]] = {
        **DrivingTask.scales,
        "speed_error": 5.0,
        "grade_ahead": 0.05,
    }

    def initialize_episode(self, physics: Physics) -> None:
        """Somewhere on the hills, at 15 to 22 m/s."""
        physics.place(self.random.uniform(30.0, 5_000.0), 0.0, self.random.uniform(15.0, 22.0))
        super().initialize_episode(physics)

    def get_observation(self, physics: Physics) -> collections.OrderedDict[str, FloatArray]:
        """Instruments, speed error [m/s], and the grade now and 25 to 400 m ahead."""
        found = super().get_observation(physics)
        found["speed_error"] = np.array([physics.speed() - self.target])
        found["grade_ahead"] = physics.grade_ahead((0.0, *PREVIEW))
        return found

    def reward_terms(self, physics: Physics) -> dict[str, float]:
        """`speed`: within 0.5 m/s of the target; `comfort`: gentle acceleration."""
        near = (self.target - 0.5, self.target + 0.5)
        return {
            "speed": float(rewards.tolerance(physics.speed(), near, margin=5.0)),
            "comfort": _comfort(physics),
        }


class Stop(DrivingTask):
    """Stop the front bumper at a line, and stay there."""

    scales: ClassVar[dict[str, float]] = {**DrivingTask.scales, "distance": 200.0}

    def initialize_episode(self, physics: Physics) -> None:
        """At 12 to 20 m/s, with the line at 1.3 to 2 times the distance a gentle stop takes."""
        speed = self.random.uniform(12.0, 20.0)
        physics.place(50.0, 0.0, speed)
        front = 50.0 + physics.truck.footprint.front_overhang
        self.line = front + self.random.uniform(1.3, 2.0) * speed**2 / (2.0 * 1.2)
        super().initialize_episode(physics)

    def distance(self, physics: Physics) -> float:
        """From the front bumper to the line [m], negative beyond it."""
        return self.line - physics.station() - physics.truck.footprint.front_overhang

    def get_observation(self, physics: Physics) -> collections.OrderedDict[str, FloatArray]:
        """Instruments and distance to the line [m]."""
        found = super().get_observation(physics)
        found["distance"] = np.array([self.distance(physics)])
        return found

    def reward_terms(self, physics: Physics) -> dict[str, float]:
        """`line`: not beyond it; `speed`: that of a stop at 1.2 m/s2 there; `comfort`."""
        distance = self.distance(physics)
        wanted = math.sqrt(2.0 * 1.2 * max(distance - 0.5, 0.0))
        error = physics.speed() - min(wanted, 20.0)
        return {
            "line": float(rewards.tolerance(distance, (0.0, math.inf), margin=2.0)),
            "speed": float(rewards.tolerance(error, (-0.3, 0.3), margin=4.0)),
            "comfort": _comfort(physics),
        }


class HillStart(DrivingTask):
    """Start on a grade without rolling back, and get going."""

    target = 4.0
    scales: ClassVar[dict[str, float]] = {**DrivingTask.scales, "rolled_back": 1.0, "grade": 0.1}

    def initialize_episode(self, physics: Physics) -> None:
        """At rest on the grade, somewhere."""
        self.start = self.random.uniform(50.0, 500.0)
        physics.place(self.start, 0.0, 0.0)
        self.farthest = self.start
        super().initialize_episode(physics)

    def after_step(self, physics: Physics) -> None:
        """Keeps the farthest station reached, from which rolling back counts."""
        self.farthest = max(self.farthest, physics.station())

    def rolled_back(self, physics: Physics) -> float:
        """How far the truck lies behind the farthest point it had reached [m]."""
        return self.farthest - physics.station()

    def get_observation(self, physics: Physics) -> collections.OrderedDict[str, FloatArray]:
        """Instruments, distance rolled back [m] and the grade."""
        found = super().get_observation(physics)
        found["rolled_back"] = np.array([self.rolled_back(physics)])
        found["grade"] = physics.grade_ahead((0.0,))
        return found

    def reward_terms(self, physics: Physics) -> dict[str, float]:
        """`speed`: 4 m/s or more; `hold`: rolled back by less than 5 cm."""
        reached = (self.target, math.inf)
        fast = rewards.tolerance(
            physics.speed(), reached, margin=self.target, value_at_margin=0.0, sigmoid="linear"
        )
        back = self.rolled_back(physics)
        hold = rewards.tolerance(back, (-math.inf, 0.05), margin=0.5)
        return {"speed": float(fast), "hold": float(hold)}


class LaneKeep(DrivingTask):
    """Keep truck and trailer in the right lane of a winding road at 20 m/s."""

    target = 20.0
    # Half the lane less half the truck leaves 0.73 m; beyond 2 m the truck is off its lane.
    off_lane = 2.0
    actions: ClassVar[tuple[str, ...]] = ("drive", "steer")
    scales: ClassVar[dict[str, float]] = {
        **DrivingTask.scales,
        "speed_error": 5.0,
        "lane_error": 1.0,
        "heading_error": 0.1,
        "trailer_error": 1.0,
        "articulation": 0.1,
        "yaw_rate": 0.1,
        "steering_wheel_angle": 1.0,
        "curvature_ahead": 0.002,
    }

    def initialize_episode(self, physics: Physics) -> None:
        """Somewhere on the road, within 0.3 m of the lane's middle, at 17 to 21 m/s."""
        station = self.random.uniform(30.0, 2_500.0)
        middle = float(physics.route.lane_offset(0, station))
        offset = middle + self.random.uniform(-0.3, 0.3)
        physics.place(station, offset, self.random.uniform(17.0, 21.0))
        super().initialize_episode(physics)

    def get_observation(self, physics: Physics) -> collections.OrderedDict[str, FloatArray]:
        """Instruments, position in the lane, trailer, steering, curvature now and ahead."""
        found = super().get_observation(physics)
        found["speed_error"] = np.array([physics.speed() - self.target])
        found["lane_error"] = np.array([physics.lane_error()])
        found["heading_error"] = np.array([physics.heading_error()])
        found["trailer_error"] = np.array([physics.trailer_error()])
        found["articulation"] = np.array([physics.articulation()])
        found["yaw_rate"] = np.array([physics.yaw_rate()])
        found["steering_wheel_angle"] = np.array([physics.steering_wheel_angle()])
        found["curvature_ahead"] = physics.curvature_ahead((0.0, *PREVIEW[:3]))
        return found

    def reward_terms(self, physics: Physics) -> dict[str, float]:
        """`lane` and `trailer`: in the middle; `speed`: near 20 m/s; `comfort`: lateral."""
        near = (self.target - 1.0, self.target + 1.0)
        sideways = abs(physics.lateral_acceleration())
        return {
            "lane": float(rewards.tolerance(physics.lane_error(), (-0.15, 0.15), margin=1.0)),
            "trailer": float(rewards.tolerance(physics.trailer_error(), (-0.4, 0.4), margin=1.5)),
            "speed": float(rewards.tolerance(physics.speed(), near, margin=8.0)),
            "comfort": float(rewards.tolerance(sideways, (0.0, 1.5), margin=2.0)),
        }

    def get_termination(self, physics: Physics) -> float | None:
        """Ends the episode, with discount 0, when the truck or its trailer has left the lane."""
        worst = max(abs(physics.lane_error()), abs(physics.trailer_error()))
        return 0.0 if worst > self.off_lane else None


def _comfort(physics: Physics) -> float:
    """1 within 1.3 m/s2 of longitudinal acceleration, falling beyond."""
    return float(rewards.tolerance(physics.acceleration(), (-1.3, 1.3), margin=1.5))
