"""How good a speed plan is: bound, second transcription, finer grid, energy; and what it takes."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace

import numpy as np

import iits_mj.validation.planning.pcc_hermite  # noqa: F401  registers "finite_elements"
from controllers.pcc import PccConfig, RoadProfile, Solution
from controllers.pcc import solve as solve_task
from controllers.pcc.planner import evaluate, on_finer_road
from controllers.pcc.vehicle import durations
from iits_mj.core.errors import PlanningError
from iits_mj.core.results import Check, Line, Panel
from iits_mj.core.units import KMH
from iits_mj.validation.planning.pcc_bound import certificate
from iits_mj.validation.planning.pcc_case import Case, balance, bound, solve

PAPER_SECONDS = 60.0
LONG_SECONDS = 5.0  # for 1000 km
FINE_STEP = 5.0  # [m]
_KEPT = 5  # solves of which the fastest counts
ELEMENTS_MAX = 30_000.0  # [m] of road: finite elements beyond take a minute and more
_ELEMENTS_SECONDS = 300.0
_CONVERGED = 0.1  # [%] of the fuel, between grids
EQUAL_TIME = 1e-4  # relative difference of trip times


@dataclass(frozen=True)
class Elements:
    """The finite elements in time of a case, or the reason why there are none."""

    answer: Solution | None
    reason: str = ""


def finite_elements(case: Case, length_max: float = ELEMENTS_MAX) -> Elements:
    """Solves the case by the paper's transcription, from the cruise as first guess."""
    if case.road.length > length_max:
        return Elements(
            None,
            f"no finite elements in time: they are solved up to {length_max / 1e3:.0f} km, the "
            f"road has {case.road.length / 1e3:.0f} km",
        )
    speed = case.solution.baseline.speed
    try:
        return Elements(
            solve_task(case.task, speed, "finite_elements", time_limit=_ELEMENTS_SECONDS)
        )
    except PlanningError as error:
        return Elements(None, f"no finite elements in time: {error}")


def bound_checks(case: Case, gap_max: float = 0.1) -> list[Check]:
    """The convex bound: how far the plan can be from the global optimum, and what can be saved.

    By the engine's map a plan burns at least the bound less the trip time times what the map is
    below the fit at most: a weak bound, but one of every plan and every choice of gears.

    Args:
      case: the plan.
      gap_max: what the gap must stay within [%]. Where time is worth little the relaxation, not the
        plan, leaves some tenths of a per cent.
    """
    task, base = case.task, case.solution.baseline
    fuel, _ = bound(case, 0.0)
    slowest, fastest = np.sqrt(task.b_low.min()), np.sqrt(task.b_high.max())
    below = case.fuel_map.below_fit(case.vehicle.fuel, float(slowest), float(fastest))
    by_map = max(fuel - below * task.time_max, 0.0)
    whole, _ = bound(case, case.task.k_a)
    gap = case.cost(case.solution.plan.speed) / whole - 1.0 if whole > 0.0 else np.inf
    return [
        Check("convex lower bound on the fuel, beside the plan's", fuel, "kg", case.solution.fuel),
        Check(
            "saving that no plan of this band exceeds, optimizer's fuel model",
            100.0 * (1.0 - fuel / case.solution.baseline_fuel),
            "%",
            case.solution.saving_percent,
        ),
        Check(
            "saving that no plan of this band exceeds, engine map",
            100.0 * (1.0 - by_map / float(base.map_fuel.sum())),
            "%",
            case.solution.map_saving_percent,
        ),
        Check("cost of the plan above the bound", 100.0 * gap, "%", 0.0, f"<= {gap_max:g}"),
    ]


def element_checks(case: Case, elements: Elements, must: str = "") -> list[Check]:
    """The paper's transcription beside the plan; `must` bounds the difference of their fuel [%]."""
    answer = elements.answer
    if answer is None:
        return []
    solution = case.solution
    saving = 100.0 * (1.0 - answer.fuel / solution.baseline_fuel)
    difference = answer.speed - solution.plan.speed
    return [
        Check("finite elements: saving", saving, "%", solution.saving_percent),
        Check(
            "finite elements: fuel above the plan's",
            100.0 * (answer.fuel / solution.fuel - 1.0),
            "%",
            0.0,
            must,
        ),
        Check(
            "finite elements: speed less the plan's, rms",
            float(np.sqrt(np.mean(difference**2))),
            "m/s",
        ),
        Check(
            "finite elements: set-up and solve",
            answer.solve_time,
            "s",
            PAPER_SECONDS,
        ),
    ]


