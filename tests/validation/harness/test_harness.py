"""Measures of time histories, options of the validation, and the digest of kept drives."""

from pathlib import Path

import numpy as np
import pytest

import iits_mj
from iits_mj.core.errors import InputError
from iits_mj.validation import COMMANDS, ValidateConfig
from iits_mj.validation.harness.recorder import fit, harmonic, peak_ratio
from iits_mj.validation.harness.run_cache import NOT_DRIVING, driving_files

TIME = np.linspace(0.0, 20.0, 2001)


def test_fit_is_100_for_the_same_signal_and_0_for_its_mean():
    signal = np.sin(TIME)
    assert fit(signal, signal) == pytest.approx(100.0)
    assert fit(np.full_like(signal, signal.mean()), signal) == pytest.approx(0.0)
    assert np.isnan(fit(signal, np.ones_like(signal)))


def test_peak_ratio_compares_magnitudes():
    assert peak_ratio(np.array([0.0, -3.0, 1.0]), np.array([2.0, 0.0, 0.0])) == pytest.approx(1.5)


def test_harmonic_finds_amplitude_and_phase_beside_a_drift():
    frequencies = np.array([0.1, 0.5])
    signal = 2.0 * np.cos(2 * np.pi * 0.1 * TIME - 0.3) + np.sin(2 * np.pi * 0.5 * TIME)
    found = harmonic(TIME, signal + 0.7 - 0.05 * TIME, frequencies)
    assert abs(found[0]) == pytest.approx(2.0)
    assert np.angle(found[0]) == pytest.approx(-0.3)
    assert np.angle(found[1]) == pytest.approx(-np.pi / 2)


def test_commands_and_options_are_the_documented_ones():
    truck = {"lateral", "longitudinal", "pbs", "plant", "standards", "step-size", "truck"}
    assert set(COMMANDS) == truck | {
        *("traffic", "planning", "aeb", "alks", "credibility", "measured")
    }
    assert ValidateConfig().step == 0.001
    assert ValidateConfig(quick=True).step == 0.002
    assert ValidateConfig(quick=True, timestep=0.005).step == 0.005
    assert ValidateConfig().payloads() == (36_000.0, 0.0)
    assert ValidateConfig(payload=12_000.0).payloads() == (12_000.0,)
    with pytest.raises(InputError, match="payload"):
        ValidateConfig(payload=50_000.0)
    with pytest.raises(InputError, match="timestep"):
        ValidateConfig(timestep=0.1)


def test_every_excluded_package_exists():
    root = Path(iits_mj.__file__).parents[1]
    assert [name for name in NOT_DRIVING if not (root / name).is_dir()] == []


def test_planning_control_traffic_and_truck_are_covered_and_evaluation_is_not():
    folders = {name.rsplit("/", 1)[0] for name in driving_files()}
    assert folders >= {
        "controllers/planning",
        "controllers/tracking",
        "iits_mj/simulation",
        "iits_mj/parameters",
        "mjcf",
        "traffic_bridge",
    }
    assert not {"iits_mj/evaluation", "iits_mj/validation/planning"} & folders
