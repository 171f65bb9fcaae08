"""Energy audit over a hilly trip: every joule of the engine's work must be accounted for.

    engine work = kinetic + potential + springs and tires + air + rolling + tire slip + dampers
                  + brakes + retarder + driveline's losses and store + auxiliaries

The plugin has counters of the engine's side and of the work of the brakes. `Ledger` sums up all
other parts at each step of the physics, from motion and tire forces and by the law of each part, so
that an error in the plugin's forces shows as missing energy; it also computes the work of the
brakes from the moments on the wheels. A force acts over a step with the velocities at its start;
the neglected part shrinks with the step and is part of the audit's error. The ledger holds on
straight roads without cross slope. It omits negligible parts: strain of the treads, play of the
couplings, work of the steering.

The truck starts at rest, keeps 70 km/h over hills as far as possible, brakes for a slow stretch
(in the whole trip in the middle of a descent), and drives on.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields

import mujoco
import numpy as np
from numpy.typing import NDArray

from iits_mj.core.arrays import FloatArray
from iits_mj.core.results import Findings, Line
from iits_mj.core.units import GRAVITY, KMH
from iits_mj.parameters import TruckParameters
from iits_mj.parameters.mass_state import air_shares, rolling_resistances, static_axle_loads
from iits_mj.truck import Truck
from iits_mj.validation.harness.recorder import PERIOD, placed_truck
from iits_mj.validation.longitudinal.hills import HILLS_LENGTH, SpeedKeeper, hills

_SIDES = ("left", "right")
# Least speed in the denominator of slips, as in the tire's sensor [m/s].
_SLIP_SPEED_MIN = 0.5
# Spin above which rolling resistance is complete: wind-up of the tire over its damping [rad/s].
_SPIN_FULL = 0.125
_ROAD_SPACING = 0.1
_START, _END_MARGIN = 30.0, 60.0
_CRUISE, _SLOW = 70.0 * KMH, 35.0 * KMH
# Ends of the slow stretch as shares of the trip.
_SLOW_FROM, _SLOW_TO = 0.6, 0.65
_TIME_LIMIT = 400.0
# Greatest missing energy [% of the engine's work].
_CLOSED = 0.5
_COUNTERS = ("engine_work", "driveline_loss", "retarder_work", "driveline_energy", "brake_work")
# Of a truck with auxiliaries.
_AUXILIARIES = "auxiliary_work"
# Speeds at which the drag area in the mean wind is tabulated [m/s].
_DRAG_SPEEDS = np.linspace(0.5, 40.0, 396)


@dataclass(frozen=True)
class Losses:
    """Energy lost since the start [J].

    Attributes:
      air; rolling, slip: of the tires on the road; tire_damping: of their rubber.
      suspension: dampers and friction.
      brakes: of the wheel ends, from the remaining moment on each wheel.
      shaft: work of the propeller shaft on the wheels, which is not a loss.
    """

    air: float = 0.0
    rolling: float = 0.0
    slip: float = 0.0
    tire_damping: float = 0.0
    suspension: float = 0.0
    brakes: float = 0.0
    shaft: float = 0.0


@dataclass(frozen=True)
class Stored:
    """Energy stored in the truck at an instant [J]."""

    kinetic: float
    potential: float
    springs: float
    tires: float

    @property
    def total(self) -> float:
        """Sum of all parts [J]."""
        return self.kinetic + self.potential + self.springs + self.tires


class Ledger:
    """Sums up the losses while `step` advances the truck."""

    def __init__(self, truck: Truck) -> None:
        """Starts with the truck on a straight road, after its `reset`."""
        self.truck = truck
        model, parameters = truck.model, truck.parameters
        ends = [(axle, side) for axle in parameters.axles for side in _SIDES]
        tires = [parameters.tires[axle.tire] for axle, _ in ends]
        self._hubs = np.array([model.body(f"{axle.name}_{side}_hub").id for axle, side in ends])
        self._wheels = np.array([model.body(f"{axle.name}_{side}_wheel").id for axle, side in ends])
        self._spins = np.array([model.joint(f"{a.name}_{side}_spin").dofadr[0] for a, side in ends])
        force = self._addresses([f"{a.name}_{side}_tire_force" for a, side in ends])
        slip = self._addresses([f"{a.name}_{side}_tire_slip" for a, side in ends])
        self._forces = np.array([force, force + 1, force + 2])
        self._slips = np.array([slip, slip + 1])
        self._free_radius = np.array([tire.free_radius for tire in tires])
        self._rolling_radius = np.array([tire.rolling_radius for tire in tires])
        self._stiffness = np.array([tire.count * tire.vertical_stiffness for tire in tires])
        self._damping = np.array([tire.count * tire.vertical_damping for tire in tires])
        nominal = parameters.tire_common.nominal_load
        self._nominal = np.array([nominal / tire.vertical_stiffness for tire in tires])
        shares, air = air_shares(parameters), parameters.aerodynamics
        self._noses = [model.body(f"{unit.name}_pressure_center").id for unit in parameters.units]
        self._air_share = tuple(0.5 * air.density * part for part in shares)
        self._drag_areas = [air.mean_drag_area(speed) for speed in _DRAG_SPEEDS.tolist()]
        # A number for each wheel end; the load dependence is that of the static loads.
        static = static_axle_loads(parameters, truck.payload)
        self._rolling = np.repeat(rolling_resistances(parameters, static), 2)
        self._bodies = np.concatenate([self._hubs, self._noses])
        self._root = int(model.body_rootid[self._hubs[0]])
        self._shaft = self._addresses(["propeller_shaft_torque", "propeller_shaft_speed"])
        station = np.arange(0.0, truck.route.length, _ROAD_SPACING)
        road = truck.route.evaluate(station)
        self._height, self._grade = road.z, road.grade
        self._sums = np.zeros(len(fields(Losses)))

    @property
    def losses(self) -> Losses:
        """The losses so far."""
        return Losses(*map(float, self._sums))

    def step(self, n: int = 1) -> None:
        """Advances the truck by n steps and counts the losses of each."""
        model, data = self.truck.model, self.truck.data
        speeds = np.empty(model.nv)
        for _ in range(n):
            speeds[:] = data.qvel
            self.truck.step(1)
            # After a step, everything but qpos and qvel still belongs to the start of the step.
            self._sums += model.opt.timestep * self._powers(speeds)

    def stored(self) -> Stored:
        """The stored energy now; MuJoCo's kinetic energy includes the turning wheels."""
        model, data = self.truck.model, self.truck.data
        mujoco.mj_forward(model, data)
        mujoco.mj_energyPos(model, data)
        mujoco.mj_energyVel(model, data)
        potential = GRAVITY * float(model.body_mass @ data.xipos[:, 2])
        vx, _, vz = (values[: len(self._wheels)] for values in self._velocity())
        deflection, _, _ = self._contact(vx, vz)
        return Stored(
            kinetic=float(data.energy[1]),
            potential=potential,
            springs=float(data.energy[0]) - potential,
            tires=0.5 * float(self._stiffness @ np.maximum(deflection, 0.0) ** 2),
        )

    def tire_loads(self) -> FloatArray:
        """Load of each tire by deflection and damping [N], shape (12,); it must match the sensor's.

        The tires must be on the ground.
        """
        vx, _, vz = (values[: len(self._wheels)] for values in self._velocity())
        deflection, _, away = self._contact(vx, vz)
        return self._stiffness * deflection - self._damping * away

    def _addresses(self, names: list[str]) -> NDArray[np.int64]:
        return np.array([int(self.truck.model.sensor(name).adr[0]) for name in names])

    def _velocity(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Velocity of hubs and pressure centers in world axes [m/s], each of shape (14,)."""
        data = self.truck.data
        turn_x, turn_y, turn_z, x, y, z = data.cvel[self._bodies].T
        arm_x, arm_y, arm_z = (data.xpos[self._bodies] - data.subtree_com[self._root]).T
        return (
            x + turn_y * arm_z - turn_z * arm_y,
            y + turn_z * arm_x - turn_x * arm_z,
            z + turn_x * arm_y - turn_y * arm_x,
        )

    def _contact(self, vx: FloatArray, vz: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Deflection [m], speed along and away from the road [m/s] of each wheel, shape (12,)."""
        x, _, z = self.truck.data.xpos[self._wheels].T
        place = np.minimum((x * (1.0 / _ROAD_SPACING)).astype(int), len(self._height) - 2)
        grade, left = self._grade[place], x - _ROAD_SPACING * place
        # The grade is constant between two points of the table.
        height = self._height[place] + left * grade
        cosine = 1.0 / np.sqrt(1.0 + grade * grade)
        ahead, away = (vx + grade * vz) * cosine, (vz - grade * vx) * cosine
        return self._free_radius - (z - height) * cosine, ahead, away

    def _powers(self, speeds: FloatArray) -> FloatArray:
        """Power of each loss [W] in the order of `Losses`; `speeds` is qvel at that instant."""
        data, p = self.truck.data, self.truck.parameters
        sensors = data.sensordata
        fx, fy, load = sensors[self._forces]
        vx, vy, vz = self._velocity()
        wheels = len(self._wheels)
        deflection, ahead, away = self._contact(vx[:wheels], vz[:wheels])
        speed = np.maximum(np.abs(ahead), _SLIP_SPEED_MIN)
        slip, angle = sensors[self._slips]
        spin = speeds[self._spins]
        radius = self._rolling_radius + (self._nominal - deflection) / 3.0
        strained = np.clip(spin / _SPIN_FULL, -1.0, 1.0)
        resistance = self._rolling * load * radius * strained
        # Tire and brake act on the axis of the wheel: the brake is the rest of the moment.
        braking = -data.qfrc_passive[self._spins] - resistance - radius * fx
        air = 0.0
        for k, body in enumerate(self._noses):
            nose = (float(vx[wheels + k]), float(vy[wheels + k]), float(vz[wheels + k]))
            frame = data.xmat[body]
            forward = nose[0] * frame[0] + nose[1] * frame[3] + nose[2] * frame[6]
            side = nose[0] * frame[1] + nose[1] * frame[4] + nose[2] * frame[7]
            area = float(np.interp(abs(forward), _DRAG_SPEEDS, self._drag_areas))
            drag = area * forward**2 + p.aerodynamics.side_area * side**2
            air += self._air_share[k] * drag * math.hypot(*nose)
        shaft = sensors[self._shaft[0]] * sensors[self._shaft[1]]
        return np.array(
            [
                air,
                float(resistance @ spin),
                float((fx * slip + fy * np.tan(angle)) @ speed),
                float(self._damping @ (away * away * (load > 0.0))),
                -float(data.qfrc_damper @ speeds) - float(data.qfrc_constraint @ speeds),
                float(braking @ spin),
                float(shaft),
            ]
        )


@dataclass(frozen=True)
class Trip:
    """Energies of a trip [J].

    Attributes:
      losses: sums of the ledger; before, after: stored energy.
      counters: change of each counter of the plugin, nan if the model lacks it.
      way: history of the position [m], shape (n,); history: sums of the ledger there, (n, k).
    """

    losses: Losses
    before: Stored
    after: Stored
    counters: dict[str, float]
    way: FloatArray
    history: FloatArray

    @property
    def stored(self) -> float:
        """Gain of stored energy on the wheels' side of the propeller shaft [J]."""
        return self.after.total - self.before.total

    @property
    def dissipated(self) -> float:
        """Losses on the wheels' side of the propeller shaft [J]."""
        found = self.losses
        road = found.air + found.rolling + found.slip
        brakes = self.counters["brake_work"]
        return road + found.tire_damping + found.suspension + brakes

    @property
    def wheels_error(self) -> float:
        """Unaccounted work of the propeller shaft as a share of its work [1]."""
        return (self.losses.shaft - self.stored - self.dissipated) / self.losses.shaft

    @property
    def driveline_error(self) -> float:
        """Engine work unaccounted for between engine and shaft, as a share of it [1]."""
        c = self.counters
        return (c["engine_work"] - self._driveline - self.losses.shaft) / c["engine_work"]

    @property
    def error(self) -> float:
        """Engine work unaccounted for, as a share of it [1]."""
        work = self.counters["engine_work"]
        return (work - (self.stored + self.dissipated + self._driveline)) / work

    @property
    def _driveline(self) -> float:
        """Work between crankshaft and propeller shaft."""
        c = self.counters
        lost = c["driveline_loss"] + c["driveline_energy"] + c["retarder_work"]
        return lost + c[_AUXILIARIES]


def drive(
    parameters: TruckParameters, payload: float, timestep: float, length: float = HILLS_LENGTH
) -> Trip:
    """Drives the first `length` m of the hills with this payload [kg]."""
    truck = placed_truck(parameters, payload, timestep, hills(), station=_START)
    truck.step(round(1.0 / timestep))
    ledger, keeper = Ledger(truck), SpeedKeeper()
    before, counters = ledger.stored(), _counters(truck)
    steps = round(PERIOD / timestep)
    rows = []
    way = _START
    begin = truck.time
    while way < length - _END_MARGIN and truck.time - begin < _TIME_LIMIT:
        way = float(truck.data.qpos[0])
        target = _SLOW if _SLOW_FROM < way / length < _SLOW_TO else _CRUISE
        truck.command(keeper.command(float(truck.data.qvel[0]), target))
        ledger.step(steps)
        rows.append([way, *vars(ledger.losses).values()])
    after = ledger.stored()
    table = np.array(rows)
    return Trip(
        losses=ledger.losses,
        before=before,
        after=after,
        counters={name: value - counters[name] for name, value in _counters(truck).items()},
        way=table[:, 0],
        history=table[:, 1:],
    )


def compare(
    parameters: TruckParameters, payload: float, timestep: float, length: float
) -> Findings:
    """The audit; each part as a share of the engine's work."""
    trip = drive(parameters, payload, timestep, length)
    way = trip.way[-1] - trip.way[0]
    found = Findings(f"energy audit, {payload / 1e3:g} t load, {way:.0f} m of hills")
    work = trip.counters["engine_work"]
    parts = {
        "kinetic": trip.after.kinetic - trip.before.kinetic,
        "potential": trip.after.potential - trip.before.potential,
        "springs and tires": trip.stored
        - (trip.after.kinetic + trip.after.potential)
        + (trip.before.kinetic + trip.before.potential),
        "air": trip.losses.air,
        "rolling": trip.losses.rolling,
        "tire slip": trip.losses.slip,
        "dampers": trip.losses.tire_damping + trip.losses.suspension,
        "brakes": trip.counters["brake_work"],
        "retarder": trip.counters["retarder_work"],
        "driveline": trip.counters["driveline_loss"],
        "driveline, stored": trip.counters["driveline_energy"],
    }
    if parameters.engine.auxiliary_power:
        parts["auxiliaries"] = trip.counters[_AUXILIARIES]
    found.check("engine work", work / 1e6, "MJ")
    for name, part in parts.items():
        found.check(f"{name}, of the engine's work", 100.0 * part / work, "%")
    brakes = 100.0 * (trip.counters["brake_work"] - trip.losses.brakes) / work
    for name, value in (
        ("missing, in all", 100.0 * trip.error),
        ("missing between engine and shaft", 100.0 * trip.driveline_error),
        ("missing between shaft and road", 100.0 * trip.wheels_error),
        ("brake work of the sensor against the wheels' moments", brakes),
    ):
        found.check(name, value, "%", must=f"{-_CLOSED:g} .. {_CLOSED:g}")
    history = dict(zip(vars(trip.losses), trip.history.T / 1e6, strict=True))
    shown = {name: history[name] for name in ("air", "rolling", "slip", "brakes")}
    shown["dampers"] = history["tire_damping"] + history["suspension"]
    lines = [Line(name, trip.way, values) for name, values in shown.items()]
    shaft = Line("work of the propeller shaft", trip.way, history["shaft"], "reference")
    found.panel("sums", "way [m]", "energy [MJ]", shaft, *lines)
    return found


def _counters(truck: Truck) -> dict[str, float]:
    known = {truck.model.sensor(i).name for i in range(truck.model.nsensor)}
    found = {name: truck.read(name) if name in known else float("nan") for name in _COUNTERS}
    return found | {_AUXILIARIES: truck.read(_AUXILIARIES) if _AUXILIARIES in known else 0.0}
