"""Tightening turn (after ISO 14792, constant speed): roll-over or grip, whichever is first.

The standard's constant-speed method holds one steering angle after another; here the wheel turns
slowly at a constant rate. The pedal alone holds 60 km/h; when full pedal no longer suffices, the
test continues at the remaining speed, which is reported. It ends when the trailer has rolled beyond
15 degrees, or when the lateral acceleration has not risen for a while in spite of more steering.
The limit is roll-over if no wheel on the inner side of the drive and trailer axles carries load:
roll instability as defined by the Australian PBS, as on the tilt table, whose threshold is the
reference. The limit is grip if the tires of an axle give 95 % of their greatest side force.

Slip control of the driven wheels is off, as by the driver's switch: the threshold is one of the
vehicle without active control (ISO 22135). Near roll-over the inner driven wheels carry little and
spin, because the differentials are open. Traction control then cuts the engine, the truck loses
speed, and the turn ends before the empty truck rolls over. One turn on the dry road shows this.

The tilt table neglects the pull of the drive wheels, the drag of the steer axle, the hitch angle,
and the duration of a fall, during which the steering continues. Gears are held longer than by the
automatic gearbox, which would change back and forth. The rate is a choice of this project:
0.15 (m/s2)/s at first.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from iits_mj.analytic import laden_units
from iits_mj.core.arrays import FloatArray
from iits_mj.core.messages import EgoState
from iits_mj.core.results import Findings, Line
from iits_mj.core.units import GRAVITY, KMH
from iits_mj.parameters import TruckParameters
from iits_mj.parameters.mass_state import group_center
from iits_mj.road import Route
from iits_mj.truck import Truck
from iits_mj.validation.handling import drive_slip
from iits_mj.validation.handling.circle import gears_held
from iits_mj.validation.handling.steady_turn import effort, grip_limit
from iits_mj.validation.harness.maneuver import steady_truck
from iits_mj.validation.harness.recorder import (
    PERIOD,
    SteeringRecord,
    drive,
    unit_lateral_acceleration,
    unit_roll,
)

SPEED = 60.0 * KMH
RATE = math.radians(4.0)
SURFACES = (0.8, 0.3)
# Bounds as shares of the tilt table's threshold, and of the grip of all tires at their peak.
ROLL_OVER, GRIP = (0.9, 1.1), (0.7, 1.0)
# An axle slides when its tires give this share of their greatest side force.
SLIDING = 0.95
# From this share to the whole of the greatest lateral acceleration, slip must grow by this factor;
# with linear tires it would be 1.11.
_LATE, _GROWTH = 0.9, 1.5
_LONGEST = 70.0
_ROLLED = math.radians(15.0)
# Samples of the mean lateral acceleration, and time without a rise that ends the test [s].
_MEAN, _NO_RISE = 50, 6.0


@dataclass(frozen=True)
class Turn:
    """A tightening turn on a surface of this friction.

    Attributes:
      recording: of the truck.
      lateral: lateral acceleration of the whole truck, mean of the last half second, (n,) [m/s2].
      inner: load on the inner wheels of drive and trailer axles relative to the start, (n,) [1].
      slip: slip angles of steer axle, drive axles and the last unit's axles, shape (3, n) [rad];
        a single unit has the first two.
      effort: side force of these axles as a share of their greatest, of the same shape [1].
    """

    recording: SteeringRecord
    friction: float
    lateral: FloatArray
    inner: FloatArray
    slip: FloatArray
    effort: FloatArray

    def rolled_over(self) -> bool:
        """Returns whether the last inner wheel of drive and trailer axles left the ground."""
        return bool(np.any(self.inner <= 0.0))

    def end(self) -> int:
        """Index of the sample at which the last inner wheel lifts, or of the last sample."""
        lifted = np.flatnonzero(self.inner <= 0.0)
        return int(lifted[0]) if len(lifted) else len(self.lateral) - 1

    def greatest(self) -> float:
        """Greatest lateral acceleration up to the end [g]."""
        return float(np.max(self.lateral[: self.end() + 1])) / GRAVITY

    def sliding(self) -> str:
        """Axles that slide at the end, in words; "" without one."""
        names = ("steer axle", "drive axles", "trailer axles")
        last = self.effort[:, self.end()]
        return ", ".join(n for n, share in zip(names, last, strict=False) if share >= SLIDING)

    def ending(self) -> str:
        """The limit that the truck reached first, in words."""
        if self.rolled_over():
            return "roll-over"
        sliding = self.sliding()
        return f"grip ({sliding} at its limit)" if sliding else "speed lost at full pedal"

    def fell(self) -> bool:
        """Returns whether the test ended because the trailer rolled beyond its limit."""
        return bool(np.max(np.abs(self.recording.trailer_roll)) > _ROLLED)

    def growth(self) -> float:
        """Slip of the steer axle at the end over that at 0.9 of the greatest acceleration [1]."""
        late = int(np.argmax(self.lateral >= _LATE * np.max(self.lateral)))
        return float(self.slip[0, self.end()] / self.slip[0, late])


def tighten(
    parameters: TruckParameters,
    payload: float,
    surface: float,
    timestep: float,
    *,
    control: bool = False,
) -> Turn:
    """Drives the turn with a payload [kg] on a friction [1], with or without slip control."""
    parameters = gears_held(parameters if control else drive_slip.without_control(parameters))
    route = Route.straight(4000.0, friction=surface)
    truck, hold = steady_truck(
        payload, SPEED, timestep, station=500.0, parameters=parameters, route=route
    )
    watch = _Watch(truck)

    def steering(time: float, _: float) -> float:
        return RATE * time

    record = drive(truck, steering, speed=SPEED, duration=_LONGEST, hold=hold, stop=watch.over)
    slip = _slips(record, parameters, payload)
    groups = (0, 1, len(parameters.axles) - len(parameters.last.axles))
    pairs = zip(groups, slip, strict=False)
    used = np.array([effort(parameters, payload, surface, axle, angle) for axle, angle in pairs])
    inner = np.array(watch.inner)
    return Turn(record, surface, np.array(watch.lateral), inner / inner[0], slip, used)


class _Watch:
    """Adds measurements that the record lacks at every sample, and detects the end of the test."""

    def __init__(self, truck: Truck) -> None:
        self.lateral: list[float] = []
        self.inner: list[float] = []
        self._raw: list[float] = []
        self._truck = truck
        units = laden_units(truck.parameters, truck.payload)
        self._masses = np.array([unit.mass for unit in units])
        self._names = [f"{axle.name}_left_tire_force" for axle in truck.parameters.axles[1:]]
        self._best = (0.0, 0)

    def over(self, _: EgoState) -> bool:
        """Adds a sample; returns True at the end of the test."""
        data, truck = self._truck.data, self._truck
        units = range(len(self._masses))
        lateral = [unit_lateral_acceleration(truck, unit) for unit in units]
        self._raw.append(float(self._masses @ lateral / self._masses.sum()))
        self.lateral.append(float(np.mean(self._raw[-_MEAN:])))
        self.inner.append(sum(float(data.sensor(name).data[2]) for name in self._names))
        if self.lateral[-1] > self._best[0]:
            self._best = (self.lateral[-1], len(self.lateral))
        rolled = abs(unit_roll(self._truck)) > _ROLLED
        return rolled or (len(self.lateral) - self._best[1]) * PERIOD > _NO_RISE


def _slips(record: SteeringRecord, parameters: TruckParameters, payload: float) -> FloatArray:
    """Slip angles of steer axle, drive axles and the last unit's axles [rad], shape (3, n).

    A single unit has the first two.
    """
    behind = group_center(parameters.lead.groups(payload)[1])
    speed = np.maximum(record.speed, 1.0)
    steer = record.road_wheel - np.arctan(record.lateral_velocity / speed)
    driven = -np.arctan((record.lateral_velocity - behind * record.yaw_rate) / speed)
    if len(parameters.units) == 1:
        return np.array([steer, driven])
    course = np.arctan2(np.gradient(record.rear_y), np.gradient(record.rear_x))
    trailer = np.angle(np.exp(1j * (record.rear_yaw - course)))
    return np.array([steer, driven, trailer])


def compare(
    parameters: TruckParameters, payload: float, threshold: float, timestep: float
) -> Findings:
    """Both surfaces, and the first one also with slip control.

    Args:
      parameters: of the truck.
      payload: [kg].
      threshold: of the tilt table [g].
      timestep: of the physics [s].
    """
    found = Findings()
    turns = {f"friction {mu:g}": tighten(parameters, payload, mu, timestep) for mu in SURFACES}
    for turn in turns.values():
        grip = grip_limit(parameters, payload, turn.friction)
        found.extend(_judge(turn, payload, threshold, grip))
    controlled = tighten(parameters, payload, SURFACES[0], timestep, control=True)
    with_control = Findings(f"{_label(controlled, payload)}, with slip control")
    with_control.check("greatest lateral acceleration", controlled.greatest(), "g")
    with_control.notes.append(_limit(with_control.label, controlled))
    found.extend(with_control)
    turns[f"friction {controlled.friction:g}, with slip control"] = controlled
    found.label = f"ISO 14792 tightening turn, {payload / 1e3:g} t"
    lateral, rolls, greatest = [], [], 0.0
    for name, turn in turns.items():
        until = slice(turn.end() + 1)
        wheel = np.rad2deg(turn.recording.steering_wheel[until])
        greatest = max(greatest, float(wheel[-1]))
        lateral.append(Line(name, wheel, turn.lateral[until] / GRAVITY))
        roll = np.rad2deg(np.abs(turn.recording.trailer_roll))
        rolls.append(Line(name, turn.lateral / GRAVITY, roll))
    across = np.array([0.0, greatest])
    found.panel(
        "until the end",
        "steering-wheel angle [deg]",
        "lateral acceleration [g]",
        Line("tilt table", across, np.full(2, threshold), "reference"),
        *lateral,
    )
    found.panel("trailer", "lateral acceleration [g]", "roll [deg]", *rolls)
    return found


def _judge(turn: Turn, payload: float, threshold: float, grip: float) -> Findings:
    """Checks against the lower of the roll-over threshold and the grip limit [g], and a note."""
    found = Findings(_label(turn, payload))
    tips, end = threshold < grip, turn.end()
    first, (low, high) = (threshold, ROLL_OVER) if tips else (grip, GRIP)
    must = f"{low * first:.4g} .. {high * first:.4g}"
    found.check("greatest lateral acceleration", turn.greatest(), "g", first, must)
    name = "load left on the inner wheels of drive and trailer axles"
    found.check(name, turn.inner[end], "1", must="<= 0" if tips else "> 0")
    name = "side force of the axle nearest its limit, share of its greatest"
    must = f"< {SLIDING:g}" if tips else f">= {SLIDING:g}"
    found.check(name, np.max(turn.effort[:, end]), "1", must=must)
    if not tips:
        name = "slip of the steer axle, end over 0.9 of the greatest acceleration"
        found.check(name, turn.growth(), "1", must=f">= {_GROWTH:g}")
    found.check("speed at the end", turn.recording.speed[end] / KMH, "km/h", SPEED / KMH)
    found.notes.append(_limit(found.label, turn))
    return found


def _label(turn: Turn, payload: float) -> str:
    return f"ISO 14792 tightening turn on {turn.friction:g}, {payload / 1e3:g} t"


def _limit(label: str, turn: Turn) -> str:
    """The limit that the truck reached first, as a sentence."""
    after = ""
    if turn.rolled_over() and not turn.fell():
        after = " Then speed was lost, and the inner wheels came down again."
    return f"{label}: {turn.ending()} first, at {turn.greatest():.3f} g.{after}"
