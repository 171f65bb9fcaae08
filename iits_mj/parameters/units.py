"""The units of a combination with their axles, couplings and load.

Positions are meters behind the unit's origin: the first steered axle's center of the motor vehicle,
the coupling point (kingpin, drawbar eye) of a towed unit. Heights are above the road.
"""

from __future__ import annotations

from dataclasses import dataclass

from iits_mj.core.checks import one_of
from iits_mj.core.errors import InputError
from iits_mj.parameters.quantity import (
    CubicMeters,
    Damping,
    Distance,
    Inertia,
    Kilograms,
    Length,
    Mass,
    Meters,
    NewtonMeters,
    NewtonMetersPerPascal,
    Pure,
    Radians,
    RollDamping,
    RollStiffness,
    Seconds,
    Share,
    SpringRate,
)

MOTOR_VEHICLES = ("tractor", "rigid_truck")
TOWED_UNITS = ("semitrailer", "center_axle_trailer", "dolly")
COUPLINGS = ("fifth_wheel", "turntable", "drawbar_eye", "pintle")


@dataclass(frozen=True)
class AxleBrake:
    """The air brakes of an axle.

    Attributes:
      dead_time: from supply valve to chamber.
      build_up_time_constant, release_time_constant: of the chambers.
      torque_per_pressure: slope through zero, of one wheel end; with a push-out pressure the torque
        is the same at `air_brake.anchor_pressure`.
      chamber_volume: of one chamber.
    """

    dead_time: Seconds
    build_up_time_constant: Seconds
    release_time_constant: Seconds
    torque_per_pressure: NewtonMetersPerPascal
    chamber_volume: CubicMeters


@dataclass(frozen=True)
class SelfSteering:
    """Steering of an axle by its own side forces, as of a caster.

    Attributes:
      trail: of the wheel centers behind their kingpins.
      stiffness, damping: of the centering, per knuckle.
      angle_max: of a knuckle.
    """

    trail: Distance
    stiffness: RollStiffness
    damping: RollDamping
    angle_max: Radians


@dataclass(frozen=True)
class Axle:
    """One axle: position, springs, dampers, brakes and wheel ends. Rates are per side.

    Attributes:
      name: the unit's and its own, "trailer_axle1".
      tire: kind of its tires, a table of `tires`.
      position: of its wheel centers, behind the unit's origin.
      track: between the middles of the wheel ends; of twin tires, of the pair.
      unsprung_mass: of the axle with its wheels; wheel_mass: of one wheel end with tires and hub.
      wheel_inertia_spin: of one wheel end about its axis.
      spring_rate, damping: vertical, of one side.
      spring_spacing: between the springs of both sides.
      auxiliary_roll_stiffness: of stabilizer and arms, without the springs.
      roll_center_height: above the axle's center.
      load_share: of its group's load, relative to the group's other axles.
      steered: by the steering wheel; driven: by the propeller shaft.
      lifted_below: payload of the combination below which the axle is lifted; 0: never.
      self_steering: None for an axle that does not steer by itself.
    """

    name: str
    tire: str
    position: Meters
    track: Length
    unsprung_mass: Mass
    wheel_mass: Mass
    wheel_inertia_spin: Inertia
    spring_rate: SpringRate
    spring_spacing: Distance
    damping: Damping
    auxiliary_roll_stiffness: RollStiffness
    roll_center_height: Meters
    brake: AxleBrake
    load_share: Share = 1.0
    steered: bool = False
    driven: bool = False
    lifted_below: Kilograms = 0.0
    self_steering: SelfSteering | None = None

    def lifted(self, payload: float) -> bool:
        """Returns whether the axle is lifted with a payload of the combination [kg]."""
        return payload < self.lifted_below


