"""Atlas of savings: roads, masses, bands and wind, against both cruises and beside the bound.

A cell is a road with a mass, a band of speeds and a wind. Its figures are by the engine's map in
the best gears, at the trip time of each cruise. The interval of a saving is its range when rolling
resistance and drag area change by 10 % and the mass by 3 %, one at a time. Without `every` the
atlas has, for each road, the middle cell and those that differ from it in one of mass, band and
wind. The MuJoCo truck drives the middle cell of each road: cruise and joint plan against the
rolling cruise, cruise and plan of speed alone against the braking one. Finished cells and drives in
the folder of runs are not computed again.
"""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Callable, Hashable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Generic

import numpy as np

from controllers.pcc import PccConfig, RoadProfile
from controllers.pcc.planner import plan
from iits_mj.core.arrays import FloatArray
from iits_mj.core.errors import PlanningError
from iits_mj.core.progress import each
from iits_mj.core.results import Findings, Line, Panel, Results
from iits_mj.core.tables import Row, read_columns, read_rows, write_rows
from iits_mj.core.units import KMH
from iits_mj.parameters import TruckParameters
from iits_mj.validation.harness.config import (
    CYCLE_55,
    CYCLE_65,
    PAPER_ROAD,
    ValidateConfig,
    find_road,
)
from iits_mj.validation.harness.run_cache import runs_folder
from iits_mj.validation.planning import (
    closed_loop,
    pcc_case,
    pcc_joint,
    pcc_replay,
    replay_drives,
)
from iits_mj.validation.planning.pcc_case import BRAKING, ROLLING, solve
from iits_mj.validation.planning.pcc_joint import compare_jointly
from iits_mj.validation.planning.pcc_replay import profile_case
from iits_mj.validation.planning.pcc_roads import read_cycle
from iits_mj.validation.planning.pcc_savings import PAPER_LENGTH, STEP, highway_without_limits
from iits_mj.validation.planning.replay_drives import DRIVES
from iits_mj.validation.planning.speed_tracking import gear_changes

LONG_HAUL = "long_haul_cycle.csv"
_LENGTH = 15_000.0  # [m]
MASSES = (19_000.0, 40_000.0, 55_000.0)  # [kg]
# Set speed, least and greatest speed [km/h].
BANDS = ((84.0, 79.0, 89.0), (80.0, 65.0, 90.0), (72.0, 45.0, 90.0))
WINDS = (0.0, 6.0, -6.0)  # [m/s], against the truck
Cell = tuple[float, tuple[float, float, float], float]  # mass, band, wind
MIDDLE = (MASSES[1], BANDS[1], WINDS[0])
_DRIVEN_STEP = 0.005  # of the physics [s]
_BY_LOAD = {"gearbox": {"shift_strategy": "adaptive"}}
# Changed one at a time for the interval: rolling resistance, drag area, mass.
_SPREAD = (
    *((1.1, 1.0, 1.0), (0.9, 1.0, 1.0)),
    *((1.0, 1.1, 1.0), (1.0, 0.9, 1.0)),
    *((1.0, 1.0, 1.03), (1.0, 1.0, 0.97)),
)


@dataclass(frozen=True)
class AtlasRow:
    """Figures of a cell; savings [%], `low` and `high` are the interval of the joint plan's.

    Attributes:
      road, mass, v_ref, v_min, v_max, head_wind: the cell [kg], [km/h], [m/s].
      alone, joint: saved by the plan of speed alone, and with gear and eco-roll, against the
        rolling cruise; bound: what no plan exceeds; braking: saved by the plan of speed alone
        against the braking cruise.
      closed: share of the gap between `alone` and `bound` that `joint` closes [%].
      changes, cruise_changes: of gear, joint plan and rolling cruise; neutral: share of road [%].
    """

    road: str
    mass: float
    v_ref: float
    v_min: float
    v_max: float
    head_wind: float
    alone: float
    joint: float
    low: float
    high: float
    bound: float
    braking: float
    closed: float
    changes: int
    cruise_changes: int
    neutral: float

    @property
    def key(self) -> tuple[str, float, float, float]:
        """Key of the cell in a table."""
        return self.road, self.mass, self.v_ref, self.head_wind


@dataclass(frozen=True)
class DrivenRow:
    """Figures of a middle cell on the MuJoCo truck, against one of the two cruises.

    Attributes:
      road: of the cell; cruise: "rolling" or "braking".
      saving: by the fuel meter, corrected for the difference at the ends [%]; expected: that of
        the drive ahead on the kinematic plant [%].
      cruise_fuel, plan_fuel: by the meter [kg]; late: trip time of the plan against that of the
        cruise [%].
      changes, cruise_changes: of gear; neutral: share of the plan's time [%].
    """

    road: str
    cruise: str
    saving: float
    expected: float
    cruise_fuel: float
    plan_fuel: float
    late: float
    changes: int
    cruise_changes: int
    neutral: float


