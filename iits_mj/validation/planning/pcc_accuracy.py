"""Quality of a speed plan: bound, second transcription, finer grid, energy; and computing time."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace

import numpy as np

from controllers.pcc import PccConfig, RoadProfile
from controllers.pcc import solve as solve_task
from controllers.pcc.planner import evaluate
from controllers.pcc.vehicle import durations
from iits_mj.core.errors import PlanningError
from iits_mj.core.results import Check, Findings, Line, Panel
from iits_mj.core.units import KMH
from iits_mj.validation.planning import pcc_hermite
from iits_mj.validation.planning.pcc_bound import below_fit, certificate
from iits_mj.validation.planning.pcc_case import SolvedPlan, balance, bound, solve
from iits_mj.validation.planning.pcc_hermite import ElementsSolution
from iits_mj.validation.planning.pcc_roads import on_finer_road

PAPER_SECONDS = 60.0
LONG_SECONDS = 5.0  # for 1000 km
FINE_STEP = 5.0  # [m]
_KEPT = 5  # solves; the fastest counts
ELEMENTS_MAX = 30_000.0  # [m] of road: longer ones take a minute and more
_ELEMENTS_SECONDS = 300.0
_CONVERGED = 0.1  # [%] of the fuel, between grids
EQUAL_TIME = 1e-4  # relative difference of trip times


@dataclass(frozen=True)
class Elements:
    """Finite elements in time of a case, or the reason why there is no solution."""

    answer: ElementsSolution | None
    reason: str = ""


def finite_elements(case: SolvedPlan, length_max: float = ELEMENTS_MAX) -> Elements:
    """Solves the case by the paper's transcription; the cruise is the first guess."""
    if case.road.length > length_max:
        return Elements(
            None,
            f"no finite elements in time: they are solved up to {length_max / 1e3:.0f} km, the "
            f"road has {case.road.length / 1e3:.0f} km",
        )
    speed = case.solution.baseline.speed
    try:
        return Elements(pcc_hermite.finite_elements(case.task, speed, time_limit=_ELEMENTS_SECONDS))
    except PlanningError as error:
        return Elements(None, f"no finite elements in time: {error}")


def bound_checks(case: SolvedPlan, gap_max: float = 0.1) -> list[Check]:
    """Returns the convex bound: the plan's distance from the global optimum, the possible saving.

    By the engine's map a plan burns at least the bound less the trip time times the greatest
    distance of the map below the fit. This bound is weak, but holds for every plan and gear choice.

    `gap_max` bounds the gap [%]: where time is worth little, the relaxation is some tenths of a
    per cent below the plan.
    """
    task, solution, found = case.task, case.solution, Findings()
    fuel, _ = bound(case, 0.0)
    slowest, fastest = np.sqrt(task.b_low.min()), np.sqrt(task.b_high.max())
    below = below_fit(case.fuel_map, case.vehicle.fuel, float(slowest), float(fastest))
    by_map = max(fuel - below * task.time_max, 0.0)
    saving = 100.0 * (1.0 - fuel / solution.baseline_fuel)
    map_saving = 100.0 * (1.0 - by_map / float(solution.baseline.map_fuel.sum()))
    whole, _ = bound(case, task.k_a)
    gap = task.cost(solution.plan.speed) / whole - 1.0 if whole > 0.0 else np.inf
    most = "saving that no plan of this band exceeds"
    found.check("convex lower bound on the fuel, beside the plan's", fuel, "kg", solution.fuel)
    found.check(f"{most}, optimizer's fuel model", saving, "%", solution.saving_percent)
    found.check(f"{most}, engine map", map_saving, "%", solution.map_saving_percent)
    found.check("cost of the plan above the bound", 100.0 * gap, "%", 0.0, f"<= {gap_max:g}")
    return found.checks


def element_checks(case: SolvedPlan, elements: Elements, must: str = "") -> list[Check]:
    """Returns the paper's transcription beside the plan; `must` bounds the excess of fuel [%]."""
    answer, solution = elements.answer, case.solution
    if answer is None:
        return []
    found = Findings("finite elements")
    saving = 100.0 * (1.0 - answer.fuel / solution.baseline_fuel)
    above = 100.0 * (answer.fuel / solution.fuel - 1.0)
    rms = float(np.sqrt(np.mean((answer.speed - solution.plan.speed) ** 2)))
    found.check("saving", saving, "%", solution.saving_percent)
    found.check("fuel above the plan's", above, "%", 0.0, must)
    found.check("speed less the plan's, rms", rms, "m/s")
    found.check("set-up and solve", answer.solve_time, "s", PAPER_SECONDS)
    return found.checks


