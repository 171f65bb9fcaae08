"""What a task shows and rewards, told once: observations, pages and scaled vectors come from it."""

from __future__ import annotations

from dataclasses import dataclass, replace


@dataclass(frozen=True)
class Observed:
    """One observation of a task.

    Attributes:
      scale: usual size, by which it is divided for a learner; in `unit`.
      unit: SI unit, "1" for pure numbers.
      meaning: in words.
      source: where it comes from: a sensor, body or site of the model, or the road.
      size: how many numbers.
    """

    scale: float
    unit: str
    meaning: str
    source: str
    size: int = 1


INSTRUMENTS = {
    "speed": Observed(
        25.0, "m/s", "of the steer axle along the tractor", "sensor `tractor_velocity`"
    ),
    "acceleration": Observed(
        2.0, "m/s2", "along the tractor, without gravity", "sensor `tractor_acceleration`"
    ),
    "gear": Observed(12.0, "1", "1 to 12, -1 in reverse, 0 in neutral", "sensor `gear`"),
    "engine_speed": Observed(220.0, "rad/s", "of the crankshaft", "sensor `engine_speed`"),
    "engine_torque": Observed(2700.0, "N m", "at the crankshaft", "sensor `engine_torque`"),
    "brake_pressure": Observed(
        8e5, "Pa", "mean of the five circuits", "sensors `brake_pressure_*`"
    ),
}
# Of one who holds a speed or creeps, the gear tells nothing.
WITHOUT_GEAR = {name: told for name, told in INSTRUMENTS.items() if name != "gear"}

BENDING = {
    "articulation": Observed(
        0.1, "rad", "tractor's yaw less the trailer's", "sensor `articulation_yaw`, negative"
    ),
    "yaw_rate": Observed(0.1, "rad/s", "of the tractor", "sensor `tractor_gyro`"),
    "steering_wheel_angle": Observed(
        1.0, "rad", "actual, left positive", "sensor `steering_wheel_position`"
    ),
}


def wide(bending: dict[str, Observed]) -> dict[str, Observed]:
    """The same for maneuvers at walking pace, with larger angles."""
    sizes = {"articulation": 0.5, "yaw_rate": 0.2, "steering_wheel_angle": 10.0}
    return {name: replace(told, scale=sizes[name]) for name, told in bending.items()}
