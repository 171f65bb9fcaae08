"""The long longitudinal checks hold, each group as a whole."""

import pytest

from iits_mj.core.units import KMH
from iits_mj.validation.longitudinal import (
    descent,
    energy_audit,
    full_stop,
    group,
    hill_climb,
    steady_points,
)
from iits_mj.validation.longitudinal.runs import HILLS_LENGTH

STEP = 0.002
LADEN = 36_000.0
pytestmark = pytest.mark.slow


def short(checks):
    return [check.name for check in checks if not check.ok]


@pytest.mark.parametrize("kph", [30.0, 60.0])
def test_speed_is_held_down_six_percent_for_six_kilometers(kph):
    assert short(descent.compare(kph * KMH, STEP)[0]) == []


@pytest.mark.parametrize("payload", [LADEN, 0.0])
def test_every_joule_of_the_engine_is_found(payload):
    assert short(energy_audit.compare(payload, STEP, HILLS_LENGTH)[0]) == []


def test_startability_and_gradeability_are_the_computed_ones():
    assert short(hill_climb.compare(STEP, quick=False)) == []


def test_steady_speeds_balance_the_forces():
    assert short(steady_points.compare_climb(STEP, quick=False)[0]) == []


def test_fuel_at_all_steady_points_is_the_map():
    assert short(steady_points.compare_fuel(STEP, quick=False)[0]) == []


@pytest.mark.parametrize("regulation", full_stop.REGULATIONS, ids=lambda r: r.name)
@pytest.mark.parametrize("payload", [LADEN, 0.0])
def test_full_stops_are_within_the_regulations(payload, regulation):
    assert short(full_stop.full_stop(payload, regulation, STEP)[0]) == []


def test_longitudinal_figures_do_not_depend_on_the_step():
    assert short(group.compare()[0]) == []
