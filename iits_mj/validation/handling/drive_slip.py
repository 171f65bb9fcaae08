"""Slip of the driven wheels: engine brake, retarder and accelerator on slippery roads.

**In a bend** at 60 km/h, whose lateral acceleration is half of what the road allows, the driver
holds the steering wheel and applies engine brake and retarder, or the full accelerator. These act
on the driven axles alone. Without drag-torque and traction control the tractor folds against its
trailer, with no wheel locked by a brake.

**Starts** with the full accelerator on ice, and with the wheels of one side on ice. Open
differentials give both sides the torque that the side on ice can carry, unless the brake holds its
wheels.

The controls are switched off by slips that no wheel reaches. No standard sets bounds; ours are
those of ABS in the same bend.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from iits_mj.core.messages import EgoState, VehicleCommand
from iits_mj.core.results import Findings, Line
from iits_mj.core.units import GRAVITY
from iits_mj.parameters import TruckParameters
from iits_mj.road import Route
from iits_mj.validation.handling.braking_stability import (
    FOLDED,
    FOLDED_OVER,
    STEADY,
    bend_is_over,
    steady_bend,
)
from iits_mj.validation.harness.maneuver import Run, run
from iits_mj.validation.harness.recorder import placed_truck

FRICTIONS = (0.2, 0.1)
BRAKING: dict[str, Any] = {"engine_brake": 1.0, "retarder": 1.0}
PULLING: dict[str, Any] = {"accelerator_pedal": 1.0}
# No slip is as large: the controls are off.
_OFF: dict[str, Any] = {
    "drive_slip_lead": 0.0,
    "drag_slip_begin": 1.0,
    "asr_slip_begin": 10.0,
    "asr_brake_speed": 0.0,
    "asr_hold_time": 100.0,
    "asr_slip_range": 10.0,
}
ICE, GRIP = 0.1, 0.8
# Starts: name, whether the left side has grip, and gain of speed that slip control must bring.
STARTS = (("on ice", False, 1.0), ("with one side on ice", True, 1.5))
# Ends the names of a start's figures.
WITHOUT = ", without slip control"
_DURATION, _START = 12.0, 10.0


def without_control(parameters: TruckParameters) -> TruckParameters:
    """Returns the truck with the control of drive slip and drag torque off."""
    return replace(parameters, air_brake=replace(parameters.air_brake, **_OFF))


def in_bend(
    parameters: TruckParameters,
    payload: float,
    timestep: float,
    friction: float,
    levers: dict[str, Any],
) -> Run:
    """Applies pedal and levers in the bend; the record begins with them."""
    lateral = 0.5 * friction * GRAVITY
    truck, wheel = steady_bend(parameters, payload, timestep, friction, lateral)

    def command(_: float, __: EgoState) -> VehicleCommand:
        return VehicleCommand(steering_wheel_angle=wheel, **levers)

    return run(truck, command, _DURATION, bend_is_over)


def start(
    parameters: TruckParameters, payload: float, timestep: float, grips: bool, ice: float = ICE
) -> Run:
    """Starts on a level road by the full accelerator.

    Args:
      parameters: of the truck.
      payload: [kg].
      timestep: of the physics [s].
      grips: whether the left side has grip; else both sides are on ice.
      ice: coefficient of friction of the ice.
    """
    route = Route.straight(2000.0).with_friction(GRIP if grips else ice, ice)
    truck = placed_truck(parameters, payload, timestep, route)
    return run(truck, lambda _, __: VehicleCommand(accelerator_pedal=1.0), _START)


def start_figures(parameters: TruckParameters, record: Run) -> tuple[float, float]:
    """Returns the speed at the end of a start [m/s] and the greatest slip of the driven wheels."""
    driven = [i for i, axle in enumerate(parameters.axles) if axle.driven]
    wheels = [2 * i + side for i in driven for side in (0, 1)]
    return float(record.speed[-1]), float(np.max(np.abs(record.wheel_slips[:, wheels])))


def start_titles(name: str) -> tuple[str, str]:
    """Returns the names of these figures for a start."""
    return f"start {name}: speed after {_START:g} s", f"start {name}: greatest slip"


def compare(parameters: TruckParameters, payload: float, timestep: float) -> Findings:
    """Bends and starts with one payload [kg]; bends only of a truck with a hitch that may fold."""
    load = f"{payload / 1e3:g} t"
    found = Findings(f"slip of the driven wheels, {load}")
    trucks = {True: parameters, False: without_control(parameters)}
    folded, steady = np.rad2deg((FOLDED, STEADY))
    for friction in FRICTIONS if len(parameters.units) > 1 else ():
        for action, levers in (("engine brake and retarder", BRAKING), ("accelerator", PULLING)):
            lines = []
            for control in (True, False):
                record = in_bend(trucks[control], payload, timestep, friction, levers)
                bent = np.clip(record.articulation, -FOLDED_OVER, FOLDED_OVER)
                change = np.rad2deg(bent - bent[0])
                name = "with slip control" if control else "without"
                lines.append(Line(name, record.time, change, "simulation" if control else ""))
                label = f"bend on {friction:g}, {action}, {name}: greatest change of hitch angle"
                must = f"<= {steady:g}" if control else ""
                if not control and levers is BRAKING:
                    must = f">= {folded:g}"
                found.check(label, np.max(np.abs(change)), "deg", must=must)
            place = f"bend on {friction:g}, {action}"
            found.panel(place, "time [s]", "change of the hitch angle [deg]", *lines)
    for name, grips, gain in STARTS:
        with_control, without = (
            start(trucks[control], payload, timestep, grips) for control in (True, False)
        )
        reached, spin = start_figures(parameters, with_control)
        free, free_spin = start_figures(parameters, without)
        speed_title, slip_title = start_titles(name)
        found.check(f"{speed_title}{WITHOUT}", free, "m/s")
        found.check(speed_title, reached, "m/s", must=f">= {gain * free:.2f}")
        found.check(f"{slip_title}{WITHOUT}", free_spin, "1")
        found.check(slip_title, spin, "1", must=f"< {free_spin:.2f}")
        lines = [
            Line("with slip control", with_control.time, with_control.speed, "simulation"),
            Line("without", without.time, without.speed),
        ]
        found.panel(f"start {name}", "time [s]", "speed [m/s]", *lines)
    return found