@dataclass(frozen=True)
class Payload:
    """The load of a unit at its greatest mass; a smaller one keeps CG and radii of gyration.

    Attributes:
      cg_position: behind the unit's origin.
      cg_height: above the road; `TruckParameters.with_payload_height` changes it.
      cg_height_min, cg_height_max: bounds of such a change.
      inertia_x, inertia_y, inertia_z: of the greatest load about its own CG.
    """

    mass_max: Mass
    cg_position: Meters
    cg_height: Distance
    cg_height_min: Distance
    cg_height_max: Distance
    inertia_x: Inertia
    inertia_y: Inertia
    inertia_z: Inertia


@dataclass(frozen=True)
class Coupling:
    """Joint of a towed unit with the unit ahead.

    Attributes:
      kind: "fifth_wheel": carries load, stiff in roll until its plate lifts; "turntable": stiff in
        roll without lash; "drawbar_eye" or "pintle": free in roll as far as `roll_stiffness` is 0.
      position: on the unit ahead, behind its origin; height: above the road.
      yaw_limit, pitch_min, pitch_max: of the towed unit against the unit ahead.
      roll_lash, plate_width: of a fifth wheel, see `plugin/laws/fifth_wheel.h`.
      yaw_friction: of the plate.
    """

    kind: str
    position: Meters
    height: Distance
    yaw_limit: Radians
    pitch_min: Radians
    pitch_max: Radians
    roll_stiffness: RollStiffness = 0.0
    roll_damping: RollDamping = 0.0
    roll_lash: Radians = 0.0
    plate_width: Distance = 0.0
    yaw_friction: NewtonMeters = 0.0

    def __post_init__(self) -> None:
        one_of("coupling of kind", self.kind, COUPLINGS)


@dataclass(frozen=True)
class Unit:
    """A motor vehicle or a towed unit; mass and inertia include axles and wheels, not the load.

    Attributes:
      name: also of its body in the MJCF.
      kind: of motor vehicle or towed unit.
      mass: with axles and wheels, without load.
      cg_position: of the mass, behind the unit's origin; cg_height: of the mass, above the road.
      inertia_x, inertia_y, inertia_z: of the mass about its own CG, in roll, pitch and yaw.
      width, height: of the body; the height above the road.
      front_overhang: of the body ahead of the unit's origin; length: of the body.
      load_equalization: share of the spring of an axle group that acts equally on all its axles.
      air_share: of air drag and side force, relative to the other units.
      axles: front to rear.
      coupling: to the unit ahead; None for the motor vehicle.
      payload: None for a unit without space for a load.
    """

    name: str
    kind: str
    mass: Mass
    cg_position: Meters
    cg_height: Distance
    inertia_x: Inertia
    inertia_y: Inertia
    inertia_z: Inertia
    front_overhang: Meters
    length: Length
    width: Length
    height: Length
    load_equalization: Share
    air_share: Pure
    axles: tuple[Axle, ...]
    coupling: Coupling | None = None
    payload: Payload | None = None

    def __post_init__(self) -> None:
        one_of(f"units.{self.name}: kind", self.kind, (*MOTOR_VEHICLES, *TOWED_UNITS))
        if not self.axles:
            raise InputError(f"units.{self.name} has no axles; at least one is needed")
        positions = [axle.position for axle in self.axles]
        if sorted(positions) != positions:
            raise InputError(
                f"units.{self.name}: axles are at {positions} m; give them from front to rear"
            )
        if (self.coupling is None) is not (self.kind in MOTOR_VEHICLES):
            needed = "cannot have" if self.coupling else "needs"
            raise InputError(f"units.{self.name} is a {self.kind}, which {needed} a coupling")

    def groups(self, payload: float) -> tuple[tuple[Axle, ...], ...]:
        """Returns the axle groups that carry the unit with a payload of the combination [kg].

        The motor vehicle has two, its steered axles ahead and all others; a towed unit has one.
        Lifted axles are in none.
        """
        down = tuple(axle for axle in self.axles if not axle.lifted(payload))
        if self.coupling is not None:
            return (down,)
        front = 0
        while front < len(down) and down[front].steered:
            front += 1
        return (down[:front], down[front:])
