"""`iits-mj validate aeb`: emergency braking by UN Regulation No. 131 and beyond it.

Regulation No. 131, 02 series of amendments (2023), table 1, category N3: the relative speed at the
impact on a car, standing or moving, is at most 0 up to 70 km/h, 28 km/h at 80 and 42 km/h at 90; a
warning comes 0.8 s before the emergency braking phase, in which 4 m/s2 or more are demanded; table
2 has the impact speeds on a child that crosses at 5 km/h. 01 series (2014), annex 3, and Commission
Regulation (EU) 347/2012, annex II, appendix 2: from 80 km/h at least 20 km/h less at a standing car
and no impact on one of 12 km/h; one warning 1.4 s and two of them 0.8 s before that phase, which
does not begin before a time to collision of 3 s; before it the speed falls by at most 15 km/h or 30
% of the whole reduction. Both: no reaction to two cars that stand 4.5 m apart, at 50 km/h. The
first warning is acoustic and optical here, the partial braking is the haptic one.

The planner sees no vehicle and keeps the speed, the emergency braking has the sensors `front` with
their noise. All tests are on a straight road unless said otherwise.
"""

from __future__ import annotations

import dataclasses
import itertools

import numpy as np

from iits_mj.core.messages import EgoFootprint
from iits_mj.core.progress import each
from iits_mj.core.results import Findings, Line, Results
from iits_mj.core.timing import TIMESTEP
from iits_mj.core.units import KMH
from iits_mj.road import RoadMap
from iits_mj.simulation import DriveConfig, DriveFrame, Observer, Simulation
from iits_mj.simulation.lock_step import LockStep
from iits_mj.simulation.sensors import SUITES
from iits_mj.validation.aeb.drives import (
    BASE,
    WARNED,
    CarefulDriver,
    Drive,
    at,
    drive,
    scenario,
    straight,
)
from iits_mj.validation.harness.config import ValidateConfig
from traffic_bridge import PlaceVehicle
from traffic_bridge.signals.events import Event

# UN R131, 02 series: speed [km/h], greatest impact speed [km/h] on a car and on a child.
CAR_IMPACTS = {20: 0, 40: 0, 60: 0, 70: 0, 80: 28, 90: 42}
CHILD_IMPACTS = {20: 0, 30: 18, 40: 29, 50: 39, 60: 49}
CHILD_SPEED = 5.0  # [km/h]
# 01 series: [km/h], [s].
REDUCTION, MOVING, WARNED_BEFORE, TWO_MODES, NOT_BEFORE = 20.0, 12.0, 1.4, 0.8, 3.0
EARLY_REDUCTION, EARLY_SHARE = 15.0, 0.3
# False reaction: speed [km/h], clear width between the cars and width of one [m].
PASSING, CLEAR, CAR_WIDTH = 50.0, 4.5, 1.9
# Beyond the regulation: friction and grade; time gap [s] and deceleration [m/s2]; gap [m] and speed
# difference [km/h].
ROADS = ((0.5, 0.0), (0.8, -0.06), (0.8, 0.04), (0.5, -0.06), (0.5, 0.04))
BRAKINGS = tuple(itertools.product((0.6, 0.8, 1.0, 1.3, 1.6, 2.0), (4.0, 6.0, 8.0)))
CUT_INS = tuple(itertools.product((5.0, 10.0, 15.0, 20.0, 30.0), (10.0, 20.0, 30.0, 40.0)))
TRAFFIC = tuple(itertools.product(("dense", "D", "E"), ("perfect", "surround"), (0, 1)))
# Time to collision with the target at the start; time at which a braking begins, and duration of a
# cut-in [s].
_FIRST, _BEGINS, CUT_IN = 7.0, 3.0, 4.0
# A difference of impact speeds that is none [km/h].
SAME = 0.1


def run(config: ValidateConfig) -> Results:
    """Drives the regulation's tests, loads and roads, the careful driver's cases, and traffic."""
    results, quick = Results("validate aeb"), config.quick
    base = dataclasses.replace(BASE, truck=config.truck)
    step = config.timestep or TIMESTEP
    for payload in config.payloads()[:1] if quick else config.payloads():
        loaded = dataclasses.replace(base, payload=payload)
        load = f"{payload / 1e3:g}t"
        results.add(f"cars_{load}", cars(loaded, step, quick))
        results.add("", crossing_child(loaded, step, quick))
    results.add("", false_reactions(base, step, quick))
    results.add("driver", _against_driver(base, step, quick))
    results.add("", _traffic(config, step))
    results.notes.append(
        "The careful driver is performance model 1 of UN R157, annex 3: 0.4 s of perception, "
        "0.75 s to the brakes, 12.65 m/s3 up to 0.774 g, with perfect sight. The brakes are the "
        "truck's."
    )
    return results


