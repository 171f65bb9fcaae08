"""Synthetic drives of a truck with known parameters, as its telemetry and its bus record them.

A simple driver holds the lane and a speed, with pedal steps, coasting and braking in turn, on a
random road without traffic. The identification of such a drive shows what its intervals are worth
(`benchmarks/identification_coverage.py`).
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Mapping, Sequence

import numpy as np

from iits_mj.core.arrays import FloatArray
from iits_mj.core.messages import EgoState, TruckReport, VehicleCommand, XbrMode
from iits_mj.core.timing import CONTROL_PERIOD, CYCLE_PERIOD
from iits_mj.identification.log import PRESSURES, SIGNALS, Log
from iits_mj.j1939 import Frame, command_to_frames, encode, make_group, pgn_of
from iits_mj.j1939.mapping import reports
from iits_mj.j1939.quantities import ReferenceTorques, quantities
from iits_mj.parameters import TruckParameters
from iits_mj.road import Route
from iits_mj.road.design import Design
from iits_mj.truck import Truck

Command = Callable[[float, EgoState], VehicleCommand]
Row = tuple[EgoState, TruckReport, VehicleCommand]

# Messages for the identification of a drive along a road and of a steered drive: periods [s].
LONGITUDINAL = {"EEC1": 0.02, "EEC3": 0.25, "ETC1": 0.02, "ETC2": 0.1, "EBC3": 0.1}
LONGITUDINAL |= {"IITS_MOTION": 0.02, "IITS_TRAILER": 0.1, "IITS_ROUTE": 0.1}
LATERAL = {"VDC2": 0.02, "IITS_TRAILER": 0.02, "IITS_MOTION": 0.02}
# The road: lengths of its straights, clothoids and arcs, and of its slopes [m], steepest slope and
# cross slope [1], lateral acceleration of the bends at their design speed [m/s2].
_STRAIGHT, _CLOTHOID, _ARC, _SLOPE = (60.0, 500.0), (70.0, 130.0), (80.0, 350.0), (250.0, 600.0)
_GRADE_MAX, _CROSS_SLOPE, _BEND_SPEED, _COMFORT = 0.04, 0.025, (11.0, 24.0), 1.2
_CURVE = 120.0
# The driver: preview [s], least and greatest speed [m/s], noise at the steering wheel [rad] with
# its correlation time [s].
_PREVIEW, _SPEED_MIN, _SPEED_MAX = 0.9, 8.0, 25.0
_STEERING_NOISE, _STEERING_TIME = 0.05, 0.4
_BRAKE_SPEED, _BRAKING = 9.0, 0.7


def drive(truck: Truck, command: Command, duration: float) -> list[Row]:
    """Rows (state, report, command) of each control period for a `command(time, state)`."""
    steps = round(CONTROL_PERIOD / truck.model.opt.timestep)
    rows = []
    for tick in range(round(duration / CONTROL_PERIOD)):
        state = truck.observe()
        given = command(tick * CONTROL_PERIOD, state)
        truck.command(given)
        rows.append((state, truck.report(), given))
        truck.step(steps)
    return rows


def random_road(rng: np.random.Generator, length: float, *, winding: bool) -> Route:
    """A road with slopes, straight or with bends that lean inward, of at least a length [m]."""
    alignment: list[tuple[float, float, float, float, float]] = [(400.0, 0.0, 0.0, 0.0, 0.0)]
    if not winding:
        alignment = [(length, 0.0, 0.0, 0.0, 0.0)]
    while math.fsum(element[0] for element in alignment) < length:
        bend = _COMFORT / rng.uniform(*_BEND_SPEED) ** 2 * rng.choice([-1.0, 1.0])
        roll = -math.copysign(_CROSS_SLOPE, bend)
        spiral, arc = rng.uniform(*_CLOTHOID), rng.uniform(*_ARC)
        alignment += [
            (spiral, 0.0, bend, 0.0, roll),
            (arc, bend, bend, roll, roll),
            (spiral, bend, 0.0, roll, 0.0),
            (rng.uniform(*_STRAIGHT), 0.0, 0.0, 0.0, 0.0),
        ]
    whole = math.fsum(element[0] for element in alignment)
    grades, place = [], 0.0
    while (place := place + rng.uniform(*_SLOPE)) < whole - _CURVE:
        grades.append((place, rng.uniform(-_GRADE_MAX, _GRADE_MAX), _CURVE))
    return Design(name="synthetic", alignment=tuple(alignment), grades=tuple(grades)).route()


class Driver:
    """Steers along a lane's middle, and accelerates, coasts, cruises and brakes in turn.

    Bends limit the speed. It begins a new phase at random times.

    Args:
      rng: of phases and steering noise.
      route: to drive on.
      parameters: of the truck.
      weave: amplitude of single sines of the steering wheel [rad], one every twenty seconds.
    """

    def __init__(
        self,
        rng: np.random.Generator,
        route: Route,
        parameters: TruckParameters,
        *,
        weave: float = 0.0,
    ) -> None:
        self._rng, self._weave = rng, weave
        front, rear = parameters.lead.groups(0.0)
        self._wheelbase = float(np.mean([a.position for a in rear]) - front[0].position)
        self._ratio = parameters.steering.ratio
        table = route.table(5.0)
        self._station: FloatArray = np.arange(len(table), dtype=np.float64) * 5.0
        heading = np.unwrap(route.heading(self._station))
        bend = np.abs(np.gradient(heading, self._station))
        limit = np.sqrt(_COMFORT / np.maximum(bend, 1e-6))
        # The speed from which the truck reaches each bend with gentle braking.
        for i in range(len(limit) - 2, -1, -1):
            limit[i] = min(limit[i], math.sqrt(limit[i + 1] ** 2 + 2.0 * 5.0 * _BRAKING))
        self._limit = np.minimum(limit, _SPEED_MAX)
        middle = route.evaluate(self._station, route.lane_offset(0, self._station))
        self._x, self._y = np.asarray(middle.x), np.asarray(middle.y)
        self._noise, self._until, self._phase = 0.0, 0.0, "pull"
        self._pedal, self._demand, self._braking, self._wanted = 1.0, 0.0, False, 20.0

    def __call__(self, time: float, state: EgoState) -> VehicleCommand:
        """Returns the command at a time [s]; times must increase from call to call."""
        if time >= self._until:
            self._next(time)
        if state.speed < _SPEED_MIN:
            self._phase, self._pedal = "pull", 1.0
        limit = float(np.interp(state.station, self._station, self._limit))
        # Too fast: brake as long as it takes, with one demand.
        if self._braking and state.speed < limit - 0.5:
            self._braking = False
        elif not self._braking and state.speed > limit + 1.0:
            self._braking, self._demand = True, -self._rng.uniform(0.8, 1.8)
        by_choice = self._phase == "brake" and state.speed > _BRAKE_SPEED
        brake = self._braking or by_choice
        pedal = 0.0
        if self._phase == "pull" and state.speed < limit:
            pedal = self._pedal
        elif self._phase == "cruise":
            pedal = 0.3 + 0.4 * (min(self._wanted, limit - 0.5) - state.speed)
        return VehicleCommand(
            accelerator_pedal=0.0 if brake else min(max(pedal, 0.0), 1.0),
            xbr_demand=self._demand if brake else 0.0,
            xbr_mode=XbrMode.MAXIMUM if brake else XbrMode.OFF,
            steering_wheel_angle=self._steering(time, state),
        )

    def _next(self, time: float) -> None:
        """Begins the next phase."""
        rng = self._rng
        order = ("pull", "cruise", "coast", "brake", "pull", "coast")
        self._phase = order[(order.index(self._phase) + rng.integers(1, 4)) % len(order)]
        lengths = {"pull": (8, 40), "cruise": (10, 40), "coast": (4, 25), "brake": (1.7, 3.5)}
        self._until = time + rng.uniform(*lengths[self._phase])
        self._pedal, self._demand = rng.uniform(0.5, 1.0), -rng.uniform(0.8, 2.2)
        self._wanted = rng.uniform(14.0, 24.0)

    def _steering(self, time: float, state: EgoState) -> float:
        """Pure pursuit of the lane's middle, with a driver's noise."""
        ahead = state.station + max(_PREVIEW * state.speed, 8.0)
        distance = ahead - state.station
        dx = float(np.interp(ahead, self._station, self._x)) - state.x
        dy = float(np.interp(ahead, self._station, self._y)) - state.y
        side = -math.sin(state.yaw) * dx + math.cos(state.yaw) * dy
        angle = self._ratio * (self._wheelbase + 0.004 * state.speed**2) * 2.0 * side / distance**2
        decay = math.exp(-CONTROL_PERIOD / _STEERING_TIME)
        push = _STEERING_NOISE * math.sqrt(1.0 - decay**2)
        self._noise = decay * self._noise + push * self._rng.standard_normal()
        since = time % 20.0
        sine = math.sin(2.0 * math.pi * since / 3.0) if since < 3.0 else 0.0
        return angle + self._noise + self._weave * sine


def frames(
    rows: Sequence[Row],
    parameters: TruckParameters,
    messages: Mapping[str, float],
    *,
    noise: float = 0.01,
    yaw_noise: float = 0.0,
    seed: int = 0,
    commands: bool = True,
) -> list[Frame]:
    """Frames of a drive: speeds with white noise, other signals with the resolution of the bus.

    Args:
      rows: of `drive`.
      parameters: with the reference torque.
      messages: names of the truck's messages and their periods [s]; commands come every 100 ms,
        and when they change.
      noise: standard deviation of the speeds' noise, share of the speed.
      yaw_noise: of the yaw rates [rad/s]; that of the articulation is half of it [rad].
      seed: of the noise.
      commands: sends the pedal and the brake demand as well.
    """
    known_quantities = quantities()
    heard = {pgn_of("EEC2"), pgn_of("XBR")}
    references = ReferenceTorques.of(parameters)
    rng = np.random.default_rng(seed)
    signals = {name: [row for row in reports() if row.message == name] for name in messages}
    wanted = {row.quantity for rows in signals.values() for row in rows}
    found = []
    for tick, (state, report, command) in enumerate(rows):
        if commands and (tick % 5 == 0 or command != rows[tick - 1][2]):
            found += [f for f in command_to_frames(command, tick, state.time) if f.pgn in heard]
        noisy = _noisy(state, noise, yaw_noise, rng)
        values = {name: known_quantities[name](noisy, report, references) for name in wanted}
        for name, period in messages.items():
            if tick % round(period / CONTROL_PERIOD) == 0:
                known = {
                    r.signal: value / r.scale
                    for r in signals[name]
                    if (value := values[r.quantity]) is not None
                }
                found.append(encode(make_group(name, known), time=state.time, saturate=True))
    return found


def _noisy(state: EgoState, noise: float, yaw_noise: float, rng: np.random.Generator) -> EgoState:
    speed, lead, last, angle = rng.standard_normal(4)
    return dataclasses.replace(
        state,
        speed=state.speed * (1.0 + noise * speed),
        yaw_rate=state.yaw_rate + yaw_noise * lead,
        trailer_yaw_rate=state.trailer_yaw_rate + yaw_noise * last,
        articulation=state.articulation + 0.5 * yaw_noise * angle,
    )


def table(
    rows: Sequence[Row], *, noise: float = 0.01, yaw_noise: float = 0.0, seed: int = 0
) -> Log:
    """The telemetry of a drive: all signals every 100 ms, speed and yaw rates with white noise.

    Args:
      rows: of `drive`.
      noise: as of `frames`.
      yaw_noise: as of `frames`.
      seed: of the noise.
    """
    rng = np.random.default_rng(seed)
    kept = [
        (_noisy(state, noise, yaw_noise, rng), report, command)
        for state, report, command in rows[:: round(CYCLE_PERIOD / CONTROL_PERIOD)]
    ]
    signals: dict[str, FloatArray] = {}
    for name in SIGNALS:
        source, key = (2, name[8:]) if name.startswith("command_") else (0, name)
        if hasattr(kept[0][source], key):
            signals[name] = np.array([float(getattr(row[source], key)) for row in kept])
    pressures = np.array([row[0].brake_pressures for row in kept])
    signals |= dict(zip(PRESSURES, pressures.T, strict=True))
    return Log(signals)
