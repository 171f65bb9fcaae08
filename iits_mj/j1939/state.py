"""`EgoState` to frames and back: what the truck reports."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from typing import Any

from iits_mj.errors import BusError
from iits_mj.j1939.database import Decoded, Status, decode, encode
from iits_mj.j1939.frame import Frame
from iits_mj.messages import EgoState

_RPM = 2.0 * math.pi / 60.0
_KPA = 1e3
# EN 590 diesel fuel at 15 C lies at 820 to 845 kg/m3.
DIESEL_DENSITY = 832.0
_LITRE = 1e-3


def state_to_frames(
    state: EgoState,
    *,
    reference_torque: float = 2700.0,
    axle_loads: Sequence[float] = (),
    loss_torque: float | None = None,
    pedal: float | None = None,
    parking_brake: bool | None = None,
) -> list[Frame]:
    """The frames that report a state; what the truck does not know is sent as "not available".

    Args:
      state: as `Truck.observe` gives it; not-finite values are refused with BusError.
      reference_torque: of the percent torques [N m] (SPN 544).
      axle_loads: axle weights [N], front to rear, one VW frame each.
      loss_torque: friction torque of the engine [N m], for EEC3.
      pedal: accelerator pedal, 0 to 1, for EEC2.
      parking_brake: True when applied.
    """
    percent = 100.0 / reference_torque
    torque = percent * state.engine_torque
    litres_per_hour = state.fuel_rate / DIESEL_DENSITY / _LITRE * 3600.0
    used = state.fuel_used / DIESEL_DENSITY / _LITRE
    pressures = [p / _KPA for p in state.brake_pressures]
    signals: dict[str, dict[str, float | Status | None]] = {
        "EEC1": {
            "engine_speed_rpm": state.engine_speed / _RPM,
            "actual_engine_torque_percent": torque,
        },
        "EEC2": {
            "accelerator_pedal_position_percent": None if pedal is None else 100.0 * pedal,
        },
        "EEC3": {
            "nominal_friction_torque_percent": (
                None if loss_torque is None else percent * loss_torque
            ),
        },
        "ETC1": {"shift_in_process": float(state.shift_in_process)},
        "ETC2": {"current_gear": float(state.gear)},
        "CCVS1": {
            "wheel_based_speed_kph": abs(state.speed) * 3.6,
            "parking_brake_switch": None if parking_brake is None else float(parking_brake),
            "brake_switch": float(max(pressures) > 0.0),
        },
        "EBC2": {"front_axle_speed_kph": abs(state.speed) * 3.6},
        "EBC3": {
            "brake_pressure_front_left_kpa": pressures[0],
            "brake_pressure_front_right_kpa": pressures[1],
            "brake_pressure_rear1_left_kpa": pressures[2],
            "brake_pressure_rear1_right_kpa": pressures[3],
        },
        "EBC5": {"foundation_brake_use": float(max(pressures) > 0.0)},
        "VDC2": {
            "steering_wheel_angle": state.steering_wheel_angle,
            "yaw_rate": state.yaw_rate,
            "lateral_acceleration": state.lateral_acceleration,
            "longitudinal_acceleration": state.acceleration,
        },
        "LFE1": {"engine_fuel_rate_l_per_h": litres_per_hour},
        "HRLFC": {"trip_fuel_l": used, "total_fuel_used_l": used},
        "AIR1": {},
        "IITS_TRAILER": {
            "articulation": state.articulation,
            "articulation_rate": state.articulation_rate,
            "trailer_yaw_rate": state.trailer_yaw_rate,
            "brake_pressure_trailer_kpa": pressures[4],
        },
        "IITS_POSE": {"position_x": state.x, "position_y": state.y},
        "IITS_ATTITUDE": {
            "yaw": math.remainder(state.yaw, 2.0 * math.pi) if math.isfinite(state.yaw) else 0.0,
            "pitch": state.pitch,
            "roll": state.roll,
            "position_z": state.z,
        },
        "IITS_ROUTE": {
            "station": state.station,
            "route_offset": state.offset,
            "trailer_route_offset": state.trailer_offset,
        },
        "IITS_MOTION": {
            "forward_speed": state.speed,
            "lateral_speed": state.lateral_speed,
            "forward_acceleration": state.acceleration,
            "road_wheel_angle": state.road_wheel_angle,
        },
    }
    _check_finite(state)
    frames = [encode(n, v, time=state.time, saturate=True) for n, v in signals.items()]
    return frames + [
        encode(
            "VW",
            {"axle_location": float(i << 4), "axle_weight_kg": load / 9.81},
            time=state.time,
            saturate=True,
        )
        for i, load in enumerate(axle_loads)
    ]


class StateReceiver:
    """Builds the truck's `EgoState` from its frames, for a controller on the other end of a bus."""

    def __init__(self, reference_torque: float = 2700.0, mass: float = 55_000.0) -> None:
        self._reference_torque = reference_torque
        self._values: dict[str, Any] = {"mass": mass}
        self._pressures = [0.0] * 5

    def receive(self, frame: Frame) -> bool:
        """Takes one frame; returns True when it told something about the state.

        Raises:
          BusError: the frame of a known group is too short.
        """
        decoded = decode(frame)
        if decoded is None:
            return False
        update = self._update(decoded)
        self._values.update(update)
        if update:
            self._values["time"] = frame.time
        return bool(update)

    def state(self) -> EgoState:
        """The state as far as frames have told it; fields never reported keep their defaults."""
        return dataclasses.replace(
            EgoState(),
            **self._values,
            brake_pressures=(
                self._pressures[0],
                self._pressures[1],
                self._pressures[2],
                self._pressures[3],
                self._pressures[4],
            ),
        )

    def _update(self, decoded: Decoded) -> dict[str, Any]:
        found: dict[str, Any] = {}
        for signal, value in decoded.values.items():
            if isinstance(value, Status):
                continue
            if signal in _PRESSURES:
                self._pressures[_PRESSURES[signal]] = value * _KPA
                found["time"] = decoded.time
            elif signal in _FIELDS:
                field, scale = _FIELDS[signal]
                found[field] = value * scale
            elif signal == "actual_engine_torque_percent":
                found["engine_torque"] = 0.01 * value * self._reference_torque
            elif signal == "current_gear":
                found["gear"] = int(value)
            elif signal == "shift_in_process":
                found["shift_in_process"] = bool(value)
        return found


