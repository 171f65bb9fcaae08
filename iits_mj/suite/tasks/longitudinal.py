"""Tasks that control pedal and brakes: cruise, stop, hill start."""

from __future__ import annotations

import math
from typing import ClassVar

import mujoco

from iits_mj.suite import scene
from iits_mj.suite.physics import INSTRUMENTS, WITHOUT_GEAR, Observed, Physics
from iits_mj.suite.tasks.base import LINEAR, DrivingTask, tolerance

_COMFORTABLE = "within 1.3 m/s2 along; 0.1 at 1.5 m/s2 more"
PREVIEW = (25.0, 50.0, 100.0, 200.0, 400.0)


class Cruise(DrivingTask):
    """Hold 20 m/s smoothly over hills.

    The mass of the truck filters the noise of an exploring agent out of its speed. So an action
    lasts longer than in the other tasks, and the brakes are as weak as a retarder: with 0.1 s and
    4 m/s2, noise of the action brakes, and PPO learns to use the full pedal against it.
    """

    time_limit = 60.0
    period = 0.5
    brake_max = 1.0
    target = 20.0
    road = staticmethod(scene.hills)
    observed: ClassVar[dict[str, Observed]] = {
        **INSTRUMENTS,
        "speed_error": Observed(5.0, "m/s", "speed minus 20 m/s", "speed"),
        "grade_ahead": Observed(
            0.05, "1", "rise over run here and 25, 50, 100, 200, 400 m ahead", "road", 6
        ),
    }
    terms: ClassVar[dict[str, str]] = {
        "speed": "within 0.5 m/s of 20 m/s; 0.5 at 2 m/s more, 0.1 at 18 m/s more",
        "comfort": _COMFORTABLE,
    }

    def initialize_episode(self, physics: Physics) -> None:
        """At a random place on the hills, at 15 to 22 m/s."""
        physics.place(self.random.uniform(30.0, 5_000.0), 0.0, self.random.uniform(15.0, 22.0))
        super().initialize_episode(physics)

    def grade_ahead(self, physics: Physics) -> list[float]:
        """Returns the grade here and 25 to 400 m ahead, six numbers."""
        return physics.grade_ahead((0.0, *PREVIEW))

    def reward_terms(self, physics: Physics) -> dict[str, float]:
        """Returns `speed`: near the target; `comfort`: gentle acceleration."""
        low, high = self.target - 0.5, self.target + 0.5
        speed = tolerance(physics.speed(), low, high, 18.0, sigmoid="reciprocal")
        return {"speed": speed, "comfort": _comfort(physics)}


class Stop(DrivingTask):
    """Stop with the front bumper at a line and stay there.

    The truck begins too far from the line for a gentle stop, and may drive at up to 20 m/s to it.
    """

    time_limit = 40.0
    period = 0.5
    brake_max = 2.0
    tags = ("easy",)
    road = staticmethod(scene.flat)
    observed: ClassVar[dict[str, Observed]] = {
        **INSTRUMENTS,
        "distance": Observed(200.0, "m", "front bumper to the line", "body `tractor`, road"),
        "speed_error": Observed(
            2.0, "m/s", "speed minus that of a stop at 1.2 m/s2 at the line", "speed, distance"
        ),
    }
    terms: ClassVar[dict[str, str]] = {
        "line": "not beyond the line; 0.1 at 2 m beyond",
        "speed": "within 0.3 m/s of a stop at 1.2 m/s2 at the line; 0.5 at 2 m/s more, 0.1 at "
        "18 m/s more",
        "comfort": _COMFORTABLE,
    }
    _line = "stop_line"
    line = 0.0  # of the episode [m]

    @classmethod
    def edit_spec(cls, spec: mujoco.MjSpec) -> None:
        """Adds the line on a mocap body that each episode moves."""
        scene.movable(spec, cls._line, size=(0.25, 4.0, 0.01))

    def initialize_episode(self, physics: Physics) -> None:
        """At 12 to 20 m/s, with the line at 1.3 to 2 times the distance of a gentle stop."""
        speed = self.random.uniform(12.0, 20.0)
        physics.place(50.0, 0.0, speed)
        front = 50.0 + physics.truck.footprint.front_overhang
        self.line = front + self.random.uniform(1.3, 2.0) * speed**2 / (2.0 * 1.2)
        scene.move(physics, self._line, self.line, 2.0)
        super().initialize_episode(physics)

    def distance(self, physics: Physics) -> float:
        """Returns the distance from the front bumper to the line [m], negative beyond it."""
        return self.line - physics.station() - physics.truck.footprint.front_overhang

    def speed_error(self, physics: Physics) -> float:
        """Returns the speed minus that of a stop at 1.2 m/s2, 0.5 m before the line [m/s]."""
        wanted = math.sqrt(2.0 * 1.2 * max(self.distance(physics) - 0.5, 0.0))
        return physics.speed() - min(wanted, 20.0)

    def reward_terms(self, physics: Physics) -> dict[str, float]:
        """Returns `line`: not beyond it; `speed`: of a stop at 1.2 m/s2; `comfort`."""
        error = self.speed_error(physics)
        return {
            "line": tolerance(self.distance(physics), 0.0, math.inf, 2.0),
            "speed": tolerance(error, -0.3, 0.3, 18.0, sigmoid="reciprocal"),
            "comfort": _comfort(physics),
        }


class HillStart(DrivingTask):
    """Start on a grade of 4 to 9 % without rolling back."""

    time_limit = 20.0
    tags = ("easy",)
    target = 4.0
    road = staticmethod(scene.uphill)
    farthest = 0.0  # station reached in the episode [m]
    observed: ClassVar[dict[str, Observed]] = {
        **WITHOUT_GEAR,
        "rolled_back": Observed(
            1.0, "m", "behind the farthest point reached", "body `tractor`, road"
        ),
        "grade": Observed(0.1, "1", "rise over run here", "road"),
    }
    terms: ClassVar[dict[str, str]] = {
        "speed": "4 m/s or more; linear from 0 at standstill",
        "hold": "rolled back by less than 5 cm; 0.1 at 0.5 m more",
    }

    def initialize_episode(self, physics: Physics) -> None:
        """At rest at a random place on the grade."""
        self.farthest = self.random.uniform(50.0, 1_750.0)
        physics.place(self.farthest, 0.0, 0.0)
        super().initialize_episode(physics)

    def after_step(self, physics: Physics) -> None:
        """Updates the farthest station reached, from which rolling back counts."""
        self.farthest = max(self.farthest, physics.station())
        super().after_step(physics)

    def rolled_back(self, physics: Physics) -> float:
        """Returns the distance behind the farthest point reached [m]."""
        return self.farthest - physics.station()

    def grade(self, physics: Physics) -> float:
        """Returns the grade here."""
        return physics.grade_ahead((0.0,))[0]

    def reward_terms(self, physics: Physics) -> dict[str, float]:
        """Returns `speed`: 4 m/s or more; `hold`: rolled back by less than 5 cm."""
        return {
            "speed": tolerance(physics.speed(), self.target, math.inf, self.target, **LINEAR),
            "hold": tolerance(self.rolled_back(physics), -math.inf, 0.05, 0.5),
        }


def _comfort(physics: Physics) -> float:
    """Returns 1 for longitudinal accelerations within 1.3 m/s2, falling beyond."""
    return tolerance(physics.acceleration(), -1.3, 1.3, 1.5)
