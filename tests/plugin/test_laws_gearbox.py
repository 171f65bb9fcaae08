"""Choice of a gear, in single situations of a truck with five gears (laws_truck.h).

Shift speeds of the tables for a half pedal: 6.7 m/s from gear 2 to 3, 10.8 m/s from 3 to 4.
"""

import numpy as np
import pytest

from tests.plugin.laws_direct import law

RATIOS = (11.67, 6, 3.2, 1.8, 1)
RADIUS = 0.52 / 2.85  # meters per radian of the shaft
IDLE, GOVERNED, BRAKE_SPEED = 62.8, 219.9, 240.9
CEILING = 0.92 * GOVERNED
INPUT = {
    "pedal": 0.5,
    "brake": 0,
    "shaft": 40,
    "torque": 0,
    "engine": 100,
    "mass": 20e3,
    "driver_pedal": None,
    "driver_brake": None,
    "open": 0,
}
STATE = {
    "gear": 0,
    "target": 0,
    "phase": 0,
    "phase_time": 0,
    "gear_time": 10,
    "low_time": 0,
    "speed": 0,
    "acceleration": 0,
    "filtered": 0,
    "load": 0,
    "slow_load": None,
    "filtered_pedal": 0.5,
    "direction": 0,
    "failed_gear": 0,
    "failed_load": 0,
}


def situation(changes):
    inputs = {**INPUT, **{k: v for k, v in changes.items() if k in INPUT}}
    inputs["driver_pedal"] = inputs["driver_pedal"] or inputs["pedal"]
    if inputs["driver_brake"] is None:
        inputs["driver_brake"] = inputs["brake"]
    state = {**STATE, **{k: v for k, v in changes.items() if k in STATE}}
    if state["slow_load"] is None:
        state["slow_load"] = state["load"]
    assert set(changes) <= {*INPUT, *STATE}
    return np.array(list(inputs.values()), float), np.array(list(state.values()), float)


def choose(gear, adaptive=0, **changes):
    """Returns the chosen gear, negative if the present one failed."""
    failed = np.zeros(1)
    chosen = law("shift_choice", adaptive, gear, *situation(changes), 0.002, failed)
    return -chosen if failed[0] else chosen


def calls_for_lower(gear, adaptive=0, **changes):
    return law("shift_low_time", adaptive, gear, *situation(changes), 0.002) > 0


def shaft(gear, engine_speed):
    return engine_speed / RATIOS[gear - 1]


@pytest.mark.parametrize("adaptive", [0, 1])
def test_overspeed_shifts_up_by_the_governors_or_the_engine_brakes_limit(adaptive):
    for pedal, brake, limit in (
        (0.5, 0, 1.08 * GOVERNED),
        (0, 0, 1.08 * GOVERNED),
        (0.5, 1, 1.08 * GOVERNED),
        (0, 1, 1.05 * BRAKE_SPEED),
    ):
        more = {"adaptive": adaptive, "pedal": pedal, "brake": brake, "gear_time": 0}
        assert choose(3, shaft=shaft(3, limit + 1), **more) == 4
        assert choose(3, shaft=shaft(3, limit - 1), **more) == 3
        assert choose(5, shaft=shaft(5, limit + 1), **more) == 5


def test_table_decides_on_upshifts():
    assert choose(2, shaft=6.6 / RADIUS) == 2
    assert choose(2, shaft=6.7 / RADIUS) == 3
    assert choose(3, shaft=10.8 / RADIUS) == 3
    assert choose(3, shaft=10.9 / RADIUS) == 4
    # No change within the first second in a gear, during a cut by the brakes, or with the pedal up.
    assert choose(2, shaft=6.7 / RADIUS, gear_time=0.9) == 2
    assert choose(3, shaft=10.9 / RADIUS, driver_pedal=0.6) == 3
    assert choose(2, shaft=6.7 / RADIUS, pedal=0.02) == 2
    # At the governor the cut takes no torque away.
    assert choose(2, shaft=shaft(2, GOVERNED), driver_pedal=0.6) == 3
    # The next gear must carry the load.
    assert choose(2, shaft=6.7 / RADIUS, load=9e3) == 2


