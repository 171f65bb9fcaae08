"""Pedal, climbing, brake and descent tests of the truck: figures in the expected range."""

import numpy as np
import pytest

from iits_mj.core.units import KMH
from iits_mj.parameters import TruckParameters
from iits_mj.road import Route
from iits_mj.truck import Truck
from iits_mj.validation.harness.maneuver import run
from iits_mj.validation.longitudinal import (
    braking,
    descent,
    energy_audit,
    fuel_map,
    group,
    hill_climb,
)
from iits_mj.validation.longitudinal.acceleration import part_throttle, part_throttle_run
from iits_mj.validation.longitudinal.hills import HILLS_LENGTH, SpeedKeeper

STEP = 0.002
LADEN = 36_000.0
TRUCK = TruckParameters.load()


def short(found):
    return [check.name for check in found.checks if not check.ok]


def values_of(checks):
    return {check.name.rsplit(": ", 1)[1]: check.value for check in checks}


def test_40_percent_pedal_agrees_with_the_paper():
    record = part_throttle_run(STEP)
    values = values_of(part_throttle(record, record).checks)
    assert values["first gear used"] == 2.0
    assert values["gear at 40 s"] in (9.0, 10.0)
    assert 40.0 < values["speed at 40 s"] < 50.0
    assert 0.6 <= values["shift, shortest"] <= values["shift, longest"] <= 1.0


def test_xbr_reaches_the_demanded_deceleration_and_pressure_and_releases_smoothly():
    checks = braking.compare_xbr(TRUCK, 31_000.0, STEP).checks
    values = values_of(check for check in checks if "integrated" not in check.name)
    assert values["mean deceleration"] == pytest.approx(1.5, rel=0.03)
    assert values["overshoot"] < 10.0
    assert values["mean pressure"] == pytest.approx(150.0, rel=0.2)
    assert values["kick beyond coasting after the release"] < 10.0


def test_full_stop_holds_without_lock_up():
    values = values_of(braking.compare_stop(TRUCK, 0.0, braking.UN_R13, STEP).checks)
    assert values["longest lock-up above 15 km/h"] <= 1.0
    assert values["speed at the end"] < 0.1
    assert 20.0 < values["distance"] < 50.0


def test_brake_response_meets_un_r13_and_the_dead_times_of_the_lines():
    found = braking.compare_response(TRUCK, 0.0, STEP)
    assert short(found) == []
    assert [len(panel.lines) for panel in found.panels] == [6]


@pytest.mark.parametrize(("grade", "managed"), [(0.15, True), (0.42, False)])
def test_laden_truck_sets_off_on_15_percent_and_not_on_42(grade, managed):
    assert hill_climb.sets_off(TRUCK, LADEN, grade, STEP).managed == managed


def test_bisection_finds_the_edge():
    climb = hill_climb.steepest(lambda grade: hill_climb.Attempt(grade < 0.237, 1))
    assert climb.grade == pytest.approx(0.237, abs=0.0025)
    assert climb.gear == 1


def test_fuel_at_a_steady_point_is_map_times_power():
    point = fuel_map.measure(60.0 * KMH, 0.4, STEP)
    specific = fuel_map.consumption(TruckParameters.load(), point)
    assert point.spread < 0.005
    assert point.rate == pytest.approx(specific * point.torque * point.speed, rel=0.01)


def test_consumption_outside_the_map_is_not_a_number():
    point = fuel_map.Point(speed=120.0, torque=9000.0, rate=1.0, spread=0.0, used=0.0, time=1.0)
    assert np.isnan(fuel_map.consumption(TruckParameters.load(), point))


def test_keeper_uses_the_pedal_uphill_and_the_engine_brake_downhill():
    shares = {}
    for grade in (0.01, -0.03):
        route = Route.straight(5e3, grade=grade)
        truck = Truck.load(LADEN, route=route, timestep=0.005, visuals=False)
        truck.reset(station=100.0, speed=15.0)
        keeper = SpeedKeeper()
        record = run(truck, lambda _, s, k=keeper: k.command(s.speed, 15.0), 45.0)
        assert record.speed[-500:] == pytest.approx(15.0, abs=0.5)
        shares[grade] = truck.last_command()
    assert shares[0.01].accelerator_pedal > 0.2
    assert shares[0.01].engine_brake == 0.0
    assert shares[-0.03].accelerator_pedal == 0.0
    assert shares[-0.03].engine_brake > 0.2


def test_a_sensor_that_the_model_lacks_reads_not_a_number():
    truck = Truck.load(0.0, timestep=0.005, visuals=False)
    record = run(truck, lambda *_: truck.last_command(), 0.1, sensors=("hope", "gear"))
    assert np.isnan(record.extra["hope"]).all()
    assert np.isfinite(record.extra["gear"]).all()


def test_change_by_the_step_is_over_the_figure_at_the_finest(monkeypatch):
    values = {0.001: 20.0, 0.002: 20.05, 0.005: 19.8}
    monkeypatch.setattr(group, "figures", lambda step: {"way": values[step]})
    checks = group.compare_steps().checks
    assert [check.value for check in checks] == pytest.approx([0.25, 1.0])
    assert [check.ok for check in checks] == [True, False]


@pytest.mark.slow
@pytest.mark.parametrize("kph", [30.0, 60.0])
def test_speed_is_held_down_six_percent_for_six_kilometers(kph):
    assert short(descent.compare(TRUCK, kph * KMH, STEP)) == []


@pytest.mark.slow
@pytest.mark.parametrize("payload", [LADEN, 0.0])
def test_ledger_accounts_for_the_work_of_the_engine(payload):
    assert short(energy_audit.compare(TRUCK, payload, STEP, HILLS_LENGTH)) == []


@pytest.mark.slow
def test_startability_and_gradeability_are_the_computed_ones():
    assert short(hill_climb.compare_limits(TRUCK, STEP, quick=False)) == []


@pytest.mark.slow
def test_steady_speeds_balance_the_forces():
    assert short(hill_climb.compare_speeds(TRUCK, STEP, quick=False)) == []


@pytest.mark.slow
def test_fuel_at_all_steady_points_is_the_map():
    assert short(fuel_map.compare(STEP, quick=False)) == []


@pytest.mark.slow
@pytest.mark.parametrize("regulation", braking.REGULATIONS, ids=lambda r: r.name)
@pytest.mark.parametrize("payload", [LADEN, 0.0])
def test_full_stops_are_within_the_regulations(payload, regulation):
    assert short(braking.compare_stop(TRUCK, payload, regulation, STEP)) == []


@pytest.mark.slow
def test_longitudinal_figures_do_not_depend_on_the_step():
    assert short(group.compare_steps()) == []
