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
import math

import numpy as np

from controllers.emergency_braking import EmergencyState
from iits_mj.core.messages import EgoFootprint
from iits_mj.core.progress import each
from iits_mj.core.results import Findings, Line, Results
from iits_mj.core.timing import TIMESTEP
from iits_mj.core.units import KMH
from iits_mj.road import RoadMap, Route
from iits_mj.simulation import DriveConfig, DriveFrame, Observer, Simulation
from iits_mj.simulation.lock_step import LockStep
from iits_mj.simulation.sensors import SUITES
from iits_mj.validation.aeb.drives import LANE, START, Drive, Setup, drive, kmh
from iits_mj.validation.harness.config import ValidateConfig
from traffic_bridge import PlaceVehicle
from traffic_bridge.scenario.actions import Brake, ChangeLane, SceneEvent

# UN R131, 02 series: speed [km/h], greatest impact speed [km/h] on a car and on a child.
CAR_IMPACTS = {20: 0, 40: 0, 60: 0, 70: 0, 80: 28, 90: 42}
CHILD_IMPACTS = {20: 0, 30: 18, 40: 29, 50: 39, 60: 49}
CHILD_SPEED = 5.0  # [km/h]
# 01 series: [km/h], [s].
REDUCTION, MOVING, WARNED, TWO_MODES, NOT_BEFORE = 20.0, 12.0, 1.4, 0.8, 3.0
EARLY_REDUCTION, EARLY_SHARE = 15.0, 0.3
# False reaction: speed [km/h] and clear width between the cars [m].
PASSING, CLEAR = 50.0, 4.5
# Beyond the regulation.
WET = 0.5
GRADES = (-0.06, 0.04)
BRAKINGS = tuple(itertools.product((0.6, 0.8, 1.0, 1.3, 1.6, 2.0), (4.0, 6.0, 8.0)))
CUT_INS = tuple(itertools.product((5.0, 10.0, 15.0, 20.0, 30.0), (10.0, 20.0, 30.0, 40.0)))
TRAFFIC = ("dense", "D", "E")
TRAFFIC_SEEDS, TRAFFIC_DURATION = 2, 300.0
# Time to collision with the target at the start [s].
_FIRST = 7.0
# Time after which a braking or a cut-in begins [s], and the duration of the cut-in [s].
_BEGINS, _CUT_IN = 3.0, 4.0
_CAR_WIDTH = 1.9
# A difference of impact speeds that is none [km/h].
_SAME = 0.1


def run(config: ValidateConfig) -> Results:
    """Drives the regulation's tests, loads and roads, the careful driver's cases, and traffic."""
    results = Results("validate aeb")
    step = config.timestep or TIMESTEP
    base = Setup(speed=0.0, events=(), truck=config.truck, timestep=step)
    for payload in config.payloads()[:1] if config.quick else config.payloads():
        loaded = dataclasses.replace(base, payload=payload)
        load = f"{payload / 1e3:g}t"
        results.add(f"standing_{load}", _standing(loaded, config.quick))
        results.add(f"moving_{load}", _moving(loaded))
        results.add("", _child(loaded, config.quick))
        results.add("", _beyond(loaded, config.quick))
    results.add("", _false_reactions(base, config.quick))
    results.add("driver", _driver(base, config.quick))
    results.add("", _traffic(config))
    results.notes.append(
        "The careful driver is performance model 1 of UN R157, annex 3: 0.4 s of perception, "
        "0.75 s to the brakes, 12.65 m/s3 up to 0.774 g, with perfect sight. The brakes are the "
        "truck's."
    )
    return results


def _target(setup: Setup, speed: float, target: float) -> Setup:
    """The setup with a car ahead; speeds [km/h]."""
    gap = max(_FIRST * (speed - target) * KMH, 25.0)
    car = PlaceVehicle(
        name="car", gap=gap, relative_lane=0, speed=target * KMH, reactive=False, type="car"
    )
    return dataclasses.replace(setup, speed=speed * KMH, events=(car,), duration=40.0)


def _warnings(found: Findings, made: Drive) -> None:
    """Checks the times of the warnings and what the speed loses before the emergency braking."""
    at = made.braked_at
    found.check("first warning before the braking", made.warned_before, "s", WARNED, ">= 1.4")
    found.check("haptic warning before the braking", made.haptic_before, "s", TWO_MODES, ">= 0.8")
    ttc = float(np.interp(at, made.time, np.minimum(made.ttc, 99.0)))
    found.check("time to collision at the braking", ttc, "s", NOT_BEFORE, f"<= {NOT_BEFORE:g}")
    lost = kmh(made.speed_at(made.first(EmergencyState.WARNING)) - made.speed_at(at))
    whole = kmh(made.speed[0] - made.speed[-1])
    most = max(EARLY_REDUCTION, EARLY_SHARE * whole)
    found.check("speed lost before the braking", lost, "km/h", most, f"<= {most:.3g}")


