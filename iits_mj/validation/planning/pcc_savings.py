"""Savings of predictive cruise control on several roads, by band, mass and other quantities.

Every saving of fuel is relative to a cruise with the same engine and brakes, with equal trip time
and equal speeds at both ends: first to one that may roll to the top of the band downhill, as trucks
do, then to the paper's, which brakes at its set speed. Savings depend on hills, mass and band: each
check names its band, and a table shows the sensitivities.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from controllers.pcc import PccConfig, RoadProfile
from iits_mj.core.errors import PlanningError
from iits_mj.core.results import Check, Findings, Line, Panel, Results
from iits_mj.core.units import KMH
from iits_mj.parameters import TruckParameters
from iits_mj.road import RoadMap
from iits_mj.validation.harness.config import (
    CYCLE_55,
    CYCLE_65,
    PAPER_ROAD,
    ValidateConfig,
    find_road,
)
from iits_mj.validation.planning.pcc_accuracy import (
    FINE_STEP,
    bound_checks,
    convergence_checks,
    cost_checks,
    element_checks,
    energy_checks,
    equal_times,
    finite_elements,
    panels,
    warm_up,
)
from iits_mj.validation.planning.pcc_case import (
    BRAKING,
    GROSS_MASS,
    PAPER_SAVING_PERCENT,
    ROLLING,
    SolvedPlan,
    bound,
    scaled_heights,
    solve,
    with_power,
    with_rolling,
)
from iits_mj.validation.planning.pcc_roads import read_cycle

PAPER_LENGTH = 15_000.0
MPH = 0.44704  # [m/s]
STEP = 50.0  # [m]
US_GROSS = 36_287.0  # [kg]: 80 000 lb, the greatest mass on US interstates
# The paper's set speed; from a speed acceptable to following drivers to the EU's speed limiter.
BAND = PccConfig(v_ref=72.0 * KMH, v_min=45.0 * KMH, v_max=90.0 * KMH)
LONG, LONG_QUICK = 1000.0, 100.0  # [km]
LOW_HILLS = 0.25  # share of the heights: the least saving, the greatest difference of models


@dataclass
class SavingsTable:
    """Savings of several plans.

    Attributes:
      checks: savings by the engine's map with gears against both cruises, the reference by the
        optimizer's model.
      notes: on plans that are missing or take another trip time.
      apart: difference of both savings [points]; gaps: of the costs to the lower bound, relative.
    """

    checks: list[Check] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    apart: list[float] = field(default_factory=list)
    gaps: list[float] = field(default_factory=list)

    def add(
        self,
        label: str,
        road: RoadProfile,
        config: PccConfig,
        mass: float = GROSS_MASS,
        parameters: TruckParameters | None = None,
        must: str = "",
    ) -> tuple[SolvedPlan, SolvedPlan] | None:
        """Plans and adds both savings; without a plan adds a note and returns None.

        Returns:
          The plan against the rolling cruise, and that against the braking cruise, whose saving
          has the bound `must`.
        """
        try:
            rolling, braking = (
                solve(road, replace(config, rolls=rolls), mass, parameters)
                for rolls in (True, False)
            )
        except PlanningError as error:
            self.notes.append(f"{label}: no plan, {error}")
            return None
        for case, cruise, bounds in ((rolling, ROLLING, ""), (braking, BRAKING, must)):
            saved, by_model = case.solution.map_saving_percent, case.solution.saving_percent
            reference = PAPER_SAVING_PERCENT if bounds else by_model
            self.checks.append(Check(f"saving {cruise}, {label}", saved, "%", reference, bounds))
            if not equal_times(case):
                what = cruise.removeprefix("against a ")
                self.notes.append(f"{label}: the band lets no plan take as long as the {what}")
            self.apart.append(abs(saved - by_model))
            self.gaps.append(bound(case, case.task.k_a)[1])
        return rolling, braking


def run_savings(config: ValidateConfig) -> Results:
    """Returns savings on the paper's road, the GEM cycles and the highway, and the plans' quality.

    The highway without limits replaces a missing paper's road; then no saving is required.
    """
    results = Results("validate planning pcc savings")
    warm_up(BAND)
    table = SavingsTable()
    path = find_road(config, PAPER_ROAD)
    if path is None:
        table.notes.append(f"the paper's road {PAPER_ROAD} was not named: give --roads DIR")
    name, must = "highway without limits", ""
    road, fine = (_main_road(path, step) for step in (STEP, FINE_STEP))
    if path is not None:
        name, must = "paper's road", f">= {PAPER_SAVING_PERCENT}"
    solved = {}
    for speed, mean in (("72 km/h mean", True), ("72 km/h set", False)):
        chosen = replace(BAND, mean_speed=mean)
        label = f"{name}, 55 t, {speed}, 45 to 90 km/h"
        solved[speed] = table.add(label, road, chosen, must=must)
    if config.quick:
        low = scaled_heights(road, LOW_HILLS)
        table.add(f"{name}, heights times {LOW_HILLS:g}, 55 t, 72 km/h set", low, BAND)
    else:
        _other_roads(config, table)
    checks = list(table.checks)
    pair = solved["72 km/h mean"]
    if pair is not None:
        case = pair[0]
        judged = bound_checks(case) + energy_checks(case)
        judged += convergence_checks(case, fine, optima=True)
        if not config.quick:
            elements = finite_elements(case)
            judged += element_checks(case, elements, must="-0.5 .. 0.5")
            table.notes += [elements.reason] if elements.reason else []
            results.figures[name] = panels(case, elements)
        prefix = f"{name}, 72 km/h mean: "
        checks += [replace(check, name=prefix + check.name) for check in judged]
        checks += cost_checks(case, LONG_QUICK if config.quick else LONG)
    if not config.quick:
        ahead = len(table.checks)
        results.figures["sensitivity"] = sensitivities(table, road, name)
        checks += table.checks[ahead:]
    found = Findings()
    apart, gap = max(table.apart, default=np.nan), 100.0 * max(table.gaps, default=np.nan)
    models = "savings by optimizer's model and by engine map apart, greatest of all"
    found.check(models, apart, "points")
    found.check("cost above the convex bound, greatest of all plans", gap, "%", 0.0, "<= 0.1")
    checks += found.checks
    results.checks = checks
    results.notes = [
        "savings are by the engine's map with gears; the reference beside them is the optimizer's "
        "model, where it is not the paper's figure; bands are those allowed, in equal trip time",
        "the rolling cruise may roll to the top of the band downhill, as today's trucks do; the "
        "braking cruise, which brakes at its set speed, is the paper's",
        "the optimizer's model knows power alone; above 19 m/s, in the top gear, the engine's "
        "friction rises with its speed, which is not convex over distance. Where little is saved "
        "(low hills, an empty truck) the model promises up to a point more than the map gives",
        *table.notes,
    ]
    return results


def _main_road(path: Path | None, step: float) -> RoadProfile:
    """Returns the paper's road if its file exists, else the highway, on a grid [m]."""
    if path is None:
        return highway_without_limits(step)
    return RoadProfile.from_csv(path, step, PAPER_LENGTH)


