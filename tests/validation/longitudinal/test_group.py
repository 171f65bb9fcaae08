"""Pedal, climbing, brake and descent tests of the truck: it is in the right region."""

import numpy as np
import pytest

from iits_mj.core.units import KMH
from iits_mj.parameters import TruckParameters
from iits_mj.road import Route
from iits_mj.truck import Truck
from iits_mj.validation.longitudinal import (
    braking,
    full_stop,
    group,
    hill_climb,
    steady_points,
)
from iits_mj.validation.longitudinal.acceleration import part_throttle, part_throttle_run
from iits_mj.validation.longitudinal.runs import SpeedKeeper, run

STEP = 0.002
LADEN = 36_000.0


def values_of(checks):
    return {check.name.rsplit(": ", 1)[1]: check.value for check in checks}


def test_forty_percent_pedal_reads_as_the_paper():
    record = part_throttle_run(STEP)
    values = values_of(part_throttle(record, record)[0])
    assert values["first gear used"] == 2.0
    assert values["gear at 40 s"] in (9.0, 10.0)
    assert 40.0 < values["speed at 40 s"] < 50.0
    assert 0.6 <= values["shift, shortest"] <= values["shift, longest"] <= 1.0


def test_xbr_brings_the_demanded_deceleration_and_pressure_and_lets_go_smoothly():
    checks, _ = braking.xbr(31_000.0, STEP)
    values = values_of(check for check in checks if "integrated" not in check.name)
    assert values["mean deceleration"] == pytest.approx(1.5, rel=0.03)
    assert values["overshoot"] < 10.0
    assert values["mean pressure"] == pytest.approx(150.0, rel=0.2)
    assert values["kick beyond coasting after the release"] < 10.0


def test_full_stop_holds_without_lock_up():
    values = values_of(full_stop.full_stop(0.0, full_stop.UN_R13, STEP)[0])
    assert values["longest lock-up above 15 km/h"] <= 1.0
    assert values["speed at the end"] < 0.1
    assert 20.0 < values["distance"] < 50.0


def test_brakes_respond_as_the_rule_and_their_lines_say():
    checks, (panel,) = braking.compare(0.0, STEP)
    assert [check.name for check in checks if not check.ok] == []
    assert len(panel.lines) == 6


@pytest.mark.parametrize(("grade", "managed"), [(0.15, True), (0.42, False)])
def test_laden_truck_sets_off_on_15_percent_and_not_on_42(grade, managed):
    assert hill_climb.sets_off(LADEN, grade, STEP).managed == managed


def test_bisection_finds_the_edge():
    climb = hill_climb._steepest(lambda grade: hill_climb._Try(grade < 0.237, 1), 0.0025)
    assert climb.grade == pytest.approx(0.237, abs=0.0025)
    assert climb.gear == 1


def test_fuel_at_a_steady_point_is_map_times_power():
    point = steady_points.measure(60.0 * KMH, 0.4, STEP)
    specific = steady_points.consumption(TruckParameters.load(), point)
    assert point.spread < 0.005
    assert point.rate == pytest.approx(specific * point.torque * point.speed, rel=0.01)


def test_consumption_outside_the_map_is_not_a_number():
    point = steady_points.Point(
        speed=120.0, torque=9000.0, rate=1.0, spread=0.0, used=0.0, time=1.0
    )
    assert np.isnan(steady_points.consumption(TruckParameters.load(), point))


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
    monkeypatch.setattr(group, "figures", lambda step: {"way": (values[step], "m")})
    checks, _ = group.compare()
    assert [check.value for check in checks] == pytest.approx([0.25, 1.0])
    assert [check.ok for check in checks] == [True, False]
