"""Planner and path tracking: situations, wind, measures, and short forms of the maneuvers."""

import numpy as np
import pytest

from iits_mj.core.results import Results
from iits_mj.core.units import KMH
from iits_mj.validation.harness.config import ValidateConfig
from iits_mj.validation.planning import path_cases as cases
from iits_mj.validation.planning.path_tracking import run_path_tracking, side_load
from iits_mj.validation.planning.side_wind import SideWind, spectrum
from iits_mj.validation.planning.situations import run_situations


@pytest.fixture(scope="module")
def situations() -> Results:
    return run_situations(ValidateConfig(quick=True))


def test_every_situation_meets_its_bounds(situations):
    assert [check.name for check in situations.checks if not check.ok] == []


def test_papers_three_situations_are_drawn_from_above(situations):
    panels = situations.figures["lane change, seen from above"]
    assert [panel.title[:3] for panel in panels] == ["(a)", "(b)", "(c)"]
    for panel in panels:
        assert any(line.label == "planned path" for line in panel.lines)
        assert all(line.x.shape == line.y.shape for line in panel.lines)


def test_notes_give_the_reasons_of_the_decisions(situations):
    assert any("there is no lane to the right" in note for note in situations.notes)
    assert any("beside the truck" in note for note in situations.notes)
    assert any("aiming for the gap" in note for note in situations.notes)


def test_turbulence_has_the_variance_of_its_spectrum_and_depends_on_the_seed_alone():
    wind = SideWind.gusty(np.random.default_rng(1), 100.0, peak=0.0)
    station = np.arange(0.0, 60_000.0, 3.0)
    blown = np.array([wind.at(float(s)) for s in station])
    wavenumber = np.geomspace(1e-3, 1.0 / 16.0, 2000)
    variance = np.trapezoid(spectrum(wavenumber, 6.0, 2.2), wavenumber)
    assert blown.mean() == pytest.approx(6.0, abs=0.1)
    assert blown.var() == pytest.approx(variance, rel=0.05)
    again = SideWind.gusty(np.random.default_rng(1), 100.0, peak=0.0)
    assert again.at(123.0) == wind.at(123.0)


def test_the_spectrum_integrates_to_the_variance_of_the_surface_layer():
    # 17 / 9.5 * 3 / 2 = 2.68 friction speeds squared over all wavenumbers.
    wavenumber = np.geomspace(1e-7, 1e4, 20_000)
    friction_speed = 0.4 * 6.0 / np.log(2.2 / 0.03)
    variance = np.trapezoid(spectrum(wavenumber, 6.0, 2.2), wavenumber)
    assert variance == pytest.approx(2.684 * friction_speed**2, rel=0.01)


def test_gusts_alternate_in_side_and_are_twice_as_long_as_their_gradient():
    wind = SideWind.gusty(np.random.default_rng(1), 4000.0, mean=1e-9, peak=12.0)
    for row in range(8):
        start, gradient = float(wind.start[row]), float(wind.gradient[row])
        sign = 1.0 if row % 2 == 0 else -1.0
        assert wind.at(start + gradient) == pytest.approx(12.0 * sign, abs=1e-6)
        assert wind.at(start + 0.5 * gradient) == pytest.approx(6.0 * sign, abs=1e-6)
        assert wind.at(start + 2.0 * gradient + 0.1) == pytest.approx(0.0, abs=1e-6)


def test_only_reversals_beyond_the_threshold_count():
    time = np.arange(0.0, 10.0, 0.01)
    assert cases.count_reversals(np.sin(2.0 * np.pi * 0.5 * time), 0.5) == 10
    assert cases.count_reversals(0.2 * np.sin(2.0 * np.pi * 0.5 * time), 0.5) == 0
    assert cases.count_reversals(time, 0.5) == 0
    assert cases.count_reversals(np.minimum(time, 10.0 - time), 0.5) == 1


def test_a_gust_pushes_the_truck_with_the_side_force_of_its_area():
    # 1/2 rho |v| v_y C_y A, |v| of truck and gust together; half of it acts on the tractor.
    force, moment = side_load(0.0, 80.0 * KMH, 12.0)
    assert force == pytest.approx(0.6 * 40.0 * np.hypot(80.0 * KMH, 12.0) * 12.0, rel=0.01)
    assert -60e3 < moment < -10e3


def test_the_quick_form_meets_every_bound():
    results = run_path_tracking(ValidateConfig(quick=True))
    assert results.ok, results.to_table()
    assert any("wind" in check.name for check in results.checks)


def test_full_braking_on_split_friction_stays_in_the_lane():
    run = cases.split_braking(0.0, 0.002, 0.8, 0.3)
    assert abs(run["speed"][-1]) < 0.1
    assert cases.peak_error(run) < 0.4


def test_a_right_angle_of_12_m_is_kept_within_0_1_m_from_standstill():
    run = cases.junction(0.0, 0.002, 12.0, 3.0)
    assert run["speed"][0] < 0.1
    assert run["station"][-1] > 100.0
    assert cases.peak_error(run) < 0.1
    assert np.abs(run["trailer"]).max() > 1.5


@pytest.mark.slow
@pytest.mark.parametrize("payload", [0.0, 36_000.0])
@pytest.mark.parametrize("friction", [0.4, 0.8])
def test_full_braking_in_a_bend_stays_within_0_4_m(payload, friction):
    run = cases.brake_in_bend(payload, 0.002, friction, 80.0 * KMH)
    assert abs(run["speed"][-1]) < 0.1
    assert cases.peak_error(run) < 0.4


@pytest.mark.slow
@pytest.mark.parametrize("payload", [0.0, 36_000.0])
def test_articulation_dies_out_after_a_push_on_the_trailer(payload):
    run = cases.side_impulse(payload, 0.002, 80.0 * KMH, 40e3, steered=True)
    assert cases.settling_time(run, 5.5, 0.1) < 4.0
    rate = np.abs(run["articulation_rate"])
    assert rate[-100:].max() < 0.02 * rate.max()


@pytest.mark.slow
@pytest.mark.parametrize(
    "factors", [{"stiffness": 0.8}, {"mass": 1.2}, {"dead_band": 2.0}, {"noise": 1.0}]
)
def test_a_truck_unlike_its_model_keeps_its_path_in_wind(factors):
    wind = SideWind.gusty(np.random.default_rng(7), 16_000.0)
    run = cases.wrong_model(0.002, wind, **factors)
    assert cases.rms_error(run) < 0.15
    assert cases.peak_error(run) < 0.4
