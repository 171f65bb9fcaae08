"""The paper's kinematic model and its tire-ground balance, derived and compared with its print."""

from __future__ import annotations

import sympy as sp

v, L, L_2 = sp.symbols("v L L_2", positive=True)
L_1, theta, phi, psi, omega = sp.symbols("L_1 theta phi psi omega", real=True)

# Tire-ground balance: longitudinal and lateral forces at front and rear wheel, sideslip beta.
F_xf, F_xr, F_yf, F_yr, beta, d_v, turn = sp.symbols("F_xf F_xr F_yf F_yr beta dv turn", real=True)
L_f, L_r, m = sp.symbols("L_f L_r m", positive=True)


def printed() -> sp.Matrix:
    """Rates of `[x, y, theta, phi, psi]` as printed, (5, 1)."""
    swing = sp.sin(psi) / L_2 + L_1 / (L * L_2) * sp.cos(psi) * sp.tan(phi) + sp.tan(phi) / L
    return sp.Matrix([v * sp.cos(theta), v * sp.sin(theta), v * sp.tan(phi) / L, omega, -v * swing])


def derived() -> sp.Matrix:
    """The same rates derived from three wheels without lateral slip, (5, 1).

    The fixed axle is at (x, y) and moves along the heading; the steered wheel, L ahead, moves along
    its own plane; the trailer's axle, L_2 behind a hitch that is L_1 behind the fixed axle, moves
    along the trailer's heading `theta + psi`.
    """
    rate, trailer_rate = sp.symbols("rate trailer_rate")
    ahead, across = _frame(theta)
    velocity = v * ahead
    steered = velocity + L * rate * across
    hitch = velocity - L_1 * rate * across
    trailer = hitch - L_2 * trailer_rate * _frame(theta + psi)[1]
    no_slip = [_frame(theta + phi)[1].dot(steered), _frame(theta + psi)[1].dot(trailer)]
    solution = sp.solve([sp.simplify(row) for row in no_slip], [rate, trailer_rate], dict=True)[0]
    psi_rate = solution[trailer_rate] - solution[rate]
    return sp.Matrix([*velocity, solution[rate], omega, psi_rate])


def balance() -> sp.Matrix:
    """Longitudinal and lateral force and yaw moment minus inertia of a bicycle model, (3, 1).

    `turn` stands for the turning rate of the velocity, `theta' + beta'`; the paper's F_c is
    `m v turn` and its `J theta''` the derived moment.
    """
    ahead, across = _frame(sp.S.Zero)
    front = F_xf * _frame(phi)[0] + F_yf * _frame(phi)[1]
    rear = F_xr * ahead + F_yr * across
    acceleration = d_v * _frame(beta)[0] + v * turn * _frame(beta)[1]
    residual = front + rear - m * acceleration
    return sp.Matrix([*residual, L_f * front[1] - L_r * rear[1]]).expand()


def printed_balance() -> sp.Matrix:
    """The paper's three equations in the same form, (3, 1)."""
    F_c = m * v * turn
    ahead = F_xf * sp.cos(phi) + F_xr - F_yf * sp.sin(phi)
    across = F_yf * sp.cos(phi) + F_yf + F_xf * sp.sin(phi)
    return sp.Matrix(
        [
            ahead - (-F_c * sp.sin(beta) + m * d_v * sp.cos(beta)),
            across - (F_c * sp.cos(beta) + m * d_v * sp.sin(beta)),
            F_xf * sp.sin(phi) * L_f + F_yf * sp.cos(phi) - F_yf * L_r,
        ]
    ).expand()


def _frame(angle: sp.Expr) -> tuple[sp.Matrix, sp.Matrix]:
    cosine, sine = sp.cos(angle), sp.sin(angle)
    return sp.Matrix([cosine, sine]), sp.Matrix([-sine, cosine])
