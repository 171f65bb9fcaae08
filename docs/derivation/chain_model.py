"""Derives yaw-plane and yaw-roll model of a chain of n units by Lagrange's equations.

    python docs/derivation/chain_model.py 3     # prints the equations of three units

Coordinates are `q = [y, psi_1 .. psi_n, phi_1 .. phi_n, alpha_1 .. alpha_k]`, see
`iits_mj/analytic/roll_bodies.py`. Positions of all points are exact (products of rotations) and are
then expanded: x and z to second order, y to first order, which is what the energies need for linear
equations. The equations hold at constant speed v along the x axis of the ground.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from functools import cache

import sympy as sp

v, g, delta = sp.symbols("v g delta", positive=True)
_EPSILON = sp.Symbol("epsilon")


@dataclass(frozen=True)
class Chain:
    """Symbols of a chain.

    Attributes:
      axles: number of axles of each unit.
      roll: False leaves the rolling coordinates out (all bodies and axles upright).
    """

    axles: tuple[int, ...]
    roll: bool = True

    @property
    def units(self) -> int:
        """Number of units."""
        return len(self.axles)

    @property
    def on(self) -> list[int]:
        """Unit of each axle."""
        return [unit for unit, count in enumerate(self.axles) for _ in range(count)]

    def of_units(self, name: str) -> list[sp.Symbol]:
        """One symbol a unit."""
        return [sp.Symbol(f"{name}_{i + 1}") for i in range(self.units)]

    def of_axles(self, name: str) -> list[sp.Symbol]:
        """One symbol an axle."""
        return [sp.Symbol(f"{name}_{i + 1}") for i in range(len(self.on))]

    def of_couplings(self, name: str) -> list[sp.Symbol]:
        """One symbol a coupling."""
        return [sp.Symbol(f"{name}_{i + 1}") for i in range(self.units - 1)]

    @property
    def coordinates(self) -> list[sp.Symbol]:
        """The coordinates q."""
        rolls = [*self.of_units("phi"), *self.of_axles("alpha")] if self.roll else []
        return [sp.Symbol("y"), *self.of_units("psi"), *rolls]


@dataclass(frozen=True, eq=False)
class Equations:
    """`M q'' + C q' + K q = B delta` in ground coordinates.

    Shapes (N, N), (N, N), (N, N), (N, 1).
    """

    M: sp.Matrix
    C: sp.Matrix
    K: sp.Matrix
    B: sp.Matrix


def _turn(yaw: sp.Expr, roll: sp.Expr) -> sp.Matrix:
    """Rotation about z, then about the turned x axis."""
    about_z = sp.Matrix([[sp.cos(yaw), -sp.sin(yaw), 0], [sp.sin(yaw), sp.cos(yaw), 0], [0, 0, 1]])
    about_x = sp.Matrix(
        [[1, 0, 0], [0, sp.cos(roll), -sp.sin(roll)], [0, sp.sin(roll), sp.cos(roll)]]
    )
    return about_z * about_x


class _Points:
    """Positions of points of a chain, relative to the reference's `v t` along the road."""

    def __init__(self, chain: Chain) -> None:
        self.chain = chain
        self.yaws = chain.of_units("psi")
        zeros = [sp.S.Zero] * max(chain.units, len(chain.on))
        self.rolls = chain.of_units("phi") if chain.roll else zeros
        self.alphas = chain.of_axles("alpha") if chain.roll else zeros
        self.positions = [sp.Symbol("reference"), *[sp.S.Zero] * (chain.units - 1)]
        self.couplings = chain.of_couplings("c")
        self.heights = [sp.S.Zero, *chain.of_couplings("h_c")]

    def on_unit(self, unit: int, position: sp.Expr, height: sp.Expr) -> sp.Matrix:
        """A point behind the unit's origin, at a height above the road."""
        place = sp.Matrix([0, sp.Symbol("y"), 0])
        ends = [*self.couplings[:unit], position]
        levels = [*self.heights[: unit + 1], height]
        for j, end in enumerate(ends):
            arm = sp.Matrix([self.positions[j] - end, 0, levels[j + 1] - levels[j]])
            place += _turn(self.yaws[j], self.rolls[j]) * arm
        return place

    def below_roll_center(self, axle: int, position: sp.Expr, down: sp.Expr) -> sp.Matrix:
        """A point of an axle that turns about its roll center, `down` below it."""
        unit = self.chain.on[axle]
        height = self.chain.of_axles("h_a")[axle] + self.chain.of_axles("e")[axle]
        center = self.on_unit(unit, position, height)
        return center + _turn(self.yaws[unit], self.alphas[axle]) * sp.Matrix([0, 0, -down])


