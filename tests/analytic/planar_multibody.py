"""An independent peer of the analytic models: rigid bodies in the plane, joined by hitches.

Newton-Euler in ground coordinates, angles of any size. Lagrange multipliers are the constraint
forces: two at each hitch, and the drive force that keeps the lead unit's forward speed.
Slip angles are exact arcs; the tire law is linear. The model shares only the truck's parameters
with the analytic module.

    python tests/analytic/planar_multibody.py

prints how well the linear model agrees with it in a step steer of 10 s, laden and empty, and the
angle at which the first signal differs by 1 %.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.integrate import solve_ivp

from iits_mj.analytic import YawPlane, simulate
from iits_mj.core.arrays import FloatArray
from iits_mj.parameters import TruckParameters

SIGNALS = ("yaw_rate", "trailer_yaw_rate", "articulation", "y")

# Rates at which a constraint's error decays [1/s] (Baumgarte); far above the truck's own.
_DECAY = 50.0


@dataclass(frozen=True)
class Motion:
    """Time histories, all of shape (n,); names and units as in `iits_mj.analytic.Response`.

    Attributes:
      time, yaw_rate, yaw: [s, rad/s, rad]; yaw_rates, headings: of the units, shape (n, units).
      x, y: steer axle's center on the ground, from its start [m].
      speed: of the tractor's CG along the tractor [m/s].
      hitch_error: greatest distance of two bodies' hitch points [m].
      energy: kinetic energy [J].
    """

    time: FloatArray
    yaw_rate: FloatArray
    yaw_rates: FloatArray
    headings: FloatArray
    yaw: FloatArray
    x: FloatArray
    y: FloatArray
    speed: FloatArray
    hitch_error: FloatArray
    energy: FloatArray

    @property
    def trailer_yaw_rate(self) -> FloatArray:
        """Of the last unit [rad/s]."""
        return self.yaw_rates[:, -1]

    @property
    def articulation(self) -> FloatArray:
        """Of the first hitch [rad]."""
        return self.headings[:, 0] - self.headings[:, 1]


@dataclass(frozen=True)
class _Axle:
    """An axle of a body, `ahead` of that body's CG [m]; `steer` is its share of the angle."""

    body: int
    ahead: float
    trail: float
    stiffness: float
    steer: float