def convergence_checks(case: Case, fine: RoadProfile, optima: bool = False) -> list[Check]:
    """The plan against that of a fine grid of the same road, in its time and between its speeds.

    The optimum on the case's own grid, and what its forces burn on the fine road. Where the band
    lets no plan take as long as the cruise, or the coarse grid knows no drive in the fine plan's
    time, nothing is bounded: there is no equal trip to compare. Bounded is what the plan burns on
    the fine road, and with `optima` that both grids have the same least fuel.
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


def equal_times(case: Case) -> bool:
    """Whether the plan takes as long as the cruise."""
    solution = case.solution
    return abs(solution.plan.time / solution.baseline.time - 1.0) <= EQUAL_TIME


def panels(case: Case, elements: Elements) -> list[Panel]:
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


def energy_checks(case: Case) -> list[Check]:
    """Energy and time of plan and cruise along their exact motion."""
    rows = []
    for name, drive in (("plan", case.solution.plan), ("cruise", case.solution.baseline)):
        flow = balance(case.vehicle, case.road, drive.speed)
        share = 100.0 / flow.engine
        rows += [
            Check(f"{name}: braked away, of the engine's work", flow.brakes * share, "%"),
            Check(
                f"{name}: energy not accounted for, of the engine's work",
                abs(flow.residual) * share,
                "%",
                0.0,
                "<= 0.1",
            ),
        ]
    return rows


def cold_seconds(case: Case) -> float:
    """Set-up and solve of the task from the cruise, a new solver each time [s].

    The least of five counts, which other load on the computer disturbs least.
    """
    seconds = []
    for _ in range(_KEPT):
        began = time.perf_counter()
        solve_task(case.task, case.solution.baseline.speed)
        seconds.append(time.perf_counter() - began)
    return min(seconds)


def long_road(road: RoadProfile, length: float) -> RoadProfile:
    """The road there and back and there again, to a length [m]; without speed limits."""
    count = round(length / road.step)
    rounds = -(-count // road.intervals)
    there, back = road.height[1:], road.height[-2::-1]
    parts = [there if i % 2 == 0 else back for i in range(rounds)]
    height = np.concatenate([road.height[:1], *parts])[: count + 1]
    station = np.asarray(road.step * np.arange(count + 1), dtype=float)
    return RoadProfile(station, height, np.full(count + 1, np.inf), f"{road.name}, repeated")


def cost_checks(case: Case, kilometers: float) -> list[Check]:
    """What planning takes: this road cold, and a long one; the paper needed about a minute."""
    road = long_road(case.road, 1e3 * kilometers)
    config = replace(case.config, mean_speed=False)
    began = time.perf_counter()
    long = solve(road, config, case.vehicle.mass, case.parameters)
    whole = time.perf_counter() - began
    gap = long.cost(long.answer.speed) / certificate(long.task, long.answer) - 1.0
    return [
        Check(
            f"{case.road.length / 1e3:.0f} km at {case.road.step:g} m, set-up and solve, cold",
            cold_seconds(case),
            "s",
            PAPER_SECONDS,
            "<= 0.05",
        ),
        Check(
            f"{kilometers:.0f} km at {road.step:g} m, set-up and solve, cold",
            long.answer.solve_time,
            "s",
            None,
            f"<= {LONG_SECONDS * kilometers / 1e3:g}",
        ),
        Check(f"{kilometers:.0f} km, with cruise, bounds and engine map, twice", whole, "s"),
        Check(f"{kilometers:.0f} km, cost above the bound", 100.0 * gap, "%", 0.0, "<= 0.1"),
    ]


def warm_up(config: PccConfig) -> None:
    """Plans a short level road once, so that what is loaded at first use is not measured."""
    station = np.linspace(0.0, 1000.0, 21)
    solve(RoadProfile(station, np.zeros(21), np.full(21, np.inf), "level"), config)
