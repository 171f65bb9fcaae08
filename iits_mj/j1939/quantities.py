"""The quantities that the truck reports, by name: to the bus, and back to state and report.

A quantity is a field of `EgoState` or `TruckReport`, or is derived from them as a control unit
derives it. An unknown quantity is None: "not available".
"""

from __future__ import annotations

import dataclasses
import operator
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, TypeAlias

from iits_mj.core.angles import wrap_angle
from iits_mj.core.errors import BusError
from iits_mj.core.messages import EgoState, TransmissionMode, TruckReport, XbrMode, not_finite
from iits_mj.j1939 import network
from iits_mj.j1939.mapping import FieldOf
from iits_mj.parameters import TruckParameters

_PLACES = ("front_left", "front_right", "rear_left", "rear_right", "trailer")
_PRESSURES = tuple(f"brake_pressure_{place}" for place in _PLACES)
_WHEELS = ("front_left", "front_right", "rear1_left", "rear1_right", "rear2_left", "rear2_right")
_RELATIVE_SPEEDS = tuple(f"relative_speed_{wheel}" for wheel in _WHEELS)
_FIELDS_OF_STATE = tuple(f.name for f in dataclasses.fields(EgoState))
_EGO, _REPORT = (
    tuple(f.name for f in dataclasses.fields(kind) if not isinstance(f.default, tuple))
    for kind in (EgoState, TruckReport)
)
_all_of_state = operator.attrgetter(*_FIELDS_OF_STATE)
# Travel above which a pedal counts as pressed.
_PRESSED = 1e-3
# Fuel economy in overrun [m/kg]: beyond the range of every signal.
_ENDLESS = 1e9
# SPN 2918: 1 the driver's demand, 2 XBR in addition mode, 3 XBR in maximum mode.
_DRIVER = 1.0
_EXECUTION: dict[int, float] = {XbrMode.ADDITION: 2.0, XbrMode.MAXIMUM: 3.0}
# SPN 899 and 900: the unit that decides on the torque of an engine or a retarder.
_NO_REQUEST, _OPERATOR, _TRANSMISSION, _BRAKES = 0.0, 1.0, 6.0, 10.0
_ASR, _ABS = 5.0, 7.0
_CONTROLLERS = {
    _TRANSMISSION: network.TRANSMISSION,
    **dict.fromkeys((_BRAKES, _ASR, _ABS), network.BRAKES),
}
# SPN 162 and 163: two characters, a single one follows a blank; a requested gear is its number.
_RANGES: dict[int, float] = {
    mode: float(
        int.from_bytes((str(mode.gear) if mode.gear else mode.name[0]).rjust(2).encode(), "little")
    )
    for mode in TransmissionMode
}
# Quantities that a real truck sends in place of those of our own messages, the preferred one first.
_SUBSTITUTES = {
    "speed": ("front_axle_speed", "wheel_based_speed"),
    "acceleration": ("longitudinal_acceleration",),
    "gear": ("gear_engaged",),
}


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
        """Reference torque of a truck's engine, rated torques of its two retarders."""
        engine = parameters.engine
        return cls(
            engine.reference_torque,
            engine.engine_brake_power / engine.engine_brake_speed,
            parameters.retarder.torque_max,
        )


Quantity: TypeAlias = Callable[[EgoState, TruckReport, ReferenceTorques], float | None]


