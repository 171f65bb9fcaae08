"""The 40 t truck over VECTO's mission "Long Haul", against what VECTO declares for it.

VECTO is the tool of the European Commission that declares a truck's fuel (Regulation (EU)
2017/2400). Its driver accelerates with 1 m/s2 up to 25 km/h, falling to 0.5 m/s2 at 60, and brakes
with 1 m/s2 up to 50 km/h, falling to 0.5 at 60. Where the grade is negative and the target above
50 km/h, it lets the truck roll 5 km/h over the target; elsewhere the target is the limit, so that a
descent ends at the target. Ahead of a lower limit, and above 50 km/h, it lifts the pedal where a
deceleration of 0.5 m/s2 would just reach the limit, and brakes where its own deceleration would:
the driver's strategy in VECTO's source of the 3.0 releases before 3.0.4, which introduced the
coasting by energies (VECTO's change log).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np

from iits_mj.core.arrays import FloatArray
from iits_mj.core.messages import EgoState, VehicleCommand, XbrMode
from iits_mj.core.results import Findings
from iits_mj.core.tables import read_columns
from iits_mj.core.units import DIESEL_DENSITY, GRAVITY, KMH
from iits_mj.parameters import TruckParameters
from iits_mj.road import Route
from iits_mj.truck import Truck
from iits_mj.validation.longitudinal.force_balance import ForceBalance
from iits_mj.validation.longitudinal.hills import Grade, sloping

TRUCK = "vecto_40t"
_CYCLE = Path(__file__).with_name("long_haul_cycle.csv")
_ENTRY = 60.0  # [m] of road before the start and after the end
_PERIOD = 0.05  # of the driver [s]
_OVERSPEED, _OVERSPEED_FROM = 5.0 * KMH, 50.0 * KMH
_TOLERANCE = 0.5  # over the target before the driver brakes, where it must not roll [m/s]
_QUICK = 12_000.0  # [m]
_COASTING, _COASTS_FROM = 0.5, 50.0 * KMH  # look-ahead: deceleration [m/s2], lowest speed
_ENERGIES = ("air", "rolling", "auxiliaries", "brakes", "gearbox and axle")


@dataclass(frozen=True)
class Declared:
    """What VECTO declares at a payload: [l/100 km], [s], energies [kWh] in order of `_ENERGIES`."""

    payload: float
    fuel: float
    time: float
    energies: tuple[float, ...]


# VECTO 3.0.1.315, generic vehicle "40t Long Haul Truck", its own result files.
DECLARED = {
    "empty": Declared(0.0, 26.27, 5191.0, (68.5, 27.6, 7.1, 3.9, 10.5)),
    "reference": Declared(19_300.0, 37.02, 5283.0, (67.2, 59.0, 7.2, 19.4, 12.4)),
    "full": Declared(25_400.0, 40.73, 5319.0, (66.6, 68.4, 7.2, 26.2, 13.1)),
}


@dataclass(frozen=True)
class Mission:
    """Target speed and grade over the distance, and the stops.

    Attributes:
      distance: of the rows [m], (n,), rising; values hold from one row to the next.
      target: [m/s]; grade: dz/ds.
      stops: distances [m] and durations [s].
    """

    distance: FloatArray
    target: FloatArray
    grade: FloatArray
    stops: tuple[tuple[float, float], ...]

    @classmethod
    def load(cls, path: Path = _CYCLE) -> Mission:
        """Reads a cycle: distance [m], target [km/h], grade [%], stop [s].

        Raises:
          InputError: the file cannot be read.
        """
        names = ("distance_m", "target_speed_kmh", "grade_percent", "stop_s")
        distance, target, grade, stop = read_columns(path, "cycle", [(name,) for name in names])
        halts = [(float(s), float(t)) for s, t in zip(distance, stop, strict=True) if t > 0.0]
        return cls(distance, target * KMH, grade / 100.0, tuple(halts))

    @property
    def length(self) -> float:
        """[m]."""
        return float(self.distance[-1])

    def cut(self, length: float) -> Mission:
        """Returns the mission's first part, which ends with a stop."""
        kept = self.distance < length
        halts = (*((s, t) for s, t in self.stops if s < length), (length, 2.0))
        distance = np.append(self.distance[kept], length)
        grade = np.append(self.grade[kept], self.grade[kept][-1])
        return Mission(distance, np.append(self.target[kept], 0.0), grade, halts)

    def route(self) -> Route:
        """A straight road with the mission's grades; it begins `_ENTRY` before the start."""
        at, grade = self.distance + _ENTRY, self.grade
        changes = np.flatnonzero(np.abs(np.diff(grade)) > 0.0) + 1
        places = [_ENTRY, *at[changes], float(at[-1]) + _ENTRY]
        grades: list[Grade] = []
        for i, row in enumerate(changes, start=1):
            # Parabolas of 10 m, or as long as there is room.
            room = min(places[i] - places[i - 1], places[i + 1] - places[i])
            grades.append((float(places[i]), float(grade[row]), min(10.0, 0.99 * room)))
        return sloping(float(at[-1]) + _ENTRY, float(grade[0]), tuple(grades))