def _histories(found: Findings, made: Drive) -> None:
    found.history("speed", "speed [km/h]", made.time, made.speed / KMH)
    found.history("demand", "demand [m/s2]", made.time, made.demand)
    names = list(EmergencyState)
    stages = np.array([names.index(state) for state in made.states], dtype=float)
    marks = ", ".join(f"{k} {state.value}" for k, state in enumerate(names))
    found.panel(
        "stage",
        "time [s]",
        "stage [-]",
        Line(marks, made.time, stages, "simulation"),
    )


def _standing(setup: Setup, quick: bool) -> Findings:
    """A standing car from each speed of the table."""
    found = Findings()
    speeds = (40, 80) if quick else tuple(CAR_IMPACTS)
    for speed in speeds:
        made = drive(_target(setup, speed, 0.0))
        found.label = _label(f"standing car at {speed} km/h", setup)
        most = CAR_IMPACTS[speed]
        found.check("impact", kmh(made.impact), "km/h", float(most), f"<= {most}")
        if speed == 80:
            lost = speed - kmh(made.impact)
            found.check("speed reduction", lost, "km/h", REDUCTION, f">= {REDUCTION:g}")
            _warnings(found, made)
            _histories(found, made)
    return found


def _moving(setup: Setup) -> Findings:
    """A car of 12 km/h from 80 km/h."""
    made = drive(_target(setup, 80.0, MOVING))
    found = Findings(_label(f"car of {MOVING:g} km/h at 80 km/h", setup))
    found.check("impact", kmh(made.impact), "km/h", 0.0, "<= 0")
    _warnings(found, made)
    found.history("speed", "speed [km/h]", made.time, made.speed / KMH)
    return found


def _child(setup: Setup, quick: bool) -> Findings:
    """A child crosses so that an unbraked truck would hit it with the middle of its front."""
    found = Findings(_label("child of 5 km/h", setup))
    route, footprint = Route.straight(length=1000.0), EgoFootprint()
    middle = float(route.lane_offset(LANE, START))
    for speed in (20,) if quick else tuple(CHILD_IMPACTS):
        way = _FIRST * CHILD_SPEED * KMH
        x = START + footprint.front_overhang + _FIRST * speed * KMH
        child = PlaceVehicle(
            name="child",
            type="pedestrian",
            points=((x, middle - way), (x, middle + 20.0)),
            speed=CHILD_SPEED * KMH,
        )
        made = drive(dataclasses.replace(setup, speed=speed * KMH, events=(child,), duration=20.0))
        most = CHILD_IMPACTS[speed]
        # The child moves across: the truck's own speed counts.
        hit = kmh(made.speed[-1]) if "collision" in made.ended else 0.0
        found.check(f"impact at {speed} km/h", hit, "km/h", float(most), f"<= {most}")
    return found


def _beyond(setup: Setup, quick: bool) -> Findings:
    """A standing car at 80 km/h on a wet road and on grades; the same bound."""
    found = Findings()
    cases = [(WET, 0.0), *((0.8, g) for g in GRADES), *((WET, g) for g in GRADES)]
    for friction, grade in cases[:1] if quick else cases:
        made = drive(dataclasses.replace(_target(setup, 80.0, 0.0), friction=friction, grade=grade))
        road = f"friction {friction:g}, grade {100.0 * grade:+.0f} %"
        found.label = _label(f"standing car at 80 km/h, {road}", setup)
        found.check("impact", kmh(made.impact), "km/h", 28.0, "<= 28")
        found.check("first warning before the braking", made.warned_before, "s", WARNED, ">= 1.4")
    return found


def _false_reactions(setup: Setup, quick: bool) -> Findings:
    """Cars at both sides, cars on the shoulder of bends, and radar ghosts: nothing must happen."""
    found = Findings("no reaction")
    aside = 0.5 * (CLEAR + _CAR_WIDTH)
    sides: tuple[SceneEvent, ...] = tuple(
        PlaceVehicle(
            name=name, gap=70.0, relative_lane=0, offset=sign * aside, speed=0.0, reactive=False
        )
        for name, sign in (("left", 1.0), ("right", -1.0))
    )
    seeds = range(1 if quick else 10)
    passes = [
        drive(
            dataclasses.replace(setup, speed=PASSING * KMH, events=sides, duration=8.0, seed=seed)
        )
        for seed in seeds
    ]
    reacted = sum(made.reacted for made in passes)
    found.check(f"cars {CLEAR:g} m apart at 50 km/h: reactions", reacted, "1", 0.0, "== 0")
    noisy = dataclasses.replace(
        SUITES["front"],
        sensors=tuple(
            dataclasses.replace(s, ghosts=0.0 if s.camera else 5.0, ghost_life=2.0)
            for s in SUITES["front"].sensors
        ),
    )
    ghosts = drive(
        dataclasses.replace(setup, speed=80.0 * KMH, duration=8.0 if quick else 90.0, suite=noisy)
    )
    found.check("ghosts of the radars, 10 per s and 2 s long", ghosts.reacted, "1", 0.0, "== 0")
    if quick:
        return found
    highway = RoadMap.builtin().route()
    shoulder = tuple(
        PlaceVehicle(
            name=f"car{k}", station=place, lane=0, offset=-aside, speed=0.0, reactive=False
        )
        for k, place in enumerate(np.arange(1_200.0, 3_200.0, 100.0))
    )
    bends = drive(
        dataclasses.replace(
            setup,
            speed=70.0 * KMH,
            events=shoulder,
            duration=110.0,
            route=highway,
            station=1_000.0,
            lane=0,
        )
    )
    found.check("cars on the shoulder of bends at 70 km/h", bends.reacted, "1", 0.0, "== 0")
    return found