@dataclass(frozen=True)
class Atlas:
    """Rows of the atlas in the order of the roads, and notes about what is missing."""

    rows: list[AtlasRow]
    driven: list[DrivenRow]
    notes: list[str]

    @property
    def middle(self) -> list[AtlasRow]:
        """The middle cells, by their saving."""
        cell = (MIDDLE[0], *MIDDLE[1], MIDDLE[2])
        found = [r for r in self.rows if (r.mass, r.v_ref, r.v_min, r.v_max, r.head_wind) == cell]
        return sorted(found, key=lambda row: row.joint)

    def on_truck(self, road: str, cruise: str) -> DrivenRow | None:
        """Returns the drives of a road against "rolling" or "braking", None without them."""
        return next((r for r in self.driven if (r.road, r.cruise) == (road, cruise)), None)


def made_roads() -> dict[str, RoadProfile]:
    """Returns the roads made by formula, each 15 km long on the plans' grid."""
    station = np.arange(0.0, _LENGTH + 1.0, STEP)

    def waves(grade: float, length: float) -> FloatArray:
        turn = 2.0 * np.pi / length
        return grade / turn * (1.0 - np.cos(turn * station))

    def random(grade: float, seed: int) -> FloatArray:
        """Waves of 1 to 8 km with random phases, whose grades have this root mean square."""
        rng, turns = np.random.default_rng(seed), 2.0 * np.pi / np.geomspace(1e3, 8e3, 12)
        parts = np.sin(np.outer(station, turns) + rng.uniform(0.0, 2.0 * np.pi, turns.size)) / turns
        height = parts.sum(axis=1)
        return height * grade / float(np.sqrt(np.mean(np.gradient(height, STEP) ** 2)))

    knots = [0.0, 3e3, 7e3, 8e3, 12e3, 15e3]
    heights = {
        "flat": 0.0 * station,
        "gently rolling": waves(0.01, 3_000.0),
        "rolling": waves(0.02, 2_000.0),
        "long waves": waves(0.015, 6_000.0),
        "lowland": random(0.008, 1),
        "upland": random(0.018, 2),
        "mountain pass": np.interp(station, knots, [0.0, 0.0, 160.0, 160.0, 0.0, 0.0]),
    }
    free = np.full(station.size, np.inf)
    return {name: RoadProfile(station, height, free, name) for name, height in heights.items()}


def read_long_haul(path: Path) -> RoadProfile:
    """Returns the road of a VECTO cycle from a CSV file with distance_m, grade_percent."""
    columns = (("distance_m",), ("grade_percent",))
    distance, percent = read_columns(path, "cycle", columns)
    height = np.concatenate([[0.0], np.cumsum(np.diff(distance) * percent[:-1] / 100.0)])
    moves = np.concatenate([[True], np.diff(distance) > 0.0])
    length = distance[-1] - distance[-1] % STEP
    return RoadProfile.from_heights(distance[moves], height[moves], STEP, length, "long haul", 0.0)


def atlas_roads(config: ValidateConfig) -> tuple[dict[str, RoadProfile], list[str]]:
    """Returns the roads of the atlas, and a note for each file that is missing."""
    roads: dict[str, RoadProfile] = {}
    notes: list[str] = []
    readers: tuple[tuple[str, str, Callable[[Path], RoadProfile]], ...] = (
        ("the paper's", PAPER_ROAD, lambda p: RoadProfile.from_csv(p, STEP, PAPER_LENGTH)),
        ("long haul", LONG_HAUL, read_long_haul),
        ("EPA 55 mph", CYCLE_55, lambda p: read_cycle(p, STEP).road),
        ("EPA 65 mph", CYCLE_65, lambda p: read_cycle(p, STEP).road),
    )
    for name, file, read in readers:
        path = find_road(config, file)
        if path is None:
            notes.append(f"road {name!r} is left out: {file} was not named, give --roads DIR")
        else:
            roads[name] = read(path)
    roads["our highway"] = highway_without_limits(STEP)
    return roads | made_roads(), notes


def cells(every: bool) -> list[Cell]:
    """Returns mass, band and wind of the cells of a road, the middle one first."""
    found = [(m, b, w) for m in MASSES for b in BANDS for w in WINDS]
    if not every:
        found = [c for c in found if sum(a != b for a, b in zip(c, MIDDLE, strict=True)) <= 1]
    return sorted(found, key=lambda cell: cell != MIDDLE)