def _orders(expression: sp.Expr, coordinates: list[sp.Symbol]) -> tuple[sp.Expr, sp.Expr]:
    """The terms of first and second order in the coordinates."""
    scaled = expression.subs({q: _EPSILON * q for q in coordinates}, simultaneous=True)
    first = scaled.diff(_EPSILON).subs(_EPSILON, 0)
    second = scaled.diff(_EPSILON, 2).subs(_EPSILON, 0) / 2
    return sp.expand(first), sp.expand(second)


@cache
def derive(chain: Chain) -> Equations:
    """Lagrange's equations of the chain, linear."""
    q = chain.coordinates
    rates = [sp.Symbol(f"{name}'") for name in q]
    points, on = _Points(chain), chain.on

    def rate(expression: sp.Expr) -> sp.Expr:
        return sum((expression.diff(x) * dx for x, dx in zip(q, rates, strict=True)), sp.S.Zero)

    kinetic = potential = sp.S.Zero

    def add(mass: sp.Expr, place: sp.Matrix, lift: sp.Expr) -> None:
        # T = m/2 (v + x')^2 + ...: v x' is the rate of a function of q and drops out of Lagrange's
        # equations; z' and the square of x' are of higher order.
        nonlocal kinetic, potential
        along, _ = _orders(place[0], q)
        if along != 0:
            raise AssertionError("x must be of second order")
        kinetic += mass * rate(_orders(place[1], q)[0]) ** 2 / 2
        potential += lift * _orders(place[2], q)[1]

    def yaw_rate(unit: int) -> sp.Symbol:
        return rates[1 + unit]

    roll_rates = [rate(sp.sympify(angle)) for angle in points.rolls]
    axle_rates = [rate(sp.sympify(angle)) for angle in points.alphas]
    bodies = zip(*(chain.of_units(name) for name in ("m", "p", "h", "I_x", "I_z")), strict=True)
    for unit, (mass, place, height, I_x, I_z) in enumerate(bodies):
        add(mass, points.on_unit(unit, place, height), mass * g)
        kinetic += I_x * roll_rates[unit] ** 2 / 2 + I_z * yaw_rate(unit) ** 2 / 2
    stiffness, damping = chain.of_couplings("k_c"), chain.of_couplings("d_c")
    dissipation = sp.S.Zero
    for j in range(chain.units - 1):
        potential += stiffness[j] * (points.rolls[j + 1] - points.rolls[j]) ** 2 / 2
        dissipation += damping[j] * (roll_rates[j + 1] - roll_rates[j]) ** 2 / 2

    mass, place, arm, I_x, I_z, load = (
        chain.of_axles(name) for name in ("m_a", "a", "e", "I_xa", "I_za", "F_z")
    )
    k_s, d_s, k_t, d_t = (chain.of_axles(name) for name in ("k_s", "d_s", "k_t", "d_t"))
    spin, track, radius = (chain.of_axles(name) for name in ("J", "s", "r"))
    heights, C, trail, steer, relax = (
        chain.of_axles(name) for name in ("h_a", "C", "t", "share", "sigma")
    )
    forces = sp.zeros(len(q), 1)
    for i, unit in enumerate(on):
        add(mass[i], points.below_roll_center(i, place[i], arm[i]), mass[i] * g - load[i])
        kinetic += I_x[i] * axle_rates[i] ** 2 / 2 + I_z[i] * yaw_rate(unit) ** 2 / 2
        # The wheels spin at v / r about an axle that rolls by alpha, and at different speeds.
        kinetic += spin[i] * v / radius[i] * yaw_rate(unit) * points.alphas[i]
        kinetic += spin[i] * (track[i] / (2 * radius[i]) * yaw_rate(unit)) ** 2 / 2
        relative = points.alphas[i] - points.rolls[unit]
        relative_rate = axle_rates[i] - roll_rates[unit]
        potential += k_s[i] * relative**2 / 2 + k_t[i] * points.alphas[i] ** 2 / 2
        dissipation += d_s[i] * relative_rate**2 / 2 + d_t[i] * axle_rates[i] ** 2 / 2
        # Slip angle over ground, and the force that acts a pneumatic trail behind the axle.
        patch, _ = _orders(points.below_roll_center(i, place[i], heights[i] + arm[i])[1], q)
        slip = steer[i] * delta + points.yaws[unit] - rate(patch) / v
        behind = patch - trail[i] * points.yaws[unit]
        # The carcass deflects by F sigma / C and takes the load along: a moment on the axle.
        behind += relax[i] * load[i] / C[i] * points.alphas[i]
        forces += C[i] * slip * sp.Matrix([behind.diff(x) for x in q])
    air, place_air = chain.of_units("air"), chain.of_units("p_air")
    for unit in range(chain.units):
        side, _ = _orders(points.on_unit(unit, place_air[unit], sp.Symbol("h_air"))[1], q)
        across = rate(side) - v * points.yaws[unit]
        forces -= air[unit] * v * across * sp.Matrix([side.diff(x) for x in q])

    momentum = sp.Matrix([kinetic.diff(dx) for dx in rates])
    M = momentum.jacobian(rates)
    C_matrix = momentum.jacobian(q)
    C_matrix -= sp.Matrix([kinetic.diff(x) for x in q]).jacobian(rates)
    C_matrix += sp.Matrix([dissipation.diff(dx) for dx in rates]).jacobian(rates)
    C_matrix -= forces.jacobian(rates)
    K = sp.Matrix([potential.diff(x) for x in q]).jacobian(q) - forces.jacobian(q)
    return Equations(M, C_matrix, K, forces.jacobian([delta]))


