"""An independent peer: two rigid bodies in the plane, joined by a constraint force at the hitch.

Newton-Euler in ground coordinates with finite angles; nothing is shared with the analytic module
but the numbers.
"""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp


def _turn(angle):
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s], [s, c]])


def _simulate(model, speed, steer_of_time, times):
    """Yaw rates of tractor and trailer, articulation, (n,) each, and steer-axle track (n, 2)."""
    masses = np.diag([model.m_c, model.m_c, model.I_c, model.m_t, model.m_t, model.I_t])

    def axle(force, pose, rates, along, trail, stiffness, steer=0.0):
        rotation = _turn(pose[2])
        arm = rotation @ np.array([along, 0.0])
        velocity = rates[:2] + rates[2] * np.array([-arm[1], arm[0]])
        local = rotation.T @ velocity
        slip = steer - np.arctan2(local[1], local[0])
        lateral = rotation @ (stiffness * slip * np.array([-np.sin(steer), np.cos(steer)]))
        point = rotation @ np.array([along - trail, 0.0])
        force[:2] += lateral
        force[2] += point[0] * lateral[1] - point[1] * lateral[0]

    def derivative(time, state):
        q, u = state[:6], state[6:]
        steer = steer_of_time(time)
        tractor, trailer = np.zeros(3), np.zeros(3)
        axle(tractor, q[:3], u[:3], model.L_c1, model.t_1, model.C_1, steer)
        for arm, stiffness in zip(model.tractor_arms, model.C_2, strict=True):
            axle(tractor, q[:3], u[:3], -arm, model.t_2, stiffness)
        for arm, stiffness in zip(model.trailer_arms, model.C_3, strict=True):
            axle(trailer, q[3:], u[3:], model.L_t1 - arm, model.t_3, stiffness)
        # A drive force holds the tractor's own forward speed, as the linear model assumes.
        ahead = _turn(q[2])[:, 0]
        tractor[:2] += 2e6 * (speed - ahead @ u[:2]) * ahead
        hitch_c = _turn(q[2]) @ np.array([-model.L_h, 0.0])
        hitch_t = _turn(q[5]) @ np.array([model.L_t1, 0.0])
        jacobian = np.array(
            [
                [1.0, 0.0, -hitch_c[1], -1.0, 0.0, hitch_t[1]],
                [0.0, 1.0, hitch_c[0], 0.0, -1.0, -hitch_t[0]],
            ]
        )
        drift = -(u[2] ** 2) * hitch_c + u[5] ** 2 * hitch_t
        gap = q[:2] + hitch_c - q[3:5] - hitch_t
        stabilise = 20.0 * (jacobian @ u) + 100.0 * gap
        system = np.block([[masses, jacobian.T], [jacobian, np.zeros((2, 2))]])
        right = np.concatenate([tractor, trailer, -drift - stabilise])
        return np.concatenate([u, np.linalg.solve(system, right)[:6]])

    start = np.zeros(12)
    start[3] = -model.L_h - model.L_t1
    start[6] = start[9] = speed
    solution = solve_ivp(
        derivative, (times[0], times[-1]), start, "LSODA", times, rtol=1e-8, atol=1e-9
    )
    q, u = solution.y[:6].T, solution.y[6:].T
    front = q[:, :2] + model.L_c1 * np.column_stack([np.cos(q[:, 2]), np.sin(q[:, 2])])
    return u[:, 2], u[:, 5], q[:, 2] - q[:, 5], front - front[0]


@pytest.fixture(scope="session")
def planar_multibody():
    """The peer's `simulate(model, speed, steer_of_time, times)`."""
    return _simulate
