"""The speed task as a scaled nonlinear program.

Nodes k = 0..n, intervals of length ds between them. Variables: b = v^2 at the nodes and y, the
brake force, in the intervals. With the net force N of the motion, linear in b, the engine's force
at the wheels is F = N + y. The duration of an interval is d = 2 ds / (v0 + v1): exact for constant
force, and convex in b.

    minimize   sum [f0 d + f1 F ds/eta + f2 (F ds/eta)^2 / d + k_a a^2 d] - worth b[n]
    subject to 0 <= y <= B_max,  -P_drag d <= F ds/eta <= P_max d,  b within bounds,
               t[n] <= T,  t[k] >= earliest[k]  with  t[k] = d[0] + ... + d[k-1]

The fuel is jointly convex in (F, d). Its curvature in b is a sum of squares and m d'' with m the
Lagrangian's derivative by d: where m >= 0 the problem is convex there.

Units of the program: b in 400 m2/s2, force in that of full power at 20 m/s, time in ds / 20 m/s,
fuel in that of full power during this time. All variables and multipliers are then of order 1.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from controllers.pcc.task import SpeedTask
from iits_mj.core.arrays import FloatArray

_SPEED = 20.0  # [m/s], unit
_B_MAX = 1e4  # [m2/s2], in place of an infinite speed limit
# Relative room in power and trip time: without it, multipliers have no bound if only one drive is
# possible.
_ROOM = 1e-7
_ROOM_BRAKE = 1e-4  # of the force of full power at 20 m/s: a newton or two
# Worth of a soft end speed over the fuel that full power burns for it.
_END_WORTH = 20.0
_PINNED = 1e-9  # difference of the bounds of b below which b is fixed


@dataclass(frozen=True)
class Problem:
    """The program of n intervals in its own units; see the module.

    Attributes:
      inertia: net force per difference of b; air: per mean of b; resistance: of grade and tires,
        shape (n,).
      fuel: coefficients of d, F and F^2 / d; calm: of (b1 - b0)^2 d; worth: of the last b.
      overrun: P_drag / P_max; full: 1, or a little more so that there is room inside; brake:
        greatest y.
      low, high: bounds of b, shape (n + 1,), equal where fixed.
      time_max: greatest t[n], inf for none.
      earliest: least t at nodes 1..n behind a vehicle, shape (n,), 0 for none.
    """

    inertia: float
    air: float
    resistance: FloatArray
    fuel: tuple[float, float, float]
    calm: float
    worth: float
    overrun: float
    full: float
    brake: float
    low: FloatArray
    high: FloatArray
    time_max: float
    earliest: FloatArray

    @property
    def intervals(self) -> int:
        """Number of intervals n."""
        return self.resistance.size

    @property
    def slope(self) -> tuple[float, float]:
        """Derivatives of the net force by b at the start and at the end of an interval."""
        return 0.5 * self.air - self.inertia, 0.5 * self.air + self.inertia

    def net(self, b: FloatArray) -> FloatArray:
        """Returns the net force of the intervals, shape (n,)."""
        first, last = self.slope
        return first * b[:-1] + last * b[1:] + self.resistance


@dataclass(frozen=True)
class Units:
    """Units of a `Problem`: b [m2/s2], force over mass [m/s2], time [s], fuel [kg]."""

    b: float
    force: float
    time: float
    fuel: float


def with_room(task: SpeedTask) -> SpeedTask:
    """Returns the task with the room in power, brakes and trip time that `scaled` adds."""
    vehicle = task.vehicle
    newton = vehicle.efficiency * vehicle.power_max / _SPEED
    more = replace(
        vehicle,
        power_max=vehicle.power_max * (1.0 + _ROOM),
        brake_max=vehicle.brake_max + _ROOM_BRAKE * newton,
    )
    return replace(task, vehicle=more, time_max=task.time_max * (1.0 + _ROOM))


def scaled(task: SpeedTask, soft_end: bool = False) -> tuple[Problem, Units]:
    """Returns a task's program and its units; a soft end speed has a worth, not a bound."""
    vehicle, step = task.vehicle, task.road.step
    fuel, power, mass = vehicle.fuel, vehicle.power_max, vehicle.inertial_mass
    full = fuel.f0 + fuel.f1 * power + fuel.f2 * power**2
    duration = step / _SPEED
    units = Units(
        b=_SPEED**2,
        force=vehicle.efficiency * power / (mass * _SPEED),
        time=duration,
        fuel=full * duration,
    )
    to_acceleration = units.b / (2.0 * step)
    high = np.minimum(task.b_high, _B_MAX)
    low = np.minimum(task.b_low, high)
    inertia = to_acceleration / units.force
    coefficients = (
        (fuel.f0 + task.price_time) / full,
        fuel.f1 * power / full,
        fuel.f2 * power**2 / full,
    )
    worth = task.price_energy * units.b / units.fuel
    if soft_end:
        low[-1] *= 0.9
        worth += _END_WORTH * inertia * (coefficients[1] + 2.0 * coefficients[2])
    problem = Problem(
        inertia=inertia,
        air=vehicle.drag / mass * units.b / units.force,
        resistance=vehicle.slope_force(task.road.grade) / (mass * units.force),
        fuel=coefficients,
        calm=task.k_a * to_acceleration**2 / full,
        worth=worth,
        overrun=vehicle.power_drag / power,
        full=1.0 + _ROOM,
        brake=vehicle.brake_max / (mass * units.force) + _ROOM_BRAKE,
        low=low / units.b,
        high=high / units.b,
        time_max=task.time_max * (1.0 + 0.1 * _ROOM) / units.time,
        earliest=np.maximum(task.earliest[1:], 0.0) / units.time,
    )
    return problem, units