def _kmh(speed: float) -> float:
    return speed / KMH


def cars(config: DriveConfig, step: float, quick: bool) -> Findings:
    """A standing car from each speed, one of 12 km/h, and a standing one on other roads."""
    found = Findings()
    cases = [(speed, 0.0, 0.8, 0.0) for speed in ((40, 80) if quick else CAR_IMPACTS)]
    cases += [(80, MOVING, 0.8, 0.0), *((80, 0.0, *road) for road in ROADS[: 1 if quick else None])]
    for speed, target, friction, grade in cases:
        gap, other = max(_FIRST * (speed - target) * KMH, 25.0), (friction, grade) in ROADS
        events = scenario("r131_car", gap=gap, speed=target * KMH)
        road = straight(friction, grade)
        made = drive(at(config, speed, 40.0), events, road, timestep=step)
        name = f"car of {target:g} km/h at {speed} km/h"
        name += f", friction {friction:g}, grade {100.0 * grade:+.0f} %" if other else ""
        found.label = _label(name, config)
        most = 0 if target else CAR_IMPACTS[speed]
        found.check("impact", _kmh(made.impact), "km/h", float(most), f"<= {most}")
        if speed != 80:
            continue
        warned = made.warned_before
        found.check("first warning before the braking", warned, "s", WARNED_BEFORE, ">= 1.4")
        if not other:
            _phases(found, made)
    return found


def _phases(found: Findings, made: Drive) -> None:
    """Checks what 01 series asks of a drive at 80 km/h."""
    lost, haptic = _kmh(made.speed[0] - made.speed[-1]), made.haptic_before
    found.check("speed reduction", lost, "km/h", REDUCTION, f">= {REDUCTION:g}")
    found.check("haptic warning before the braking", haptic, "s", TWO_MODES, ">= 0.8")
    ttc = float(np.interp(made.braked_at, made.time, np.minimum(made.ttc, 99.0)))
    found.check("time to collision at the braking", ttc, "s", NOT_BEFORE, f"<= {NOT_BEFORE:g}")
    before, then = np.interp([made.first(*WARNED), made.braked_at], made.time, made.speed)
    most, early = max(EARLY_REDUCTION, EARLY_SHARE * lost), _kmh(before - then)
    found.check("speed lost before the braking", early, "km/h", most, f"<= {most:.3g}")
    found.history("speed", "speed [km/h]", made.time, made.speed / KMH)
    found.history("demand", "demand [m/s2]", made.time, made.demand)


def crossing_child(config: DriveConfig, step: float, quick: bool) -> Findings:
    """A child crosses so that an unbraked truck would hit it with the middle of its front."""
    found = Findings(_label("child of 5 km/h", config))
    begin = config.start_station
    middle = float(straight().lane_offset(config.start_lane, begin))
    for speed in (20,) if quick else tuple(CHILD_IMPACTS):
        x = begin + EgoFootprint().front_overhang + _FIRST * speed * KMH
        child = scenario("r131_child", station=x, offset=middle, speed=CHILD_SPEED * KMH)
        made, most = drive(at(config, speed), child, timestep=step), CHILD_IMPACTS[speed]
        # The child moves across: the truck's own speed counts.
        hit = _kmh(made.speed[-1]) if "collision" in made.ended else 0.0
        found.check(f"impact at {speed} km/h", hit, "km/h", float(most), f"<= {most}")
    return found


def two_cars() -> tuple[Event, ...]:
    """Two cars that stand at both sides of the way."""
    return scenario("r131_two_cars", clear=CLEAR, width=CAR_WIDTH)


def false_reactions(config: DriveConfig, step: float, quick: bool) -> Findings:
    """Cars at both sides, cars on the shoulder of bends, and radar ghosts: nothing must happen."""
    found, aside = Findings("no reaction"), 0.5 * (CLEAR + CAR_WIDTH)
    passing = at(config, PASSING, 8.0)
    reacted = sum(
        drive(dataclasses.replace(passing, seed=seed), two_cars(), timestep=step).reacted
        for seed in range(1 if quick else 10)
    )
    found.check(f"cars {CLEAR:g} m apart at 50 km/h: reactions", reacted, "1", 0.0, "== 0")
    many = tuple(
        dataclasses.replace(sensor, ghosts=0.0 if sensor.camera else 5.0, ghost_life=2.0)
        for sensor in SUITES["front"]
    )
    ghosts = drive(at(config, 80.0, 8.0 if quick else 90.0), sensors=many, timestep=step)
    found.check("ghosts of the radars, 10 per s and 2 s long", ghosts.reacted, "1", 0.0, "== 0")
    if quick:
        return found
    shoulder = [
        PlaceVehicle(
            name=f"car{k}", station=station, lane=0, offset=-aside, speed=0.0, reactive=False
        )
        for k, station in enumerate(np.arange(1_200.0, 3_200.0, 100.0))
    ]
    begin = dataclasses.replace(at(config, 70.0, 110.0), start_station=1_000.0, start_lane=0)
    bends = drive(begin, shoulder, RoadMap.builtin().route(), timestep=step)
    found.check("cars on the shoulder of bends at 70 km/h", bends.reacted, "1", 0.0, "== 0")
    return found