def _driver(setup: Setup, quick: bool) -> Findings:
    """Cars that brake or cut in: the emergency braking against the careful driver."""
    found = Findings("against the careful driver")
    kinds = {
        "brakings": BRAKINGS[1:2] if quick else BRAKINGS,
        "cut-ins": CUT_INS[9:10] if quick else CUT_INS,
    }
    speed = 80.0 * KMH
    for kind, cases in kinds.items():
        rows = []
        for first, second in each(list(cases), kind, str):
            events = _braking(first, second) if kind == "brakings" else _cut_in(first, second)
            one = dataclasses.replace(setup, speed=speed, events=events, duration=20.0)
            rows.append(
                [kmh(drive(dataclasses.replace(one, guard=g)).impact) for g in ("driver", "aeb")]
            )
        driver, aeb = np.array(rows).T
        avoided = int(np.sum((driver == 0.0) & (aeb > 0.0)))
        found.check(f"{kind}: impacts that the driver avoids", avoided, "1", 0.0, "== 0")
        more = float(np.max(aeb - driver))
        found.check(f"{kind}: greatest excess of the impact", more, "km/h", 0.0, f"<= {_SAME:g}")
        found.check(f"{kind}: impacts of the driver", np.sum(driver > 0.0), "1")
        found.check(f"{kind}: impacts with emergency braking", np.sum(aeb > 0.0), "1")
        number = np.arange(1.0, len(cases) + 1.0)
        found.panel(
            f"{kind} at 80 km/h",
            "case",
            "impact [km/h]",
            Line("careful driver", number, driver, "reference"),
            Line("emergency braking", number, aeb, "simulation"),
        )
    found.notes.append(
        "Cases in this order. Brakings, time gap [s] and deceleration [m/s2]: "
        + ", ".join(f"{gap:g}/{a:g}" for gap, a in kinds["brakings"])
        + ". Cut-ins, gap [m] at the begin and speed difference [km/h]: "
        + ", ".join(f"{gap:g}/{dv:g}" for gap, dv in kinds["cut-ins"])
        + "."
    )
    return found


def _braking(time_gap: float, deceleration: float) -> tuple[SceneEvent, ...]:
    speed = 80.0 * KMH
    car = PlaceVehicle(
        name="car", gap=time_gap * speed, relative_lane=0, speed=speed, reactive=False
    )
    return car, Brake(actor="car", at_time=_BEGINS, deceleration=deceleration)


def _cut_in(gap: float, difference: float) -> tuple[SceneEvent, ...]:
    car = PlaceVehicle(
        name="car",
        gap=gap + _BEGINS * difference * KMH,
        relative_lane=1,
        speed=(80.0 - difference) * KMH,
        reactive=False,
    )
    return car, ChangeLane(actor="car", relative_lane=-1, at_time=_BEGINS, duration=_CUT_IN)


class _Reactions(Observer):
    """Counts the warnings and brakings of a drive."""

    def __init__(self) -> None:
        self.count, self._was = 0, EmergencyState.OFF

    def observe(self, simulation: LockStep, frame: DriveFrame) -> None:
        del simulation
        assert frame.emergency is not None
        state = frame.emergency.state
        calm = (EmergencyState.OFF, EmergencyState.STANDBY)
        self.count += self._was in calm and state not in calm
        self._was = state


def _traffic(config: ValidateConfig) -> Findings:
    """The whole stack in ordinary traffic: a reaction would be a false one."""
    found = Findings("whole stack in traffic")
    reactions, time, collisions = 0, 0.0, 0
    cases = list(itertools.product(TRAFFIC, ("perfect", "surround"), range(TRAFFIC_SEEDS)))
    if config.quick:
        cases = [("dense", "surround", 0)]
    for density, sensors, seed in each(cases, "driving in traffic", str):
        setup = DriveConfig(
            truck=config.truck,
            density=density,
            sensors=sensors,
            seed=seed,
            start_station=1_000.0 + 4_000.0 * seed,
            duration=60.0 if config.quick else TRAFFIC_DURATION,
            aeb="on",
        )
        log = _Reactions()
        with Simulation(setup, visuals=False, timestep=config.timestep or TIMESTEP) as simulation:
            summary = simulation.run([log])
        reactions += log.count
        time += summary.duration
        collisions += summary.collision
    found.check("time driven", time / 60.0, "min")
    found.check("warnings and brakings", reactions, "1", 0.0, "== 0")
    found.check("collisions", collisions, "1", 0.0, "== 0")
    return found


def _label(name: str, setup: Setup) -> str:
    payload = math.nan if setup.payload is None else setup.payload
    return f"{name}, {payload / 1e3:g} t load"
