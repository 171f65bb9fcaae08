"""Tightening turn (after ISO 14792, constant speed): which comes first, grip or roll-over.

The standard's constant-speed method holds one steering angle after the other; here the wheel turns
on slowly at a constant rate. The pedal alone holds 60 km/h; where full pedal no longer does, the
test goes on with the speed that is left, which is reported. It ends when
the trailer has rolled beyond 15 degrees, or when the lateral acceleration has not risen for a
while in spite of more steering. It was roll-over when no wheel on the inner side of drive and
trailer axles carried load any more: roll instability as the Australian PBS has it, the same as on
the tilt table, whose threshold is the reference. It was grip when an axle slipped so far that its
tires gave all but 5 % of the side force that they can.

The tilt table leaves out what the turn has: pull on the drive wheels, drag of the steer axle, a
hitch angle, and the time that a fall takes, during which the steering goes on. Gears are held
longer than the automatic does, which would hunt. The rate is our choice: 0.15 (m/s2)/s at first.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy import optimize

from iits_mj.analytic import laden_trailer, static_axle_loads
from iits_mj.core.arrays import FloatArray
from iits_mj.core.results import Check, Line, Panel
from iits_mj.core.units import GRAVITY, KMH
from iits_mj.parameters import TireCommon, TruckParameters
from iits_mj.parameters.tire_law import cornering_stiffness, friction, lateral_shape
from iits_mj.road import Route
from iits_mj.road.elements import DEFAULT_FRICTION
from iits_mj.truck import Truck
from iits_mj.validation.handling.circle import gears_held
from iits_mj.validation.harness.recorder import PERIOD, Recording, drive, run_straight, trailer_roll

# --- How much side force the tires can give, by the tire's law with loads as at rest ---
# The tires' friction holds on a surface of 0.8 and scales with the surface's.


def grip_limit(parameters: TruckParameters, payload: float, surface: float) -> float:
    """Lateral acceleration [g] with every tire at its best at once and loads as at rest.

    An upper bound: load that moves to the outer tires, pull and drag only take from it.
    """
    loads = static_axle_loads(parameters, payload)
    best = [
        load * _friction(parameters, index, float(load), surface)
        for index, load in enumerate(loads)
    ]
    return float(np.sum(best) / np.sum(loads))


def effort(
    parameters: TruckParameters, payload: float, surface: float, index: int, slip: FloatArray
) -> FloatArray:
    """Share of its greatest side force that an axle gives, 1 beyond the peak, shape (n,).

    Args:
      parameters: of the truck.
      payload: [kg].
      surface: friction of the road [1].
      index: of the axle, from the front.
      slip: angle [rad], shape (n,).
    """
    common = parameters.tire_common
    tire = parameters.tires[parameters.axles[index].tire]
    load = float(static_axle_loads(parameters, payload)[index])
    each = load / (2 * tire.count)
    most = each * _friction(parameters, index, load, surface)
    stiffness = float(cornering_stiffness(each, tire, common))
    stretch = np.tan(np.abs(slip)) * stiffness / (common.shape_lateral * most)
    stretch = np.minimum(stretch, _peak(common))
    return lateral_shape(stretch, common)


def _friction(parameters: TruckParameters, index: int, load: float, surface: float) -> float:
    """Peak friction of an axle's tires [1] at the axle's load [N]."""
    tire, common = parameters.tires[parameters.axles[index].tire], parameters.tire_common
    each = load / (2 * tire.count)
    return float(friction(each, common.friction_lateral, common)) * surface / DEFAULT_FRICTION


def _peak(common: TireCommon) -> float:
    """`B tan(alpha)` at which the Magic Formula peaks: `C atan(...) = 90 deg`, for C above 1."""
    wanted, curve = math.tan(0.5 * math.pi / common.shape_lateral), common.curvature_lateral
    found = optimize.brentq(lambda b: b - curve * (b - math.atan(b)) - wanted, 0.0, 10.0 * wanted)
    return float(found)


# --- Tightening turn (after ISO 14792, constant speed): which comes first, grip or roll-over ---

SPEED = 60.0 * KMH
RATE = math.radians(4.0)
SURFACES = (0.8, 0.3)
# Bounds as shares: of the tilt table's threshold; of all tires' grip at their best at once.
ROLL_OVER, GRIP = (0.9, 1.1), (0.7, 1.0)
# An axle slides when its tires give this share of their greatest side force.
SLIDING = 0.95
# From here to the greatest lateral acceleration slip must grow so much (a linear tire's: 1.11).
_LATE, _GROWTH = 0.9, 1.5
_LONGEST = 70.0
_ROLLED = math.radians(15.0)
# The lateral acceleration is a mean over so many samples; without rise for so long the test ends.
_MEAN, _NO_RISE = 50, 6.0


@dataclass(frozen=True)
class Turn:
    """One tightening turn on a surface of this friction, to its end.

    Attributes:
      recording: of the truck.
      lateral: lateral acceleration of the whole truck, mean of the last half second, (n,) [m/s2].
      inner: load on the inner wheels of drive and trailer axles over what it was, (n,) [1].
      slip: slip angles of steer axle, drive axles and trailer axles, shape (3, n) [rad].
      effort: share of their greatest side force that these tires give, shape (3, n) [1].
    """

    recording: Recording
    friction: float
    lateral: FloatArray
    inner: FloatArray
    slip: FloatArray
    effort: FloatArray

    def rolled_over(self) -> bool:
        """True when the last inner wheel of drive and trailer axles left the ground."""
        return bool(np.any(self.inner <= 0.0))

    def end(self) -> int:
        """Sample at which the last inner wheel lifts; the last sample when it never does."""
        lifted = np.flatnonzero(self.inner <= 0.0)
        return int(lifted[0]) if len(lifted) else len(self.lateral) - 1

    def greatest(self) -> float:
        """Greatest lateral acceleration up to the end [g]."""
        return float(np.max(self.lateral[: self.end() + 1])) / GRAVITY

    def sliding(self) -> str:
        """Axles that slide at the end, in words; empty when none does."""
        names = ("steer axle", "drive axles", "trailer axles")
        last = self.effort[:, self.end()]
        return ", ".join(n for n, share in zip(names, last, strict=True) if share >= SLIDING)

    def ending(self) -> str:
        """What came first."""
        if self.rolled_over():
            return "roll-over"
        sliding = self.sliding()
        return f"grip ({sliding} at its limit)" if sliding else "speed lost at full pedal"

    def fell(self) -> bool:
        """True when the trailer rolled on and the test was ended for it."""
        return bool(np.max(np.abs(self.recording.trailer_roll)) > _ROLLED)

    def growth(self) -> float:
        """Slip of the steer axle at the end over that at 0.9 of the greatest acceleration [1]."""
        late = int(np.argmax(self.lateral >= _LATE * np.max(self.lateral)))
        return float(self.slip[0, self.end()] / self.slip[0, late])


def tighten(payload: float, surface: float, timestep: float) -> Turn:
    """Drives the turn with a payload [kg] on a friction [1]."""
    parameters = gears_held(TruckParameters.load())
    route = Route.straight(4000.0, friction=surface)
    truck = Truck.load(
        payload, parameters=parameters, route=route, timestep=timestep, visuals=False
    )
    truck.reset(station=500.0, speed=SPEED)
    hold = run_straight(truck, SPEED)
    watch = _Watch(truck)
    record = drive(
        truck,
        lambda time, _: RATE * time,
        speed=SPEED,
        duration=_LONGEST,
        hold=hold,
        stop=watch.over,
    )
    slip = _slips(record, parameters)
    groups = (0, 1, len(parameters.tractor.axles))
    used = np.array(
        [
            effort(parameters, payload, surface, axle, angle)
            for axle, angle in zip(groups, slip, strict=True)
        ]
    )
    inner = np.array(watch.inner)
    return Turn(record, surface, np.array(watch.lateral), inner / inner[0], slip, used)


class _Watch:
    """Keeps what the recording does not, sample by sample, and knows when the test is over."""

    def __init__(self, truck: Truck) -> None:
        self.lateral: list[float] = []
        self.inner: list[float] = []
        self._raw: list[float] = []
        self._truck = truck
        self._mass = (
            truck.parameters.tractor.mass,
            laden_trailer(truck.parameters, truck.payload).mass,
        )
        self._names = [f"{axle.name}_left_tire_force" for axle in truck.parameters.axles[1:]]
        self._best = (0.0, 0)

    def over(self, trailer: float) -> bool:
        """Takes a sample; trailer: its lateral acceleration [m/s2]."""
        data, (pulling, pulled) = self._truck.data, self._mass
        tractor = self._truck.observe().lateral_acceleration
        self._raw.append((pulling * tractor + pulled * trailer) / (pulling + pulled))
        self.lateral.append(float(np.mean(self._raw[-_MEAN:])))
        self.inner.append(sum(float(data.sensor(name).data[2]) for name in self._names))
        if self.lateral[-1] > self._best[0]:
            self._best = (self.lateral[-1], len(self.lateral))
        rolled = abs(trailer_roll(self._truck)) > _ROLLED
        return rolled or (len(self.lateral) - self._best[1]) * PERIOD > _NO_RISE


def _slips(record: Recording, parameters: TruckParameters) -> FloatArray:
    """Slip angles of steer axle, drive axles and trailer axles [rad], shape (3, n)."""
    behind = float(np.mean([axle.position for axle in parameters.tractor.axles[1:]]))
    speed = np.maximum(record.speed, 1.0)
    steer = record.road_wheel - np.arctan(record.lateral_velocity / speed)
    driven = -np.arctan((record.lateral_velocity - behind * record.yaw_rate) / speed)
    course = np.arctan2(np.gradient(record.rear_y), np.gradient(record.rear_x))
    trailer = np.angle(np.exp(1j * (record.yaw - record.articulation - course)))
    return np.array([steer, driven, trailer])


def compare(
    payload: float, threshold: float, timestep: float
) -> tuple[list[Check], list[Panel], list[str]]:
    """Checks, panels and what came first on both surfaces; threshold: the tilt table's [g]."""
    parameters = TruckParameters.load()
    checks: list[Check] = []
    turns = [tighten(payload, surface, timestep) for surface in SURFACES]
    for turn in turns:
        grip = grip_limit(parameters, payload, turn.friction)
        checks += _checks(turn, payload, threshold, grip)
    label = f"ISO 14792 tightening turn, {payload / 1e3:g} t"
    wheel = [np.rad2deg(turn.recording.steering_wheel[: turn.end() + 1]) for turn in turns]
    across = np.array([0.0, max(float(angle[-1]) for angle in wheel)])
    lines = [Line("tilt table", across, np.full(2, threshold), "reference")]
    lines += [
        Line(f"friction {turn.friction:g}", angle, turn.lateral[: len(angle)] / GRAVITY)
        for turn, angle in zip(turns, wheel, strict=True)
    ]
    rolls = tuple(
        Line(
            f"friction {turn.friction:g}",
            turn.lateral / GRAVITY,
            np.rad2deg(np.abs(turn.recording.trailer_roll)),
        )
        for turn in turns
    )
    angle = "steering-wheel angle [deg]"
    panels = [
        Panel(f"{label}: until the end", angle, "lateral acceleration [g]", tuple(lines)),
        Panel(f"{label}: trailer", "lateral acceleration [g]", "roll [deg]", rolls),
    ]
    return checks, panels, [_conclusion(payload, turn) for turn in turns]


