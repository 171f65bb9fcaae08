"""Unit and components of every sensor of the truck's model."""

from __future__ import annotations

import re
from dataclasses import dataclass

from iits_mj.core.errors import InputError

_XYZ = ("x", "y", "z")
_PERCENT, _PASCAL, _NEWTON_METER = "%", "Pa", "N m"


@dataclass(frozen=True)
class SensorUnit:
    """Description of a sensor's numbers.

    Attributes:
      unit: SI unit, "1" for pure numbers, "%" for SAE J1939's percent of a reference.
      components: a name for each number, () for a single one or one per wheel.
      meaning: in words.
    """

    unit: str
    components: tuple[str, ...] = ()
    meaning: str = ""


# Patterns of whole names; the first match applies.
_TABLE: tuple[tuple[str, SensorUnit], ...] = (
    (r"gear", SensorUnit("1", (), "from 1, 0 in neutral, -1 in reverse")),
    (r"shift_in_process|clutch_engagement", SensorUnit("1")),
    (r"engine_speed|propeller_shaft_speed", SensorUnit("rad/s")),
    (r".*_torque_percent.*|engine_torque_percent|torque_loss_percent", SensorUnit(_PERCENT)),
    (r"fuel_rate", SensorUnit("kg/s")),
    (r"fuel_used", SensorUnit("kg", (), "since the reset")),
    (r"steering_wheel_torque", SensorUnit(_NEWTON_METER, (), "of the driver, left positive")),
    (r"engine_torque|.*_brake_torque|retarder_torque|.*shaft_torque", SensorUnit(_NEWTON_METER)),
    (r"endurance_torque_demand", SensorUnit(_NEWTON_METER, (), "of engine brake and retarder")),
    (r"accelerator_pedal_position", SensorUnit("1", (), "0 to 1")),
    (r"retarder_heat", SensorUnit("1", (), "1 where the continuous power settles")),
    (
        r"engine_work|auxiliary_work|driveline_loss|retarder_work|driveline_energy|brake_work",
        SensorUnit("J"),
    ),
    (
        r"powertrain_report",
        SensorUnit(
            "1, rad/s, 1, %, %",
            (
                "gear_engaged",
                "input_shaft_speed",
                "engine_torque_mode",
                "engine_torque_percent_driver",
                "engine_load_percent",
            ),
        ),
    ),
    (r"brake_pressures?(_.*)?|reservoir_pressure_.*", SensorUnit(_PASCAL)),
    (r"brake_torques", SensorUnit(_NEWTON_METER, (), "of each wheel end")),
    (r"wheel_speeds", SensorUnit("rad/s", (), "of each wheel end")),
    (
        r"slip_control_active",
        SensorUnit(
            "1",
            ("asr_engine", "asr_brake", "drag_torque"),
            "0 or 1: traction control by engine, by brakes, drag-torque control",
        ),
    ),
    (r"xbr_active|abs_active|compressor_active", SensorUnit("1", (), "0 or 1")),
    (r"steering_wheel_position|steer_angle_.*", SensorUnit("rad", (), "left positive")),
    (
        r"articulation\d*_(yaw|pitch|roll)",
        SensorUnit("rad", (), "of a towed unit against the unit ahead"),
    ),
    (r"articulation\d*_rate", SensorUnit("rad/s", (), "of the yaw")),
    (r"tractor_position", SensorUnit("m", _XYZ, "steer axle's middle on the ground")),
    (r"tractor_orientation", SensorUnit("1", ("w", "x", "y", "z"), "quaternion")),
    (r".*_velocity", SensorUnit("m/s", _XYZ, "in the unit's own frame")),
    (r".*_gyro", SensorUnit("rad/s", _XYZ, "in the unit's own frame")),
    (r".*_acceleration", SensorUnit("m/s2", _XYZ, "in the unit's own frame, with gravity")),
    (r".*_tire_force", SensorUnit("N", _XYZ, "along, to the left, upward")),
    (r".*_tire_slip", SensorUnit("1, rad", ("longitudinal", "angle"), "slip and slip angle")),
)


def sensor_unit(name: str) -> SensorUnit:
    """Returns the description of a sensor's numbers.

    Raises:
      InputError: the truck has no such sensor.
    """
    for pattern, unit in _TABLE:
        if re.fullmatch(pattern, name):
            return unit
    raise InputError(f"sensor {name!r} is unknown")
