"""Double lane change of the laden truck, in the manner of ISO 3888."""

from __future__ import annotations

from typing import ClassVar

import mujoco
import numpy as np
from dm_control.utils import rewards

from controllers.planning.trajectory import Quintic
from iits_mj.suite import scene
from iits_mj.suite.physics import Observed, Physics
from iits_mj.suite.scene import LANE_WIDTH
from iits_mj.suite.tasks.base import Observations, PathTask

PREVIEW = (10.0, 20.0, 35.0, 50.0, 75.0)
# Stations where the truck is to leave its lane, be in the other, leave that, and be back [m].
GATES = (250.0, 325.0, 400.0, 475.0)
_CONES = 0.5 * LANE_WIDTH - 0.2
_OUT = Quintic.to_zero(GATES[0], GATES[1] - GATES[0], LANE_WIDTH)
_BACK = Quintic.to_zero(GATES[2], GATES[3] - GATES[2], LANE_WIDTH)


class LaneChange(PathTask):
    """To the left lane within 75 m, 75 m there, and back within 75 m, at 60 km/h and laden.

    ISO 3888-1 has this track for cars: its lengths are those of a car at 80 km/h, ours leave the
    semitrailer about 1.5 m/s2.
    """

    target = 60.0 / 3.6
    trailer_off_path = 2.5
    observed: ClassVar[dict[str, Observed]] = {
        **PathTask.observed,
        "roll": Observed(0.05, "rad", "of the tractor, right side down positive", "body `tractor`"),
        "lateral_acceleration": Observed(
            2.0, "m/s2", "of the steer axle, without gravity", "sensor `tractor_acceleration`"
        ),
        "path_ahead": Observed(
            4.0, "m", "offset of the path 10, 20, 35, 50, 75 m ahead, less here", "track", 5
        ),
    }
    terms: ClassVar[dict[str, str]] = {
        "lane": "steer axle within 0.2 m of the track; 0.1 at 1 m more",
        "trailer": "trailer's axles within 0.4 m of it; 0.1 at 1.5 m more",
        "speed": "within 1 m/s of 60 km/h; 0.1 at 8 m/s more",
        "upright": "lateral acceleration within 2 m/s2; 0.1 at 2 m/s2 more",
    }

    @classmethod
    def edit_spec(cls, spec: mujoco.MjSpec) -> None:
        """Cones along both sides of the three lanes of the track."""
        lanes = ((170.0, GATES[0], 0.0), (GATES[1], GATES[2], LANE_WIDTH), (GATES[3], 560.0, 0.0))
        for number, (start, end, middle) in enumerate(lanes):
            for station in np.arange(start, end + 1.0, 15.0):
                for side in (-1.0, 1.0):
                    name = f"cone{number}_{station:g}_{'left' if side > 0 else 'right'}"
                    scene.cone(spec, name, station, middle + side * _CONES)

    def wanted(self, physics: Physics, station: float) -> float:
        """The track's middle, quintic between its lanes."""
        del physics
        return float(_BACK.evaluate(station)[0] - _OUT.evaluate(station)[0])

    def initialize_episode(self, physics: Physics) -> None:
        """10 to 60 m before the track leaves the lane, at 54 to 60 km/h, a little off."""
        station = GATES[0] - self.random.uniform(10.0, 60.0)
        physics.place(station, self.random.uniform(-0.2, 0.2), self.random.uniform(15.0, 16.7))
        super().initialize_episode(physics)

    def get_observation(self, physics: Physics) -> Observations:
        """What every path has, roll, lateral acceleration, and where the path goes."""
        found = super().get_observation(physics)
        found["roll"] = np.array([physics.roll()])
        found["lateral_acceleration"] = np.array([physics.lateral_acceleration()])
        station = physics.station()
        here = self.wanted(physics, station)
        found["path_ahead"] = np.array([self.wanted(physics, station + d) - here for d in PREVIEW])
        return found

    def reward_terms(self, physics: Physics) -> dict[str, float]:
        """`lane`, `trailer`: on the track; `speed`: near 60 km/h; `upright`: lateral comfort."""
        sideways = abs(physics.lateral_acceleration())
        return {
            **self.path_terms(physics, 0.2),
            "upright": float(rewards.tolerance(sideways, (0.0, 2.0), margin=2.0)),
        }
