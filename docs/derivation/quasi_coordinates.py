"""Derives the inertial terms again by Boltzmann-Hamel, with velocities in the tractor's frame.

The paper uses this approach. It shows the origin of the inertial terms of the virtual work, and
that the kinetic energy must be correct to second order: the printed one omits a term.
"""

from __future__ import annotations

import sympy as sp
from lagrange_model import (
    RATES,
    I_c,
    I_t,
    L_h,
    L_t1,
    domega_c,
    domega_t,
    dv_yc,
    gamma,
    m_c,
    m_t,
    omega_c,
    omega_t,
    v,
    v_x,
    v_yc,
)

_dgamma = RATES[3]

# The lateral velocity of the trailer's CG in the tractor's frame; the paper's form is correct.
V_YT = v_yc - L_h * omega_c - L_t1 * omega_t


def printed_energy() -> sp.Expr:
    """The paper's T, in which the trailer's CG has the tractor's forward velocity."""
    return (
        I_c * omega_c**2 + I_t * omega_t**2 + m_c * (v_x**2 + v_yc**2) + m_t * (v_x**2 + V_YT**2)
    ) / 2


def energy() -> sp.Expr:
    """T with the trailer's forward velocity to second order, `v - L_t1 omega_t gamma`."""
    return printed_energy() - m_t * v_x * L_t1 * omega_t * gamma


def inertia_terms(energy: sp.Expr) -> sp.Matrix:
    """Linear inertia forces about y_c, beta_c and beta_t at constant speed, (3, 1).

    Boltzmann-Hamel for a frame that turns with omega_c, `beta_c` entering T through gamma alone:

        y_c:     d/dt dT/dv_yc    + omega_c dT/dv
        beta_c:  d/dt dT/domega_c + v dT/dv_yc - v_yc dT/dv - dT/dgamma
        beta_t:  d/dt dT/domega_t + dT/dgamma
    """
    rows = [
        _rate(energy.diff(v_yc)) + omega_c * energy.diff(v_x),
        _rate(energy.diff(omega_c))
        + v_x * energy.diff(v_yc)
        - v_yc * energy.diff(v_x)
        - energy.diff(gamma),
        _rate(energy.diff(omega_t)) + energy.diff(gamma),
    ]
    return sp.Matrix([_linear(row) for row in rows])


def _rate(momentum: sp.Expr) -> sp.Expr:
    rates = {v_yc: dv_yc, omega_c: domega_c, omega_t: domega_t, gamma: omega_c - omega_t}
    return sum((momentum.diff(state) * rate for state, rate in rates.items()), sp.S.Zero)


def _linear(row: sp.Expr) -> sp.Expr:
    epsilon = sp.symbols("epsilon")
    small = (v_yc, omega_c, omega_t, gamma, dv_yc, domega_c, domega_t)
    scaled = row.subs(v_x, v).subs({s: epsilon * s for s in small})
    return sp.expand(scaled.diff(epsilon).subs(epsilon, 0))
