"""The speed planner: its mathematics, its limits, and its saving on the paper's road."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import nnls

from controllers.pcc import PccConfig, RoadProfile, plan
from controllers.pcc.fuel import FuelMap, nonnegative_fit
from controllers.pcc.planner import lower_speeds, make_vehicle
from controllers.pcc.vehicle import cruise, durations, full_power_speed
from iits_mj.core.errors import InputError, PlanningError
from iits_mj.parameters import TruckParameters, shipped_trucks
from tests.controllers.pcc.dynamic_program import least_cost
from tests.paths import outside

JINAN = "road/jinan_altimap_pcc.csv"
PARAMETERS = TruckParameters.load()
MASS = 55_000.0


def road_of(grade, step=50.0, limit=np.inf):
    height = np.concatenate([[0.0], np.cumsum(np.asarray(grade) * step)])
    station = step * np.arange(height.size)
    return RoadProfile(station, height, np.full(height.size, limit), "test road")


def hills(intervals=120, amplitude=0.03, period=2000.0):
    middle = 50.0 * (np.arange(intervals) + 0.5)
    return road_of(amplitude * np.sin(2.0 * np.pi * middle / period))


@pytest.fixture(scope="module")
def hilly():
    return plan(hills(), PARAMETERS, MASS, PccConfig(k_a=0.0))


def test_fuel_fit_is_convex_and_within_3_percent_of_the_map():
    fit = FuelMap(PARAMETERS).fit(12.5, 25.0)
    assert min(fit.f0, fit.f1, fit.f2) >= 0.0
    assert fit.error < 0.03
    assert fit.rate(np.array([-fit.overrun_power]))[0] == pytest.approx(0.0, abs=1e-9)


def test_fuel_fit_is_the_nonnegative_least_squares_fit():
    rng = np.random.default_rng(1)
    for _ in range(20):
        basis = rng.normal(size=(30, 3))
        value = basis @ rng.normal(size=3) + rng.normal(0.0, 0.1, 30)
        assert nonnegative_fit(basis, value) == pytest.approx(nnls(basis, value)[0], abs=1e-9)


def test_engine_rate_equals_the_table_at_its_points():
    engine = PARAMETERS.engine
    rate = FuelMap(PARAMETERS).engine_rate(
        np.array([engine.fuel_map.rows[4]]), np.array([engine.fuel_map.columns[5]])
    )
    power = engine.fuel_map.rows[4] * engine.fuel_map.columns[5]
    assert rate[0] == pytest.approx(engine.fuel_map.values[4, 5] * power, rel=1e-12)


def test_overrun_burns_no_fuel():
    rate, _ = FuelMap(PARAMETERS).rate(np.array([-2e4]), np.array([20.0]))
    assert rate[0] == 0.0


def test_chosen_gear_burns_least_of_those_that_give_the_force():
    fuel_map = FuelMap(PARAMETERS)
    force, speed = 8_000.0, 20.0
    rate, gear = fuel_map.rate(np.array([force]), np.array([speed]))
    omega = fuel_map.gear_speed * speed
    for i in np.flatnonzero((omega > 85.0) & (omega < PARAMETERS.engine.governed_speed)):
        torque = force / fuel_map.efficiency / fuel_map.gear_speed[i]
        full = np.interp(
            omega[i], PARAMETERS.engine.full_load_speed, PARAMETERS.engine.full_load_torque
        )
        if torque <= full:
            other = fuel_map.engine_rate(np.array([torque]), np.array([omega[i]]))[0]
            assert other >= rate[0] - 1e-12
    assert 1 <= gear[0] <= 12


def test_plan_takes_no_longer_and_ends_at_the_cruises_speed(hilly):
    assert hilly.plan.time <= hilly.baseline.time * (1.0 + 1e-6)
    assert hilly.plan.speed[0] == hilly.baseline.speed[0]
    assert hilly.plan.speed[-1] == hilly.baseline.speed[-1]


def test_plan_keeps_band_power_and_brakes(hilly):
    config = PccConfig()
    vehicle = make_vehicle(PARAMETERS, FuelMap(PARAMETERS), MASS, config)
    assert hilly.plan.speed.max() <= config.v_max + 1e-9
    assert hilly.plan.speed.min() >= config.v_min - 1e-9
    assert hilly.plan.power.max() <= vehicle.power_max * (1.0 + 1e-4)
    net = vehicle.net_force(hilly.plan.speed, hilly.road)
    assert net.min() >= -vehicle.brake_max - vehicle.power_drag / config.v_min


def test_plan_saves_fuel_on_hills_by_both_fuel_models(hilly):
    assert hilly.saving_percent > 5.0
    assert hilly.map_saving_percent > 5.0


def test_the_plan_saves_no_fuel_on_a_level_road():
    solution = plan(road_of(np.zeros(100)), PARAMETERS, MASS)
    assert abs(solution.saving_percent) < 0.05
    assert np.abs(solution.plan.speed - 20.0).max() < 0.1


def test_cruise_slows_on_a_climb_beyond_full_power_and_recovers():
    road = road_of(np.concatenate([np.zeros(20), np.full(30, 0.05), np.zeros(60)]))
    config = PccConfig()
    vehicle = make_vehicle(PARAMETERS, FuelMap(PARAMETERS), MASS, config)
    speed = cruise(vehicle, road, 20.0, 20.0)
    assert speed[:21] == pytest.approx(20.0)
    assert 12.0 < speed[50] < 15.0
    assert speed[-1] == pytest.approx(20.0)
    assert vehicle.power(speed, road).max() <= vehicle.power_max * (1.0 + 1e-4)


def test_steady_climb_speed_balances_power_and_resistance():
    road = road_of(np.full(200, 0.04))
    vehicle = make_vehicle(PARAMETERS, FuelMap(PARAMETERS), MASS, PccConfig())
    v = cruise(vehicle, road, 20.0, 20.0)[-1]
    resistance = vehicle.slope_force(np.array([0.04]))[0] + vehicle.drag * v**2
    assert resistance * v == pytest.approx(vehicle.efficiency * vehicle.power_max, rel=1e-3)


def test_plan_and_cruise_keep_the_speed_limits():
    road = hills()
    limit = np.full(road.station.size, 25.0)
    limit[60:80] = 16.0
    solution = plan(replace(road, v_limit=limit), PARAMETERS, MASS)
    assert (solution.plan.speed <= limit + 1e-6).all()
    assert (solution.baseline.speed <= limit + 1e-6).all()


def confirmed(road, states):
    """Returns the excess of the dynamic program's cost, as share of the plan's fuel."""
    config = PccConfig(k_a=0.0, rolls=False)
    solution = plan(road, PARAMETERS, MASS, config)
    vehicle = make_vehicle(PARAMETERS, FuelMap(PARAMETERS), MASS, config)
    base = solution.baseline.speed
    cap = np.minimum(road.v_limit, config.v_max)
    low = lower_speeds(full_power_speed(vehicle, road, base[0], cap), config.v_min)
    b_low, b_high = low**2, cap**2
    b_low[[0, -1]] = b_high[[0, -1]] = base[[0, -1]] ** 2
    price = solution.time_price
    least, _ = least_cost(vehicle, road, b_low, b_high, price, states)
    return (least - solution.fuel - price * solution.plan.time) / solution.fuel


def test_dynamic_program_confirms_the_optimum_within_a_thousandth():
    # No drive on the grid may be cheaper; the rounding of 1200 speeds costs 0.7 thousandths.
    assert -1e-6 < confirmed(hills(intervals=80), 1200) < 1e-3


@pytest.mark.slow
def test_dynamic_program_confirms_the_optimum_on_the_papers_road():
    excess = confirmed(RoadProfile.from_csv(outside(JINAN), length=15_000.0), 1600)
    assert -1e-6 < excess < 5e-4


def test_the_50_m_grid_is_within_a_thousandth_of_a_fine_one(hilly):
    fine = road_of(np.repeat(hilly.road.grade, 10), step=5.0)
    solution = plan(fine, PARAMETERS, MASS, PccConfig(k_a=0.0))
    assert hilly.fuel == pytest.approx(solution.fuel, rel=1e-3)
    # Fuel of the coarse plan on the fine grid, plus the price of the time difference.
    vehicle = make_vehicle(PARAMETERS, FuelMap(PARAMETERS), MASS, PccConfig(k_a=0.0))
    b = np.interp(fine.station, hilly.road.station, hilly.plan.speed**2)
    driven = vehicle.fuel_of(np.sqrt(b), fine).sum()
    late = durations(np.sqrt(b), fine).sum() - solution.plan.time
    assert driven + solution.time_price * late == pytest.approx(solution.fuel, rel=1e-3)


def test_clock_of_the_plan_begins_at_zero_and_ends_with_the_cruises(hilly):
    assert hilly.plan.clock[0] == 0.0
    assert (np.diff(hilly.plan.clock) > 0.0).all()
    assert hilly.plan.clock[-1] == pytest.approx(hilly.baseline.time, rel=1e-6)


def test_a_weight_on_acceleration_reduces_speed_changes_and_saving(hilly):
    calm = plan(hills(), PARAMETERS, MASS, PccConfig(k_a=200.0))
    assert np.diff(calm.plan.speed).std() < 0.9 * np.diff(hilly.plan.speed).std()
    assert calm.saving_percent < hilly.saving_percent


def test_saving_on_the_papers_road():
    road = RoadProfile.from_csv(outside(JINAN), length=15_000.0)
    braking = PccConfig(rolls=False)
    solution = plan(road, PARAMETERS, MASS, braking)
    assert road.intervals == 300
    # At least the paper's saving, by the model and by the engine's map.
    assert 21.68 <= solution.saving_percent < 26.0
    assert 21.68 <= solution.map_saving_percent < 26.0
    assert solution.saving_percent == pytest.approx(solution.map_saving_percent, abs=0.3)
    narrow = plan(road, PARAMETERS, MASS, replace(braking, v_max=75.0 / 3.6))
    assert narrow.saving_percent < solution.saving_percent - 8.0
    # Against a cruise that rolls downhill as the plan may, less than half of it is left.
    assert 9.0 < plan(road, PARAMETERS, MASS).map_saving_percent < 11.0


def test_rolling_cruise_is_as_fast_as_coasting_allows_and_brakes_at_the_top_only():
    grade = np.concatenate([np.zeros(10), np.full(20, -0.02), np.full(20, -0.04), np.zeros(70)])
    road, vehicle = road_of(grade), make_vehicle(PARAMETERS, FuelMap(PARAMETERS), MASS, PccConfig())
    speed = cruise(vehicle, road, 20.0, 20.0, top=25.0)
    assert speed[:11] == pytest.approx(20.0)
    assert speed.max() == pytest.approx(25.0)
    assert speed[-1] == pytest.approx(20.0)
    # Above the set speed and below the top the wheels take the engine's drag alone.
    mean = 0.5 * (speed[1:] + speed[:-1])
    rolls = (speed[1:] > 20.0) & (speed[1:] < 25.0) & (speed[:-1] > 20.0) & (speed[:-1] < 25.0)
    assert np.count_nonzero(rolls) > 20
    power = vehicle.net_force(speed, road) * mean
    assert power[rolls] == pytest.approx(-vehicle.power_overrun, rel=1e-6)
    assert (
        FuelMap(PARAMETERS).rate(vehicle.net_force(speed, road)[rolls], mean[rolls])[0].max() < 5e-4
    )


def test_rolling_cruise_equals_the_braking_one_where_it_never_overruns():
    climb = road_of(np.concatenate([np.zeros(20), np.full(30, 0.05), np.zeros(60)]))
    vehicle = make_vehicle(PARAMETERS, FuelMap(PARAMETERS), MASS, PccConfig())
    assert cruise(vehicle, climb, 20.0, 20.0, top=25.0) == pytest.approx(
        cruise(vehicle, climb, 20.0, 20.0), abs=1e-6
    )


def test_rolling_cruise_keeps_the_speed_limits_and_needs_brakes_for_them():
    limit = np.full(121, 24.0)
    limit[60:80] = 16.0
    road = replace(hills(), v_limit=limit)
    vehicle = make_vehicle(PARAMETERS, FuelMap(PARAMETERS), MASS, PccConfig())
    assert (cruise(vehicle, road, 20.0, 20.0, top=25.0) <= limit + 1e-6).all()
    with pytest.raises(PlanningError, match="do not hold"):
        cruise(replace(vehicle, brake_max=0.0), hills(amplitude=0.1), 20.0, 20.0, top=25.0)
    weak = replace(vehicle, power_max=0.3 * vehicle.power_max)
    with pytest.raises(PlanningError, match="does not carry"):
        cruise(weak, road_of(np.full(200, 0.2)), 20.0, 20.0, top=25.0)


def test_the_cruise_can_have_a_mean_speed_instead_of_a_set_speed():
    for rolls in (True, False):
        config = PccConfig(mean_speed=True, rolls=rolls)
        solution = plan(hills(amplitude=0.02), PARAMETERS, MASS, config)
        assert solution.road.length / solution.baseline.time == pytest.approx(20.0, rel=1e-3)


def test_a_climb_beyond_full_power_is_refused_with_the_station():
    with pytest.raises(PlanningError, match=r"full power .* at station"):
        plan(road_of(np.full(100, 0.24)), PARAMETERS, MASS)


def test_a_descent_beyond_the_brakes_is_refused_with_the_grade():
    road = road_of(np.append(np.zeros(50), np.full(50, -0.2)))
    with pytest.raises(PlanningError, match=r"do not hold 55000 kg on the 20.0 % descent"):
        plan(road, PARAMETERS, MASS)


def test_a_start_speed_too_high_for_a_limit_ahead_is_refused():
    road = road_of(np.zeros(40))
    limit = np.full(road.station.size, 25.0)
    limit[20] = 10.0
    vehicle = make_vehicle(PARAMETERS, FuelMap(PARAMETERS), MASS, PccConfig())
    assert cruise(vehicle, replace(road, v_limit=limit), 24.0, 24.0)[20] == pytest.approx(10.0)
    weak = replace(vehicle, brake_max=5_000.0)
    with pytest.raises(PlanningError, match=r"start speed 24.00 m/s is above the \d+"):
        cruise(weak, replace(road, v_limit=limit), 24.0, 24.0)


@pytest.mark.parametrize(
    ("change", "name"),
    [
        ({"v_min": 30.0}, "band"),
        ({"v_ref": np.nan}, "v_ref"),
        ({"k_a": -1}, "k_a"),
        ({"v_max": "90"}, "v_max"),
    ],
)
def test_bad_settings_are_refused_by_name(change, name):
    with pytest.raises(InputError, match=name):
        PccConfig(**change)


@pytest.mark.parametrize("mass", [float("nan"), -1.0, "55 t", None])
def test_bad_mass_is_refused(mass):
    with pytest.raises(InputError, match="mass"):
        plan(hills(), PARAMETERS, mass)


def test_a_band_beyond_the_gears_is_refused():
    with pytest.raises(PlanningError, match="no gear runs at"):
        plan(hills(), PARAMETERS, MASS, PccConfig(v_max=60.0))


def test_a_plan_without_brakes_slows_down_by_engine_drag_only():
    gentle = hills(amplitude=0.01)
    solution = plan(gentle, PARAMETERS, MASS, PccConfig(deceleration_max=0.0))
    assert solution.optimum.method == "interior_point"
    vehicle = make_vehicle(PARAMETERS, FuelMap(PARAMETERS), MASS, PccConfig())
    net = vehicle.net_force(solution.plan.speed, gentle)
    mean = 0.5 * (solution.plan.speed[1:] + solution.plan.speed[:-1])
    assert (net >= -vehicle.power_drag * vehicle.efficiency / mean - 5.0).all()


@pytest.mark.parametrize(
    "text",
    [
        "",
        "a,b\n1,2\n",
        "s_m,z_m\n",
        "s_m,z_m\n0,x\n",
        "s_m,z_m\n0,1\n0,2\n9,9\n",
        "s_m,z_m\n0,nan\n900,1",
    ],
)
def test_unusable_profiles_are_refused(tmp_path, text):
    path = tmp_path / "road.csv"
    path.write_text(text)
    with pytest.raises(InputError):
        RoadProfile.from_csv(path)


def test_a_missing_profile_is_refused(tmp_path):
    with pytest.raises(InputError, match="cannot be read"):
        RoadProfile.from_csv(tmp_path / "none.csv")


def test_csv_profile_has_the_heights_of_the_file(tmp_path):
    path = tmp_path / "road.csv"
    rows = "".join(f"{s},{0.01 * s}\n" for s in range(0, 1001, 10))
    path.write_text("# a source line\ns_m,z_m\n" + rows)
    road = RoadProfile.from_csv(path, step=100.0)
    assert road.intervals == 10
    assert road.grade == pytest.approx(np.full(10, 0.01))


def test_hills_return_their_potential_energy_exactly():
    # On such steep ramps the sine of the angle would lose 0.5 % of the height.
    road = road_of(np.tile(np.repeat([0.1, -0.1], 10), 5))
    vehicle = make_vehicle(PARAMETERS, FuelMap(PARAMETERS), MASS, PccConfig())
    work = vehicle.slope_force(road.grade).sum() * road.step
    assert work == pytest.approx(MASS * 9.81 * vehicle.rolling * road.length, rel=1e-9)
    climb = vehicle.slope_force(road.grade[:10]).sum() * road.step
    climb -= MASS * 9.81 * vehicle.rolling * 500.0
    assert climb == pytest.approx(MASS * 9.81 * road.height[10], rel=1e-9)


def test_a_plan_ends_at_the_cruises_speed_even_below_the_band():
    # At the end the cruise is below the band; a truck that arrives faster is not.
    road = road_of(np.concatenate([np.zeros(300), np.full(60, 0.05)]), step=5.0)
    solution = plan(road, PARAMETERS, MASS, PccConfig(v_min=18.0))
    assert solution.baseline.speed[-1] < 17.5
    assert solution.plan.speed[-1] == pytest.approx(solution.baseline.speed[-1], abs=0.02)
    before = solution.baseline.speed >= 18.0
    assert solution.plan.speed[before].min() >= 0.999 * 18.0 - 1e-6


def test_greatest_power_does_not_depend_on_the_band():
    fuel_map = FuelMap(PARAMETERS)
    powers = [
        make_vehicle(PARAMETERS, fuel_map, MASS, PccConfig(v_min=low, v_max=high)).power_max
        for low, high in ((1.1, 25.0), (12.5, 25.0), (18.0, 38.0))
    ]
    assert powers[0] == powers[1] == powers[2]
    given = fuel_map.power_max(np.linspace(2.5, 40.0, 20_000))
    assert given.min() == pytest.approx(powers[0], rel=1e-4)
    assert powers[0] > 0.85 * given.max()


def test_plan_leaves_its_band_only_where_full_power_cannot_reach_it():
    # The climb takes the speed below the band for some 500 m.
    road = road_of(np.concatenate([np.zeros(40), np.full(24, 0.05), np.full(60, -0.005)]))
    config = PccConfig(v_min=15.5)
    solution = plan(road, PARAMETERS, MASS, config)
    vehicle = make_vehicle(PARAMETERS, FuelMap(PARAMETERS), MASS, config)
    fastest = full_power_speed(vehicle, road, 20.0, np.full(road.station.size, config.v_max))
    reached = fastest >= config.v_min
    assert 5 < np.count_nonzero(~reached) < 40
    assert solution.plan.speed[reached].min() >= 0.999 * config.v_min - 1e-6
    assert (solution.plan.speed >= 0.999 * fastest - 1e-6)[~reached].all()


VECTO = TruckParameters.load("vecto_40t")


def test_a_map_of_the_fuel_rate_is_used_at_its_points():
    engine, fuel_map = VECTO.engine, FuelMap(VECTO)
    table = engine.fuel_rate_map
    torque, speed = np.meshgrid(table.columns, table.rows)
    driving = torque >= 0.0
    found = fuel_map.engine_rate(torque[driving], speed[driving])
    assert found == pytest.approx(engine.fuel_factor * table.values[driving], rel=1e-12)


def test_below_the_engines_drag_no_map_of_the_fuel_rate_burns_fuel():
    speed = np.linspace(80.0, 180.0, 30)
    drag = np.interp(speed, VECTO.engine.drag_speed, VECTO.engine.drag_torque)
    assert FuelMap(VECTO).engine_rate(-1.05 * drag, speed) == pytest.approx(np.zeros(30), abs=2e-5)


def test_the_wheel_force_is_what_the_losses_leave_of_the_engines_torque():
    box, radius = VECTO.gearbox, VECTO.tires[VECTO.driven_axles[0].tire].rolling_radius
    fuel_map, speed = FuelMap(VECTO), 22.0
    for force in (-1200.0, 3000.0, 15_000.0):
        inputs = fuel_map._input_torques(np.array([force]), np.array([speed]))[:, 0]
        for gear in range(9, len(box.ratios)):
            shaft = speed / radius * box.final_drive
            number = box.loss_map[gear]
            table = list(box.loss_maps.values())[number - 1]
            torque = inputs[gear] - table.at(shaft * box.ratios[gear], inputs[gear])
            torque *= box.ratios[gear]
            retarder = VECTO.retarder
            torque -= np.interp(shaft, retarder.drag_speed, retarder.drag_torque)
            torque -= box.axle_loss.at(shaft, torque)
            assert torque * box.final_drive / radius == pytest.approx(force, rel=1e-3)


def test_auxiliaries_burn_the_fuel_of_their_work():
    spared = replace(VECTO, engine=replace(VECTO.engine, auxiliaries={}))
    force, speed = np.array([6000.0]), np.array([22.0])
    (with_them, gear), (without, _) = (FuelMap(p).rate(force, speed) for p in (VECTO, spared))
    # The marginal efficiency of a diesel engine is 40 to 50 %; 42.7 MJ/kg.
    work = (with_them - without)[0] * 42.7e6
    assert 0.38 < VECTO.engine.auxiliary_power / work < 0.52
    assert gear[0] == len(VECTO.gearbox.ratios)


@pytest.mark.parametrize("name", shipped_trucks())
def test_the_plan_of_every_truck_saves_fuel_on_hills(name):
    truck = TruckParameters.load(name)
    found = plan(hills(), truck, truck.gross_mass(truck.payload_max), PccConfig(k_a=0.0))
    assert found.saving_percent > 0.1