def braking(speed: float) -> float:
    """The driver's deceleration [m/s2] at a speed [m/s]."""
    return float(np.interp(speed, (50.0 * KMH, 60.0 * KMH), (1.0, 0.5)))


def accelerating(speed: float) -> float:
    """The driver's acceleration [m/s2] at a speed [m/s]."""
    return float(np.interp(speed, (25.0 * KMH, 60.0 * KMH), (1.0, 0.5)))


def _approach(targets: FloatArray, deceleration: Callable[[float], float]) -> FloatArray:
    """Greatest speed [m/s] at each meter from which a deceleration by speed reaches the targets."""
    allowed = targets.copy()
    for i in range(len(allowed) - 2, -1, -1):
        after = float(allowed[i + 1])
        if allowed[i] > after:
            reached = math.sqrt(after * after + 2.0 * deceleration(after + 0.1))
            allowed[i] = min(float(allowed[i]), reached)
    return allowed


def _pedal(balance: ForceBalance, acceleration: float, state: EgoState, grade: float) -> float:
    """Accelerator pedal for an acceleration [m/s2]; below 0 where brakes must help."""
    gear = max(state.gear, 1)
    mass = balance.mass + float(balance.rotating_mass(gear))
    force = mass * acceleration + float(balance.resistance(state.speed, grade))
    speed = max(state.engine_speed, balance.parameters.engine.idle_speed)
    torque = balance.needed_torque(force, gear, speed)
    return balance.pedal(torque, speed) if torque > 0.0 else -1.0


class Driver:
    """VECTO's driver on a mission; `command` gives the controls at a state.

    Args:
      mission: to drive; parameters, payload: of the truck.
    """

    def __init__(self, mission: Mission, parameters: TruckParameters, payload: float) -> None:
        self.mission = mission
        self.balance = ForceBalance(parameters, payload)
        self._place = np.arange(0.0, mission.length + 1.0)
        rows = np.searchsorted(mission.distance, self._place, side="right") - 1
        self._grade = mission.grade[rows]
        self._target = mission.target[rows]
        # Stops are one meter long; the target there is that of the road before.
        for place, _ in mission.stops:
            first = int(place)
            self._target[first : first + 1] = self._target[max(first - 1, 0)] or self._target[-1]
        self._target[0] = self._target[1]
        rolls = (self._grade < 0.0) & (self._target > _OVERSPEED_FROM)
        self._limit = self._target + np.where(rolls, _OVERSPEED, 0.0)
        self._stops = [stop for stop in mission.stops if stop[0] > 0.0]
        self._leg = 0
        self._halt_until: float | None = None
        self._look_ahead()
        self._integral = 0.0
        self._too_fast = False

    @property
    def done(self) -> bool:
        """Whether the last stop is over."""
        return self._leg >= len(self._stops)

    def _look_ahead(self) -> None:
        """Sets the speeds at each meter at which the driver brakes or coasts towards limits."""
        limits = self._limit.copy()
        if self._leg < len(self._stops):
            limits[int(self._stops[self._leg][0]) :] = 0.0
        self._braking = _approach(limits, braking)
        self._coasting = np.maximum(_approach(limits, lambda _: _COASTING), _COASTS_FROM)

    def _at(self, values: FloatArray, place: float) -> float:
        return float(values[min(max(int(place), 0), len(values) - 1)])

    def command(self, state: EgoState) -> VehicleCommand:
        """The controls for the coming period."""
        place, v = state.station - _ENTRY, state.speed
        stop, duration = self._stops[self._leg]
        if self._halt_until is not None:
            if state.time < self._halt_until:
                return VehicleCommand(xbr_mode=XbrMode.MAXIMUM, xbr_demand=-1.0)
            self._halt_until = None
            self._leg += 1
            if self.done:
                return VehicleCommand(xbr_mode=XbrMode.MAXIMUM, xbr_demand=-1.0)
            self._look_ahead()
        elif v < 0.3 and place > stop - 2.0:
            self._halt_until = state.time + duration
        grade, target = self._at(self._grade, place), self._at(self._target, place)
        limit = self._at(self._limit, place)
        left = max(stop - 0.3 - place, 0.0)
        allowed = min(self._at(self._braking, place), math.sqrt(2.0 * left) + 0.1)
        if v > allowed + 0.05 and allowed < limit:
            return self._brake(-braking(v) + (allowed - v))
        most = max(limit, target + _TOLERANCE)
        self._too_fast = v > most or (self._too_fast and v > most - 0.1)
        if self._too_fast:
            return self._brake(max(most - 0.1 - v, -1.0))
        if v > min(target, self._at(self._coasting, place)) + 0.1:
            self._integral = 0.0
            return VehicleCommand()
        error = min(target, allowed) - v
        wanted = min(max(0.5 * error, -0.5), accelerating(v))
        pedal = _pedal(self.balance, wanted, state, grade)
        if abs(error) < 1.0 and not state.shift_in_process and 0.0 < pedal < 1.0:
            self._integral = min(max(self._integral + 0.02 * error * _PERIOD, -0.2), 0.2)
        return VehicleCommand(accelerator_pedal=min(max(pedal + self._integral, 0.0), 1.0))

    def _brake(self, acceleration: float) -> VehicleCommand:
        self._integral = 0.0
        return VehicleCommand(xbr_mode=XbrMode.MAXIMUM, xbr_demand=max(acceleration, -3.0))


