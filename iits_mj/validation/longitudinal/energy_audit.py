"""Energy audit over a hilly trip: nothing is made, and every joule of the engine is found.

    engine work = kinetic + potential + springs and tires + air + rolling + tire slip + dampers
                  + brakes + retarder + driveline's losses and store

The engine's side and the brakes' work are the plugin's own counters, the rest is summed up by
`energy.Ledger`, which also says what the brakes must have taken by the moments on the wheels. The
truck starts at rest, keeps 70 km/h over hills as far as it can, brakes for a slow stretch (in the
whole trip in the middle of a descent), and drives on.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields

import mujoco
import numpy as np
from numpy.typing import NDArray

from iits_mj.core.arrays import FloatArray
from iits_mj.core.results import Check, Line, Panel
from iits_mj.core.units import GRAVITY, KMH
from iits_mj.truck import Truck
from iits_mj.validation.harness.recorder import PERIOD
from iits_mj.validation.longitudinal.runs import HILLS_LENGTH, SpeedKeeper, hills

# --- Where the energy goes: every loss of the truck, summed up at each step of the physics ---
# The engine's side and the brakes have counters in the plugin. Everything else is computed here
# from motion and tire forces, by what each part does, so that a mistake in the plugin's forces
# shows as energy from nowhere. A force acts from one step to the next with the velocities of the
# step's start; what that leaves out falls with the step and is counted in the audit's error.
#
# Holds on straight roads without cross slope. Not counted, as they are next to nothing there:
# strain of the treads, play of the couplings, work of the steering.

_SIDES = ("left", "right")
# Below it slips are measured over this speed (as the tire's sensor does) [m/s].
_SLIP_SPEED_MIN = 0.5
# Spin at which rolling resistance is there in full: the tire's wind-up over its damping [rad/s].
_SPIN_FULL = 0.125
_ROAD_SPACING = 0.1


@dataclass(frozen=True)
class Losses:
    """Energy that has left the truck since the start [J].

    Attributes:
      air, rolling, slip: of the tires over the road; tire_damping: of their rubber.
      suspension: dampers and friction.
      brakes: of the wheel ends, by what is left of the moment on each wheel.
      shaft: work that the propeller shaft has done on the wheels; it is no loss.
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
    """Energy in the truck at an instant [J]: motion, height, springs, compressed tires."""

    kinetic: float
    potential: float
    springs: float
    tires: float

    @property
    def total(self) -> float:
        """All of it [J]."""
        return self.kinetic + self.potential + self.springs + self.tires


