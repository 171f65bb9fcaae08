"""Yaw-plane and yaw-roll models of n units against their derivation by sympy."""

import numpy as np
import pytest

from iits_mj.analytic import YawPlane, YawRoll
from iits_mj.analytic.roll_bodies import RollBody, RollData, roll_bodies
from iits_mj.core.errors import InputError
from iits_mj.core.units import GRAVITY

sp = pytest.importorskip("sympy", reason="the derivation needs sympy (extra 'docs')")
chain_model = pytest.importorskip("chain_model")

CHAINS = {1: (2,), 2: (2, 1), 3: (2, 1, 2), 4: (2, 1, 1, 1)}


def random_chain(axles, seed):
    """A combination of random numbers: the model's arrays, and the derivation's symbols."""
    rng, chain = np.random.default_rng(seed), chain_model.Chain(axles)
    n, on = len(axles), np.array(chain.on)
    bodies = {
        name: rng.uniform(*limits, n)
        for name, limits in {
            "m": (3e3, 3e4),
            "p": (1.0, 5.0),
            "h": (0.8, 2.2),
            "I_x": (2e3, 3e4),
            "I_z": (2e4, 4e5),
            "air": (1.0, 20.0),
            "p_air": (-1.0, 5.0),
        }.items()
    }
    couplings = {
        name: rng.uniform(*limits, n - 1)
        for name, limits in {
            "c": (2.0, 8.0),
            "h_c": (0.7, 1.3),
            "k_c": (1e5, 8e6),
            "d_c": (1e3, 5e4),
        }.items()
    }
    on_axles = {
        name: rng.uniform(*limits, len(on))
        for name, limits in {
            "m_a": (500.0, 1200.0),
            "e": (-0.1, 0.3),
            "I_xa": (200.0, 600.0),
            "I_za": (200.0, 600.0),
            "F_z": (3e4, 1e5),
            "k_s": (2e5, 2e6),
            "d_s": (1e3, 2e4),
            "k_t": (1e6, 5e6),
            "d_t": (1e2, 2e3),
            "J": (20.0, 60.0),
            "s": (1.8, 2.1),
            "r": (0.4, 0.55),
            "h_a": (0.4, 0.55),
            "C": (1e5, 9e5),
            "t": (0.0, 0.1),
            "share": (0.0, 1.0),
            "sigma": (0.2, 0.8),
        }.items()
    }
    on_axles["a"] = np.where(on == 0, rng.uniform(0.0, 5.0, len(on)), rng.uniform(4, 9, len(on)))
    reference, height_air, speed = 1.3, 1.7, 21.0
    masses = [[bodies["m"][k], *on_axles["m_a"][on == k]] for k in range(n)]
    places = [[bodies["p"][k], *on_axles["a"][on == k]] for k in range(n)]
    mass = np.array([sum(part) for part in masses])
    cg = np.array([np.average(p, weights=m) for p, m in zip(places, masses, strict=True)])
    inertia = np.array(
        [
            bodies["I_z"][k]
            + on_axles["I_za"][on == k].sum()
            + sum(m * (p - cg[k]) ** 2 for m, p in zip(masses[k], places[k], strict=True))
            for k in range(n)
        ]
    )
    plane = YawPlane(
        mass=mass,
        inertia=inertia,
        cg=cg,
        couplings=couplings["c"],
        unit=on,
        position=on_axles["a"],
        cornering=on_axles["C"],
        steer=on_axles["share"],
        trail=on_axles["t"],
        reference=reference,
    )
    data = RollData(
        bodies=tuple(
            RollBody(k, *(float(bodies[name][k]) for name in ("m", "p", "h", "I_x")))
            for k in range(n)
        ),
        cg_height=bodies["h"],
        coupling_height=couplings["h_c"],
        coupling_stiffness=couplings["k_c"],
        coupling_damping=couplings["d_c"],
        axle_mass=on_axles["m_a"],
        axle_height=on_axles["h_a"],
        axle_inertia_x=on_axles["I_xa"],
        arm=on_axles["e"],
        load=on_axles["F_z"],
        cruise_load=on_axles["F_z"],
        suspension=on_axles["k_s"],
        suspension_damping=on_axles["d_s"],
        tires=on_axles["k_t"],
        tires_damping=on_axles["d_t"],
        spin_inertia=on_axles["J"],
        track=on_axles["s"],
        rolling_radius=on_axles["r"],
        relaxation=on_axles["sigma"],
        pressure_position=bodies["p_air"],
        pressure_height=height_air,
        side_area=2.0 * bodies["air"],
        air_density=1.0,
    )
    values = {sp.Symbol("reference"): reference, sp.Symbol("h_air"): height_air}
    values |= {chain_model.v: speed, chain_model.g: GRAVITY}
    for group, count in ((bodies, n), (couplings, n - 1), (on_axles, len(on))):
        for name, array in group.items():
            values |= {sp.Symbol(f"{name}_{i + 1}"): float(array[i]) for i in range(count)}
    return plane, data, values, speed


