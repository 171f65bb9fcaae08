"""Lane keeping of the stack, with UN R157, 5.2.1, and the drift of UN R130.

R157: no outer edge of a front tire crosses the outer edge of a lane marking; here neither side of
tractor or trailer leaves the lane, which is stricter. R130 is of warnings that a driver who drifts
out of the lane with 0.1 to 0.8 m/s gets at the latest when the tire is 0.3 m outside the marking.
No driver steers a truck of the stack, so nobody is to be warned. What remains is a sleeping driver
from whom the stack takes over: at the line, at 65 km/h, and before those 0.3 m the truck must turn.
"""

from __future__ import annotations

import dataclasses
import functools
import itertools

from controllers.planning.planner import Planner
from iits_mj.core.angles import wrap_angles
from iits_mj.core.messages import Decision, EgoFootprint, Scene, SpeedProfile, Trajectory
from iits_mj.core.progress import each
from iits_mj.core.results import Findings
from iits_mj.road import RoadMap
from iits_mj.simulation import DriveConfig
from iits_mj.validation.aeb.drives import LANE_WIDTH, at, drive, scenario, straight

# UN R130: rates of departure [m/s], speed of the test [km/h], and distance of the last warning
# outside the marking [m].
RATES, TEST_SPEED, OUTSIDE = (0.1, 0.3, 0.5, 0.8), 65.0, 0.3
# Bends: of the built-in highway from a station [m] on, at a speed [km/h], for a time [s].
_BENDS, _BENDS_SPEED, _BENDS_TIME = 1_000.0, 60.0, 110.0
_GUST_SPEED, _GUST_TIME = 80.0, 12.0  # [km/h], [s]
# The driver falls asleep [s]; time for the return [s].
_SLEEPS, _RETURN = 1.0, 10.0


class Sleeper(Planner):
    """The planner, which drifts at a rate [m/s] from the lane's middle until it is at the line."""

    rate = 0.5

    def plan(
        self,
        scene: Scene,
        decision: Decision = Decision.KEEP,
        profile: SpeedProfile | None = None,
    ) -> Trajectory:
        """Returns the lane's middle, shifted aside while the driver sleeps."""
        plan = super().plan(scene, decision, profile)
        room = 0.5 * (LANE_WIDTH - scene.footprint.width)
        if scene.time > _SLEEPS + room / abs(self.rate):
            return plan
        slept = (plan.time - _SLEEPS).clip(0.0)
        aside, turn = self.rate * slept, self.rate * (slept > 0.0) / plan.speed.clip(1.0)
        point = self.route.evaluate(plan.station, plan.offset + aside)
        return dataclasses.replace(
            plan,
            offset=plan.offset + aside,
            x=point.x,
            y=point.y,
            yaw=wrap_angles(plan.yaw + turn),
        )


def sleeper(rate: float) -> type[Sleeper]:
    """Returns the planner of a driver who drifts at a rate [m/s], positive to the left."""
    return type("Sleeper", (Sleeper,), {"rate": rate})


def lane_keeping(config: DriveConfig, label: str, step: float, quick: bool) -> Findings:
    """Bends, gusts from both sides, and the take-over from a sleeping driver.

    Args:
      config: of the stack: truck and load.
      label: of the load.
      step: of the physics [s].
      quick: fewer and shorter drives.
    """
    found = Findings(f"lane, {label}")
    run = functools.partial(drive, timestep=step)
    bends = at(config, _BENDS_SPEED, 20.0 if quick else _BENDS_TIME)
    bends = dataclasses.replace(bends, start_station=_BENDS, start_lane=0)
    least = run(bends, (), RoadMap.builtin().route()).room
    found.check("least distance from its edges in bends at 60 km/h", least, "m", 0.0, ">= 0")
    for friction, side in ((0.8, 90.0),) if quick else itertools.product((0.8, 0.5), (90.0, -90.0)):
        gust = scenario("lane_gust", direction=side)
        least = run(at(config, _GUST_SPEED, _GUST_TIME), gust, straight(friction)).room
        name = f"the same in a gust from the {'left' if side > 0.0 else 'right'}"
        found.check(f"{name}, friction {friction:g}", least, "m", 0.0, ">= 0")
    room = 0.5 * (LANE_WIDTH - EgoFootprint().width)
    for rate in each(RATES[-1:] if quick else RATES, "taking over", str):
        for side in (1.0, -1.0)[: 1 if quick else None]:
            setup = dataclasses.replace(config, planner=sleeper(side * rate))
            duration = _SLEEPS + room / rate + _RETURN
            made = run(at(setup, TEST_SPEED, duration))
            where = "left" if side > 0.0 else "right"
            name = f"farthest beyond the line, drift of {rate:g} m/s to the {where}"
            found.check(name, -made.room, "m", OUTSIDE, f"<= {OUTSIDE:g}")
    return found
