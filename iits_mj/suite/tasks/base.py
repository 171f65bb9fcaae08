"""What the tasks share: actions, instruments, and the way a path is told."""

from __future__ import annotations

import abc
import collections
import math
from typing import Any, ClassVar

import mujoco
import numpy as np
from dm_control.suite import base
from dm_control.utils import rewards
from dm_env import specs

from iits_mj.core.arrays import FloatArray
from iits_mj.core.checks import read_action
from iits_mj.core.messages import TransmissionMode, VehicleCommand, XbrMode
from iits_mj.suite.physics import BENDING, INSTRUMENTS, WITHOUT_GEAR, Observed, Physics

Observations = collections.OrderedDict[str, FloatArray]

# Full negative "drive" asks the brakes for this deceleration [m/s2].
BRAKE_MAX = 4.0


class DrivingTask(base.Task, abc.ABC):
    """What all tasks share.

    | action  | range   | meaning                                                          |
    |---------|---------|------------------------------------------------------------------|
    | `drive` | -1 .. 1 | above 0: accelerator pedal; below: XBR demand down to -4 m/s2      |
    | `steer` | -1 .. 1 | steering-wheel angle up to `steer_max`, left positive (where used) |

    Attributes:
      observed: what is seen, by name; of the instruments those that are named here.
      terms: what the factors of the reward mean.
      steer_max: steering-wheel angle of a full `steer` [rad].
      gear_mode: of the transmission.
    """

    actions: ClassVar[tuple[str, ...]] = ("drive",)
    steer_max: ClassVar[float] = 0.5 * math.pi
    gear_mode: ClassVar[TransmissionMode] = TransmissionMode.DRIVE
    observed: ClassVar[dict[str, Observed]]
    terms: ClassVar[dict[str, str]]

    @property
    def scales(self) -> dict[str, float]:
        """Size by which each observation is divided for a learner."""
        return {name: told.scale for name, told in self.observed.items()}

    @classmethod
    def edit_spec(cls, spec: mujoco.MjSpec) -> None:
        """Adds what of the task is to be seen; it touches nothing."""

    def action_spec(self, physics: Physics) -> specs.BoundedArray:
        """One number in [-1, 1] for each of `actions`."""
        del physics
        full = np.ones(len(self.actions))
        names = "\t".join(self.actions)
        return specs.BoundedArray(full.shape, np.float64, -full, full, name=names)

    def before_step(self, action: Any, physics: Physics) -> None:
        """Turns the action into the truck's command; values outside [-1, 1] are clipped.

        Raises:
          InputError: not one finite number for each of `actions`.
        """
        values = np.clip(read_action(action, (len(self.actions),)), -1.0, 1.0)
        named = dict(zip(self.actions, values.tolist(), strict=True))
        drive = named["drive"]
        physics.command(
            VehicleCommand(
                accelerator_pedal=max(drive, 0.0),
                xbr_demand=BRAKE_MAX * min(drive, 0.0),
                xbr_mode=XbrMode.MAXIMUM if drive < 0.0 else XbrMode.OFF,
                steering_wheel_angle=self.steer_max * named.get("steer", 0.0),
                transmission_mode=self.gear_mode,
            )
        )

    def get_observation(self, physics: Physics) -> Observations:
        """What the truck's own instruments show, SI units, each of shape (1,)."""
        return collections.OrderedDict(
            (name, np.array([float(getattr(physics, name)())]))
            for name in INSTRUMENTS
            if name in self.observed
        )

    @abc.abstractmethod
    def reward_terms(self, physics: Physics) -> dict[str, float]:
        """Named factors of the reward, each in [0, 1]."""

    def get_reward(self, physics: Physics) -> float:
        """Product of the terms."""
        return float(np.prod(list(self.reward_terms(physics).values())))


class PathTask(DrivingTask):
    """A task that steers along a path beside the road's reference line.

    Attributes:
      target: speed to hold [m/s].
      off_path, trailer_off_path: distance from the path at which the episode ends [m].
      overturned: roll of the tractor at which it ends, too [rad].
    """

    target: float
    off_path: ClassVar[float] = 2.0
    trailer_off_path: ClassVar[float] = 2.0
    overturned: ClassVar[float] = 0.3
    actions: ClassVar[tuple[str, ...]] = ("drive", "steer")
    observed: ClassVar[dict[str, Observed]] = {
        **WITHOUT_GEAR,
        "speed_error": Observed(5.0, "m/s", "speed less the one to hold", "speed"),
        "lane_error": Observed(1.0, "m", "steer axle left of the path", "body `tractor`, road"),
        "heading_error": Observed(
            0.1, "rad", "tractor's heading less the path's", "body `tractor`, road"
        ),
        "trailer_error": Observed(
            1.0, "m", "trailer's axle group left of the path", "site `trailer_axle_center`, road"
        ),
        **BENDING,
    }

    @abc.abstractmethod
    def wanted(self, physics: Physics, station: float) -> float:
        """Offset of the path at a station [m], positive to the left."""

    def lane_error(self, physics: Physics) -> float:
        """Steer axle left of the path [m]."""
        ego = physics.ego()
        return ego.offset - self.wanted(physics, ego.station)

    def trailer_error(self, physics: Physics) -> float:
        """Middle of the trailer's axle group left of the path where that is [m]."""
        ego = physics.ego()
        return ego.trailer_offset - self.wanted(physics, physics.trailer_station())

    def heading_error(self, physics: Physics) -> float:
        """Tractor's heading less the path's [rad]."""
        station = physics.station()
        slope = self.wanted(physics, station + 0.5) - self.wanted(physics, station - 0.5)
        return physics.heading_error() - math.atan(slope)

    def get_observation(self, physics: Physics) -> Observations:
        """Instruments, speed error, place on the path, trailer and steering."""
        found = super().get_observation(physics)
        found["speed_error"] = np.array([physics.speed() - self.target])
        found["lane_error"] = np.array([self.lane_error(physics)])
        found["heading_error"] = np.array([self.heading_error(physics)])
        found["trailer_error"] = np.array([self.trailer_error(physics)])
        found["articulation"] = np.array([physics.articulation()])
        found["yaw_rate"] = np.array([physics.yaw_rate()])
        found["steering_wheel_angle"] = np.array([physics.steering_wheel_angle()])
        return found

    def path_terms(self, physics: Physics, lane_room: float) -> dict[str, float]:
        """`lane`: steer axle within `lane_room` [m] of the path; `trailer`: its axles; `speed`."""
        near = (self.target - 1.0, self.target + 1.0)
        room = (-lane_room, lane_room)
        return {
            "lane": float(rewards.tolerance(self.lane_error(physics), room, margin=1.0)),
            "trailer": float(
                rewards.tolerance(self.trailer_error(physics), (-0.4, 0.4), margin=1.5)
            ),
            "speed": float(rewards.tolerance(physics.speed(), near, margin=8.0)),
        }

    def get_termination(self, physics: Physics) -> float | None:
        """Ends the episode, with discount 0, off the path or rolled over."""
        left = abs(self.lane_error(physics)) > self.off_path
        trailer_left = abs(self.trailer_error(physics)) > self.trailer_off_path
        return 0.0 if left or trailer_left or abs(physics.roll()) > self.overturned else None


def comfort(physics: Physics) -> float:
    """1 within 1.3 m/s2 of longitudinal acceleration, falling beyond."""
    return float(rewards.tolerance(physics.acceleration(), (-1.3, 1.3), margin=1.5))