@dataclass(frozen=True)
class Drive:
    """A driven mission.

    Attributes:
      fuel: [kg]; distance: [m]; time: [s].
      energies: [kWh], in order of `_ENERGIES`.
      engine, potential: work of the engine and gain of potential energy [kWh].
      record: time, place, speed, target, gear, height; one column each.
    """

    fuel: float
    distance: float
    time: float
    energies: tuple[float, ...]
    engine: float
    record: FloatArray

    @property
    def liters_per_100_km(self) -> float:
        """Fuel [l/100 km]."""
        return self.fuel / DIESEL_DENSITY / self.distance * 1e5


def _add_clutch_loss(spec: mujoco.MjSpec) -> None:
    """Adds a sensor for the clutch's part of the driveline's losses."""
    like = spec.sensor("driveline_loss")
    added = spec.add_sensor(name="clutch_loss", type=like.type)
    added.plugin = like.plugin


def drive(
    parameters: TruckParameters,
    mission: Mission,
    payload: float,
    timestep: float,
    watch: Callable[[EgoState], None] | None = None,
) -> Drive:
    """Drives a mission with VECTO's driver.

    Args:
      parameters: of the truck.
      mission: to drive.
      payload: [kg].
      timestep: of the physics [s].
      watch: is called with every state.
    """
    truck = Truck.load(
        payload,
        parameters=parameters,
        route=mission.route(),
        timestep=timestep,
        visuals=False,
        edit_spec=_add_clutch_loss,
    )
    truck.detects_contacts = False
    driver = Driver(mission, parameters, payload)
    balance, steps = driver.balance, round(_PERIOD / timestep)
    weight = balance.rolling * balance.mass * GRAVITY
    state = truck.reset(station=_ENTRY)
    air = rolling = empty_retarder = 0.0
    rows = []
    while not driver.done:
        truck.command(driver.command(state))
        truck.step(steps)
        state = truck.observe()
        way = state.speed * _PERIOD
        air += way * float(balance.air(state.speed))
        rolling += way * weight * math.cos(state.pitch)
        turns = truck.read("propeller_shaft_speed")
        empty_retarder += turns * float(parameters.retarder.empty_drag(turns)) * _PERIOD
        rows.append((state.time, state.station - _ENTRY, state.speed, state.gear, state.z))
        if watch is not None:
            watch(state)
    gears = truck.read("driveline_loss") - truck.read("clutch_loss") - empty_retarder
    auxiliaries = truck.read("auxiliary_work") if parameters.engine.auxiliary_power else 0.0
    lost = (auxiliaries, truck.read("brake_work"), gears)
    energies = tuple(energy / 3.6e6 for energy in (air, rolling, *lost))
    return Drive(
        state.fuel_used,
        state.station - _ENTRY,
        state.time,
        energies,
        truck.read("engine_work") / 3.6e6,
        np.array(rows),
    )


def compare(timestep: float, *, quick: bool) -> Findings:
    """VECTO's truck over the mission at each of its loads; quick: the first 12 km, one load.

    The quick form has no declared figures and shows only that the mission can be driven.
    """
    found, mission = Findings("VECTO Long Haul"), Mission.load()
    truck = TruckParameters.load(TRUCK)
    if quick:
        short = drive(truck, mission.cut(_QUICK), DECLARED["reference"].payload, timestep)
        found.check("distance driven", short.distance / 1e3, "km", _QUICK / 1e3, ">= 11.9")
        return found
    for name, declared in DECLARED.items():
        driven = drive(truck, mission, declared.payload, timestep)
        label = f"{name}, {declared.payload / 1e3:g} t of load"
        found.check(
            f"{label}: fuel", driven.liters_per_100_km, "l/100 km", *_within(declared.fuel, 0.03)
        )
        found.check(f"{label}: time", driven.time, "s", *_within(declared.time, 0.02))
        for part, energy, given in zip(_ENERGIES, driven.energies, declared.energies, strict=True):
            found.check(f"{label}: energy of {part}", energy, "kWh", *_within(given, 0.05))
    found.notes += [
        "Our tires slip while they drive, about 1 % of the engine's work, which VECTO does not "
        "count; axle loads follow from the truck's statics instead of VECTO's shares.",
        "Gearbox: VECTO's shift lines are not among the figures. The truck's gearbox shifts down "
        "to at most 1743 rpm, of four values tried the one that meets the declared times best; "
        "energies and fuel are not fitted. At 1400 rpm, where full torque begins to fall, the "
        "full truck takes 1 % longer, and its brakes take 0.5 kWh less.",
    ]
    return found


def _within(value: float, share: float) -> tuple[float, str]:
    """A reference and the bound that allows a share around it."""
    return value, f"{value * (1.0 - share):.2f} .. {value * (1.0 + share):.2f}"
