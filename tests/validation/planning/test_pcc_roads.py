"""Roads from cycles with grade over time; plans on finer roads."""

import numpy as np
import pytest

from controllers.pcc import PccConfig, RoadProfile, plan
from controllers.pcc.fuel import FuelMap
from controllers.pcc.planner import make_vehicle
from controllers.pcc.vehicle import durations
from iits_mj.core.errors import InputError
from iits_mj.parameters import TruckParameters
from iits_mj.validation.planning.pcc_roads import on_finer_road, read_cycle
from tests.paths import outside

PARAMETERS = TruckParameters.load()
MASS = 55_000.0


def write(path, time, speed, grade):
    rows = "".join(f"{t},{v},{g},0\n" for t, v, g in zip(time, speed, grade, strict=True))
    path.write_text("\ufeffcycSecs,cycMps,cycGrade,cycRoadType\n" + rows, encoding="utf-8")
    return path


def test_grade_over_time_becomes_grade_over_station(tmp_path):
    time = np.arange(201)
    grade = np.where(time < 100, 0.02, -0.01)
    cycle = read_cycle(write(tmp_path / "c.csv", time, np.full(201, 20.0), grade))
    assert cycle.speed == pytest.approx(20.0)
    assert cycle.spread == 0.0
    assert cycle.road.length == pytest.approx(4000.0)
    assert cycle.road.grade[:39] == pytest.approx(np.full(39, 0.02))
    assert cycle.road.grade[41:] == pytest.approx(np.full(39, -0.01))


def test_road_does_not_depend_on_the_speed_of_the_cycle(tmp_path):
    slow = read_cycle(
        write(tmp_path / "a.csv", np.arange(401), np.full(401, 10.0), np.full(401, 0.03))
    )
    fast = read_cycle(
        write(tmp_path / "b.csv", np.arange(201), np.full(201, 20.0), np.full(201, 0.03))
    )
    assert slow.road.height == pytest.approx(fast.road.height)
    assert fast.speed == pytest.approx(2.0 * slow.speed)


def test_standstill_adds_no_road(tmp_path):
    speed = np.concatenate([np.full(50, 20.0), np.zeros(30), np.full(50, 20.0)])
    cycle = read_cycle(write(tmp_path / "c.csv", np.arange(130), speed, np.full(130, 0.01)))
    assert cycle.road.length == pytest.approx(1950.0, abs=50.0)
    assert cycle.speed < 16.0
    assert cycle.road.grade == pytest.approx(np.full(cycle.road.intervals, 0.01))


@pytest.mark.parametrize(
    ("name", "speed"),
    [("EPA_Ph2_urban_highway_55mph.csv", 55.0), ("EPA_Ph2_rural_interstate_65mph.csv", 65.0)],
)
def test_gem_cycles_are_20_km_within_5_percent_grade(name, speed):
    cycle = read_cycle(outside(f"cycles/{name}"))
    assert cycle.speed == pytest.approx(speed * 0.44704, rel=1e-3)
    assert 19_900.0 < cycle.road.length < 20_100.0
    assert 0.03 < np.abs(cycle.road.grade).max() < 0.0502


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("", "columns"),
        ("a,b,c\n1,2,3\n", "columns"),
        ("cycSecs,cycMps,cycGrade\n0,20,0\n", "fewer than 2"),
        ("cycSecs,cycMps,cycGrade\n0,20,0\n0,20,0\n", "time must rise"),
        ("cycSecs,cycMps,cycGrade\n0,20,0\n1,-1,0\n", "below 0"),
        ("cycSecs,cycMps,cycGrade\n0,20,0\n1,x,0\n", "not a number"),
        ("cycSecs,cycMps,cycGrade\n0,20,0\n1,nan,0\n", "finite"),
        ("cycSecs,cycMps,cycGrade\n0,0,0\n1,0,0\n", "never moves"),
        ("cycSecs,cycMps,cycGrade\n0,20,0\n1,20,0\n", "too short"),
        ("cycSecs,cycMps,cycGrade\n0,20,1\n100,20,1\n", "grade"),
    ],
)
def test_unusable_cycles_are_refused_with_the_reason(tmp_path, text, reason):
    path = tmp_path / "c.csv"
    path.write_text(text)
    with pytest.raises(InputError, match=reason):
        read_cycle(path)


def test_a_missing_cycle_is_refused(tmp_path):
    with pytest.raises(InputError, match="cannot be read"):
        read_cycle(tmp_path / "none.csv")


def road_of(grade, step=50.0):
    height = np.concatenate([[0.0], np.cumsum(np.asarray(grade) * step)])
    station = step * np.arange(height.size)
    return RoadProfile(station, height, np.full(height.size, np.inf), "test road")


def test_plan_with_constant_forces_burns_the_planned_fuel_on_a_rough_road():
    rng = np.random.default_rng(1)
    rough = 0.02 * np.sin(np.arange(600) / 60.0) + rng.normal(0.0, 0.01, 600)
    fine = road_of(rough, step=10.0)
    road = RoadProfile(fine.station[::5], fine.height[::5], fine.v_limit[::5], "coarse")
    config = PccConfig(k_a=0.0, rolls=False)
    coarse, best = (plan(r, PARAMETERS, MASS, config) for r in (road, fine))
    vehicle = make_vehicle(PARAMETERS, FuelMap(PARAMETERS), MASS, config)

    def excess(speed):
        late = durations(speed, fine).sum() - best.plan.time
        burnt = vehicle.fuel_of(speed, fine).sum() + best.time_price * late
        return burnt / best.fuel - 1.0

    straight = np.interp(fine.station, road.station, coarse.plan.speed)
    held = on_finer_road(vehicle, road, coarse.plan.speed, fine)
    assert abs(excess(held)) < 1e-3
    assert excess(straight) > 4e-3
    # The band's upper edge cuts the bumps where the plan drives along it.
    banded = on_finer_road(vehicle, road, coarse.plan.speed, fine, config.v_max)
    assert banded.max() <= config.v_max + 1e-9
    assert excess(banded) < 0.7 * excess(straight)


def test_a_fine_road_that_leaves_the_plan_is_refused():
    vehicle = make_vehicle(PARAMETERS, FuelMap(PARAMETERS), MASS, PccConfig())
    with pytest.raises(InputError, match="leaves the plan"):
        on_finer_road(vehicle, road_of(np.zeros(120)), np.full(121, 20.0), road_of(np.zeros(140)))
