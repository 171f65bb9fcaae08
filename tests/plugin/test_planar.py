"""Planar motion of a chain of units, the law alone, against MuJoCo and conservation laws."""

import mujoco
import numpy as np
import pytest

from tests.plugin.laws_direct import law

# Mass, CG behind the coupling, yaw inertia, next coupling, of a truck, a dolly and a trailer.
CHAIN = ((9_000.0, 1.5, 3e4, 5.0), (2_500.0, 2.4, 2e3, 2.6), (30_000.0, 4.5, 3e5, 0.0))


def inertia(mass, cg, yaw, hitch, *, height=0.0, coupling=0.0, behind=0.0, roll=0.0):
    """A PlanarInertia of one body; heights are above the roll axis."""
    lever = coupling - height
    return [
        mass,
        -mass * cg,
        mass * lever,
        mass * cg**2 + yaw,
        -mass * cg * lever,
        mass * lever**2 + roll,
        -hitch,
        coupling - behind,
    ]


def accelerate(units, velocity, rates, angles, forces, rolling=None):
    """Accelerations (n, 4), hitch forces (n, 2) and motions (n, 6) of a chain.

    `angles` are the yaws of the units, `velocity` that of the first unit along its axes.
    """
    count, units = len(units), np.array(units)
    rolls = np.zeros(count) if rolling is None else rolling
    motion, v = np.zeros((count, 6)), np.array(velocity)
    for i in range(count):
        turned = angles[i] - angles[i - 1] if i else 0.0
        c, s = np.cos(turned), np.sin(turned)
        v = np.array([c * v[0] + s * v[1], c * v[1] - s * v[0]])
        motion[i] = *v, rates[i], rolls[i], c, s
        v = v + np.array([0.0, units[i, 6] * rates[i] + units[i, 7] * rolls[i]])
    out, hitches = np.zeros((count, 4)), np.zeros((count, 2))
    law("planar", count, int(rolling is not None), units, motion, np.array(forces), out, hitches)
    return out, hitches, motion


def test_a_chain_accelerates_as_in_mujoco():
    bodies, tail = "", ""
    for number, (mass, cg, yaw, _) in enumerate(CHAIN):
        at = 0.0 if number == 0 else -CHAIN[number - 1][3]
        joints = '<joint type="slide" axis="1 0 0"/><joint type="slide" axis="0 1 0"/>'
        bodies += f'<body name="u{number}" pos="{at} 0 0">{joints if number == 0 else ""}'
        bodies += '<joint type="hinge" axis="0 0 1"/>'
        bodies += f'<inertial mass="{mass}" pos="{-cg} 0 0" diaginertia="{yaw} {yaw} {yaw}"/>'
        tail += "</body>"
    option = '<option gravity="0 0 0"/>'
    model = mujoco.MjModel.from_xml_string(
        f"<mujoco>{option}<worldbody>{bodies}{tail}</worldbody></mujoco>"
    )
    data = mujoco.MjData(model)
    angles, rates = np.array([0.3, -0.4, 0.9]), np.array([0.5, -0.2, 0.7])
    data.qpos[:] = 0.0, 0.0, *np.diff(angles, prepend=0.0)
    c, s = np.cos(angles[0]), np.sin(angles[0])
    velocity = np.array([8.0, -1.0])
    data.qvel[:] = c * 8.0 + s, s * 8.0 - c, *np.diff(rates, prepend=0.0)
    forces = np.array([[3e3, -2e4, 5e4, 0.0], [-1e3, 8e3, -3e3, 0.0], [2e3, 3e4, -1e5, 0.0]])
    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)
    for number, (fx, fy, moment, _) in enumerate(forces):
        a = angles[number]
        world = [np.cos(a) * fx - np.sin(a) * fy, np.sin(a) * fx + np.cos(a) * fy, 0.0]
        body = model.body(f"u{number}").id
        mujoco.mj_applyFT(
            model, data, world, [0.0, 0.0, moment], data.xpos[body], body, data.qfrc_applied
        )
    mujoco.mj_forward(model, data)

    found, _, _ = accelerate([inertia(*unit) for unit in CHAIN], velocity, rates, angles, forces)
    np.testing.assert_allclose(found[:, 2], np.cumsum(data.qacc[2:]), rtol=1e-9)
    np.testing.assert_allclose(
        found[0, :2], [c * data.qacc[0] + s * data.qacc[1], c * data.qacc[1] - s * data.qacc[0]],
        rtol=1e-9,
    )  # fmt: skip


def glide(units, steps, h, rolling):
    """Momentum and kinetic energy over time of a chain on which no force acts."""
    units = np.array(units)
    angles, rates = np.array([0.0, 0.5, -0.4]), np.array([0.8, -0.5, 0.4])
    rolls, velocity = np.array([0.2, -0.3, 0.1]), np.array([10.0, 0.5])
    momenta, energies = [], []
    for _ in range(steps):
        out, _, at = accelerate(
            units, velocity, rates, angles, np.zeros((3, 4)), rolls if rolling else None
        )
        momentum = np.column_stack(
            [
                units[:, 0] * at[:, 0],
                units[:, 0] * at[:, 1] + units[:, 1] * at[:, 2] + units[:, 2] * at[:, 3],
            ]
        )
        c, s = np.cos(angles), np.sin(angles)
        momenta.append(
            [(c * momentum[:, 0] - s * momentum[:, 1]).sum(),
             (s * momentum[:, 0] + c * momentum[:, 1]).sum()]
        )  # fmt: skip
        energies.append(
            0.5 * (units[:, 0] * (at[:, 0] ** 2 + at[:, 1] ** 2) + units[:, 3] * rates**2).sum()
            + (units[:, 1] * at[:, 1] * rates).sum()
        )
        c, s = np.cos(h * rates[0]), np.sin(h * rates[0])
        vx, vy = velocity + h * out[0, :2]
        velocity = np.array([c * vx + s * vy, c * vy - s * vx])
        rates = rates + h * out[:, 2]
        rolls = rolls + h * out[:, 3]
        angles = angles + h * rates
    return np.array(momenta), np.array(energies)


def test_a_free_chain_keeps_its_momentum_and_energy():
    momenta, energies = glide([inertia(*unit) for unit in CHAIN], 2_000, 5e-4, rolling=False)
    size = np.linalg.norm(momenta[0])
    assert np.ptp(momenta, axis=0).max() < 2e-3 * size
    assert np.ptp(energies) < 2e-3 * energies[0]


def test_a_free_chain_that_rolls_keeps_its_momentum():
    heights = {"height": 1.1, "coupling": 0.4, "behind": 0.5, "roll": 2e4}
    units = [inertia(*unit, **heights) for unit in CHAIN]
    momenta, _ = glide(units, 1_000, 5e-4, rolling=True)
    assert np.ptp(momenta, axis=0).max() < 2e-3 * np.linalg.norm(momenta[0])


def test_the_hitch_pulls_a_trailer_with_its_mass_times_acceleration():
    units = [inertia(*CHAIN[0]), inertia(*CHAIN[2])]
    still = (0.0, 0.0)
    out, hitches, _ = accelerate(units, (20.0, 0.0), still, still, [[5e4, 0, 0, 0], [0] * 4])
    assert out[:, 0] == pytest.approx(5e4 / (CHAIN[0][0] + CHAIN[2][0]))
    assert hitches[1] == pytest.approx([CHAIN[2][0] * out[1, 0], 0.0])
