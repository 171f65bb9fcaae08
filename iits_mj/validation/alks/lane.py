"""Lane keeping of the stack, with UN R157, 5.2.1, and the drift of UN R130.

R157: no outer edge of a front tire crosses the outer edge of a lane marking; here neither side of
tractor or trailer leaves the lane, which is stricter. R130 is of warnings that a driver who drifts
out of the lane with 0.1 to 0.8 m/s gets at the latest when the tire is 0.3 m outside the marking.
No driver steers a truck of the stack, so nobody is to be warned. What remains is a sleeping driver
from whom the stack takes over at 65 km/h, `LAG` before the truck would be at the line, and before
those 0.3 m the truck must turn. Awake drivers in gusts must not lose the wheel.
"""

from __future__ import annotations

import dataclasses
import functools
import itertools
import math
import typing

from controllers.planning.planner import Planner
from iits_mj.core.angles import wrap_angles
from iits_mj.core.messages import (
    Decision,
    EgoFootprint,
    EgoState,
    Scene,
    SpeedProfile,
    Trajectory,
)
from iits_mj.core.progress import each
from iits_mj.core.results import Findings
from iits_mj.road import RoadMap, Route
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
# The truck's acceleration across the road has built up this long after a step of its path, measured
# at 65 km/h [s].
LAG = 0.4
# A drive with a gust from each side in turn, in which nothing threatens [s].
_WINDY_TIME, _GUSTS_EVERY = 300.0, 10


def time_to_line(ego: EgoState, route: Route, width: float) -> float:
    """Returns the time until a side of the truck's front reaches the edge of its lane [s].

    Args:
      ego: the truck, which keeps its speed across the road.
      route: the road.
      width: of the truck [m].

    Returns:
      0 at the edge and beyond it; inf while the truck does not approach it.
    """
    lane = max(int(route.lane_at(ego.station, ego.offset)), 0)
    turned = ego.yaw - float(route.evaluate(ego.station, ego.offset).heading)
    across = ego.speed * math.sin(turned) + ego.lateral_speed * math.cos(turned)
    aside = ego.offset - float(route.lane_offset(lane, ego.station))
    toward = math.copysign(1.0, aside) * across
    room = 0.5 * (float(route.lane_width(lane, ego.station)) - width) - abs(aside)
    return max(room, 0.0) / toward if toward > 1e-3 else math.inf


class Sleeper(Planner):
    """The planner, which drifts at a rate [m/s] from the lane's middle until the stack takes over.

    The stack takes over when `time_to_line` is at most `ahead` [s]. `alarms` has the times at which
    this was so [s].
    """

    rate = 0.0
    ahead = 0.0
    alarms: typing.ClassVar[list[float]] = []

    def plan(
        self,
        scene: Scene,
        decision: Decision = Decision.KEEP,
        profile: SpeedProfile | None = None,
    ) -> Trajectory:
        """Returns the lane's middle, shifted aside while the driver sleeps."""
        plan = super().plan(scene, decision, profile)
        if time_to_line(scene.ego, self.route, scene.footprint.width) <= self.ahead:
            self.alarms.append(scene.time)
        if self.alarms:
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


def sleeper(rate: float, ahead: float) -> type[Sleeper]:
    """Returns the planner of a driver who drifts at a rate [m/s], positive to the left."""
    return type("Sleeper", (Sleeper,), {"rate": rate, "ahead": ahead, "alarms": []})


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
            where = f"drift of {rate:g} m/s to the {'left' if side > 0.0 else 'right'}"
            for ahead, when in ((LAG, f"{LAG:g} s before"), (0.0, "at"))[: 1 if quick else None]:
                setup = dataclasses.replace(config, planner=sleeper(side * rate, ahead))
                made = run(at(setup, TEST_SPEED, _SLEEPS + room / rate + _RETURN))
                name = f"farthest beyond the line, {where}, taken over {when} the line"
                condition = f"<= {OUTSIDE:g}" if ahead else ""
                found.check(name, -made.room, "m", OUTSIDE, condition)
    awake, duration = sleeper(0.0, LAG), 20.0 if quick else _WINDY_TIME
    times = range(3, int(duration), _GUSTS_EVERY)
    gusts = [
        dataclasses.replace(event, at_time=float(time))
        for number, time in enumerate(times)
        for event in scenario("lane_gust", direction=90.0 * (-1.0) ** number)
    ]
    windy = at(dataclasses.replace(config, planner=awake), _GUST_SPEED, duration)
    run(windy, gusts, straight(length=windy.start_station + 1.1 * windy.speed * duration))
    name = (
        f"false take-overs in {duration:g} s, winds of 20 m/s from both sides, {_GUST_SPEED:g} km/h"
    )
    found.check(name, len(awake.alarms), "1", 0.0, "== 0")
    return found