def quantities() -> dict[str, Quantity]:
    """Functions that compute the quantities of `signals.csv` in SI units, by quantity."""
    found: dict[str, Quantity] = {name: FieldOf(0, name) for name in _EGO}
    found |= {name: FieldOf(1, name) for name in _REPORT}
    found |= {name: _pressure(place) for place, name in enumerate(_PRESSURES)}
    found |= {name: _relative_speed(wheel) for wheel, name in enumerate(_RELATIVE_SPEEDS)}
    found |= _retarder("engine_brake", network.ENGINE_RETARDER)
    found |= _retarder("retarder", network.DRIVELINE_RETARDER)
    return found | {
        "heading": lambda s, _r, _t: wrap_angle(s.yaw),
        "longitudinal_acceleration": FieldOf(0, "acceleration"),
        "front_axle_speed": lambda _s, r, _t: _front_axle_speed(r),
        # These sensors count teeth, so they do not measure the sense of rotation.
        "propeller_shaft_speed": lambda _s, r, _t: _magnitude(r.propeller_shaft_speed),
        "input_shaft_speed": lambda _s, r, _t: _magnitude(r.input_shaft_speed),
        "clutch_slip": lambda s, r, _t: _slip(s.engine_speed, r.input_shaft_speed),
        "requested_range": lambda _s, r, _t: _letters(r.transmission_mode),
        "current_range": lambda _s, r, _t: _letters(_selector(r.gear_engaged)),
        "engine_controller": lambda _s, r, _t: _controller(r.engine_torque_mode, network.ENGINE),
        "driveline_engaged": lambda _s, r, _t: _test(r.clutch_engagement, 0.999),
        "accelerator_released": lambda _s, r, _t: _test(r.accelerator_pedal, _PRESSED, above=False),
        "brake_pedal_pressed": lambda _s, r, _t: _test(r.brake_pedal, _PRESSED),
        "fuel_economy": lambda s, r, _t: _economy(r.wheel_based_speed, s.fuel_rate),
        "friction_braking": lambda s, _r, _t: float(max(s.brake_pressures) > 0.0),
        "xbr_execution": lambda _s, r, _t: _execution(r),
        # This truck accepts any demand at any time (SPN 2917).
        "xbr_system_state": lambda _s, r, _t: None if r.xbr_active is None else 0.0,
        "abs_operational": lambda _s, r, _t: r.abs_operational,
        # SPN 1812: the angle is absolute.
        "steering_sensor_type": lambda _s, _r, _t: 1.0,
    }


def _retarder(name: str, address: int) -> dict[str, Quantity]:
    """Quantities of ERC1 of a retarder ("engine_brake", "retarder"); braking is negative."""
    lever, torque, available, intended = (
        operator.attrgetter(f"{name}{suffix}")
        for suffix in ("", "_torque", "_torque_percent_available", "_torque_percent_intended")
    )
    reference = operator.attrgetter(name)

    def percent(_s: EgoState, report: TruckReport, t: ReferenceTorques) -> float | None:
        # Also None if the truck has no such retarder.
        value = torque(report)
        return None if value is None or reference(t) <= 0.0 else -100.0 * value / reference(t)

    def driver(_s: EgoState, report: TruckReport, _t: ReferenceTorques) -> float | None:
        share, most = lever(report), available(report)
        return None if share is None or most is None else share * most

    def mode(s: EgoState, report: TruckReport, t: ReferenceTorques) -> float | None:
        asked, given = driver(s, report, t), intended(report)
        if asked is None or given is None:
            return None
        # 0.5 % is half a step of the signals.
        if given > -0.5:
            return _NO_REQUEST
        return _BRAKES if given < asked - 0.5 else _OPERATOR

    return {
        f"{name}_percent": percent,
        f"{name}_torque_percent_driver": driver,
        f"{name}_mode": mode,
        f"{name}_controller": lambda s, r, t: _controller(mode(s, r, t), address),
    }


def check_finite(state: EgoState, report: TruckReport) -> None:
    """Raises BusError if a number of state or report is not finite."""
    found = not_finite(state) or not_finite(report)
    if found:
        raise BusError(f"state {found}: a finite number is needed")


def to_state(found: Mapping[str, float], references: ReferenceTorques, base: EgoState) -> EgoState:
    """The state with the received quantities; all others are those of `base`."""
    values: dict[str, Any] = dict(found)
    for name, others in _SUBSTITUTES.items():
        if name not in values:
            received = [found[other] for other in others if other in found]
            if received:
                values[name] = received[0]
    if "heading" in found:
        values["yaw"] = found["heading"]
    if "gear" in values:
        values["gear"] = round(values["gear"])
    if "shift_in_process" in values:
        values["shift_in_process"] = values["shift_in_process"] > 0.5
    if "engine_torque_percent" in found and "torque_loss_percent" in found:
        # The percent torque is that of the cylinders: friction and engine brake are subtracted.
        net = found["engine_torque_percent"] - found["torque_loss_percent"]
        braking = references.engine_brake * found.get("engine_brake_percent", 0.0)
        values["engine_torque"] = 0.01 * (references.engine * net + braking)
    values["brake_pressures"] = tuple(map(found.get, _PRESSURES, base.brake_pressures))
    fetch: Callable[[str, Any], Any] = values.get
    return EgoState(*map(fetch, _FIELDS_OF_STATE, _all_of_state(base)))


