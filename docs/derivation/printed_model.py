"""The paper's lateral equations as printed, with a choice for each wrong term."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import sympy as sp
from lagrange_model import (
    FORCES,
    RATES,
    STATES,
    L_c1,
    L_c2,
    L_h,
    L_t1,
    L_t2,
    Matrices,
    delta,
    derive,
    gamma,
    i_2,
    i_3,
    m_c,
    m_t,
    matrices_of,
    omega_c,
    omega_t,
    v,
)
from quasi_coordinates import printed_energy

# Virtual displacements along the paper's coordinates.
DISPLACEMENTS = (d_x, d_y, d_c, d_t) = sp.symbols("Dx_c Dy_c Dbeta_c Dbeta_t", real=True)


@dataclass(frozen=True)
class Reading:
    """Choices for the inertial and tire terms; the defaults are the corrected ones.

    Attributes:
      label: name in tables.
      sign: of the inertial terms in the virtual work; the paper prints +1.
      trailer_rate: yaw rate in the trailer's inertial term; the paper prints omega_t.
      hitch_angle: whether the trailer's slip angles contain gamma. The paper prints no tire law.
    """

    label: str
    sign: int = -1
    trailer_rate: sp.Symbol = omega_c
    hitch_angle: bool = True


CORRECTED = Reading("corrected")
PRINTED = Reading("as printed: plus signs, omega_t", sign=1, trailer_rate=omega_t)
READINGS = (
    CORRECTED,
    PRINTED,
    Reading("as printed, slip without gamma", 1, omega_t, hitch_angle=False),
    Reading("plus signs only", sign=1),
    Reading("omega_t only", trailer_rate=omega_t),
    Reading("slip without gamma only", hitch_angle=False),
)


def virtual_work(reading: Reading) -> sp.Expr:
    """The printed virtual work of tires and inertia, without pneumatic trail."""
    F_1, F_2f, F_2r, F_3f, F_3m, F_3r = FORCES
    d_yt = d_y - L_h * d_c - L_t1 * d_t
    tires = (
        (-F_1 * delta - (F_3f + F_3m + F_3r) * d_t) * d_x
        + F_1 * (d_y + L_c1 * d_c)
        + F_2f * (d_y - (L_c2 - i_2) * d_c)
        + F_2r * (d_y - (L_c2 + i_2) * d_c)
        + F_3f * (d_yt - (L_t2 - i_3) * d_t)
        + F_3r * (d_yt - (L_t2 + i_3) * d_t)
        + F_3m * (d_yt - L_t2 * d_t)
    )
    inertia = m_c * omega_c * v * d_y + m_t * reading.trailer_rate * v * d_yt
    return tires + reading.sign * inertia


def generalized_forces(reading: Reading) -> sp.Matrix:
    """`Q`, the gradient of the virtual work along y_c, beta_c, beta_t, (3, 1)."""
    work = virtual_work(reading)
    # As printed, the first line is a product of two displacements; at Dx_c = 0 it vanishes.
    return sp.Matrix([sp.expand(work.diff(d).subs(d_x, 0)) for d in (d_y, d_c, d_t)])


def printed_inertia() -> sp.Matrix:
    """The printed `d/dt (grad T)` about y_c, beta_c, beta_t, (3, 1)."""
    velocities = sp.Matrix(STATES[:3])
    momenta = sp.Matrix([printed_energy()]).jacobian(velocities)
    return (momenta.jacobian(velocities) * sp.Matrix(RATES[:3])).expand()


@cache
def matrices(reading: Reading) -> Matrices:
    """H, A_h and B_h of a reading of the printed equations, with the derived slip angles."""
    slips = derive().slips
    if not reading.hitch_angle:
        slips = tuple(slip.subs(gamma, 0) for slip in slips)
    return matrices_of(printed_inertia() - generalized_forces(reading), slips)