def test_gear_that_failed_needs_a_greater_reserve():
    # Half pedal in gear 3 after the change: torque over load is between 1.03 and 1.12.
    speed, heavy = 7.0 / RADIUS, 400e3
    loads = [
        load for load in range(1000, 6000, 10) if choose(2, mass=heavy, shaft=speed, load=load) == 3
    ]
    failed = [
        load
        for load in range(1000, 6000, 10)
        if choose(2, mass=heavy, shaft=speed, load=load, failed_gear=3, failed_load=9e3) == 3
    ]
    assert max(loads) / max(failed) == pytest.approx(1.12 / 1.03, rel=0.03)
    assert choose(2, mass=heavy, shaft=speed, load=max(loads), failed_gear=4, failed_load=9e3) == 3


def test_upshift_soon_after_a_downshift_waits_for_the_governor():
    low, high = 3.05 / RADIUS, shaft(1, CEILING + 1)
    for direction, time, speed, gear in (
        (0, 3, low, 2),
        (1, 3, low, 2),
        (-1, 3, low, 1),
        (-1, 6, low, 2),
        (-1, 3, high, 2),
    ):
        assert choose(1, shaft=speed, direction=direction, gear_time=time) == gear


def test_kick_down_engages_the_gear_of_the_upshift_table():
    floored = {"pedal": 1, "filtered_pedal": 0.2, "mass": 60e3, "load": 3000, "shaft": 10 / RADIUS}
    assert choose(4, **floored) == 3
    assert choose(4, **{**floored, "filtered_pedal": 0.75}) == 4
    assert choose(4, **{**floored, "pedal": 0.94}) == 4
    # Not into a gear that the engine would soon outgrow, or at its ceiling.
    assert choose(4, **{**floored, "mass": 8e3, "load": 0}) == 4
    assert choose(4, **{**floored, "shaft": shaft(3, CEILING + 1)}) == 4
    # A kick-down may also reverse a recent upshift.
    assert choose(4, direction=1, **{**floored, "gear_time": 2}) == 3


def test_stopped_truck_goes_back_to_the_gear_for_starting():
    assert choose(4, shaft=0, open=1, pedal=0) == 1
    assert choose(4, shaft=0, open=1, pedal=0.5) == 1
    assert choose(4, shaft=0, open=0, pedal=0, low_time=0) == 4
    assert choose(4, shaft=shaft(1, 1.1 * IDLE), open=1, pedal=0) == 4


def test_engine_brake_calls_for_gears_with_more_engine_speed():
    braking = {"pedal": 0, "brake": 1, "shaft": 60, "low_time": 0.6}
    assert choose(5, **braking) == 3
    assert choose(5, **{**braking, "brake": 0.5, "driver_brake": 0.5}) == 4
    assert choose(5, **{**braking, "low_time": 0.4}) == 5
    # More than the whole engine brake is as the whole.
    slow = {**braking, "shaft": 42}
    assert choose(5, driver_brake=1.6, **slow) == choose(5, **slow) == 3
    # The friction brakes already decelerate the truck.
    fast = {**braking, "shaft": 80}
    assert calls_for_lower(5, **fast)
    assert calls_for_lower(5, acceleration=-0.79 / RADIUS, **fast)
    assert not calls_for_lower(5, acceleration=-0.81 / RADIUS, **fast)
    assert not calls_for_lower(5, **{**fast, "driver_brake": 0})
    # Downhill the truck gains speed during the change.
    limit = shaft(3, 0.93 * BRAKE_SPEED)
    load = -(limit - 60) / (0.7 - 0.5 * 0.15) * 20e3 * RADIUS**2
    assert choose(5, load=0.95 * load, **braking) == 3
    assert choose(5, load=1.05 * load, **braking) == 4


def test_too_slow_an_engine_calls_for_a_lower_gear():
    slowest = IDLE * (1.15 + 0.6 * 0.3)
    slow = {"pedal": 0.3, "shaft": shaft(4, slowest - 1)}
    assert calls_for_lower(4, **slow)
    assert not calls_for_lower(4, **{**slow, "shaft": shaft(4, slowest + 1)})
    # Not if the truck gains the speed within 1.5 s, and never below gear 2.
    assert not calls_for_lower(4, acceleration=shaft(4, 2) / 1.5, **slow)
    assert not calls_for_lower(1, **{**slow, "shaft": shaft(1, slowest - 1)})
    assert choose(4, low_time=0.51, **slow) == -3
    assert choose(4, low_time=0.49, **slow) == 4
    assert choose(4, low_time=0.51, **{**slow, "pedal": 0.01, "shaft": shaft(4, 70)}) == 3
    # The gear for starting waits 1.5 s longer, below which only a floored pedal goes.
    assert choose(2, low_time=0.51, **{**slow, "shaft": shaft(2, slowest - 1)}) == -1


