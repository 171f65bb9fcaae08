"""The quantities that the truck reports, flat and by name, and back."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from iits_mj.errors import BusError
from iits_mj.messages import EgoState, TruckReport, XbrMode
from iits_mj.parameters import TruckParameters

_PLACES = ("front_left", "front_right", "rear_left", "rear_right", "trailer")
PRESSURES = tuple(f"brake_pressure_{place}" for place in _PLACES)
_EGO = tuple(f.name for f in dataclasses.fields(EgoState) if f.name != "brake_pressures")
_REPORT = tuple(f.name for f in dataclasses.fields(TruckReport) if f.name != "axle_loads")
# SPN 2918: 1 the driver's demand, 2 XBR in addition mode, 3 XBR in maximum mode.
_EXECUTION = {XbrMode.ADDITION: 2.0, XbrMode.MAXIMUM: 3.0}


@dataclass(frozen=True, slots=True)
class ReferenceTorques:
    """100 % of the percent torques on the bus [N m].

    Attributes:
      engine: SPN 544, at the crankshaft.
      engine_brake: SPN 556 of the engine's retarder, at the crankshaft.
      retarder: SPN 556 of the driveline's retarder, at the propeller shaft.
    """

    engine: float = 2700.0
    engine_brake: float = 1453.0
    retarder: float = 3500.0

    @classmethod
    def of(cls, parameters: TruckParameters) -> ReferenceTorques:
        """Those of a truck: the engine's reference, the rated torques of its two retarders."""
        engine = parameters.engine
        return cls(
            engine.reference_torque,
            engine.engine_brake_power / engine.engine_brake_speed,
            parameters.retarder.torque_max,
        )


def flatten(
    state: EgoState, report: TruckReport, references: ReferenceTorques
) -> dict[str, float | None]:
    """All quantities of `signals.csv` by name, SI units; None is "not available".

    Raises:
      BusError: a number is not finite.
    """
    found: dict[str, float | None] = {name: getattr(state, name) for name in _EGO}
    found |= zip(PRESSURES, state.brake_pressures, strict=True)
    found |= {name: getattr(report, name) for name in _REPORT}
    for name, value in (*found.items(), *(("axle_loads", x) for x in report.axle_loads)):
        if value is not None and not math.isfinite(value):
            raise BusError(f"state {name} = {value!r}: a finite number is wanted")
    braking = max(state.brake_pressures) > 0.0
    return found | {
        "heading": math.remainder(state.yaw, 2.0 * math.pi),
        "ground_speed": abs(state.speed),
        "friction_braking": float(braking),
        "driveline_engaged": _test(report.clutch_engagement, 0.999),
        "brake_pedal_pressed": _test(report.brake_pedal, 1e-3),
        "xbr_execution": _execution(report),
        "engine_brake_percent": _percent(report.engine_brake_torque, references.engine_brake),
        "retarder_percent": _percent(report.retarder_torque, references.retarder),
    }


def to_state(found: Mapping[str, float], references: ReferenceTorques, base: EgoState) -> EgoState:
    """The state with the quantities that were heard; the rest is `base`'s."""
    values: dict[str, Any] = {name: found[name] for name in _EGO if name in found}
    if "heading" in found:
        values["yaw"] = found["heading"]
    if "gear" in values:
        values["gear"] = round(values["gear"])
    if "shift_in_process" in values:
        values["shift_in_process"] = values["shift_in_process"] > 0.5
    if "engine_torque_percent" in found and "torque_loss_percent" in found:
        # Percent torque counts what the cylinders give: friction and engine brake come off it.
        net = found["engine_torque_percent"] - found["torque_loss_percent"]
        braking = references.engine_brake * found.get("engine_brake_percent", 0.0)
        values["engine_torque"] = 0.01 * (references.engine * net + braking)
    values["brake_pressures"] = tuple(
        found.get(name, old) for name, old in zip(PRESSURES, base.brake_pressures, strict=True)
    )
    return dataclasses.replace(base, **values)


def to_report(
    found: Mapping[str, float], references: ReferenceTorques, axle_loads: tuple[float, ...]
) -> TruckReport:
    """The report with the quantities that were heard; the rest is "not available"."""
    values: dict[str, Any] = {name: found[name] for name in _REPORT if name in found}
    if "engine_brake_percent" in found:
        share = -0.01 * found["engine_brake_percent"]
        values["engine_brake_torque"] = share * references.engine_brake
    if "retarder_percent" in found:
        values["retarder_torque"] = -0.01 * found["retarder_percent"] * references.retarder
    return TruckReport(**values, axle_loads=axle_loads)


def _test(value: float | None, limit: float) -> float | None:
    return None if value is None else float(value > limit)


def _percent(torque: float | None, reference: float) -> float | None:
    """None, too, for a truck that has no such retarder."""
    return None if torque is None or reference <= 0.0 else -100.0 * torque / reference


def _execution(report: TruckReport) -> float | None:
    if report.xbr_active is None or report.xbr_mode is None:
        return None
    if report.xbr_active > 0.5:
        return _EXECUTION.get(XbrMode(round(report.xbr_mode)), 0.0)
    return float((report.brake_pedal or 0.0) > 1e-3)
