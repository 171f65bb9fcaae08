"""The roads on which plan and cruise are driven against each other on the MuJoCo truck."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np

from controllers.pcc.planner import PccConfig
from controllers.pcc.profile import RoadProfile
from controllers.planning.speed_plan import SpeedConfig
from iits_mj.core.units import KMH
from iits_mj.road import RoadMap, Route
from iits_mj.road.measured import Lanes, measured_route
from iits_mj.validation.harness.config import (
    CYCLE_55,
    CYCLE_65,
    PAPER_ROAD,
    ValidateConfig,
    find_road,
)
from iits_mj.validation.planning.closed_loop import Task
from iits_mj.validation.planning.pcc_roads import read_cycle
from iits_mj.validation.planning.pcc_savings import BAND, MPH, PAPER_LENGTH, STEP
from iits_mj.validation.planning.replay_drives import RUN_IN, RUN_OUT, Case

# Where the law has no speed limiter: 100 km/h is what trucks may drive on Chinese expressways, the
# paper's (regulation on the road traffic safety law, article 78).
_CHINA = 100.0 * KMH
# The gearbox that chooses by load and fuel; with the published shift speeds the truck has 50 kW
# less on climbs, so that a mean of 72 km/h takes a set speed near the band's end.
_BY_LOAD = {"gearbox": {"shift_strategy": "adaptive"}}
# On the cycles: 5 mph above and 15 mph below the cycle's speed.
_ABOVE, _BELOW = 5.0 * MPH, 15.0 * MPH
# Of a route beyond the measured stretch: the planner stops before a road's end in sight [m].
_LEFT = 600.0
# The limits are the planner's affair, not the road's, where it is a bare profile [m/s].
_UNLIMITED = 40.0
LADEN, EMPTY = 36_000.0, 0.0


def paper_case(
    config: ValidateConfig,
    settings: PccConfig = BAND,
    payload: float = LADEN,
    timestep: float = Task.timestep,
    by_load: bool = False,
    must: bool = False,
) -> Case | None:
    """The paper's road at a set or a mean speed; None where its file is not at hand.

    Args:
      config: where roads are looked for.
      settings: speeds and band.
      payload: [kg].
      timestep: of the physics [s].
      by_load: gears by load and fuel, not by the published shift speeds.
      must: whether the paper's saving is to be reached.
    """
    path = find_road(config, PAPER_ROAD)
    if path is None:
        return None
    road = RoadProfile.from_csv(path, STEP, PAPER_LENGTH)
    # The truck drives the measured heights every 10 m, the planner sees every fifth.
    fine = RoadProfile.from_csv(path, 10.0, PAPER_LENGTH + 200.0)
    kind = "mean" if settings.mean_speed else "set"
    speeds = f"{settings.v_ref / KMH:.0f} km/h {kind}, up to {settings.v_max / KMH:.0f}"
    name = f"the paper's road, {speeds}" + (", gears by load" if by_load else "")
    case = _bare(name, road, fine, settings, payload, timestep)
    return dataclasses.replace(case, overlay=_BY_LOAD if by_load else {}, paper=must)


def cycle_case(config: ValidateConfig, name: str, payload: float = LADEN) -> Case | None:
    """A certification cycle's grades at the cycle's own speed; None without the file."""
    path = find_road(config, name)
    if path is None:
        return None
    cycle = read_cycle(path, STEP)
    settings = PccConfig(v_ref=cycle.speed, v_min=cycle.speed - _BELOW, v_max=cycle.speed + _ABOVE)
    title = {CYCLE_55: "EPA GEM 55 mph", CYCLE_65: "EPA GEM 65 mph"}.get(name, name)
    return _bare(title, cycle.road, cycle.road, settings, payload, Task.timestep)


def highway_case(
    payload: float = LADEN, length: float | None = None, timestep: float = Task.timestep
) -> Case:
    """Our own highway with its limits and curves, cruised at 72 km/h or what the limit is."""
    return _along(RoadMap.builtin().route(), "our highway", payload, length, timestep)


def valley_case(length: float, timestep: float, depth: float = 0.04) -> Case:
    """Down and up again, for the quick form."""
    fine = np.arange(0.0, length + 1.0, 10.0)
    height = -depth * (length - fine) * fine / length
    road = RoadProfile.from_heights(fine, height, STEP, name="valley")
    return _bare("a valley", road, road, BAND, EMPTY, timestep)


def full_cases(config: ValidateConfig) -> list[Case]:
    """Those of the full form whose files are at hand, the paper's road first.

    The paper's saving is to be reached with gears by load: at 72 km/h mean within what China's law
    allows, and at 72 km/h set within the speed limiter. The others say what the band is worth, and
    what gear changes at the published speeds cost.

    With a payload named in the config only the cases with that load.
    """
    mean = dataclasses.replace(BAND, mean_speed=True)
    wide = dataclasses.replace(mean, v_max=_CHINA)
    cases = [
        paper_case(config, wide, by_load=True, must=True),
        paper_case(config, by_load=True, must=True),
        paper_case(config, mean, by_load=True),
        paper_case(config),
        paper_case(config, wide),
        paper_case(config, payload=EMPTY),
        highway_case(),
        cycle_case(config, CYCLE_55),
        cycle_case(config, CYCLE_65),
    ]
    step = Task.timestep if config.timestep is None else config.timestep
    wanted = [case for case in cases if case is not None]
    if config.payload is not None:
        wanted = [case for case in wanted if case.payload == config.payload]
    return [dataclasses.replace(case, timestep=step) for case in wanted]


def _along(
    route: Route,
    name: str,
    payload: float,
    length: float | None = None,
    timestep: float = Task.timestep,
) -> Case:
    """A route with its limits and curves, from behind the run-in to before its end."""
    wanted = route.length - RUN_IN - _LEFT if length is None else length
    road = RoadProfile.from_route(
        route, RUN_IN, wanted, STEP, lateral_acceleration=SpeedConfig.curve_acceleration
    )
    return Case(name, route, road, 0.0, BAND, payload, timestep)


def _bare(
    name: str,
    road: RoadProfile,
    fine: RoadProfile,
    settings: PccConfig,
    payload: float,
    timestep: float,
) -> Case:
    """A straight road with these heights, begun and ended on its first and last grade."""
    before = np.arange(-RUN_IN, -1e-6, fine.step)
    after = np.arange(fine.step, RUN_OUT + _LEFT, fine.step)
    first, last = float(fine.grade[0]), float(fine.grade[-1])
    station = fine.station - fine.station[0]
    height = np.concatenate(
        [fine.height[0] + first * before, fine.height, fine.height[-1] + last * after]
    )
    stations = np.concatenate([before, station, station[-1] + after])
    route: Route = measured_route(
        stations, height, lanes=Lanes(speed_limit=_UNLIMITED), name=Path(road.name).stem
    )
    return Case(name, route, road, RUN_IN - float(road.station[0]), settings, payload, timestep)