def state_space(chain: Chain) -> tuple[sp.Matrix, sp.Matrix, sp.Matrix]:
    """`M u' = A [u, gamma, angles] + B delta` in the lead unit's frame.

    The states are the velocities `u = [v_y, omega, phi', alpha']`, the articulations, and the
    angles of roll. The equations must not depend on the lead unit's heading.
    """
    found, n = derive(chain), chain.units
    flat, size = 1 + n, len(chain.coordinates)
    # y' = v_y + v psi_1 and y'' = v_y' + v omega_1; psi_j = psi_1 - gamma_1 - ... - gamma_(j-1).
    by_heading = sum((found.K[:, 1 + j] for j in range(n)), sp.zeros(size, 1)) + v * found.C[:, 0]
    if any(sp.simplify(row) != 0 for row in by_heading):
        raise AssertionError("the equations depend on the heading")
    by_velocity = -found.C
    by_velocity[:, 1] -= v * found.M[:, 0]
    by_gamma = [
        sum((found.K[:, 1 + j] for j in range(i + 1, n)), sp.zeros(size, 1)) for i in range(n - 1)
    ]
    by_angle = -found.K[:, flat:]
    return found.M, sp.Matrix.hstack(by_velocity, *by_gamma, by_angle), found.B


def main() -> None:
    """Prints the yaw-plane equations of n units, one axle each."""
    units = int(sys.argv[1]) if len(sys.argv) > 1 else 3
    chain = Chain((1,) * units, roll=False)
    M, A, B = state_space(chain)
    velocities = ["v_y", *[f"omega_{i + 1}" for i in range(units)]]
    states = [*velocities, *[f"gamma_{i + 1}" for i in range(units - 1)]]
    still = dict.fromkeys(
        [*chain.of_axles("J"), *chain.of_units("air"), sp.Symbol("reference")], sp.S.Zero
    )
    for row, name in enumerate(velocities):
        print(f"\nEquation of {name}:")
        for column, other in enumerate(velocities):
            print(f"  M, {other}':", sp.factor(M[row, column].subs(still)))
        for column, other in enumerate(states):
            print(f"  A, {other}:", sp.collect(sp.expand(A[row, column].subs(still)), v))
        print("  B, delta:", B[row].subs(still))


if __name__ == "__main__":
    main()
