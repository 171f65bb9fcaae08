"""The adaptive shift strategy: fuel, load and mass."""

import numpy as np
import pytest

from iits_mj.road import Route
from iits_mj.truck import Truck
from tests.plugin.driveline_rig import PARAMETERS, Case, constant, drive, shifts
from tests.plugin.vehicle_sled import KMH

ENGINE, GEARBOX = PARAMETERS.engine, PARAMETERS.gearbox
EFFICIENCY = GEARBOX.efficiency * GEARBOX.driveline_efficiency
ADAPTIVE = {"shift_strategy": "adaptive"}
# A second is worth far more than fuel.
POWER = ADAPTIVE | {"adaptive_climb_speed": "0.92", "adaptive_time_price": "1"}


def consumption(torque, turns):
    """Returns the specific consumption [kg/J] of the map: bilinear, constant beyond its edges."""
    fuel = ENGINE.fuel_map
    rows = [np.interp(turns, fuel.columns, row) for row in fuel.values]
    return np.interp(torque, fuel.rows, rows)


def consumption_of(torque, turns):
    """Returns the same for many points of work, each of shape (n,)."""
    fuel = ENGINE.fuel_map
    rows = np.array([np.interp(turns, fuel.columns, row) for row in fuel.values])
    place = np.interp(torque, fuel.rows, np.arange(len(fuel.rows)))
    low = np.minimum(place.astype(int), len(fuel.rows) - 2)
    column = np.arange(len(turns))
    part = place - low
    return (1.0 - part) * rows[low, column] + part * rows[low + 1, column]


def held_speed(case, seconds=90.0, gain=0.4):
    """Returns the traces of a drive in which a slow PI controller holds the start speed.

    The pedal is constant for blocks of 3 s and follows from the speed at the end of the last one.
    """
    pedal, integral = 0.3, 0.3
    pedals = []
    for _ in range(round(seconds / 3.0)):
        pedals.append(pedal)
        controls = np.concatenate([constant(1, 3.0, [p]) for p in pedals], axis=1)
        traces = drive([case], controls, changes=ADAPTIVE, timestep=0.005)
        error = case.speed - traces["speed"][0, -1]
        integral = float(np.clip(integral + 0.1 * gain * error, 0.05, 0.9))
        pedal = float(np.clip(integral + gain * error, 0.03, 1.0))
    return traces


@pytest.mark.parametrize(
    ("mass", "grade", "speed"),
    [(19_000.0, 0.0, 70), (37_000.0, 0.01, 60), (55_000.0, 0.02, 45), (55_000.0, 0.0, 80)],
)
def test_cruising_gear_burns_at_most_5_percent_more_than_the_best_gear(mass, grade, speed):
    traces = held_speed(Case(mass, grade, speed * KMH), 45.0)
    shaft = traces["propeller_shaft_speed"][0, -1]
    window = traces["shift_in_process"][0, -400:] == 0
    torque = traces["propeller_shaft_torque"][0, -400:][window].mean()
    rates = {}
    for gear, ratio in enumerate(GEARBOX.ratios, 1):
        turns, engine_torque = shaft * ratio, torque / (ratio * EFFICIENCY)
        shifting = GEARBOX.shifting
        lowest = ENGINE.idle_speed * (shifting.lowest_speed + 0.3 * shifting.lowest_speed_pedal)
        most = np.interp(turns, ENGINE.full_load_speed, ENGINE.full_load_torque)
        if lowest * 1.05 < turns < 0.7 * ENGINE.governed_speed and engine_torque < most / 1.1:
            rates[gear] = consumption(engine_torque, turns) * engine_torque * turns
    assert len(rates) >= 2
    gear = int(traces["gear"][0, -1])
    assert rates[gear] < 1.05 * min(rates.values())


def test_laden_truck_on_a_climb_drives_in_a_lower_gear_at_the_same_speed_and_pedal():
    cases = [Case(19_000.0, 0.0, 60 * KMH), Case(55_000.0, 0.0, 60 * KMH)]
    cases += [Case(55_000.0, 0.03, 60 * KMH)]
    traces = drive(cases, constant(3, 6.0, np.full(3, 0.6)), changes=ADAPTIVE)
    light, laden, climbing = traces["gear"][:, -1]
    assert climbing < laden <= light