class Ledger:
    """Counts the losses while `step` advances the truck."""

    def __init__(self, truck: Truck) -> None:
        """The truck stands or rolls on a straight road as its `reset` has left it."""
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
        share, air = parameters.aerodynamics.tractor_share, parameters.aerodynamics
        self._noses = [model.body(f"{unit}_pressure_center").id for unit in ("tractor", "trailer")]
        self._air_share = tuple(0.5 * air.density * part for part in (share, 1.0 - share))
        self._bodies = np.concatenate([self._hubs, self._noses])
        self._root = int(model.body_rootid[self._hubs[0]])
        self._shaft = self._addresses(["propeller_shaft_torque", "propeller_shaft_speed"])
        station = np.arange(0.0, truck.route.length, _ROAD_SPACING)
        road = truck.route.evaluate(station)
        self._height, self._grade = road.z, road.grade
        self._sums = np.zeros(len(fields(Losses)))

    @property
    def losses(self) -> Losses:
        """What was counted so far."""
        return Losses(*map(float, self._sums))

    def step(self, n: int = 1) -> None:
        """Advances the truck by n steps and counts each."""
        model, data = self.truck.model, self.truck.data
        speeds = np.empty(model.nv)
        for _ in range(n):
            speeds[:] = data.qvel
            self.truck.step(1)
            # Everything but qpos and qvel still shows the instant from which the step went on.
            self._sums += model.opt.timestep * self._powers(speeds)

    def stored(self) -> Stored:
        """What is in the truck now; MuJoCo's kinetic energy includes the turning wheels."""
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

    def _addresses(self, names: list[str]) -> NDArray[np.int64]:
        return np.array([int(self.truck.model.sensor(name).adr[0]) for name in names])

    def _velocity(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Velocity of hubs, then pressure centers, in the world's axes [m/s], each shape (14,)."""
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
        # Between two points of the table the grade is taken as constant.
        height = self._height[place] + left * grade
        cosine = 1.0 / np.sqrt(1.0 + grade * grade)
        ahead, away = (vx + grade * vz) * cosine, (vz - grade * vx) * cosine
        return self._free_radius - (z - height) * cosine, ahead, away

    def _powers(self, speeds: FloatArray) -> FloatArray:
        """Power of each loss [W], in the order of `Losses`; `speeds` are qvel of that instant."""
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
        resistance = p.tire_common.rolling_resistance * load * radius * strained
        # On the wheel's own axis act the tire and the brake, which is what is left of the moment.
        braking = -data.qfrc_passive[self._spins] - resistance - radius * fx
        air = 0.0
        for k, body in enumerate(self._noses):
            nose = (float(vx[wheels + k]), float(vy[wheels + k]), float(vz[wheels + k]))
            frame = data.xmat[body]
            forward = nose[0] * frame[0] + nose[1] * frame[3] + nose[2] * frame[6]
            side = nose[0] * frame[1] + nose[1] * frame[4] + nose[2] * frame[7]
            drag = p.aerodynamics.drag_area * forward**2 + p.aerodynamics.side_area * side**2
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


# --- Energy audit over a hilly trip: nothing is made, and every joule of the engine is found ---

_START, _END_MARGIN = 30.0, 60.0
_CRUISE, _SLOW = 70.0 * KMH, 35.0 * KMH
# Where the truck has to be slow, over the length of the trip.
_SLOW_FROM, _SLOW_TO = 0.6, 0.65
_TIME_LIMIT = 400.0
_CLOSED = 0.5
_COUNTERS = ("engine_work", "driveline_loss", "retarder_work", "driveline_energy", "brake_work")


@dataclass(frozen=True)
class Trip:
    """What a trip took [J]: by the ledger, by what is stored more than before, and by counters.

    Attributes:
      losses: sums of the ledger; before, after: what the truck stored.
      counters: change of each of the plugin's counters, nan where the model has none of the name.
      time, way: history of time [s] and position [m], shape (n,).
      history: sums of the ledger at these times, shape (n, k).
    """

    losses: Losses
    before: Stored
    after: Stored
    counters: dict[str, float]
    time: np.ndarray
    way: np.ndarray
    history: np.ndarray

    @property
    def stored(self) -> float:
        """Gain of everything stored on the wheels' side of the propeller shaft [J]."""
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
        """Energy that the propeller shaft gave and nobody got, over its work [1]."""
        return (self.losses.shaft - self.stored - self.dissipated) / self.losses.shaft

    @property
    def driveline_error(self) -> float:
        """Engine work that neither reached the shaft nor was counted, over engine work [1]."""
        c = self.counters
        engine = c["engine_work"] - c["driveline_loss"] - c["driveline_energy"] - c["retarder_work"]
        return (engine - self.losses.shaft) / c["engine_work"]

    @property
    def error(self) -> float:
        """Engine work that is nowhere, over engine work [1]."""
        c = self.counters
        found = self.stored + self.dissipated
        found += c["driveline_loss"] + c["driveline_energy"] + c["retarder_work"]
        return (c["engine_work"] - found) / c["engine_work"]


def drive(payload: float, timestep: float, length: float = HILLS_LENGTH) -> Trip:
    """The trip with this payload [kg], over the first `length` m of the hills."""
    truck = Truck.load(payload, route=hills(), timestep=timestep, visuals=False)
    truck.reset(station=_START)
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
        rows.append([truck.time - begin, way, *vars(ledger.losses).values()])
    after = ledger.stored()
    table = np.array(rows)
    return Trip(
        losses=ledger.losses,
        before=before,
        after=after,
        counters={name: value - counters[name] for name, value in _counters(truck).items()},
        time=table[:, 0],
        way=table[:, 1],
        history=table[:, 2:],
    )


def compare(payload: float, timestep: float, length: float) -> tuple[list[Check], list[Panel]]:
    """The audit as checks, each share over the engine's work."""
    trip = drive(payload, timestep, length)
    label = f"energy audit, {payload / 1e3:g} t load, {trip.way[-1] - trip.way[0]:.0f} m of hills"
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
    brakes = 100.0 * (trip.counters["brake_work"] - trip.losses.brakes) / work
    checks = [
        Check(f"{label}: engine work", work / 1e6, "MJ"),
        *[
            Check(f"{label}: {name}, of the engine's work", 100.0 * part / work, "%")
            for name, part in parts.items()
        ],
        _closed(f"{label}: missing, in all", 100.0 * trip.error),
        _closed(f"{label}: missing between engine and shaft", 100.0 * trip.driveline_error),
        _closed(f"{label}: missing between shaft and road", 100.0 * trip.wheels_error),
        _closed(f"{label}: brake work of the sensor against the wheels' moments", brakes),
    ]
    history = dict(zip(vars(trip.losses), trip.history.T / 1e6, strict=True))
    shown = {name: history[name] for name in ("air", "rolling", "slip", "brakes")}
    shown["dampers"] = history["tire_damping"] + history["suspension"]
    lines = (
        Line("work of the propeller shaft", trip.way, history["shaft"], "reference"),
        *(Line(name, trip.way, values) for name, values in shown.items()),
    )
    return checks, [Panel(f"{label}: sums", "way [m]", "energy [MJ]", lines)]


def _closed(name: str, value: float) -> Check:
    return Check(name, value, "%", None, f"{-_CLOSED:g} .. {_CLOSED:g}")


def _counters(truck: Truck) -> dict[str, float]:
    known = {truck.model.sensor(i).name for i in range(truck.model.nsensor)}
    return {name: truck.read(name) if name in known else float("nan") for name in _COUNTERS}
