"""Derives the yaw-sideslip model of tractor and semitrailer by Lagrange's equations.

Ground coordinates `q = [X, Y, beta_c, beta_t]` (tractor's CG, headings of tractor and trailer) are
true coordinates: Lagrange's equation holds for them without the extra terms that velocities in a
rotating frame need. Every step is exact except the last one, which linearizes.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import sympy as sp

t = sp.symbols("t", real=True)

# The paper's symbols. i_2: half the tandem's spacing; i_3: axle spacing of the tri-axle.
m_c, m_t, I_c, I_t, v = sp.symbols("m_c m_t I_c I_t v", positive=True)
L_c1, L_c2, L_h, L_t1, L_t2, i_2, i_3 = sp.symbols("L_c1 L_c2 L_h L_t1 L_t2 i_2 i_3", positive=True)
v_yc, omega_c, omega_t, gamma, delta = sp.symbols("v_yc omega_c omega_t gamma delta", real=True)
F_1, F_2f, F_2r, F_3f, F_3m, F_3r = FORCES = sp.symbols("F_1 F_2f F_2r F_3f F_3m F_3r", real=True)
C_1, C_2f, C_2r, C_3f, C_3m, C_3r = STIFFNESSES = sp.symbols(
    "C_1 C_2f C_2r C_3f C_3m C_3r", positive=True
)
# Not in the paper: pneumatic trails of the three axle groups, and the drive force.
t_1, t_2, t_3 = TRAILS = sp.symbols("t_1 t_2 t_3", nonnegative=True)
F_x = sp.symbols("F_x", real=True)

STATES = (v_yc, omega_c, omega_t, gamma)

# Axles of tractor (ahead of its CG) and trailer (behind the hitch), in the order of FORCES.
TRACTOR_AXLES = ((L_c1, t_1), (-(L_c2 - i_2), t_2), (-(L_c2 + i_2), t_2))
TRAILER_AXLES = ((L_t1 + L_t2 - i_3, t_3), (L_t1 + L_t2, t_3), (L_t1 + L_t2 + i_3, t_3))


@dataclass(frozen=True, eq=False)
class Matrices:
    """`H s' = A_h s + B_h delta` with `s = [v_yc, omega_c, omega_t, gamma]`.

    Shapes (4, 4), (4, 4), (4, 1).
    """

    H: sp.Matrix
    A_h: sp.Matrix
    B_h: sp.Matrix


@dataclass(frozen=True)
class Derivation:
    """Results of the steps.

    Attributes:
      balance: step 3, exact `inertia - force` along the tractor's x and y and about beta_c and
        beta_t, (4, 1), in `v_x`, its rate and the states' rates.
      drive_force: step 4, F_x that holds the speed, exact.
      lateral: step 5, the three linear equations `inertia - force = 0`, (3, 1), in the tires'
        forces.
      slips: step 6, the linear slip angle of each axle in the order of FORCES.
      matrices: step 7.
    """

    balance: sp.Matrix
    drive_force: sp.Expr
    lateral: sp.Matrix
    slips: tuple[sp.Expr, ...]
    matrices: Matrices


# Coordinates as functions of time, and the tractor-frame quantities that replace them later.
X, Y, B_c, B_t = (sp.Function(name)(t) for name in ("X", "Y", "beta_c", "beta_t"))
COORDINATES = sp.Matrix([X, Y, B_c, B_t])
v_x = sp.symbols("v_x", real=True)
dv_x, dv_yc, domega_c, domega_t, dgamma = sp.symbols("dv_x dv_yc domega_c domega_t dgamma")
RATES = (dv_yc, domega_c, domega_t, dgamma)
heading = sp.symbols("beta_c", real=True)


def _along(angle: sp.Expr) -> sp.Matrix:
    return sp.Matrix([sp.cos(angle), sp.sin(angle)])


def _across(angle: sp.Expr) -> sp.Matrix:
    return sp.Matrix([-sp.sin(angle), sp.cos(angle)])


def tractor_point(ahead: sp.Expr) -> sp.Matrix:
    """A point of the tractor's center line, `ahead` of its CG, on the ground, (2, 1)."""
    return sp.Matrix([X, Y]) + ahead * _along(B_c)


def trailer_point(behind: sp.Expr) -> sp.Matrix:
    """A point of the trailer's center line, `behind` the hitch, on the ground, (2, 1)."""
    return tractor_point(-L_h) - behind * _along(B_t)


def kinetic_energy() -> sp.Expr:
    """Step 1: kinetic energy of both bodies, exact."""
    tractor, trailer = tractor_point(sp.S.Zero).diff(t), trailer_point(L_t1).diff(t)
    turning = I_c * B_c.diff(t) ** 2 + I_t * B_t.diff(t) ** 2
    return (m_c * tractor.dot(tractor) + m_t * trailer.dot(trailer) + turning) / 2


def inertia_forces() -> sp.Matrix:
    """Step 2: `d/dt dT/dq' - dT/dq`, exact, (4, 1)."""
    energy = kinetic_energy()
    return sp.Matrix([energy.diff(q.diff(t)).diff(t) - energy.diff(q) for q in COORDINATES])