def test_adaptive_upshift_on_a_climb_is_not_undone():
    cases = [Case(mass, g, 15 * KMH) for mass in (37_000.0, 55_000.0) for g in (0.01, 0.02, 0.03)]
    traces = drive(cases, constant(len(cases), 80.0, np.ones(len(cases))), changes=ADAPTIVE)
    for gear in traces["gear"]:
        steps = [after - before for time, before, after in shifts(gear) if time > 2.0]
        assert len(steps) >= 2
        assert min(steps) > 0


@pytest.mark.parametrize("timestep", [0.001, 0.002, 0.005])
def test_light_truck_skips_low_gears_at_40_percent_pedal_and_a_laden_climb_does_not(timestep):
    """With the released powertrain's shift speeds 19 t take 13.7 s to 20 km/h on a rougher road."""
    cases = [Case(19_000.0, 0.0, 0.0), Case(55_000.0, 0.06, 5 * KMH)]
    pedal = [0.4, 1.0]
    controls = constant(2, 16.0, pedal, timestep=timestep)
    traces = drive(cases, controls, changes=ADAPTIVE, timestep=timestep)
    light, laden = ([change[1:] for change in shifts(g, timestep)] for g in traces["gear"])
    assert light[:2] == [(2, 4), (4, 6)]
    assert all(after == before + 1 for before, after in laden)
    reached = timestep * np.argmax(traces["speed"][0] > 20 * KMH)
    assert 9.0 < reached < 13.7


def test_adaptive_strategy_accelerates_faster_than_the_tables_at_full_pedal():
    case, controls = Case(37_000.0, 0.0, 2.0), constant(1, 50.0, [1.0])
    speeds = [
        drive([case], controls, changes={"shift_strategy": name})["speed"][0, -1]
        for name in ("tables", "adaptive")
    ]
    assert speeds[1] > speeds[0]


def test_priced_time_decides_between_power_and_fuel_on_a_climb():
    """With dear time a laden truck uses 80 % of the engine's power despite gear changes."""
    cases = [Case(55_000.0, grade, 80 * KMH) for grade in (0.025, 0.03, 0.04, 0.05)]
    powers, rates = [], []
    for changes in (POWER, ADAPTIVE):
        traces = drive(cases, constant(len(cases), 60.0, np.ones(len(cases))), changes=changes)
        power = np.maximum(traces["engine_torque"], 0.0) * traces["engine_speed"]
        powers.append(power.mean(axis=1))
        rates.append(
            [
                (consumption_of(torque, turns) * work).sum() / work.sum()
                for torque, turns, work in zip(
                    traces["engine_torque"], traces["engine_speed"], power, strict=True
                )
            ]
        )
    greatest = (ENGINE.full_load_speed * ENGINE.full_load_torque).max()
    assert (powers[0] > 0.8 * greatest).all(), powers
    assert (powers[0] > 0.999 * np.array(powers[1])).all(), powers
    assert np.mean(powers[0]) > 1.02 * np.mean(powers[1]), powers
    assert np.mean(rates[1]) < np.mean(rates[0]), rates


def test_short_horizon_prevents_a_downshift_that_pays_later():
    """Torque builds up so slowly that a lower gear does no more work within 5 s."""
    case, controls = Case(55_000.0, 0.04, 80 * KMH), constant(1, 30.0, [1.0])
    lowest = [
        drive([case], controls, changes=POWER | {"adaptive_horizon": horizon})["gear"][0].min()
        for horizon in ("5", "30")
    ]
    assert lowest[1] < lowest[0]


@pytest.mark.parametrize("grade", [0.023, 0.026])
def test_a_gear_change_at_speed_is_not_corrected_because_the_wheels_slip_vanishes(grade):
    """40 t at 80 km/h need 11th gear; with the torque the wheels' slip vanishes, as if braked."""
    route = Route.straight(length=1500.0, grade=grade)
    truck = Truck.load(
        40_000.0 - PARAMETERS.gross_mass(0.0),
        parameters={"gearbox": {"shift_strategy": "adaptive"}},
        route=route,
        timestep=0.005,
        plant="yaw-sideslip",
        visuals=False,
    )
    truck.reset(station=100.0, speed=80.0 / 3.6)
    truck.command(accelerator_pedal=1.0)
    gears = []
    for _ in range(300):
        truck.step(10)
        gears.append(truck.observe().gear)
    assert min(g for g in gears if g) == 11