def measure_cell(
    road: RoadProfile,
    name: str,
    cell: Cell,
    parameters: TruckParameters,
) -> AtlasRow:
    """Returns the figures of a cell.

    Raises:
      PlanningError: no plan exists, as where the truck cannot climb.
    """
    mass, band, wind = cell
    v_ref, v_min, v_max = band
    config = PccConfig(v_ref * KMH, v_min * KMH, v_max * KMH, head_wind=wind)
    case = solve(road, config, mass, parameters)
    braking = plan(road, parameters, mass, replace(config, rolls=False))
    found = compare_jointly(case)
    changed = [
        plan(road, _changed(parameters, *factors[:2]), factors[2] * mass, config).map_saving_percent
        for factors in _SPREAD
    ]
    offset = found.joint_saving - case.solution.map_saving_percent
    return AtlasRow(
        name,
        mass,
        *band,
        wind,
        found.convex_saving,
        found.joint_saving,
        min(*changed, case.solution.map_saving_percent) + offset,
        max(*changed, case.solution.map_saving_percent) + offset,
        found.bound_saving,
        braking.map_saving_percent,
        found.closed,
        found.joint.changes,
        found.cruise.changes,
        found.rolling_share,
    )


def _changed(parameters: TruckParameters, rolling: float, area: float) -> TruckParameters:
    """Returns the truck with factors on rolling resistance and air drag."""
    tires = {
        kind: replace(tire, rolling_resistance=rolling * tire.rolling_resistance)
        for kind, tire in parameters.tires.items()
    }
    air = replace(parameters.aerodynamics, density=area * parameters.aerodynamics.density)
    return replace(parameters, tires=tires, aerodynamics=air)


def drive_cell(
    road: RoadProfile, name: str, *, rolls: bool, folder: Path | None = None
) -> DrivenRow:
    """Returns the figures of a road's middle cell on the MuJoCo truck.

    Args:
      road: its profile.
      name: for the row.
      rolls: against the rolling cruise, with gear and eco-roll planned too; else against the
        braking one.
      folder: keeps finished drives.
    """
    mass, (v_ref, v_min, v_max), _ = MIDDLE
    config = PccConfig(v_ref * KMH, v_min * KMH, v_max * KMH, rolls=rolls)
    payload = mass - TruckParameters.load().gross_mass(0.0)
    case = profile_case(name, road, road, config, payload, _DRIVEN_STEP)
    case = replace(case, overlay=_BY_LOAD, joint=rolls)
    ahead = replay_drives.run_ahead(case, folder, DRIVES)
    replay = replay_drives.run(case, folder, DRIVES, ahead.vehicle)
    base, plan = replay.cruise, replay.plan
    return DrivenRow(
        name,
        "rolling" if rolls else "braking",
        100.0 * replay.saving,
        100.0 * ahead.saving,
        base.fuel,
        plan.fuel,
        100.0 * (plan.time / base.time - 1.0),
        gear_changes(plan.record),
        gear_changes(base.record),
        100.0 * float(np.mean(plan.record["gear"] == 0.0)),
    )


def compute_atlas(
    config: ValidateConfig, *, every: bool = False, minutes: float = math.inf
) -> Atlas:
    """Computes and drives the cells that the folder of runs does not have.

    Args:
      config: folders of roads and of runs.
      every: all 27 cells of a road.
      minutes: after which no further cell is begun; a note says how many are left.
    """
    roads, notes = atlas_roads(config)
    parameters = TruckParameters.load()
    modules = (pcc_case, pcc_joint, pcc_replay, replay_drives, closed_loop)
    folder = runs_folder(config, "pcc-atlas", sys.modules[__name__], *modules)
    found = _Kept(folder, "cells.csv", AtlasRow, lambda row: row.key)
    driven = _Kept(folder, "driven.csv", DrivenRow, lambda row: (row.road, row.cruise))
    # The middle cells of all roads come first, so that a stopped atlas has them.
    wanted = cells(every)
    order: tuple[Cell | bool, ...] = (*wanted, True, False)
    tasks = [(name, task) for task in order for name in roads]
    end, left = time.monotonic() + 60.0 * minutes, 0
    for name, task in each(tasks, "atlas", str):
        try:
            if isinstance(task, bool):
                kind, drive = "rolling" if task else "braking", partial(drive_cell, rolls=task)
                make = partial(drive, roads[name], name, folder=folder)
                left += not driven.get((name, kind), make, late=time.monotonic() > end)
            else:
                mass, band, wind = task
                measure = partial(measure_cell, roads[name], name, task, parameters)
                late = time.monotonic() > end
                left += not found.get((name, mass, band[0], wind), measure, late=late)
        except PlanningError as error:
            notes.append(f"{name}, {task}: {error}")
    if left:
        notes.append(f"{left} of {len(tasks)} cells and drives are left: run the command again")
    rows = sorted(found.asked, key=lambda row: list(roads).index(row.road))
    return Atlas(rows, driven.asked, notes)


