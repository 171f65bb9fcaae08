"""Predictive cruise control as the stack's speed reference: limits, traffic flow, plans.

`PccReference` plans once a second. `RoadLimits` gives it the speed limits of the road, and `Flow`
the speed of the vehicles ahead.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from controllers.pcc.leader_constraint import Leader
from controllers.pcc.planner import PccConfig
from controllers.pcc.profile import RoadProfile
from controllers.pcc.receding import HorizonPlan, RecedingPlanner
from controllers.pcc.trip import Appointment, RecedingConfig
from controllers.planning.config import PlannerConfig
from controllers.planning.road_preview import LanePath, RoadPreview
from controllers.planning.rollover_limits import RollMargins
from controllers.planning.speed_caps import SpeedCaps, with_zones
from iits_mj.core.arrays import FloatArray
from iits_mj.core.checks import require_positive
from iits_mj.core.errors import InputError
from iits_mj.core.messages import EgoState, Scene, SpeedProfile, TrackedVehicle
from iits_mj.core.neighbors import Neighbor
from iits_mj.core.timing import CYCLE_PERIOD
from iits_mj.core.vehicles import VehicleFrame
from iits_mj.parameters import TruckParameters

if TYPE_CHECKING:
    from iits_mj.road import Route

_FREE = 1e3  # [m/s] in place of no reference speed
_MASS_CHANGE = 0.02  # relative change of mass that makes a new planner
_GAIN_AHEAD = (50.0, 11)  # spacing [m] and number of the places where a lane change must pay


class RoadLimits:
    """Greatest speeds over station that the trajectory planner allows.

    The limits of the map and of variable signs, and those of bends by comfort and by the truck's
    roll-over margin, each approached at the planner's gentle deceleration. `step` is the distance
    between the nodes of plans [m].
    """

    def __init__(
        self, route: Route, step: float, planner: PlannerConfig, parameters: TruckParameters
    ) -> None:
        self._route, self._preview = route, RoadPreview(route)
        self._caps = SpeedCaps(self._preview, planner)
        self._margins = RollMargins(parameters, 1.0 / planner.change.duration_min)
        self._around = math.ceil(0.5 * step / self._preview.step)
        self._holding: tuple[object, ...] | None = None
        self._limit: FloatArray = np.empty(0)

    def update(self, scene: Scene) -> bool:
        """Updates signs, lane and mass from a scene; returns whether the limits have changed.

        Raises:
          InputError: a zone's limit is not a positive number, or its ends are not finite.
        """
        ego, zones = scene.ego, scene.signals.zones
        of_lane = any(zone.lane is not None for zone in zones)
        lane = max(int(self._route.lane_at(ego.station, ego.offset)), 0) if of_lane else 0
        zones = tuple(zone for zone in zones if zone.lane is None or zone.lane == lane)
        margin = self._margins.at(ego.mass)
        if self._holding == (margin.threshold, zones):
            return False
        preview, station = self._preview, self._preview.station
        path = with_zones(
            LanePath(station, preview.offset[0], preview.speed_limit[0], 1.0, math.inf, lane), zones
        )
        free = SpeedProfile(station, np.full(station.size, _FREE))
        slowest = self._caps.cap(path, free, margin, ego)
        # A node represents half a step to both sides.
        padded = np.pad(slowest, self._around, mode="edge")
        window = np.lib.stride_tricks.sliding_window_view(padded, 2 * self._around + 1)
        self._limit = np.asarray(window.min(axis=1))
        self._holding = (margin.threshold, zones)
        return True

    def at(self, station: FloatArray) -> FloatArray:
        """Returns the greatest speeds at the nodes of a plan [m/s], in the shape of station."""
        row = np.round(station / self._preview.step).astype(int)
        return self._limit.take(row, mode="clip")


@dataclass(frozen=True)
class FlowConfig:
    """Settings of the estimated traffic flow.

    Attributes:
      sight: range ahead in which vehicles on the road's lanes count [m].
      memory: time constant of the estimate [s].
      margin: by which a truck can be faster than the flow by passing some vehicles [m/s].
      presence: share of the time with a vehicle in sight above which there is a flow, 0 to 1.
    """

    sight: float = 300.0
    memory: float = 30.0
    margin: float = 1.0
    presence: float = 0.5

    def __post_init__(self) -> None:
        require_positive(self, *vars(self))


class Flow:
    """Filtered mean speed of the vehicles ahead: a faster plan would be late."""

    def __init__(self, config: FlowConfig | None = None) -> None:
        self.config = config or FlowConfig()
        self.reset()

    def reset(self) -> None:
        """Clears the estimate."""
        self._speed = self._present = 0.0
        self._time = -math.inf

    def update(self, time: float, station: float, vehicles: Iterable[TrackedVehicle]) -> float:
        """Returns the greatest mean speed that the traffic allows [m/s]; inf without traffic.

        `time` [s] and `station` [m] are the truck's, `vehicles` those in sight.
        """
        config = self.config
        frame = VehicleFrame.of(vehicles)
        columns = (frame.lanes.tolist(), *frame.columns("station", "speed").tolist())
        ahead = [
            speed
            for lane, place, speed in zip(*columns, strict=True)
            if lane >= 0 and 0.0 < place - station < config.sight and math.isfinite(speed)
        ]
        # The first update counts in full.
        weight = 1.0 - math.exp(-max(time - self._time, 0.0) / config.memory)
        self._time = time
        self._present += weight * (float(bool(ahead)) - self._present)
        if ahead:
            mean = max(sum(ahead) / len(ahead), 0.0)
            fresh = self._speed <= 0.0
            self._speed = mean if fresh else self._speed + weight * (mean - self._speed)
        return self._speed + config.margin if self._present > config.presence else math.inf


@dataclass(frozen=True)
class PccReport:
    """Plans of a drive so far.

    Attributes:
      plans: number by status; reasons: number of plans that are not optimal, by reason.
      solve_time: of each optimal plan [s]; schedules: their number.
      price: of a second now [kg/s]; lag: behind the schedule now [s], NaN without one.
    """

    plans: dict[str, int]
    solve_time: tuple[float, ...]
    reasons: dict[str, int]
    price: float
    lag: float
    schedules: int


class PccReference:
    """The receding-horizon planner in the stack; see `controllers.planning.speed_reference`.

    Attributes:
      planner: None before the first scene, which gives the truck's mass.
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
        """Samples the road.

        Args:
          route: the truck's road, with the limits and curve speeds of the plans.
          config: set speed and band.
          parameters: of the truck.
          receding: settings of the plans.
          appointment: end of the trip; default: the road's end.
          period: between two plans [s].
          planner: settings of the trajectory planner, with the speed in bends.

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
        """Clears all memory, for a new drive."""
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
        """Returns the plan; makes a new one once a period.

        Raises:
          InputError: the truck's station, speed, time or mass is not finite.
        """
        if self.last is None or scene.time - self._planned_at >= self.period - 0.5 * CYCLE_PERIOD:
            self._planned_at = scene.time
            self.last = self._plan(scene, find_leader())
        return self.last.profile

    def at(self, station: float) -> float:
        """Returns the reference speed at a station now [m/s]."""
        return self.config.v_ref if self.last is None else self.last.profile.at(station)

    def free(self, station: float) -> float:
        """Returns the schedule's greatest speed within 500 m, in traffic the set speed [m/s]."""
        schedule = None if self.planner is None else self.planner.schedule
        if schedule is None or not schedule.covers(station):
            return self.config.v_ref
        fastest = schedule.fastest(station, *_GAIN_AHEAD)
        return fastest if math.isinf(self._top) else max(fastest, self.config.v_ref)

    def report(self) -> PccReport:
        """Returns a report of the plans since the reset."""
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
        # In traffic the truck may pass other vehicles at the set speed.
        self._top = max(flow, self.config.v_ref)
        found = planner.plan(ego.station, ego.speed, scene.time, leader, self._top)
        self._plans[found.status] += 1
        if found.status == "optimal":
            self._times.append(found.solve_time)
        else:
            self._reasons[found.reason] += 1
        return found

    def _planner_for(self, ego: EgoState) -> RecedingPlanner:
        """Returns the planner of a truck of this mass, a new one when the load changes."""
        if not math.isfinite(ego.mass):
            raise InputError(f"speed planner: mass is {ego.mass!r}: must be finite")
        planner = self.planner
        if planner is None or abs(ego.mass / planner.vehicle.mass - 1.0) > _MASS_CHANGE:
            planner = RecedingPlanner(
                self.road, self._parameters, ego.mass, self.config, self.receding, self.appointment
            )
            self.planner = planner
        return planner


def _leader_of(ego: EgoState, neighbor: Neighbor) -> Leader:
    """Returns a neighbor as leader; beside the truck's front it counts as at its bumper.

    Raises:
      InputError: the gap is more negative than the vehicle is long, so it is not ahead.
    """
    if not neighbor.gap >= -neighbor.length:
        raise InputError(
            f"vehicle {neighbor.id!r}: gap {neighbor.gap:g} m means that it is not ahead; use "
            f"{-neighbor.length:g} m (its length) or more"
        )
    return Leader(
        ego.station + max(neighbor.gap, 0.0), max(neighbor.speed, 0.0), neighbor.acceleration
    )