def generalized_forces() -> sp.Matrix:
    """Step 2: the virtual work of every force per virtual displacement, exact, (4, 1).

    Each axle's lateral force stands across its wheels and acts its pneumatic trail behind the
    axle's center; the drive force acts along the tractor.
    """
    work = sp.zeros(4, 1)
    steers = (delta, sp.S.Zero, sp.S.Zero)
    for force, (ahead, trail), steer in zip(FORCES[:3], TRACTOR_AXLES, steers, strict=True):
        # The pneumatic trail of the steered wheel lies along the wheel, not along the tractor.
        point = tractor_point(ahead) - trail * _along(B_c + steer)
        work += _virtual_work(force * _across(B_c + steer), point)
    for force, (behind, trail) in zip(FORCES[3:], TRAILER_AXLES, strict=True):
        work += _virtual_work(force * _across(B_t), trailer_point(behind + trail))
    return work + _virtual_work(F_x * _along(B_c), tractor_point(-L_c2))


def _virtual_work(force: sp.Matrix, point: sp.Matrix) -> sp.Matrix:
    return point.jacobian(COORDINATES).T * force


def _in_tractor_frame(expression: sp.Matrix | sp.Expr) -> sp.Matrix | sp.Expr:
    """Replaces the ground coordinates by the tractor's own velocities and the hitch angle."""
    along, across = _along(heading), _across(heading)
    velocity = v_x * along + v_yc * across
    # The terms `omega_c v` and `-omega_c v_yc` come from the rotation of the frame.
    acceleration = (dv_x - omega_c * v_yc) * along + (dv_yc + omega_c * v_x) * across
    values = [
        *zip([q.diff(t, 2) for q in COORDINATES], [*acceleration, domega_c, domega_t], strict=True),
        *zip([q.diff(t) for q in COORDINATES], [*velocity, omega_c, omega_t], strict=True),
        (B_t, heading - gamma),
        (B_c, heading),
    ]
    return expression.subs(values)


def _expand(expression: sp.Expr) -> sp.Expr:
    """A sum of products of sines and cosines of single angles, with `sin^2 = 1 - cos^2`."""
    terms = sp.expand(sp.expand_trig(expression))
    for angle in (heading, gamma, delta):
        sine, square = sp.sin(angle), 1 - sp.cos(angle) ** 2
        terms = sp.expand(terms.subs({sine**3: sine * square, sine**2: square}))
    return terms


def exact_balance() -> sp.Matrix:
    """Step 3: the equations in the tractor's frame, exact, (4, 1); the heading must drop out."""
    ground = _in_tractor_frame(inertia_forces() - generalized_forces())
    planar = sp.Matrix([ground[0], ground[1]])
    rows = [_along(heading).dot(planar), _across(heading).dot(planar), ground[2], ground[3]]
    balance = sp.Matrix([_expand(row) for row in rows])
    if balance.has(heading):
        raise AssertionError("the equations depend on the heading: a frame was confused")
    return balance


def slip_angles() -> tuple[sp.Expr, ...]:
    """Step 6: the slip angle `steer - atan(across / along)` of each axle's center, exact."""
    centers = [tractor_point(ahead) for ahead, _ in TRACTOR_AXLES]
    centers += [trailer_point(behind) for behind, _ in TRAILER_AXLES]
    angles = [B_c] * 3 + [B_t] * 3
    steers = [delta] + [sp.S.Zero] * 5
    slips = []
    for center, angle, steer in zip(centers, angles, steers, strict=True):
        velocity = center.diff(t)
        local = sp.atan(_across(angle).dot(velocity) / _along(angle).dot(velocity))
        slips.append(steer - _in_tractor_frame(local).subs(heading, 0))
    return tuple(slips)


def linear(expression: sp.Expr) -> sp.Expr:
    """The terms of first order in the states, their rates, the steer angle and the forces."""
    epsilon = sp.symbols("epsilon")
    small = (*STATES, *RATES, delta, *FORCES)
    scaled = expression.subs({v_x: v, dv_x: 0}).subs({s: epsilon * s for s in small})
    return sp.expand(sp.simplify(scaled.diff(epsilon).subs(epsilon, 0)))


@cache
def derive() -> Derivation:
    """Runs all steps."""
    balance = exact_balance()
    # Step 4: only the first equation has the drive force, and determines it.
    if balance[1:, :].has(F_x):
        raise AssertionError("the drive force must act along the tractor only")
    (drive_force,) = sp.solve(balance[0].subs({v_x: v, dv_x: 0}), F_x)
    lateral = sp.Matrix([linear(row) for row in balance[1:, :]])
    slips = tuple(linear(slip) for slip in slip_angles())
    return Derivation(balance, drive_force, lateral, slips, matrices_of(lateral, slips))


def matrices_of(lateral: sp.Matrix, slips: tuple[sp.Expr, ...]) -> Matrices:
    """Step 7: tire forces `F = C alpha` and `gamma' = omega_c - omega_t`; coefficients collected.

    Args:
      lateral: linear `inertia - force` about y_c, beta_c, beta_t, (3, 1).
      slips: linear slip angle of each axle, in the order of FORCES.
    """
    tires = {f: c * a for f, c, a in zip(FORCES, STIFFNESSES, slips, strict=True)}
    residual = lateral.subs(tires).col_join(sp.Matrix([dgamma - (omega_c - omega_t)]))
    H = residual.jacobian(RATES)
    A_h = -residual.jacobian(STATES)
    B_h = -residual.jacobian([delta])
    return Matrices(*(matrix.applyfunc(sp.factor) for matrix in (H, A_h, B_h)))