def to_report(
    found: Mapping[str, float], references: ReferenceTorques, axle_loads: tuple[float, ...]
) -> TruckReport:
    """The report with the received quantities; all others are None, not available."""
    values: dict[str, Any] = {name: found[name] for name in _REPORT if name in found}
    if "engine_brake_percent" in found:
        share = -0.01 * found["engine_brake_percent"]
        values["engine_brake_torque"] = share * references.engine_brake
    if "retarder_percent" in found:
        values["retarder_torque"] = -0.01 * found["retarder_percent"] * references.retarder
    for mode, letters in _RANGES.items():
        if found.get("requested_range") == letters:
            values["transmission_mode"] = float(mode)
    # A truck with fewer axles sends those of its own, front to rear.
    known = [name for name in _RELATIVE_SPEEDS if name in found]
    whole = known == list(_RELATIVE_SPEEDS[: len(known)]) and len(known) % 2 == 0
    if "front_axle_speed" in found and whole:
        values["wheel_speeds"] = tuple(found["front_axle_speed"] + found[name] for name in known)
    return TruckReport(**values, axle_loads=axle_loads)


def _pressure(place: int) -> Quantity:
    return lambda state, _report, _references: state.brake_pressures[place]


def _relative_speed(wheel: int) -> Quantity:
    def relative(_s: EgoState, report: TruckReport, _t: ReferenceTorques) -> float | None:
        front = _front_axle_speed(report)
        speeds = report.wheel_speeds
        return None if front is None or wheel >= len(speeds) else speeds[wheel] - front

    return relative


def _front_axle_speed(report: TruckReport) -> float | None:
    speeds = report.wheel_speeds
    return 0.5 * (speeds[0] + speeds[1]) if len(speeds) > 1 else None


def _magnitude(value: float | None) -> float | None:
    return None if value is None else abs(value)


def _test(value: float | None, limit: float, *, above: bool = True) -> float | None:
    return None if value is None else float((value > limit) is above)


def _slip(engine_speed: float, input_speed: float | None) -> float | None:
    """SPN 522: slip of the clutch, as a share of the engine speed."""
    if input_speed is None or engine_speed <= 0.0:
        return None
    return min(max(1.0 - abs(input_speed) / engine_speed, 0.0), 1.0)


def _economy(speed: float | None, fuel_rate: float) -> float | None:
    """Instantaneous fuel economy [m/kg]."""
    if speed is None:
        return None
    return min(speed / fuel_rate, _ENDLESS) if fuel_rate > 0.0 else _ENDLESS


def _letters(mode: float | None) -> float | None:
    """The code of a selector position (SPN 162 and 163)."""
    return None if mode is None else _RANGES.get(round(mode))


def _selector(gear: float | None) -> float | None:
    """The selector position of a gear."""
    if gear is None:
        return None
    if gear == 0:
        return TransmissionMode.NEUTRAL
    return TransmissionMode.DRIVE if gear > 0 else TransmissionMode.REVERSE


def _controller(mode: float | None, own: int) -> float | None:
    """Address of the unit in control: that of the torque mode, or the unit's own address."""
    return None if mode is None else float(_CONTROLLERS.get(mode, own))


def _execution(report: TruckReport) -> float | None:
    """Code of the demand that the brakes execute (SPN 2918)."""
    if report.xbr_active is None or report.xbr_mode is None:
        return None
    if report.xbr_active > 0.5:
        return _EXECUTION.get(round(report.xbr_mode), 0.0)
    return _DRIVER if (report.brake_pedal or 0.0) > _PRESSED else 0.0
