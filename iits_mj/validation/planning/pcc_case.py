"""A solved speed plan with the problem that it solves, its bound, its energy and exact motion."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from controllers.pcc import (
    PccComparison,
    PccConfig,
    RoadProfile,
    Solution,
    SpeedTask,
    plan,
)
from controllers.pcc import solve as solve_task
from controllers.pcc.fuel import FuelMap
from controllers.pcc.vehicle import PointMass, durations
from iits_mj.core.arrays import FloatArray
from iits_mj.core.errors import PlanningError
from iits_mj.core.units import GRAVITY
from iits_mj.parameters import TruckParameters
from iits_mj.validation.planning.pcc_bound import certificate, lower_bound

PAPER_SAVING_PERCENT = 21.68
# The two cruises in names of checks; the second is the paper's.
ROLLING, BRAKING = "against a rolling cruise", "against a braking cruise"
GROSS_MASS = 55_000.0  # [kg] of the truck with its greatest load
_TIGHT = 1e-4  # relative gap that counts as none
_RELAXED_MAX = 1_500_000.0  # [m]: IPOPT takes 3 s and much memory for the relaxation of 100 km
# Gauss points of an interval, for integrals of the exact motion.
_ROOTS, _WEIGHTS = np.polynomial.legendre.leggauss(5)


@dataclass(frozen=True)
class SolvedPlan:
    """A solved plan.

    Attributes:
      solution: plan and cruise; vehicle, task: the problem of the plan.
      answer: solution of the task, with its multipliers.
      config: settings; parameters: of the truck; fuel_map: of its engine.
    """

    solution: PccComparison
    vehicle: PointMass
    task: SpeedTask
    answer: Solution
    config: PccConfig
    parameters: TruckParameters
    fuel_map: FuelMap

    @property
    def road(self) -> RoadProfile:
        """The road."""
        return self.task.road


def solve(
    road: RoadProfile,
    config: PccConfig,
    mass: float = GROSS_MASS,
    parameters: TruckParameters | None = None,
) -> SolvedPlan:
    """Plans, and solves the same problem again with its multipliers.

    Raises:
      PlanningError: there is no plan; the message gives the reason.
    """
    parameters = parameters or TruckParameters.load()
    solution = plan(road, parameters, mass, config)
    if min(solution.baseline_fuel, float(solution.baseline.map_fuel.sum())) <= 0.0:
        raise PlanningError(
            f"on road {road.name!r} the cruise burns no fuel at all: nothing can be saved"
        )
    # The trip time of the cruise; that of the plan's task differs by rounding.
    task = replace(solution.task, time_max=solution.baseline.time)
    answer = solve_task(task, solution.baseline.speed)
    return SolvedPlan(solution, task.vehicle, task, answer, config, parameters, FuelMap(parameters))


def bound(case: SolvedPlan, k_a: float) -> tuple[float, float]:
    """Returns a lower bound on fuel plus the term of k_a of all plans of the case, and the gap.

    From the multipliers of the optimum; if those leave a gap, from the relaxation's own optimum.

    Args:
      case: the plan.
      k_a: weight of a^2 [kg/s per (m/s2)^2]; 0 bounds the fuel.

    Returns:
      The bound [kg], and the relative distance of the optimum for that k_a above it.
    """
    if k_a == case.task.k_a:
        task, answer = case.task, case.answer
    else:
        task = replace(case.task, k_a=k_a)
        answer = solve_task(task, case.answer.speed)
    cost = task.cost(answer.speed)
    least = certificate(task, answer)
    if cost > least * (1.0 + _TIGHT) and case.road.length < _RELAXED_MAX:
        least = max(least, lower_bound(task).cost)
    return least, cost / least - 1.0 if least > 0.0 else np.inf


def with_rolling(parameters: TruckParameters, coefficient: float) -> TruckParameters:
    """Returns the truck with another rolling resistance coefficient."""
    tires = {
        kind: replace(tire, rolling_resistance=coefficient, rolling_resistance_exponent=1.0)
        for kind, tire in parameters.tires.items()
    }
    return replace(parameters, tires=tires)


def with_power(parameters: TruckParameters, share: float) -> TruckParameters:
    """Returns the truck with a share of its torque at full pedal and the same drag and fuel map."""
    engine = parameters.engine
    pedal = replace(engine.pedal_map, values=share * engine.pedal_map.values)
    weaker = replace(engine, full_load_torque=share * engine.full_load_torque, pedal_map=pedal)
    return replace(parameters, engine=weaker)


def scaled_heights(road: RoadProfile, factor: float) -> RoadProfile:
    """Returns the road with all heights, and thus all grades, times a factor."""
    return replace(road, height=road.height * factor)


@dataclass(frozen=True)
class Balance:
    """Balance of the engine's work of a drive [J].

    Attributes:
      engine: at the wheels, drag of the overrunning engine subtracted; rolling, air, climb: against
        resistances and height; kinetic: gained; brakes: friction, retarder.
      time_error: trip time of the exact motion less that of the grid, relative.
    """

    engine: float
    rolling: float
    air: float
    climb: float
    kinetic: float
    brakes: float
    time_error: float

    @property
    def residual(self) -> float:
        """Work not accounted for [J]."""
        used = self.rolling + self.air + self.climb + self.kinetic + self.brakes
        return self.engine - used


def balance(vehicle: PointMass, road: RoadProfile, speed: FloatArray) -> Balance:
    """Returns the energy balance of a drive along its exact motion, not the grid's.

    Between nodes the force is constant: by `d(v^2)/ds = 2 (F - R - k v^2) / m`, v^2 approaches its
    steady value exponentially. Air drag and time are integrals of this by five Gauss points, and
    the work of climbing is weight times rise. The optimizer computes none of them this way.
    """
    net = vehicle.net_force(speed, road)
    mean = 0.5 * (speed[1:] + speed[:-1])
    drag_force = -vehicle.power_drag * vehicle.efficiency / mean
    engine = np.maximum(net, drag_force)
    steady = (net - vehicle.slope_force(road.grade)) / vehicle.drag
    rate = 2.0 * vehicle.drag / vehicle.inertial_mass
    way = 0.5 * road.step * (_ROOTS + 1.0)
    weight = 0.5 * road.step * _WEIGHTS
    inside = steady[:, None] + (speed[:-1, None] ** 2 - steady[:, None]) * np.exp(-rate * way)
    exact_time = float(((1.0 / np.sqrt(inside)) @ weight).sum())
    grid_time = float(durations(speed, road).sum())
    weight_force = vehicle.mass * GRAVITY
    return Balance(
        engine=float(engine.sum()) * road.step,
        rolling=road.length * weight_force * vehicle.rolling,
        air=vehicle.drag * float((inside @ weight).sum()),
        climb=weight_force * float(road.height[-1] - road.height[0]),
        kinetic=0.5 * vehicle.inertial_mass * float(speed[-1] ** 2 - speed[0] ** 2),
        brakes=float((engine - net).sum()) * road.step,
        time_error=exact_time / grid_time - 1.0,
    )