def test_table_calls_for_a_lower_gear_at_its_speed_less_a_margin():
    # For gear 4 and half a pedal, 5.75 m/s by the table, here times three.
    limit = 3 * 5.75 - 0.55
    for strategy, speed, calls in ((2, limit - 0.01, 1), (2, limit + 0.01, 0), (0, limit, 0)):
        assert calls_for_lower(4, strategy, shaft=speed / RADIUS) == calls


def test_floored_pedal_that_loses_speed_calls_for_a_lower_gear():
    # Gear 4 at full torque, 2565 N m at 112 rad/s; the load is a tenth greater.
    engine_speed = 112.0
    full = 2565 * 1.8 * 0.931
    losing = {
        "pedal": 1,
        "shaft": shaft(4, engine_speed),
        "torque": full,
        "load": 1.1 * full,
        "engine": engine_speed,
        "acceleration": -0.01,
        "filtered_pedal": 1,
        "mass": 40e3,
    }
    assert calls_for_lower(4, **losing)
    # The torque has not built up, the gear carries the load, or the pedal is not floored.
    assert not calls_for_lower(4, **{**losing, "torque": 0.5 * full, "acceleration": 1e-3})
    assert not calls_for_lower(4, **{**losing, "load": 0.8 * full, "acceleration": 0.1})
    assert not calls_for_lower(4, **{**losing, "pedal": 0.69})
    # In gear 3 the governor would leave less torque.
    assert not calls_for_lower(4, **{**losing, "shaft": shaft(3, 215)})


def test_gear_that_holds_its_load_at_a_lower_speed_is_kept():
    """Gear 3 loses speed fast. Its torque rises by 1.5 % down to its lowest speed, 110 rad/s."""
    available = law("engine_pedal_torque", 128.0, 1.0) * 3.2 * 0.931
    losing = {
        "pedal": 1,
        "shaft": shaft(3, 128),
        "torque": available,
        "engine": 128,
        "acceleration": -7,
        "filtered_pedal": 1,
    }
    for share, calls in ((0.98, False), (1.01, False), (1.02, True)):
        assert calls_for_lower(3, load=share * available, **losing) == calls


def test_adaptive_strategy_cruises_in_the_gear_with_the_least_fuel():
    # It decides every 0.1 s.
    light = {"adaptive": 1, "pedal": 0.3, "load": 300, "gear_time": 10.0005}
    assert choose(3, shaft=shaft(3, 190), **light) > 3
    assert choose(3, shaft=shaft(3, 190), **{**light, "gear_time": 10.05}) == 3
    # Below idle the gears cannot be compared.
    assert choose(3, shaft=shaft(3, 60), **light) == 3
    # A load that only the present gear carries.
    assert choose(3, shaft=shaft(3, 190), **{**light, "load": 3500}) == 3


def test_adaptive_strategy_climbs_in_the_strongest_gear():
    climb = {"adaptive": 1, "pedal": 1, "gear_time": 10.0005, "mass": 40e3, "filtered_pedal": 1}
    # 100 rad/s in gear 4: gear 3 has 180 rad/s and 1.7 times the torque.
    torque = 2400 * 1.8 * 0.931
    assert choose(4, shaft=shaft(4, 100), load=6e3, torque=torque, **climb) == 3
    assert choose(4, shaft=shaft(4, 100), load=1e3, torque=torque, **climb) == 4


def test_gear_after_an_engine_at_its_governor_need_not_give_all_the_demanded_power():
    """It must carry the load when its torque has built up, as gear 4 does up to 3.82 kN m."""
    governed = {"adaptive": 1, "pedal": 1, "gear_time": 10.0005, "mass": 40e3, "filtered_pedal": 1}
    for load, gear in ((3800, 4), (3840, 3)):
        assert choose(3, shaft=shaft(3, 222), load=load, torque=250, **governed) == gear