class _Kept(Generic[Row]):
    """Rows that a file keeps, and those of them that were asked for."""

    def __init__(
        self, folder: Path | None, name: str, kind: type[Row], key: Callable[[Row], Hashable]
    ) -> None:
        self._path = None if folder is None else folder / name
        self._kind = kind
        self._rows = [] if self._path is None else read_rows(self._path, kind, "atlas")
        self._known = {key(row): row for row in self._rows}
        self.asked: list[Row] = []

    def get(self, key: Hashable, make: Callable[[], Row], *, late: bool) -> bool:
        """Adds a row to those asked for and returns whether there is one.

        A row that is not known is made and kept, unless it is late.
        """
        row = self._known.get(key)
        if row is None and late:
            return False
        if row is None:
            row = make()
            self._rows.append(row)
            if self._path is not None:
                write_rows(self._path, self._kind, self._rows, "atlas")
        self.asked.append(row)
        return True


def atlas_results(atlas: Atlas) -> Results:
    """Returns the atlas as checks, notes and one figure."""
    results = Results("pcc --atlas", notes=list(atlas.notes))
    for row in atlas.rows:
        found = Findings(
            f"{row.road}, {row.mass / 1e3:.0f} t, {row.v_min:g} to {row.v_max:g} km/h, wind "
            f"{row.head_wind:+g} m/s"
        )
        interval = f"{row.low:.1f} .. {row.high:.1f}"
        found.check(f"saved {ROLLING}, gear and eco-roll too", row.joint, "%", interval)
        found.check(f"saved {ROLLING}, speed alone", row.alone, "%")
        found.check("that no plan exceeds", row.bound, "%")
        found.check(f"saved {BRAKING}, speed alone", row.braking, "%")
        found.check("of the gap closed", min(max(row.closed, -999.0), 999.0), "%")
        found.check("changes of gear", row.changes, "1", float(row.cruise_changes))
        found.check("road in neutral", row.neutral, "%")
        results.checks += found.checks
    for drive in atlas.driven:
        against = ROLLING if drive.cruise == "rolling" else BRAKING
        found = Findings(f"{drive.road}, on the truck {against}")
        found.check("saved", drive.saving, "%", drive.expected)
        found.check("trip time against the cruise's", drive.late, "%")
        found.check("changes of gear", drive.changes, "1", float(drive.cruise_changes))
        results.checks += found.checks
    results.figures["atlas"] = atlas_panels(atlas)
    ranked = ", ".join(f"{i} {row.road}" for i, row in enumerate(atlas.middle, start=1))
    results.notes.append(f"roads of the figure: {ranked}")
    results.notes += [
        "savings by the engine's map in the best gears, at the trip time of each cruise; beside "
        "the first its range when rolling resistance and drag area change by 10 %, the mass by "
        "3 %; beside the changes of gear those of the cruise; beside a driven saving the one that "
        "the drive ahead on the kinematic plant expected",
        "the long haul is the road of VECTO's cycle, at the speeds of the band; flat to mountain "
        "pass are made by formula",
    ]
    return results


def atlas_panels(atlas: Atlas) -> list[Panel]:
    """Returns the savings of the middle cells over the roads, then all cells over the bound."""
    rows, middle = atlas.rows, atlas.middle
    order = np.arange(1.0, len(middle) + 1.0)
    lines = tuple(
        Line(label, order, np.array([getattr(row, name) for row in middle]), role)
        for label, name, role in (
            (f"{BRAKING} (the paper's), speed alone", "braking", "reference"),
            (f"{ROLLING}, bound", "bound", ""),
            (f"{ROLLING}, gear and eco-roll too", "joint", "simulation"),
            (f"{ROLLING}, speed alone", "alone", "second"),
        )
    )
    title = f"{MIDDLE[0] / 1e3:.0f} t, {MIDDLE[1][1]:g} to {MIDDLE[1][2]:g} km/h, calm"
    panels = [Panel(title, "road, in the order of the notes", "saving [%]", lines)]
    for what, name in (("mass [t]", "mass"), ("head wind [m/s]", "head_wind")):
        scale = 1e-3 if name == "mass" else 1.0
        curves = []
        for row in middle:
            same = [r for r in rows if r.road == row.road and r.v_ref == row.v_ref]
            others = "head_wind" if name == "mass" else "mass"
            same = [r for r in same if getattr(r, others) == getattr(row, others)]
            same = sorted(same, key=lambda r: getattr(r, name))
            x = np.array([scale * getattr(r, name) for r in same])
            curves.append(Line(row.road, x, np.array([r.joint for r in same])))
        panels.append(Panel(f"gear and eco-roll too, {ROLLING}", what, "saving [%]", tuple(curves)))
    return panels
