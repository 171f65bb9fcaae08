"""Jack-knife and trailer swing: a bend on low friction, braked with one group's wheels locked.

The truck runs steadily through a gentle left bend at 60 km/h on a friction of 0.3, then brakes with
its steering wheel held. Which wheels lock follows from parameters alone: brakes of the other groups
without torque, ABS off (its least speed out of reach). The control is the truck as it is shipped,
braked harder than the road allows, so that ABS works on every axle.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from iits_mj.core.results import Check, Line, Panel
from iits_mj.core.units import KMH
from iits_mj.parameters import TruckParameters
from iits_mj.road import Route
from iits_mj.truck import Truck
from iits_mj.validation.handling.braking_run import BrakingRun, brake
from iits_mj.validation.harness.recorder import drive, run_straight

FRICTION = 0.3
SPEED = 60.0 * KMH
# Lateral acceleration in the bend [m/s2]: a third of what the road allows.
LATERAL = 1.0
DEMAND = 4.0
# A hitch angle beyond which the truck has folded up, and within which it stays on its course [rad].
FOLDED, STEADY = np.deg2rad(30.0), np.deg2rad(5.0)
# A swing of the trailer that takes it out of its lane: 1 m at the last axle [rad].
SWUNG = np.deg2rad(6.0)
_INTO = 8.0
_LONG = 12.0
_SLOW = 3.0 * KMH


@dataclass(frozen=True)
class Group:
    """Axles whose wheels lock; none with ABS. `axles` are indices front to rear."""

    name: str
    axles: tuple[int, ...]


DRIVE = Group("drive axles locked", (1, 2))
TRAILER = Group("trailer axles locked", (3, 4, 5))
ABS = Group("all axles, ABS", ())


def overlay(group: Group, parameters: TruckParameters) -> dict[str, object]:
    """Parameters that make the group's wheels lock and no others brake."""
    if not group.axles:
        return {}
    torque = parameters.air_brake.torque_per_pressure
    chosen = [float(t) if i in group.axles else 0.0 for i, t in enumerate(torque)]
    return {"air_brake": {"abs_speed_min": 100.0, "torque_per_pressure": chosen}}


def bend(payload: float, group: Group, timestep: float) -> BrakingRun:
    """Brakes in the bend, from the brakes' demand on; ends at 3 km/h or when folded up."""
    parameters = TruckParameters.load()
    truck = Truck.load(
        payload,
        parameters=overlay(group, parameters),
        route=Route.straight(2000.0).with_friction(FRICTION),
        timestep=timestep,
        visuals=False,
    )
    truck.reset(station=50.0, speed=SPEED)
    hold = run_straight(truck, SPEED)
    radius = SPEED**2 / LATERAL
    wheel = parameters.steering.ratio * parameters.tractor.axles[1].position / radius
    # Understeer makes the bend wider than that: it need not be exact, only the same for all.
    drive(
        truck,
        lambda time, _: wheel * min(time / 2.0, 1.0),
        speed=SPEED,
        duration=_INTO,
        hold=hold,
    )
    limit = 2.0 * FOLDED
    return brake(
        truck,
        DEMAND,
        lambda _, __: wheel,
        duration=_LONG,
        stop=lambda state: state.speed < _SLOW or abs(state.articulation) > limit,
    )


def compare(payload: float, timestep: float) -> tuple[list[Check], list[Panel]]:
    """Checks and panels for one payload [kg]."""
    runs = {group: bend(payload, group, timestep) for group in (DRIVE, TRAILER, ABS)}
    label = f"braking in a bend on {FRICTION:g}, {payload / 1e3:g} t, 60 km/h"
    change = {
        group: np.rad2deg(run.articulation - run.articulation[0]) for group, run in runs.items()
    }
    steady = float(np.rad2deg(STEADY))
    checks = [
        Check(
            f"{label}, {group.name}: share of time with one of them locked above 15 km/h",
            run.locked(slice(group.axles[0], group.axles[-1] + 1), 15.0 * KMH),
            "1",
        )
        for group, run in runs.items()
        if group.axles
    ]
    checks += [
        Check(
            f"{label}, {DRIVE.name}: hitch angle (jack-knife)",
            float(np.max(change[DRIVE])),
            "deg",
            None,
            f">= {np.rad2deg(FOLDED):g}",
        ),
        Check(
            f"{label}, {TRAILER.name}: hitch angle (trailer swing)",
            float(np.min(change[TRAILER])),
            "deg",
            None,
            f"<= {-np.rad2deg(SWUNG):g}",
        ),
        Check(
            f"{label}, {ABS.name}: greatest change of the hitch angle",
            float(np.max(np.abs(change[ABS]))),
            "deg",
            None,
            f"<= {steady:g}",
        ),
        Check(
            f"{label}, {ABS.name}: share of time with a wheel locked above 15 km/h",
            runs[ABS].locked(slice(0, 6), 15.0 * KMH),
            "1",
            None,
            "<= 0.2",
        ),
    ]
    lines = tuple(
        Line(group.name, run.time, change[group], "reference" if group is ABS else "")
        for group, run in runs.items()
    )
    tracks = tuple(
        Line(group.name, run.x - run.x[0], run.y - run.y[0], "reference" if group is ABS else "")
        for group, run in runs.items()
    )
    return checks, [
        Panel(f"{label}: hitch angle", "time [s]", "change of the hitch angle [deg]", lines),
        Panel(f"{label}: steer axle", "x [m]", "y [m]", tracks),
    ]
