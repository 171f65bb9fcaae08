"""The analytic models against their derivation in `docs/derivation`, and what the paper prints."""

import dataclasses
import re

import kinematic_model
import lagrange_model as symbols
import numpy as np
import pytest
import quasi_coordinates
import sympy as sp
import yaw_sideslip as page
from lagrange_model import FORCES, RATES, STATES, TRAILS, derive
from printed_model import CORRECTED, PRINTED, READINGS, matrices

from iits_mj.analytic import Kinematic, YawPlane, critical_speed, understeer_gradient
from iits_mj.parameters import TruckParameters

PARAMETERS = TruckParameters.load()
LADEN = YawPlane.from_parameters(PARAMETERS, PARAMETERS.payload_max, pneumatic_trail=False)
V80 = 80.0 / 3.6
WITHOUT_GAMMA = READINGS[2]


def _any_truck(seed):
    """A truck of random numbers, so that no coincidence of our truck's hides a wrong term."""
    rng = np.random.default_rng(seed)
    tandem, group = rng.uniform(2.0, 3.0), rng.uniform(6.0, 9.0)
    half, spacing = rng.uniform(0.4, 0.9), rng.uniform(1.0, 1.6)
    cg, trails = rng.uniform(1.0, 2.5), rng.uniform(0.0, 0.1, 3)
    return YawPlane(
        mass=rng.uniform([6e3, 8e3], [1e4, 5e4]),
        inertia=rng.uniform([2e4, 1e5], [5e4, 8e5]),
        cg=np.array([cg, rng.uniform(3.0, 6.0)]),
        couplings=np.array([cg + rng.uniform(1.0, 3.0)]),
        unit=np.array([0, 0, 0, 1, 1, 1]),
        position=np.array(
            [0.0, cg + tandem - half, cg + tandem + half, *(group + spacing * np.arange(-1, 2))]
        ),
        cornering=rng.uniform(1e5, 9e5, 6),
        steer=np.eye(6)[0],
        trail=np.repeat(trails, [1, 2, 3]),
        reference=cg,
    )


def _zero(matrix):
    return matrix.applyfunc(lambda element: sp.simplify(sp.expand(element))).is_zero_matrix


@pytest.mark.parametrize("trail", [False, True])
@pytest.mark.parametrize("payload", [0.0, 20_000.0, 36_000.0])
def test_lagrange_gives_the_matrices_of_the_package(payload, trail):
    model = YawPlane.from_parameters(PARAMETERS, payload, pneumatic_trail=trail)
    for speed in (5.0, V80, 30.0):
        assert page.greatest_difference(model, speed) < 1e-13


@pytest.mark.parametrize("seed", range(5))
def test_lagrange_gives_the_matrices_of_the_package_for_any_truck(seed):
    assert page.greatest_difference(_any_truck(seed), 10.0 + seed) < 1e-13


def test_comparison_notices_a_wrong_number():
    model = _any_truck(7)
    wrong = dataclasses.replace(model, couplings=1.01 * model.couplings)
    derived = page.numeric(derive().matrices, wrong, V80)
    assert np.max(np.abs(derived[1][:3] - model.forces(V80)[:, :4])) > 1e-3 * np.max(
        np.abs(derived[1])
    )


def test_equations_do_not_depend_on_the_heading_nor_the_lateral_ones_on_the_drive_force():
    balance = derive().balance
    assert not balance.has(symbols.heading)
    assert balance[0].has(symbols.F_x)
    assert not balance[1:, :].has(symbols.F_x)


def test_boltzmann_hamel_gives_the_same_inertial_terms_as_lagrange():
    inertia = derive().lateral.subs(dict.fromkeys(FORCES, 0))
    assert _zero(quasi_coordinates.inertia_terms(quasi_coordinates.energy()) - inertia)


def test_printed_kinetic_energy_lacks_a_term_of_second_order():
    inertia = derive().lateral.subs(dict.fromkeys(FORCES, 0))
    missed = quasi_coordinates.inertia_terms(quasi_coordinates.printed_energy()) - inertia
    couple = symbols.m_t * symbols.L_t1 * symbols.v
    assert _zero(missed - sp.Matrix([0, -couple * symbols.omega_t, couple * symbols.omega_c]))


def test_printed_inertia_matrix_and_input_vector_are_right():
    derived, bare = derive().matrices, dict.fromkeys(TRAILS, 0)
    for reading in READINGS:
        assert _zero(matrices(reading).H - derived.H)
        assert _zero(matrices(reading).B_h - derived.B_h.subs(bare))


def test_minus_signs_and_the_tractors_yaw_rate_make_the_printed_equations_right():
    bare = dict.fromkeys(TRAILS, 0)
    assert _zero(matrices(CORRECTED).A_h - derive().matrices.A_h.subs(bare))


def test_printed_equations_are_wrong_in_the_inertial_terms_only():
    bare = dict.fromkeys(TRAILS, 0)
    wrong = matrices(PRINTED).A_h - derive().matrices.A_h.subs(bare)
    m_c, m_t, v = symbols.m_c, symbols.m_t, symbols.v
    arms = sp.Matrix([1, -symbols.L_h, -symbols.L_t1])
    expected = sp.zeros(4, 4)
    # Printed less right: both of m_c's terms and the trailer's two, with omega_c and omega_t.
    expected[0, 1] = 2 * m_c * v
    expected[:3, 1] += m_t * v * arms
    expected[:3, 2] = m_t * v * arms
    assert _zero(wrong - expected)


@pytest.mark.parametrize("reading", [PRINTED, WITHOUT_GAMMA], ids=lambda r: r.label)
def test_laden_truck_is_unstable_at_80_kmh_as_printed(reading):
    assert page.system(reading, LADEN, V80).eigenvalues()[0].real > 0.05


