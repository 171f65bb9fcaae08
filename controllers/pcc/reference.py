"""Predictive cruise control as the stack's speed reference: a plan a second, behind traffic."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from controllers.pcc.fence import Leader
from controllers.pcc.flow import Flow
from controllers.pcc.planner import PccConfig
from controllers.pcc.profile import RoadProfile
from controllers.pcc.receding import HorizonPlan, RecedingPlanner
from controllers.pcc.road_limits import RoadLimits
from controllers.pcc.trip import Appointment, RecedingConfig
from controllers.planner_config import PlannerConfig
from controllers.surroundings import Neighbor
from iits_mj.errors import InputError
from iits_mj.messages import EgoState, Scene, SpeedProfile
from iits_mj.parameters import TruckParameters

if TYPE_CHECKING:
    from iits_mj.road import Route

_HALF_CYCLE = 0.05
_MASS_CHANGE = 0.02  # of the mass, beyond which the truck is another one
_GAIN_AHEAD = 500.0  # [m] in which a lane change is to pay


@dataclass(frozen=True)
class PccReport:
    """What PCC did in a drive.

    Attributes:
      plans: number by status; solve_time: of every solve [s]; reasons: why not optimal, by number.
      price: of a second now [kg/s]; lag: behind the schedule now [s], nan without one.
      schedules: made so far.
    """

    plans: dict[str, int]
    solve_time: tuple[float, ...]
    reasons: dict[str, int]
    price: float
    lag: float
    schedules: int


class PccReference:
    """The receding-horizon planner in the stack; see `controllers.speed_reference`.

    Attributes:
      planner: None before the first scene, which tells the truck's mass.
      last: the last plan.
    """

    def __init__(
        self,
        route: Route,
        config: PccConfig,
        parameters: TruckParameters | None = None,
        receding: RecedingConfig | None = None,
        appointment: Appointment | None = None,
        period: float = 1.0,
        planner: PlannerConfig | None = None,
    ) -> None:
        """Looks the road up.

        Args:
          route: the truck's road, whose limits and curve speeds the plans keep.
          config: set speed and band.
          parameters: of the truck.
          receding: settings.
          appointment: where the trip ends, and when; default: the road's end.
          period: between two plans [s].
          planner: settings of the trajectory planner, which say how fast bends are driven.

        Raises:
          InputError: the period is not above 0.
        """
        if not math.isfinite(period) or period <= 0.0:
            raise InputError(f"period = {period!r} s is not allowed: use a number above 0")
        self.config, self.receding = config, receding or RecedingConfig()
        self.appointment, self.period = appointment, period
        self._parameters = parameters or TruckParameters.load()
        self.road = RoadProfile.from_route(route, step=self.receding.step)
        self._limits = RoadLimits(
            route, self.receding.step, planner or PlannerConfig(), self._parameters
        )
        self.planner: RecedingPlanner | None = None
        self._flow = Flow()
        self.reset()

    def reset(self) -> None:
        """Ready for a new drive."""
        if self.planner is not None:
            self.planner.reset()
        self._flow.reset()
        self._top = math.inf
        self.last: HorizonPlan | None = None
        self._planned_at = -math.inf
        self._plans: Counter[str] = Counter()
        self._reasons: Counter[str] = Counter()
        self._times: list[float] = []

    def update(self, scene: Scene, find_leader: Callable[[], Neighbor | None]) -> SpeedProfile:
        """The plan, made anew once a period.

        Raises:
          InputError: the truck's station, speed, time or mass is not finite.
        """
        if self.last is None or scene.time - self._planned_at >= self.period - _HALF_CYCLE:
            self._planned_at = scene.time
            self.last = self._plan(scene, find_leader())
        return self.last.profile

    def at(self, station: float) -> float:
        """Speed asked for at a station now [m/s]."""
        return self.config.v_ref if self.last is None else self.last.profile.at(station)

    def free(self, station: float) -> float:
        """The most that the schedule has within the next 500 m; in traffic the set speed [m/s]."""
        schedule = None if self.planner is None else self.planner.schedule
        if schedule is None or not schedule.covers(station):
            return self.config.v_ref
        ahead = station + np.linspace(0.0, _GAIN_AHEAD, 11)
        fastest = float(schedule.speed_at(ahead).max())
        return fastest if math.isinf(self._top) else max(fastest, self.config.v_ref)

    def report(self) -> PccReport:
        """What was done since the reset."""
        price, lag = (math.nan, math.nan) if self.last is None else (self.last.price, self.last.lag)
        schedules = 0 if self.planner is None else self.planner.trip.schedules
        times = tuple(self._times)
        return PccReport(dict(self._plans), times, dict(self._reasons), price, lag, schedules)

    def _plan(self, scene: Scene, neighbor: Neighbor | None) -> HorizonPlan:
        ego = scene.ego
        planner = self._planner_for(ego)
        if self._limits.update(scene) or planner.trip.limits is None:
            planner.trip.limit_by(self._limits.at)
        leader = None if neighbor is None else _leader_of(ego, neighbor)
        flow = self._flow.update(scene.time, ego.station, scene.vehicles)
        # Among others the set speed is driven where it can be, by passing them, and no more.
        self._top = max(flow, self.config.v_ref)
        found = planner.plan(ego.station, ego.speed, scene.time, leader, self._top)
        self._plans[found.status] += 1
        if found.status == "optimal":
            self._times.append(found.solve_time)
        else:
            self._reasons[found.reason] += 1
        return found

    def _planner_for(self, ego: EgoState) -> RecedingPlanner:
        """The planner of a truck of this mass; made once, unless the load changes."""
        if not math.isfinite(ego.mass):
            raise InputError(f"speed planner: mass is {ego.mass!r}: must be finite")
        planner = self.planner
        if planner is None or abs(ego.mass / planner.vehicle.mass - 1.0) > _MASS_CHANGE:
            planner = RecedingPlanner(
                self.road,
                self._parameters,
                ego.mass,
                self.config,
                self.receding,
                self.appointment,
            )
            self.planner = planner
        return planner


def _leader_of(ego: EgoState, neighbor: Neighbor) -> Leader:
    """Whose rear is ahead; who drives in beside the truck counts as at its bumper.

    Raises:
      InputError: the gap is more negative than the vehicle is long: it is not ahead.
    """
    vehicle = neighbor.vehicle
    if not neighbor.gap >= -vehicle.length:
        raise InputError(
            f"vehicle {vehicle.id!r}: gap {neighbor.gap:g} m is not that of a vehicle ahead: use "
            f"{-vehicle.length:g} m, its length, or more"
        )
    return Leader(
        ego.station + max(neighbor.gap, 0.0), max(vehicle.speed, 0.0), vehicle.acceleration
    )