def _checks(turn: Turn, payload: float, threshold: float, grip: float) -> list[Check]:
    """What the weaker of roll-over at this threshold and grip [g] lets expect."""
    label = f"ISO 14792 tightening turn on {turn.friction:g}, {payload / 1e3:g} t"
    tips = threshold < grip
    first, (low, high) = (threshold, ROLL_OVER) if tips else (grip, GRIP)
    inner, effort = float(turn.inner[turn.end()]), float(np.max(turn.effort[:, turn.end()]))
    return [
        Check(
            f"{label}: greatest lateral acceleration",
            turn.greatest(),
            "g",
            first,
            f"{low * first:.4g} .. {high * first:.4g}",
        ),
        Check(
            f"{label}: load left on the inner wheels of drive and trailer axles",
            inner,
            "1",
            None,
            "<= 0" if tips else "> 0",
        ),
        Check(
            f"{label}: side force of the axle nearest its limit, share of its greatest",
            effort,
            "1",
            None,
            f"< {SLIDING:g}" if tips else f">= {SLIDING:g}",
        ),
        *(
            []
            if tips
            else [
                Check(
                    f"{label}: slip of the steer axle, end over 0.9 of the greatest acceleration",
                    turn.growth(),
                    "1",
                    None,
                    f">= {_GROWTH:g}",
                )
            ]
        ),
        Check(
            f"{label}: speed at the end",
            float(turn.recording.speed[turn.end()] / KMH),
            "km/h",
            float(SPEED / KMH),
        ),
    ]


def _conclusion(payload: float, turn: Turn) -> str:
    """A sentence on what came first."""
    after = ""
    if turn.rolled_over() and not turn.fell():
        after = " Then speed was lost, and the inner wheels came down again."
    return (
        f"ISO 14792 tightening turn on {turn.friction:g}, {payload / 1e3:g} t: "
        f"{turn.ending()} first, at {turn.greatest():.3f} g.{after}"
    )
