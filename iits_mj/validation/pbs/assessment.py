"""Assessment of a truck by the Performance-Based Standards: every measure on the simulated truck.

The laden truck drives every maneuver, the empty one those of its paths; the worse value counts.
Where an analytic model predicts a measure (`predicted`), its value stands beside the simulated one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from iits_mj.analytic.swept_path import Turn
from iits_mj.core.messages import VehicleCommand
from iits_mj.core.results import Line, Panel
from iits_mj.core.units import GRAVITY, KMH
from iits_mj.parameters import TruckParameters, Unit
from iits_mj.truck import Truck
from iits_mj.validation.handling.lane_change import (
    PathChange,
    follow_path,
    steer_axle_acceleration,
)
from iits_mj.validation.handling.low_speed_turn import pbs_turn
from iits_mj.validation.handling.rollover import tilt_table
from iits_mj.validation.handling.yaw_damping import Pulse, pulse
from iits_mj.validation.harness.recorder import sampled
from iits_mj.validation.longitudinal import hill_climb
from iits_mj.validation.longitudinal.force_balance import ForceBalance
from iits_mj.validation.pbs import measures
from iits_mj.validation.pbs.limits import STANDARDS, reached
from iits_mj.validation.pbs.maneuvers import FROM_REST, LaneChange, PulseSteer
from iits_mj.validation.pbs.predicted import predicted
from iits_mj.validation.pbs.straight import StraightDrive, straight_path

# Time allowed for the acceleration capability [s], and grade of gradeability B.
_PATIENCE, _GENTLE = 90.0, 0.01


@dataclass(frozen=True)
class Assessment:
    """Measures of a truck by the keys of `limits.STANDARDS`, in their units.

    Attributes:
      truck: its name.
      values: of the simulated truck; predicted: of the analytic models.
      amplification: peak lateral acceleration over that of the steer axle: of the rearmost units
        coupled in roll, and of the last unit; empty for a single unit.
      panels: the maneuvers of the laden truck.
    """

    truck: str
    values: dict[str, float]
    predicted: dict[str, float]
    amplification: tuple[float, ...]
    panels: list[Panel]

    @property
    def level(self) -> int | None:
        """Level that the combination reaches: the worst of its measures."""
        return reached(self.values)[1]

    def rows(self) -> list[Sequence[str]]:
        """The assessor's table: a row for each measure, the headings first."""
        rows: list[Sequence[str]] = [
            ("measure", "value", "unit", "predicted", *(f"level {k}" for k in range(1, 5)), "level")
        ]
        levels = reached(self.values)[0]
        for name, value in self.values.items():
            standard, model = STANDARDS[name], self.predicted.get(name)
            shown = "" if model is None else f"{model:.3g}"
            bounds = (standard.must(level) for level in range(1, 5))
            row = (standard.name, f"{value:.3g}", standard.unit, shown, *bounds)
            rows.append((*row, level_text(levels[name])))
        return rows


def level_text(level: int | None) -> str:
    """Returns a level as text."""
    return "none" if level is None else str(level)


def assess(
    parameters: TruckParameters, payloads: Sequence[float], timestep: float, seed: int = 0
) -> Assessment:
    """Drives all maneuvers.

    Args:
      parameters: of the truck.
      payloads: to assess [kg], the greatest first.
      timestep: of the physics [s].
      seed: of the road's unevenness.

    Raises:
      InputError: the truck cannot hold the speed of a maneuver, or a payload is not allowed.
    """
    laden, towing = payloads[0], len(parameters.units) > 1
    values, modeled, panels = _pulling(parameters, laden, timestep)
    tilt = tilt_table(parameters, laden, timestep)
    lean = Line("truck", np.rad2deg(tilt.table), np.rad2deg(np.abs(tilt.roll)), "simulation")
    panels.append(Panel("tilt table", "table angle [deg]", "roll on the table [deg]", (lean,)))
    values["rollover"] = tilt.threshold
    amplification: tuple[float, ...] = ()
    if towing:
        change = follow_path(parameters, laden, LaneChange.speed, timestep)
        amplification = amplifications(parameters, laden, change)
        values["amplification"] = amplification[0] / tilt.threshold
        panels.append(_lane_change_panel(parameters, change))
    found = []
    for payload in payloads:
        turn = pbs_turn(parameters, payload, timestep)
        drive = straight_path(parameters, payload, timestep, seed)
        swing = pulse(parameters, payload, PulseSteer.speed, timestep)
        found.append(
            measures.turn_measures(turn.driven)
            | {
                "friction_demand": float(np.max(turn.demand)),
                "tracking_ability": measures.tracking_ability(drive.points),
                "yaw_damping": _damping(swing),
            }
        )
        if towing:
            if payload != laden:
                change = follow_path(parameters, payload, LaneChange.speed, timestep)
            found[-1]["off_tracking"] = change.off_tracking()
        if payload == laden:
            panels += [
                _turn_panel(turn.driven), _straight_panel(drive), _pulse_panel(parameters, swing)
            ]  # fmt: skip
    values |= _worst(found)
    modeled |= _worst([predicted(parameters, payload) for payload in payloads])
    values = {name: values[name] for name in STANDARDS if name in values}
    return Assessment(parameters.name, values, modeled, amplification, panels)