def highway_without_limits(step: float) -> RoadProfile:
    """Returns the built-in highway on a grid [m], without speed limits and curve speeds."""
    road = RoadProfile.from_route(RoadMap.builtin().route(), step=step)
    return replace(road, v_limit=np.full(road.station.size, np.inf))


def _other_roads(config: ValidateConfig, table: SavingsTable) -> None:
    """Adds the paper's road in the narrower band, the cycles and the highway, without bounds."""
    path = find_road(config, PAPER_ROAD)
    if path is not None:
        road = RoadProfile.from_csv(path, STEP, PAPER_LENGTH)
        for speed, mean in (("72 km/h mean", True), ("72 km/h set", False)):
            chosen = replace(BAND, v_max=85.0 * KMH, mean_speed=mean)
            table.add(f"paper's road, 55 t, {speed}, 45 to 85 km/h", road, chosen)
    for name, label in ((CYCLE_55, "GEM 55 mph"), (CYCLE_65, "GEM 65 mph")):
        path = find_road(config, name)
        if path is None:
            table.notes.append(f"{label}: {name} was not named: give --roads DIR")
            continue
        cycle = read_cycle(path, STEP)
        # Greatest speeds: that of the cycle, the EU's speed limiter, and 5 mph more than the cycle,
        # a frequent limit of such roads.
        tops = {cycle.speed, max(cycle.speed, BAND.v_max), cycle.speed + 5.0 * MPH}
        for top in sorted(tops):
            band = PccConfig(v_ref=cycle.speed, v_min=cycle.speed - 15.0 * MPH, v_max=top)
            for mass in (US_GROSS, GROSS_MASS):
                words = f"{band.v_min / MPH:.0f} to {top / MPH:.1f} mph"
                table.add(f"{label}, {mass / 1e3:.1f} t, {words}", cycle.road, band, mass)
    road = RoadProfile.from_route(RoadMap.builtin().route(), step=STEP)
    table.add("highway with its limits, 55 t, 72 km/h set, 45 to 90 km/h", road, BAND)
    if find_road(config, PAPER_ROAD) is not None:
        free = highway_without_limits(STEP)
        table.add("highway without limits, 55 t, 72 km/h set, 45 to 90 km/h", free, BAND)