class PlanarTruck:
    """A combination with the numbers of `model`.

    Args:
      model: masses, lengths, stiffnesses and pneumatic trails.
      hold_speed: whether a drive force keeps the lead unit's forward speed; else it coasts.
    """

    def __init__(self, model: YawPlane, *, hold_speed: bool = True) -> None:
        self._hold = hold_speed
        # Of each hitch, ahead of the CGs of the unit ahead and of the unit behind it.
        self._ahead, self._behind = model.cg[:-1] - model.couplings, model.cg[1:]
        self._steer_axle = float(model.cg[0] - model.position[0])
        self._mass = np.column_stack([model.mass, model.mass, model.inertia]).ravel()
        ahead = model.cg[model.unit] - model.position
        columns = (model.unit, ahead, model.trail, model.cornering, model.steer)
        self._axles = tuple(
            _Axle(int(body), *map(float, row)) for body, *row in zip(*columns, strict=True)
        )

    def drive(
        self,
        speed: float,
        steer: Callable[[float], float],
        time: FloatArray,
        *,
        spin: tuple[float, ...] = (),
    ) -> Motion:
        """Motion from a straight truck at `speed` [m/s] under `steer(time)` [rad], at `time` (n,).

        Args:
          speed: forward speed at the start, held if the truck holds its speed.
          steer: road-wheel angle.
          time: increasing [s].
          spin: yaw rates of the two units of a tractor-semitrailer at the start [rad/s], about the
            hitch; default: none.
        """
        bodies = len(self._mass) // 3
        start = np.zeros(6 * bodies)
        start[3 : 3 * bodies : 3] = np.cumsum(self._ahead - self._behind)
        start[3 * bodies :: 3] = speed
        if spin:
            start[8], start[11] = spin
            # The hitch itself moves straight ahead at the start.
            start[7], start[10] = -spin[0] * self._ahead[0], -spin[1] * self._behind[0]
        solution = solve_ivp(
            lambda now, state: self._derivative(state, steer(now), speed),
            (float(time[0]), float(time[-1])),
            start,
            "LSODA",
            time,
            rtol=1e-8,
            atol=1e-9,
            max_step=0.05,
        )
        if not solution.success:
            raise RuntimeError(solution.message)
        q, u = np.split(solution.y, 2)
        gaps = [np.zeros(len(time))]
        for j, (ahead, behind) in enumerate(zip(self._ahead, self._behind, strict=True)):
            one, other = q[3 * j : 3 * j + 3], q[3 * j + 3 : 3 * j + 6]
            gap = one[:2] - other[:2] + ahead * _along(one[2]) - behind * _along(other[2])
            gaps.append(np.linalg.norm(gap, axis=0))
        front = q[:2] + self._steer_axle * _along(q[2])
        return Motion(
            time=time,
            yaw_rate=u[2],
            yaw_rates=u[2::3].T,
            headings=q[2::3].T,
            yaw=q[2],
            x=front[0] - front[0, 0],
            y=front[1],
            speed=np.sum(_along(q[2]) * u[:2], axis=0),
            hitch_error=np.max(gaps, axis=0),
            energy=0.5 * self._mass @ u**2,
        )

    def _derivative(self, state: FloatArray, steer: float, speed: float) -> FloatArray:
        q, u = np.split(state, 2)
        forces = np.zeros(len(q))
        for axle in self._axles:
            part = slice(3 * axle.body, 3 * axle.body + 3)
            forces[part] += _tire_force(axle, q[part], u[part], axle.steer * steer)
        jacobian, drift, error, error_rate = self._hitch_constraint(q, u)
        if self._hold:
            along, across = _along(q[2]), _across(q[2])
            jacobian = np.vstack([jacobian, [*along, *np.zeros(len(q) - 2)]])
            drift = np.append(drift, u[2] * (across @ u[:2]))
            error = np.append(error, 0.0)
            error_rate = np.append(error_rate, along @ u[:2] - speed)
        # Mass times acceleration = forces + jacobian' multipliers; jacobian acceleration = target.
        target = -drift - 2.0 * _DECAY * error_rate - _DECAY**2 * error
        inverse = jacobian / self._mass
        multipliers = np.linalg.solve(inverse @ jacobian.T, target - inverse @ forces)
        return np.concatenate([u, (forces + jacobian.T @ multipliers) / self._mass])

    def _hitch_constraint(
        self, q: FloatArray, u: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Jacobian (2 hitches, 3 bodies), its rate times velocity, and the gaps and their rates."""
        hitches = len(self._ahead)
        jacobian, drift, error = np.zeros((2 * hitches, len(q))), [], []
        for j, (ahead, behind) in enumerate(zip(self._ahead, self._behind, strict=True)):
            one, other, rows = 3 * j, 3 * j + 3, slice(2 * j, 2 * j + 2)
            arm, arm_behind = ahead * _along(q[one + 2]), behind * _along(q[other + 2])
            jacobian[rows, one : one + 2], jacobian[rows, other : other + 2] = np.eye(2), -np.eye(2)
            jacobian[rows, one + 2] = -arm[1], arm[0]
            jacobian[rows, other + 2] = arm_behind[1], -arm_behind[0]
            drift.append(-(u[one + 2] ** 2) * arm + u[other + 2] ** 2 * arm_behind)
            error.append(q[one : one + 2] + arm - q[other : other + 2] - arm_behind)
        return jacobian, np.ravel(drift), np.ravel(error), jacobian @ u


def _tire_force(axle: _Axle, pose: FloatArray, rates: FloatArray, steer: float) -> FloatArray:
    """Force x, y [N] and moment about the body's CG [N m] of one axle, (3,)."""
    along, across = _along(pose[2]), _across(pose[2])
    velocity = rates[:2] + rates[2] * axle.ahead * across
    slip = steer - np.arctan2(across @ velocity, along @ velocity)
    force = axle.stiffness * slip * _across(pose[2] + steer)
    # The force acts behind the axle's center by its pneumatic trail, along the wheel.
    arm = axle.ahead * along - axle.trail * _along(pose[2] + steer)
    return np.array([force[0], force[1], arm[0] * force[1] - arm[1] * force[0]])


def _along(angle: FloatArray | float) -> FloatArray:
    return np.array([np.cos(angle), np.sin(angle)])


def _across(angle: FloatArray | float) -> FloatArray:
    return np.array([-np.sin(angle), np.cos(angle)])


def ramp_step(steer: float) -> Callable[[float], float]:
    """A step of the road-wheel angle [rad] at 0.5 s, over 0.1 s."""
    return lambda now: float(steer * np.clip((now - 0.5) / 0.1, 0.0, 1.0))


def disagreement(
    model: YawPlane, speed: float, steer: float, duration: float = 10.0
) -> dict[str, float]:
    """Rms of linear less multibody over rms of multibody, per signal, in a step steer [rad]."""
    time = np.linspace(0.0, duration, round(duration / 0.01) + 1)
    step = ramp_step(steer)
    peer = PlanarTruck(model).drive(speed, step, time)
    ours = simulate(model.at(speed), time, np.array([step(now) for now in time]))
    return {name: _relative(getattr(ours, name), getattr(peer, name)) for name in SIGNALS}


def _relative(signal: FloatArray, reference: FloatArray) -> float:
    return float(np.sqrt(np.mean((signal - reference) ** 2) / np.mean(reference**2)))


def limit_angle(model: YawPlane, speed: float, bound: float = 0.01) -> float:
    """Smallest step of the road-wheel angle [rad] at which a signal's disagreement is `bound`."""
    low, high = 0.0, 0.2
    for _ in range(10):
        middle = 0.5 * (low + high)
        if max(disagreement(model, speed, middle).values()) < bound:
            low = middle
        else:
            high = middle
    return high


def agreement_table(parameters: TruckParameters) -> str:
    """Markdown table of the disagreement and of the angle at which it reaches 1 %."""
    ratio = parameters.steering.ratio
    lines = [
        "| payload [t] | speed [km/h] | 3 deg, worst signal | 15 deg: yaw rate | trailer's yaw rate"
        " | hitch angle | lateral position | 1 % at, steering wheel | road wheels |",
        "|" + "---|" * 9,
    ]
    for payload in (parameters.payload_max, 0.0):
        model = YawPlane.from_parameters(parameters, payload)
        for speed in (30.0, 80.0, 100.0):
            small, large = (
                disagreement(model, speed / 3.6, np.deg2rad(degrees) / ratio)
                for degrees in (3.0, 15.0)
            )
            cells = [100.0 * max(small.values()), *(100.0 * large[name] for name in SIGNALS)]
            limit = np.rad2deg(limit_angle(model, speed / 3.6))
            lines.append(
                f"| {payload / 1e3:g} | {speed:g} | "
                + " | ".join(f"{cell:.3f} %" for cell in cells)
                + f" | {limit * ratio:.0f} deg | {limit:.1f} deg |"
            )
    return "\n".join(lines)


if __name__ == "__main__":
    print(agreement_table(TruckParameters.load()))
