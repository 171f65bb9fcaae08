"""The instruments of the page: short texts with units, from the truck's state and reports."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from controllers.decision.policy import GreedyPolicy
from controllers.decision.priced import PricedPolicy
from controllers.stack import Stack
from iits_mj.core.messages import (
    Decision,
    EgoState,
    Scene,
    TransmissionMode,
    TruckReport,
    VehicleCommand,
    XbrMode,
)
from iits_mj.core.units import KMH, RPM
from iits_mj.simulation import DriveFrame

_ENGINE_RPM = 2500.0  # end of the engine's bar
_BRAKE = 6.0  # end of the brake's bar [m/s2]
_MODES = {"lane_keeping": "keeps lane", "lane_change": "changes lane", "abort": "aborts change"}
_NAMES = {Decision.LEFT: "left", Decision.KEEP: "keep", Decision.RIGHT: "right"}
_HOUR = 3600.0
_GAP_MAX = 500.0


def truck_state(
    ego: EgoState, command: VehicleCommand, report: TruckReport | None = None
) -> dict[str, Any]:
    """Returns what every viewer of a truck shows: speed, gear, bars."""
    rpm = ego.engine_speed / RPM
    retarder = max(command.retarder, command.engine_brake)
    if report is not None and report.retarder_torque_percent_intended is not None:
        retarder = max(retarder, -report.retarder_torque_percent_intended / 100.0)
    braking = -command.xbr_demand if command.xbr_mode is not XbrMode.OFF else 0.0
    pressure = max(ego.brake_pressures) / 1e5
    brake = max(braking / _BRAKE, command.brake_pedal)
    return {
        "speed": f"{abs(ego.speed) / KMH:.0f}",
        "gear": _gear(ego, command),
        "engine": [rpm / _ENGINE_RPM, f"{rpm:.0f} rpm"],
        "pedal": [command.accelerator_pedal, f"{100.0 * command.accelerator_pedal:.0f} %"],
        "brake": [max(brake, pressure / 10.0), f"{pressure:.1f} bar"],
        "retarder": [retarder, f"{100.0 * max(retarder, 0.0):.0f} %"],
    }


def truck_rows(ego: EgoState) -> list[tuple[str, str]]:
    """Returns names and values of a truck's further instruments."""
    bends = (ego.articulation, *ego.rear_articulations)
    shown = " ".join(f"{math.degrees(angle):+.1f}°" for angle in bends)
    rows = [
        ("steering wheel", f"{math.degrees(ego.steering_wheel_angle):+.0f}°"),
        ("fuel", f"{ego.fuel_rate * _HOUR:.1f} kg/h"),
        ("fuel used", f"{ego.fuel_used:.2f} kg"),
    ]
    if any(bends):
        rows.insert(1, ("articulation", shown))
    return rows


def drive_state(frame: DriveFrame) -> dict[str, Any]:
    """Returns what is wanted of a drive and where it is."""
    ego, plan = frame.ego, frame.trajectory
    limit = f"limit {frame.speed_limit / KMH:.0f}"
    wanted = frame.reference_speed
    if math.isfinite(wanted):
        limit += f" · wanted {wanted / KMH:.0f}"
    rows = truck_rows(ego)
    rows += [
        ("gap ahead", _gap(frame.gap_ahead)),
        ("time gap", f"{frame.time_gap:.1f} s" if frame.time_gap < 99.0 else "free"),
        ("lane", f"{frame.lane + 1} of {frame.lane_count}" if frame.lane >= 0 else "off the lanes"),
        ("station", f"{ego.station:.0f} m"),
        ("grade", f"{100.0 * frame.grade:+.1f} %"),
        ("time", f"{frame.time:.1f} s"),
        ("plan", plan.reason or _MODES.get(plan.mode.value, plan.mode.value)),
    ]
    return {"wanted": limit, "rows": rows}


def choice(stack: Stack) -> list[tuple[str, str, bool]]:
    """Returns the decisions with their values, and which one was taken.

    Decision makers without values show only what they decided.
    """
    values: Sequence[float | None] = (None, None, None)
    maker = stack.decision_maker
    if isinstance(maker, GreedyPolicy | PricedPolicy) and stack.decisions:
        values = maker.values(stack.history.observation()).tolist()
    return [
        (_NAMES[decision], "" if value is None else f"{value:.2f}", decision is taken)
        for taken in (stack.last_decision,)
        for decision, value in zip(_NAMES, values, strict=True)
    ]


def gap_texts(scene: Scene) -> list[str]:
    """Returns gap and relative speed of each vehicle of a scene."""
    neighbors, own = scene.neighbors, scene.ego.speed
    texts = []
    for gap, speed in zip(neighbors.gap.tolist(), neighbors.speed.tolist(), strict=True):
        where = f"{gap:.0f} m" if gap > 0.0 else "beside"
        texts.append(f"{where}, {(speed - own) / KMH:+.0f} km/h")
    return texts


def _gear(ego: EgoState, command: VehicleCommand) -> str:
    if ego.shift_in_process:
        return "·"
    if ego.gear < 0 or command.transmission_mode is TransmissionMode.REVERSE:
        return "R"
    return str(ego.gear) if ego.gear else "N"


def _gap(gap: float) -> str:
    return f"{gap:.0f} m" if gap < _GAP_MAX else "free"