_PRESSURES = {
    "brake_pressure_front_left_kpa": 0,
    "brake_pressure_front_right_kpa": 1,
    "brake_pressure_rear1_left_kpa": 2,
    "brake_pressure_rear1_right_kpa": 3,
    "brake_pressure_trailer_kpa": 4,
}

# Signal to (field of EgoState, factor to SI).
_FIELDS = {
    "engine_speed_rpm": ("engine_speed", _RPM),
    "engine_fuel_rate_l_per_h": ("fuel_rate", DIESEL_DENSITY * _LITRE / 3600.0),
    "trip_fuel_l": ("fuel_used", DIESEL_DENSITY * _LITRE),
    "steering_wheel_angle": ("steering_wheel_angle", 1.0),
    "yaw_rate": ("yaw_rate", 1.0),
    "lateral_acceleration": ("lateral_acceleration", 1.0),
    "articulation": ("articulation", 1.0),
    "articulation_rate": ("articulation_rate", 1.0),
    "trailer_yaw_rate": ("trailer_yaw_rate", 1.0),
    "position_x": ("x", 1.0),
    "position_y": ("y", 1.0),
    "position_z": ("z", 1.0),
    "yaw": ("yaw", 1.0),
    "pitch": ("pitch", 1.0),
    "roll": ("roll", 1.0),
    "station": ("station", 1.0),
    "route_offset": ("offset", 1.0),
    "trailer_route_offset": ("trailer_offset", 1.0),
    "forward_speed": ("speed", 1.0),
    "lateral_speed": ("lateral_speed", 1.0),
    "forward_acceleration": ("acceleration", 1.0),
    "road_wheel_angle": ("road_wheel_angle", 1.0),
}


def _check_finite(state: EgoState) -> None:
    for field in dataclasses.fields(state):
        value = getattr(state, field.name)
        numbers = value if isinstance(value, tuple) else (value,)
        if not all(math.isfinite(number) for number in numbers):
            raise BusError(f"state {field.name} = {value!r}: a finite number is wanted")