def braking(time_gap: float, deceleration: float) -> tuple[Event, ...]:
    """A car ahead at 80 km/h, with a time gap [s], that brakes to a stop [m/s2]."""
    times = {"time_gap": time_gap, "begins": _BEGINS}
    return scenario("r157_braking", speed=80.0 * KMH, deceleration=deceleration, **times)


def cut_in(gap: float, difference: float) -> tuple[Event, ...]:
    """A car that changes to the truck's lane at a gap [m], slower than 80 km/h by [km/h]."""
    return scenario("r157_cut_in", gap=gap, slower=difference * KMH, duration=CUT_IN)


def _against_driver(config: DriveConfig, step: float, quick: bool) -> Findings:
    """Cars that brake or cut in: the emergency braking against the careful driver."""
    found, order = Findings("against the careful driver"), []
    for kind, make, cases in (
        ("brakings", braking, BRAKINGS[1:2] if quick else BRAKINGS),
        ("cut-ins", cut_in, CUT_INS[9:10] if quick else CUT_INS),
    ):
        rows = [
            [
                _kmh(drive(at(config, 80.0), make(*case), guard=guard, timestep=step).impact)
                for guard in (CarefulDriver(), None)
            ]
            for case in each(cases, kind, str)
        ]
        driver, aeb = np.array(rows).T
        avoided = np.sum((driver == 0.0) & (aeb > 0.0))
        found.check(f"{kind}: impacts that the driver avoids", avoided, "1", 0.0, "== 0")
        more = np.max(aeb - driver)
        found.check(f"{kind}: greatest excess of the impact", more, "km/h", 0.0, f"<= {SAME:g}")
        found.check(f"{kind}: impacts of the driver", np.sum(driver > 0.0), "1")
        found.check(f"{kind}: impacts with emergency braking", np.sum(aeb > 0.0), "1")
        number = np.arange(1.0, len(cases) + 1.0)
        lines = Line("careful driver", number, driver, "reference"), Line("AEB", number, aeb)
        found.panel(f"{kind} at 80 km/h", "case", "impact [km/h]", *lines)
        order.append(", ".join(f"{first:g}/{second:g}" for first, second in cases))
    found.notes.append(
        f"Cases in this order. Brakings, time gap [s] and deceleration [m/s2]: {order[0]}. "
        f"Cut-ins, gap [m] at the begin and speed difference [km/h]: {order[1]}."
    )
    return found


class _Reactions(Observer):
    """Counts the times at which the emergency braking leaves its standby."""

    count, _was = 0, False

    def observe(self, simulation: LockStep, frame: DriveFrame) -> None:
        del simulation
        reacts = frame.emergency is not None and frame.emergency.state in WARNED
        self.count += reacts and not self._was
        self._was = reacts


def _traffic(config: ValidateConfig, step: float) -> Findings:
    """The whole stack in ordinary traffic: a reaction would be a false one."""
    found, log, time, collisions = Findings("whole stack in traffic"), _Reactions(), 0.0, 0
    cases = [("dense", "surround", 0)] if config.quick else TRAFFIC
    for density, sensors, seed in each(cases, "driving in traffic", str):
        setup = DriveConfig(
            truck=config.truck,
            density=density,
            sensors=sensors,
            seed=seed,
            start_station=1_000.0 + 4_000.0 * seed,
            duration=60.0 if config.quick else 300.0,
            aeb="on",
        )
        with Simulation(setup, visuals=False, timestep=step) as simulation:
            summary = simulation.run([log])
        time += summary.duration
        collisions += summary.collision
    found.check("time driven", time / 60.0, "min")
    found.check("warnings and brakings", log.count, "1", 0.0, "== 0")
    found.check("collisions", collisions, "1", 0.0, "== 0")
    return found


def _label(name: str, config: DriveConfig) -> str:
    return f"{name}, {(config.payload or 0.0) / 1e3:g} t load"