def sensitivities(table: SavingsTable, road: RoadProfile, name: str) -> list[Panel]:
    """Returns the savings over band, mass, rolling resistance, power, hills and k_a, one by one."""
    truck, panels = TruckParameters.load(), []

    def sweep(
        quantity: str,
        unit: str,
        values: tuple[float, ...],
        solve_one: Callable[[str, float], tuple[SolvedPlan, SolvedPlan] | None],
    ) -> None:
        words = "" if unit == "1" else f" {unit}"
        solved = [(v, solve_one(f"{name}, {quantity} {v:g}{words}", v)) for v in values]
        found = [(value, pair) for value, pair in solved if pair is not None]
        x = np.array([value for value, _ in found], dtype=float)
        saved = np.array([[c.solution.map_saving_percent for c in pair] for _, pair in found])
        lines = tuple(
            Line(cruise, x, values, role)
            for cruise, values, role in zip(
                (ROLLING, BRAKING), saved.T, ("simulation", "reference"), strict=True
            )
        )
        title = f"{quantity} [{unit}]"
        panels.append(Panel(f"{name}: {quantity}", title, "saving [%]", lines))

    def band(
        quantity: str, unit: str, values: tuple[float, ...], of: Callable[[float], PccConfig]
    ) -> None:
        sweep(quantity, unit, values, lambda label, value: table.add(label, road, of(value)))

    speeds = (75.0, 80.0, 85.0, 90.0, 95.0)
    band("greatest speed", "km/h", speeds, lambda top: replace(BAND, v_max=top * KMH))
    band("least speed", "km/h", (45.0, 50.0, 55.0), lambda low: replace(BAND, v_min=low * KMH))
    sweep(
        "mass",
        "t",
        (19.0, 30.0, 40.0, 55.0),
        lambda label, mass: table.add(label, road, BAND, 1e3 * mass),
    )
    sweep(
        "rolling resistance",
        "1",
        (0.005, 0.006, 0.007),
        lambda label, c: table.add(label, road, BAND, GROSS_MASS, with_rolling(truck, c)),
    )
    sweep(
        "engine's full load times",
        "1",
        (0.8, 0.9, 1.0),
        lambda label, share: table.add(label, road, BAND, GROSS_MASS, with_power(truck, share)),
    )
    sweep(
        "heights times",
        "1",
        (LOW_HILLS, 0.5, 1.0, 1.25),
        lambda label, factor: table.add(label, scaled_heights(road, factor), BAND),
    )
    band("k_a", "g/s per (m/s2)2", (0.0, 0.5, 2.0), lambda k_a: replace(BAND, k_a=k_a))
    return panels