def amplifications(
    parameters: TruckParameters, payload: float, change: PathChange
) -> tuple[float, float]:
    """Returns the peak lateral acceleration over that of the steer axle in a lane change.

    Of the rearmost units that are coupled in roll, and of the last unit.
    """
    front, sides = change.front(), change.recording.lateral_accelerations
    together = measures.roll_coupled_acceleration(parameters, payload, sides)
    return (
        measures.rearward_amplification(front, together),
        measures.rearward_amplification(front, sides[:, -1]),
    )


def _damping(swing: Pulse) -> float:
    """Damping of the worst yaw rate or articulation."""
    record, free = swing.recording, swing.free
    return measures.yaw_damping([*record.yaw_rates[free].T, *record.articulations[free].T])


def _worst(found: Sequence[dict[str, float]]) -> dict[str, float]:
    """Returns the worst of the values of each measure."""
    return {
        name: (min if STANDARDS[name].least else max)(values[name] for values in found)
        for name in found[0]
    }


def _pulling(
    parameters: TruckParameters, payload: float, timestep: float
) -> tuple[dict[str, float], dict[str, float], list[Panel]]:
    """Startability, gradeability and acceleration: simulated, by the balance of forces, a panel."""
    balance = ForceBalance(parameters, payload)
    speed = balance.best_speed(_GENTLE)
    start = hill_climb.startability(parameters, payload, timestep)
    climb = hill_climb.gradeability(parameters, payload, timestep)
    modeled = {
        name: 100.0 * min(hill_climb.computed_grades(balance, found.gear, turns))
        for name, found, turns in (
            ("startability", start, balance.launch_speed),
            ("gradeability_a", climb, hill_climb.strongest_speed(balance)),
        )
    }
    modeled["gradeability_b"] = speed / KMH
    steady = hill_climb.steady_speed(balance, _GENTLE, speed, timestep)
    truck = Truck.load(payload, parameters=parameters, timestep=timestep, visuals=False)
    begin = truck.reset().station
    time, distance, speeds = sampled(
        truck,
        lambda *_: VehicleCommand(accelerator_pedal=1.0),
        lambda state: [state.station - begin, state.speed / KMH],
        _PATIENCE,
        lambda state: state.station - begin > FROM_REST,
    ).T
    values = {
        "startability": 100.0 * start.grade,
        "gradeability_a": 100.0 * climb.grade,
        "gradeability_b": steady.speed / KMH,
        "acceleration": measures.acceleration_time(time, distance),
    }
    line = Line("truck", time, speeds, "simulation")
    return values, modeled, [Panel("100 m from rest", "time [s]", "speed [km/h]", (line,))]


def _turn_panel(done: Turn) -> Panel:
    corners = done.tracks()
    lines = (
        Line("outer steer tire", *done.path.T),
        Line("front corner", *corners[:, 0, 1].T),
        Line("last unit's inner rear corner", *corners[:, -1, 3].T),
        Line("last unit's outer rear corner", *corners[:, -1, 2].T),
    )
    return Panel("low-speed turn", "x [m]", "y [m]", lines)


def _straight_panel(drive: StraightDrive) -> Panel:
    place, right, left = measures.swept_edges(drive.points)
    lines = (Line("left edge", place, left), Line("right edge", place, right))
    return Panel("straight path", "station [m]", "offset [m]", lines)


def _lane_change_panel(parameters: TruckParameters, change: PathChange) -> Panel:
    record = change.recording
    front = steer_axle_acceleration(record) / GRAVITY
    lines = [Line("steer axle", record.time, front, "reference")]
    for unit, side in zip(parameters.units, record.lateral_accelerations.T, strict=True):
        lines.append(Line(_title(unit), record.time, side / GRAVITY))
    return Panel("lane change", "time [s]", "lateral acceleration [g]", tuple(lines))


def _pulse_panel(parameters: TruckParameters, swing: Pulse) -> Panel:
    record = swing.recording
    lines = tuple(
        Line(_title(unit), record.time, rate)
        for unit, rate in zip(parameters.units, record.yaw_rates.T, strict=True)
    )
    return Panel("pulse steer", "time [s]", "yaw rate [rad/s]", lines)


def _title(unit: Unit) -> str:
    return unit.name.replace("_", " ")