def convergence_checks(case: SolvedPlan, fine: RoadProfile, optima: bool = False) -> list[Check]:
    """Compares the plan with a plan on a finer grid of the same road, in its time and end speeds.

    Bounds apply to the fuel of the plan's forces on the fine road, and with `optima` also to the
    least fuel of both grids. There is no bound without equal trip times: if the band allows no plan
    as long as the cruise, or the coarse grid no drive in the time of the fine plan.
    """
    road, grids = case.road, f"{case.road.step:g} m grid against {fine.step:g} m"
    other = solve(fine, case.config, case.vehicle.mass, case.parameters)
    best = other.solution
    low, high = case.task.b_low.copy(), case.task.b_high.copy()
    low[[0, -1]] = high[[0, -1]] = best.plan.speed[[0, -1]] ** 2
    task = replace(case.task, b_low=low, b_high=high, time_max=best.plan.time)
    must = f"<= {_CONVERGED:g}" if equal_times(case) and equal_times(other) else ""
    try:
        answer = solve_task(task, case.answer.speed)
    except PlanningError:
        apart = 100.0 * abs(case.solution.fuel / best.fuel - 1.0)
        return [Check(f"fuel on the {grids}, in other trip times", apart, "%", 0.0)]
    optimum = float(case.vehicle.fuel_of(answer.speed, road).sum())
    held = on_finer_road(case.vehicle, road, answer.speed, fine, case.config.v_max)
    late = float(durations(held, fine).sum()) - best.plan.time
    driven = float(other.vehicle.fuel_of(held, fine).sum()) + best.time_price * late
    return [
        Check(
            f"fuel {what} the {grids}", 100.0 * (fuel / best.fuel - 1.0), "%", 0.0, must and bounds
        )
        for what, fuel, bounds in (
            ("on", optimum, f"-{_CONVERGED:g} .. {_CONVERGED:g}" if optima else ""),
            ("when driven on the finer road: plan of", driven, must),
        )
    ]


def equal_times(case: SolvedPlan) -> bool:
    """Returns whether plan and cruise have the same trip time."""
    solution = case.solution
    return abs(solution.plan.time / solution.baseline.time - 1.0) <= EQUAL_TIME


def panels(case: SolvedPlan, elements: Elements) -> list[Panel]:
    """Returns the paper's four panels: road, speed, engine power, accumulated fuel."""
    road, solution = case.road, case.solution
    node = road.station / 1e3
    middle = 0.5 * (node[1:] + node[:-1])
    drives = [("cruise", solution.baseline, "reference"), ("plan", solution.plan, "simulation")]
    if elements.answer is not None:
        speed = elements.answer.speed
        drives.append(("finite elements", evaluate(case.vehicle, case.fuel_map, road, speed), ""))
    speeds, powers, fuels = [], [], []
    for label, drive, role in drives:
        used = np.concatenate([[0.0], np.cumsum(drive.map_fuel)])
        speeds.append(Line(label, node, drive.speed / KMH, role))
        powers.append(Line(label, middle, np.maximum(drive.power, 0.0) / 1e3, role))
        fuels.append(Line(label, node, 1e3 * used, role))
    place = "station [km]"
    return [
        Panel("Road", place, "height [m]", (Line("road", node, road.height),)),
        Panel("Speed", place, "speed [km/h]", tuple(speeds)),
        Panel("Engine power", place, "power [kW]", tuple(powers)),
        Panel("Accumulated fuel", place, "fuel [g]", tuple(fuels)),
    ]


def energy_checks(case: SolvedPlan) -> list[Check]:
    """Returns energy and time of plan and cruise along their exact motion."""
    checks = []
    for name, drive in (("plan", case.solution.plan), ("cruise", case.solution.baseline)):
        flow, found = balance(case.vehicle, case.road, drive.speed), Findings(name)
        share = 100.0 / flow.engine
        missing = "energy not accounted for, of the engine's work"
        found.check("braked away, of the engine's work", flow.brakes * share, "%")
        found.check(missing, abs(flow.residual) * share, "%", 0.0, "<= 0.1")
        checks += found.checks
    return checks


def cold_seconds(case: SolvedPlan) -> float:
    """Returns the time of set-up and solve from the cruise with a new solver, least of five [s]."""

    def once() -> float:
        began = time.perf_counter()
        solve_task(case.task, case.solution.baseline.speed)
        return time.perf_counter() - began

    return min(once() for _ in range(_KEPT))


def long_road(road: RoadProfile, length: float) -> RoadProfile:
    """Returns the road there and back repeatedly, to a length [m]; without speed limits."""
    count = round(length / road.step)
    rounds = -(-count // road.intervals)
    there, back = road.height[1:], road.height[-2::-1]
    parts = [there if i % 2 == 0 else back for i in range(rounds)]
    height = np.concatenate([road.height[:1], *parts])[: count + 1]
    station = np.asarray(road.step * np.arange(count + 1), dtype=float)
    return RoadProfile(station, height, np.full(count + 1, np.inf), f"{road.name}, repeated")


def cost_checks(case: SolvedPlan, kilometers: float) -> list[Check]:
    """Returns the computing time for this road and a long one; the paper's is about a minute."""
    road = long_road(case.road, 1e3 * kilometers)
    config = replace(case.config, mean_speed=False)
    began = time.perf_counter()
    long = solve(road, config, case.vehicle.mass, case.parameters)
    whole = time.perf_counter() - began
    gap = long.task.cost(long.answer.speed) / certificate(long.task, long.answer) - 1.0
    found, cold, far = Findings(), cold_seconds(case), f"{kilometers:.0f} km"
    name = f"{case.road.length / 1e3:.0f} km at {case.road.step:g} m, set-up and solve, cold"
    found.check(name, cold, "s", PAPER_SECONDS, "<= 0.05")
    most = f"<= {LONG_SECONDS * kilometers / 1e3:g}"
    found.check(
        f"{far} at {road.step:g} m, set-up and solve, cold", long.answer.solve_time, "s", None, most
    )
    found.check(f"{far}, with cruise, bounds and engine map, twice", whole, "s")
    found.check(f"{far}, cost above the bound", 100.0 * gap, "%", 0.0, "<= 0.1")
    return found.checks


def warm_up(config: PccConfig) -> None:
    """Plans a short level road once, so that later timings exclude the loading of libraries."""
    station = np.linspace(0.0, 1000.0, 21)
    solve(RoadProfile(station, np.zeros(21), np.full(21, np.inf), "level"), config)