EFFICIENCY, CHANGE, CUT = 0.98 * 0.95, 0.7, 0.15
ENGINE_INERTIA, GEAR_INERTIAS = 2.21, (0.15, 0.15, 0.15, 0.2, 0.46)


def work_ahead(gear, following, **changes):
    """Work within 30 s after a change to a gear, by the law and by short steps of the vehicle."""
    inputs, state = situation(changes)
    values = dict(zip(INPUT, inputs, strict=True))
    load, pedal, start = changes["load"], values["pedal"], values["shaft"]
    ratio, inertia = RATIOS[following - 1], values["mass"] * RADIUS**2
    speed, angle, left, h = start, 0.0, 30.0, 1e-3
    missing, building = 0.0, 0.0
    turning = inertia + ratio**2 * (ENGINE_INERTIA + GEAR_INERTIAS[following - 1])
    if following != gear:
        # The torque falls linearly during the cut, from that of a constant speed.
        speed -= (CHANGE - 0.5 * CUT) * load / inertia
        angle, left = 0.5 * CHANGE * (start + speed), left - CHANGE
        demand = law("engine_pedal_torque", ratio * speed, pedal)
        before = values["torque"] / (RATIOS[gear - 1] * EFFICIENCY)
        drag = float(np.interp(ratio * speed, [104.7, 254.5], [131, 200]))
        recovery = np.zeros(2)
        engine = [ratio * speed, *3 * [before + drag], 0, 0]
        law("engine_recovery", engine, CHANGE, demand, demand, drag, recovery)
        building = recovery[1]
        missing = recovery[0] / building
    while left > 0 and speed > 0:
        torque = law("engine_pedal_torque", ratio * speed, pedal) - (building > 0) * missing
        faster = max(0, speed + h * (torque * ratio * EFFICIENCY - load) / turning)
        angle += 0.5 * h * (speed + faster)
        speed, left, building = faster, left - h, building - h
    work = law("work_ahead", gear, inputs, state, following)
    return work, 0.5 * inertia * (speed**2 - start**2) + load * angle


@pytest.mark.parametrize(
    ("gear", "following", "engine_speed", "load"),
    [(4, 4, 120, 2000), (4, 4, 120, 5000), (4, 3, 110, 4500), (3, 4, 170, 1500), (4, 2, 60, 9000)],
)
def test_work_ahead_is_that_of_the_simulated_vehicle(gear, following, engine_speed, load):
    full = 2600 * RATIOS[gear - 1] * EFFICIENCY
    climb = {"pedal": 1, "mass": 40e3, "load": load, "shaft": shaft(gear, engine_speed)}
    law_work, work = work_ahead(gear, following, torque=full, **climb)
    assert law_work == pytest.approx(work, rel=0.02)


def test_gear_that_stalls_does_no_negative_work():
    """The vehicle stands from then on; it does not roll back within the horizon."""
    full = 2600 * RATIOS[3] * EFFICIENCY
    for load in (2e4, 5e4, 2e5):
        inputs = {"pedal": 1, "mass": 20e3, "load": load, "torque": full, "shaft": shaft(4, 80)}
        assert law("work_ahead", 4, *situation(inputs), 4) >= 0


def test_gear_holds_the_speed_at_which_its_torque_has_fallen_to_the_load():
    full, transmission = 2300, RATIOS[3] * EFFICIENCY
    climb = {"pedal": 1, "mass": 40e3, "torque": 2600 * transmission, "shaft": shaft(4, 130)}

    def held(load):
        return RATIOS[3] * law("held_speed", 4, *situation({**climb, "load": load}), 4)

    # Full load falls from 2450 N m at 167 rad/s to 1870 N m at 220 rad/s.
    speed = 167 + (2450 - full) / 580 * 53
    step = 0.01 * GOVERNED
    assert speed - step <= held(full * transmission) <= speed
    assert GOVERNED * 0.96 < held(100.0) < GOVERNED
    # At 130 rad/s it needs a reserve of 3 %.
    available = law("engine_pedal_torque", 130.0, 1.0) * transmission
    assert held(available / 1.031) > 130
    assert held(available / 1.029) == 0