def test_laden_truck_is_stable_at_80_kmh_as_derived():
    assert page.system(CORRECTED, LADEN, V80).eigenvalues()[0].real < -0.5


@pytest.mark.parametrize("seed", range(3))
def test_plus_signs_turn_understeer_into_as_much_oversteer(seed):
    model = _any_truck(seed)

    def steer_per_curvature(reading, speed):
        return speed / page.system(reading, model, speed).steady_state()[1]

    slopes = [
        steer_per_curvature(reading, 20.0) - steer_per_curvature(reading, 10.0)
        for reading in (CORRECTED, PRINTED)
    ]
    assert slopes[1] == pytest.approx(-slopes[0], rel=1e-9)


def test_understeering_truck_has_a_critical_speed_only_as_printed():
    assert understeer_gradient(LADEN) > 0.0
    assert critical_speed(LADEN) == np.inf
    assert page.unstable_from(PRINTED, LADEN) < 60.0


def test_trailer_never_aligns_when_its_slip_angle_lacks_the_hitch_angle():
    lacking = next(r for r in READINGS if not r.hitch_angle and r.sign == -1)
    values = page.system(lacking, LADEN, V80).eigenvalues()
    assert abs(values[0]) < 1e-9
    assert page.system(CORRECTED, LADEN, V80).eigenvalues()[0].real < -0.5


def test_inertia_matrix_is_symmetric_and_positive_definite_for_any_numbers():
    H = derive().matrices.H
    assert H == H.T
    for size in range(1, 5):
        minor = sp.Poly(sp.expand(H[:size, :size].det()), *H.free_symbols)
        # Masses, inertias and lengths are positive, and no term is subtracted.
        assert all(coefficient > 0 for coefficient in minor.coeffs())


def _power_surplus(reading):
    """Rate of kinetic energy less the drive force's power, second order, without tires."""
    right = matrices(reading)
    tireless = right.A_h.subs(dict.fromkeys(symbols.STIFFNESSES, 0))
    rates = right.H.LUsolve(tireless * sp.Matrix(STATES))
    energy = quasi_coordinates.energy().subs(symbols.v_x, symbols.v)
    growth = sum(energy.diff(s) * rate for s, rate in zip(STATES, rates, strict=True))
    epsilon = sp.symbols("epsilon")
    small = {s: epsilon * s for s in (*STATES, *RATES)}
    force = derive().drive_force.subs(dict.fromkeys(FORCES, 0)).subs(small)
    second = force.diff(epsilon, 2).subs(epsilon, 0) / 2
    second = second.subs(dict(zip(RATES, rates, strict=True)))
    return growth - symbols.v * second


def test_without_tires_only_the_drive_force_changes_the_kinetic_energy():
    assert sp.simplify(_power_surplus(CORRECTED)) == 0


def test_printed_inertial_terms_create_energy():
    surplus = _power_surplus(PRINTED)
    numbers = {symbol: sp.Integer(3 + i) for i, symbol in enumerate(surplus.free_symbols)}
    assert surplus.subs(numbers) != 0


def test_printed_kinematic_model_is_right():
    assert _zero(kinematic_model.derived() - kinematic_model.printed())


def test_kinematic_model_of_the_package_is_the_derived_one():
    model = Kinematic.from_parameters(PARAMETERS)
    names = [getattr(kinematic_model, n) for n in ("L", "L_1", "L_2", "v", "omega")]
    angles = [getattr(kinematic_model, n) for n in ("theta", "phi", "psi")]
    rates = sp.lambdify([*names, *angles], kinematic_model.derived(), "numpy")
    state = np.array([3.0, -2.0, 0.7, 0.3, -0.5])
    expected = rates(model.L, model.hitches[0], model.lengths[0], 4.0, 0.2, *state[2:])[:, 0]
    np.testing.assert_allclose(model.derivative(state, 4.0, 0.2), expected, rtol=1e-12)


def test_printed_tire_ground_balance_has_three_misprints():
    k = kinematic_model
    wrong = k.balance() - k.printed_balance()
    rear = k.F_yr - k.F_yf
    moment = k.F_yf * sp.cos(k.phi) * (k.L_f - 1) - k.L_r * rear
    assert _zero(wrong - sp.Matrix([0, rear, moment]))


def test_script_renews_its_block_of_the_page(tmp_path):
    text = page.ROOT.joinpath("docs/analytic.md").read_text(encoding="utf-8")
    copy = tmp_path / "analytic.md"
    copy.write_text(text, encoding="utf-8")
    page.write_block(copy, "effects", "| a | table |")
    renewed = copy.read_text(encoding="utf-8")
    assert "| a | table |" in renewed
    assert renewed.startswith(text.partition("<!-- effects -->")[0])
    with pytest.raises(SystemExit, match="no block"):
        page.write_block(copy, "nowhere", "")


def test_example_of_the_page_runs(capsys):
    text = page.ROOT.joinpath("docs/analytic.md").read_text(encoding="utf-8")
    (example,) = re.findall(r"```python\n(.*?)```", text, re.DOTALL)
    exec(compile(example, "analytic.md", "exec"), {})
    assert "nan" not in capsys.readouterr().out


@pytest.mark.slow
def test_script_asserts_its_claims_and_draws_its_figures(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr("sys.argv", ["yaw_sideslip.py", "--plot", str(tmp_path)])
    page.main()
    assert "Derived matrices equal" in capsys.readouterr().out
    sizes = [path.stat().st_size for path in tmp_path.glob("*.png")]
    assert len(sizes) == 2
    assert all(5_000 < size < 150_000 for size in sizes)