def _numeric(chain, values):
    matrices = chain_model.state_space(chain)
    return sp.lambdify(list(values), matrices, "numpy")(*values.values())


def _close(ours, derived):
    np.testing.assert_allclose(ours, derived, rtol=1e-9, atol=1e-11 * np.max(np.abs(derived)))


@pytest.mark.parametrize("units", CHAINS)
@pytest.mark.parametrize("seed", range(2))
def test_yaw_plane_matrices_are_those_of_lagrange(units, seed):
    plane, _, values, speed = random_chain(CHAINS[units], seed)
    still = {f"{name}_{i + 1}" for name in ("J", "air") for i in range(10)}
    values = {key: 0.0 if key.name in still else value for key, value in values.items()}
    M, A, B = _numeric(chain_model.Chain(CHAINS[units], roll=False), values)
    _close(plane.inertia_matrix(), M)
    _close(plane.forces(speed), np.hstack([A, B]))
    system = plane.at(speed)
    _close(system.A[: 1 + units], np.linalg.solve(M, A))
    _close(system.B[: 1 + units], np.linalg.solve(M, B)[:, 0])


@pytest.mark.parametrize("units", CHAINS)
def test_yaw_roll_matrices_are_those_of_lagrange(units):
    plane, data, values, speed = random_chain(CHAINS[units], 7 + units)
    model = YawRoll.of(plane, data, roll_bodies(plane, data), relaxation=False)
    M, A, B = _numeric(chain_model.Chain(CHAINS[units]), values)
    _close(model.inertia, M)
    system, rolls = model.at(speed), units + len(data.load)
    # States of the system: plane (velocities, articulations), angles, rates of the angles.
    flat = list(range(1 + units))
    angles = list(range(2 * units, 2 * units + rolls))
    rates = list(range(2 * units + rolls, 2 * units + 2 * rolls))
    order = [*flat, *rates, *range(1 + units, 2 * units), *angles]
    rows = [*flat, *rates]
    motion, push = np.linalg.solve(M, A), np.linalg.solve(M, B)
    # The derivation's columns: velocities of plane and roll, articulations, angles.
    _close(system.A[np.ix_(rows, order)], motion)
    _close(system.B[rows], push[:, 0])


def test_a_wrong_number_is_noticed():
    plane, _, values, _ = random_chain(CHAINS[3], 0)
    values[sp.Symbol("c_2")] *= 1.01
    M, _, _ = _numeric(chain_model.Chain(CHAINS[3], roll=False), values)
    assert np.max(np.abs(M - plane.inertia_matrix())) > 1e-4 * np.max(np.abs(M))


def test_arrays_that_do_not_fit_are_refused():
    plane, _, _, _ = random_chain(CHAINS[2], 0)
    names = {name: getattr(plane, name) for name in plane.__dataclass_fields__}
    with pytest.raises(InputError, match="couplings has 0 values; 1"):
        YawPlane(**{**names, "couplings": np.array([])})
    with pytest.raises(InputError, match="each of 2 needs one"):
        YawPlane(**{**names, "unit": np.array([0, 0, 0])})
