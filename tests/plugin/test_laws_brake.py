"""Laws of the air brake, each called alone."""

import math

import numpy as np
import pytest

from tests.plugin.laws_direct import law

# --- air supply and lines -------------------------------------------------------------------

RESERVOIRS = [0.03, 0.04, 0.05, 7.1e-5, 870e3, 1000e3, 480e3, 200e3]
ATMOSPHERE = 101325


def pump(pressures, pumping, engine_speed, h):
    state = np.array([*pressures, pumping], float)
    law("reservoir_pump", RESERVOIRS, engine_speed, h, state)
    return state


def test_compressor_runs_between_cut_in_and_cut_out():
    assert pump([900e3] * 3, 0, 100.0, 1.0) == pytest.approx([900e3, 900e3, 900e3, 0])
    one_low = pump([900e3, 860e3, 900e3], 0, 100.0, 1.0)
    assert one_low[3] == 1
    # It delivers its displacement of atmospheric air, shared in proportion to the deficits.
    air = np.dot(one_low[:3] - [900e3, 860e3, 900e3], RESERVOIRS[:3])
    assert air == pytest.approx(ATMOSPHERE * 7.1e-5 * 100)
    rise = one_low[:3] - [900e3, 860e3, 900e3]
    assert rise / rise[0] == pytest.approx([1, 1.4, 1])
    assert pump([900e3] * 3, 1, 100.0, 1.0)[0] > 900e3
    full = pump([999e3] * 3, 1, 300.0, 10.0)
    assert full == pytest.approx([1000e3, 1000e3, 1000e3, 0])
    assert pump([800e3] * 3, 1, -50.0, 1.0)[0] == 800e3
    # A pressure above the cut-out neither takes air nor lends it to the others.
    assert pump([1100e3, 800e3, 1000e3], 0, 100.0, 1.0)[[0, 2]] == pytest.approx([1100e3, 1000e3])


def test_drawn_air_lowers_the_pressure_of_its_circuit_down_to_zero():
    state = np.array([5e5, 6e5, 7e5, 0])
    law("reservoir_draw", RESERVOIRS, 1, 4000.0, state)
    assert state == pytest.approx([5e5, 5e5, 7e5, 0])
    law("reservoir_draw", RESERVOIRS, 0, 1e6, state)
    assert state == pytest.approx([0, 5e5, 7e5, 0])


def test_springs_apply_by_the_better_circuit_of_the_tractor_and_by_the_trailers():
    def springs(circuit, *pressures):
        return law("reservoir_springs", RESERVOIRS, circuit, [*pressures, 0])

    assert springs(0, 340e3, 0, 0) == springs(1, 0, 340e3, 0) == springs(2, 0, 0, 340e3) == 0.5
    assert springs(0, 0, 0, 900e3) == springs(2, 900e3, 900e3, 0) == 1
    assert springs(0, 100e3, 100e3, 0) == 1
    assert springs(0, 480e3, 0, 0) == springs(2, 0, 0, 600e3) == 0


@pytest.mark.parametrize("circuit", [0, 1, 2])
@pytest.mark.parametrize("h", [0.001, 0.004])
def test_line_delivers_a_ramp_after_its_dead_time(circuit, h):
    for time, delay in ((1.0, 0.2), (0.5, 0.35), (3.0, 0.01)):
        for longest in (delay, delay + 1):  # a line may be short beside a long one
            late = law("line_after_ramp", circuit, 1e5, time, delay, longest, h)
            assert late == pytest.approx(1e5 * (time - delay), rel=1e-9)
    assert law("line_after_ramp", circuit, 1e5, 0.1, 0.2, 0.2, h) == 0


def test_line_without_dead_time_delivers_the_present_pressure():
    for time in (0.002, 0.1, 1.0):
        assert law("line_after_ramp", 0, 1e5, time, 0.0, 0.2, 0.002) == pytest.approx(1e5 * time)


def test_line_knows_when_it_last_had_pressure():
    for circuit in range(3):
        assert law("line_last_used", circuit, 1e5, 0.4, 1.0, 0.01) == pytest.approx(0.4)
    assert law("line_last_used", 0, 0.0, 0.4, 1.0, 0.01) == 0


# --- wheel brake ----------------------------------------------------------------------------

PUSH_OUT, HYSTERESIS = 25e3, 15e3


def test_brake_torque_is_that_of_the_pressure_beyond_push_out_or_of_the_springs():
    assert law("wheel_torque", [4e5, 4e5, 0, 0, 0], 0.0) == pytest.approx(0.0276 * 375e3)
    assert law("wheel_torque", [0, 20e3, 0, 0, 0], 0.0) == 0
    assert law("wheel_torque", [0, 0, 0, 0, 0], 0.5) == pytest.approx(4500)
    assert law("wheel_torque", [4e5, 4e5, 0, 0, 0], 1.0) == pytest.approx(0.0276 * 375e3)


def test_chamber_takes_air_for_its_pressure_and_its_stroke():
    assert law("wheel_air", [4e5, 4e5, 0, 0, 0]) == pytest.approx(1.1e-3 * (4e5 + ATMOSPHERE))
    assert law("wheel_air", [10e3, 0, 0, 0, 0]) == pytest.approx(1.1e-3 * (10e3 + 0.4 * ATMOSPHERE))
    assert law("wheel_air", [0, 0, 0, 0, 0]) == 0


def test_stiffness_and_damping_of_the_brake_stay_in_the_stable_range():
    out = np.zeros(9)
    for stiffness, inertia, h in ((4e5, 25, 0.001), (4e5, 25, 0.01), (4e7, 25, 0.002)):
        law("wheel_rates", stiffness, float(inertia), h, out)
        k = min(stiffness, 0.4 * inertia / h**2)
        c = min(0.6 * math.sqrt(k * inertia), max(0, 0.7 * inertia / h - k * h))
        assert out[[0, 6, 7, 8]] == pytest.approx([h, k, c, 1 / (k * h + c)])
        lags = [1 - math.exp(-h / tau) for tau in (0.2, 0.14, 0.08, 0.01)]
        assert out[1:5] == pytest.approx(lags, rel=1e-3)


def test_gripping_brake_is_a_spring_and_damper_that_slips_at_its_capacity():
    h, k, wind_up = 0.001, 4e5, np.array([1e-3])
    c = 0.6 * math.sqrt(k * 25)
    torque = law("wheel_grip", 1e4, 0.1, h, wind_up)
    assert torque == pytest.approx(k * (1e-3 + h * 0.1) + c * 0.1)
    assert wind_up[0] == pytest.approx(1e-3 + h * 0.1)
    for sign in (1, -1):
        assert law("wheel_grip", 500.0, sign * 5.0, h, wind_up) == sign * 500
    # At rest the wind-up stays where spring and capacity are in balance.
    for _ in range(200):
        law("wheel_grip", 500.0, 5.0, h, wind_up)
    assert k * wind_up[0] < 500
    held = wind_up[0]
    assert law("wheel_grip", 500.0, 0.0, h, wind_up) == pytest.approx(k * held)
    assert wind_up[0] == pytest.approx(held)


def duty(slip, *, hub=10.0, pressure=3e5, slow=None, h=0.002):
    after = np.zeros(1)
    state = [pressure, pressure, 0, slip if slow is None else slow, pressure]
    return law("wheel_duty", state, hub, hub * (1 - slip) / 0.51, h, after), after[0]


def test_abs_fills_below_the_lower_slip_and_empties_above_the_upper_one():
    assert [duty(s)[0] for s in (0.0, 0.05, 0.1, 0.15, 0.2, 0.25, 0.5)] == pytest.approx(
        [1, 1, 0.5, 0, -0.5, -1, -1]
    )
    assert duty(0.5, hub=0.8)[0] == 1  # too slow
    assert duty(0.9, hub=1.25, slow=0.225)[0] == pytest.approx(1 - 0.5 * 1.75, abs=0.01)
    assert duty(0.5, pressure=20e3)[0] == 1  # the brake is released
    assert duty(0.1)[1] == pytest.approx(0.1)
    # Below 5 m/s the slip is over 5 m/s.
    assert duty(0.25, hub=2.5, slow=0.125)[0] == pytest.approx(0.25)


# Drag: begin, end, release and return times; traction likewise; lag, lead; low speed, hold time,
# range; brake speed and pressure.
SLIP_CONTROL = [0.08, 0.02, 0.3, 10, 0.1, 0.03, 0.3, 10, 0.02, 0.08, 5, 1, 0.3, 11.1, 5e5]


def relief(slips, *, speed=15.0, h=0.01):
    state = np.zeros(8)
    return np.array([law("drag_relief", SLIP_CONTROL, float(s), speed, h, state) for s in slips])


def test_slip_of_a_driven_wheel_is_positive_when_the_driveline_brakes_it():
    assert law("wheel_slip", 10.0, 9.0 / 0.51) == pytest.approx(0.1)
    assert law("wheel_slip", -10.0, -11.0 / 0.51) == pytest.approx(-0.1)
    # Below 5 m/s the slip is over 5 m/s.
    assert law("wheel_slip", 0.0, 0.5 / 0.51) == pytest.approx(-0.1)


def test_drag_goes_from_the_first_slip_to_the_second_and_returns_slowly():
    up = relief([0.079] + [0.09] * 30)
    # Its rate announces it within the first step.
    assert 0 < up[0] < 0.01 / 0.3
    assert np.diff(up[:30]) == pytest.approx(0.01 / 0.3)
    assert up[-1] == 1
    down = relief([0.09] * 40 + [*np.linspace(0.09, 0.03, 200)] + [0.01] * 100)
    assert down[239] == 1  # between the slips it goes on
    assert down[-1] == pytest.approx(1 - 0.01 / 10 * 100, abs=0.005)


def test_drag_is_taken_from_the_moment_at_which_the_slip_passes_the_first():
    # A slip that rises by 0.1 a second, with a lead of 0.08 s: 0.08 is passed at 0.72 s.
    for h in (0.001, 0.002, 0.005):
        share = relief(np.arange(0, 0.75, h) * 0.1, h=h)
        # The share holds from half a step after its step.
        since = (len(share) + 0.5) * h - 0.72
        assert share[-1] == pytest.approx(since / 0.3, abs=2e-3)


def test_steady_slip_below_the_first_does_not_take_the_drag():
    ramp = np.linspace(0, 0.07, 400)
    assert not relief(ramp).any()
    assert not relief([0.5] * 50, speed=4.9).any()
    assert relief([0.5] * 50, speed=-5.1).all()


def traction(slips, *, speed, steps=1, h=0.01):
    state = np.zeros(8)
    return [
        law("traction_cut", SLIP_CONTROL, slips, len(slips), speed, h, state) for _ in range(steps)
    ]


def test_traction_control_of_a_start_is_a_pi_control_of_the_mean_slip():
    cut = traction([-0.1, -0.5, -0.1, -0.3], speed=2.0, steps=101)
    error = (0.25 - 0.1) / 0.3
    assert cut[0] == pytest.approx(error + 0.01 * error)
    assert cut[100] == pytest.approx(min(1, 2.01 * error))
    assert traction([-0.1] * 4, speed=2.0, steps=3)[-1] == 0
    assert traction([-0.9] * 4, speed=2.0)[0] == 1


def test_traction_control_of_a_start_does_not_wind_up():
    state = np.zeros(8)
    # Slip, steps, and the cut at their end: the integral stays between 0 and 1.
    for spin, steps, cut in ((0.0, 1000, 0), (0.25, 1, 0.505), (0.9, 1000, 1), (0.07, 1, 0.899)):
        for _ in range(steps):
            last = law("traction_cut", SLIP_CONTROL, [-spin] * 4, 4, 2.0, 0.01, state)
        assert last == pytest.approx(cut)


def test_fastest_wheel_counts_above_the_speed_of_the_brakes():
    slips = [0.0, -0.08, 0.0, 0.0]
    mean = traction(slips, speed=10.0, steps=500)
    assert mean[-1] == 0
    assert traction(slips, speed=12.0, steps=50)[-1] == 1


def test_brakes_stop_the_wheel_that_spins_faster_than_the_slowest():
    slips = [0.0, -0.33, -0.18, -0.03]
    found = [law("traction_pressure", SLIP_CONTROL, slips, 4, s, 2.0) for s in slips]
    assert found == pytest.approx([0, 5e5, 2.5e5, 0])
    assert law("traction_pressure", SLIP_CONTROL, slips, 4, -0.33, 11.2) == 0
    # A slowest wheel that brakes does not count as spin of the others.
    dragged = [0.5, 0.0]
    assert law("traction_pressure", SLIP_CONTROL, dragged, 2, 0.0, 2.0) == 0


def test_rate_of_the_slip_damps_abs():
    value, slow = duty(0.15, slow=0.145)
    share = 1 - math.exp(-0.2)
    assert slow == pytest.approx(0.145 + share * 0.005, rel=1e-4)
    rate = (0.15 - 0.5 * (0.145 + slow)) / 0.01
    assert value == pytest.approx(-0.022 * rate / 0.1, rel=1e-6)


def test_steered_wheel_fills_slowly_beyond_the_other_while_abs_works_there():
    def rise(circuit, own, other, active):
        state, beside = [own, own, 0, 0, 0], [other, other, 0, 0, 0]
        return law("wheel_rise_max", circuit, state, beside, active, 0.002)

    assert rise(0, 3e5, 2e5, 0) == math.inf
    assert rise(1, 3e5, 2e5, 1) == math.inf
    assert rise(0, 4e5, 2e5, 1) == pytest.approx(100e3 * 0.002)
    assert rise(0, 1e5, 2e5, 1) == pytest.approx(1.5 * 2e5 + PUSH_OUT - 1e5)


def test_chamber_under_abs_refills_to_a_share_of_its_mean_pressure_and_then_by_pulses():
    def rise(pressure, mean, active):
        state = [pressure, pressure, active, 0, mean]
        return law("wheel_rise_max", 1, state, [0, 0, 0, 0, 0], 0, 0.002)

    pulses = 0.002 * (2e5 + PUSH_OUT) / 1.0
    assert rise(1e5, 2e5, 0) == math.inf
    assert rise(1e5, 2e5, 1) == pytest.approx(0.9 * 2e5 - 1e5 + pulses)
    assert rise(2e5, 2e5, 1) == pytest.approx(pulses)


def test_abs_is_active_from_a_release_until_the_supply_pressure_is_reached():
    def active(supply, share, pressure, was):
        return law("wheel_active", supply, share, [pressure, pressure, was, 0, 0])

    assert active(4e5, -0.1, 3e5, 0)
    assert not active(4e5, 0.5, 3e5, 0)
    assert active(4e5, 0.5, 4e5, 1)
    assert active(4e5, 1.0, 3e5, 1)
    assert not active(4e5, 1.0, 3.8e5, 1)


def update(supply, state, *, rise_max=math.inf, share=1.0, h=0.01):
    state = np.array(state, float)
    law("wheel_update", supply, rise_max, share, h, state)
    return state[:2]


def test_chamber_fills_and_empties_with_its_lags_and_behind_its_hysteresis():
    fill, empty = 1 - math.exp(-0.05), 1 - math.exp(-0.01 / 0.14)
    assert update(5e5, [1e5, 1e5, 0, 0, 0]) == pytest.approx(1e5 + 4e5 * fill, rel=1e-4)
    half = update(5e5, [1e5, 1e5, 0, 0, 0], share=0.5)
    assert half == pytest.approx(1e5 + 2e5 * fill, rel=1e-4)
    assert update(5e5, [1e5, 1e5, 0, 0, 0], rise_max=1e3) == pytest.approx(101e3)
    pressure, effective = update(0.0, [4e5, 4e5, 0, 0, 0])
    assert pressure == pytest.approx(4e5 * (1 - empty), rel=1e-3)
    assert effective == pytest.approx(pressure + HYSTERESIS)
    assert update(390e3, [4e5, 4e5, 0, 0, 0])[1] == pytest.approx(4e5)
    released = update(5e5, [4e5, 4e5, 0, 0, 0], share=-0.5)
    assert released[0] == pytest.approx(4e5 * (1 - 0.5 * (1 - math.exp(-0.01 / 0.08))), rel=1e-3)
    assert not update(0.0, [20.0, 2000.0, 0, 0]).any()
    assert update(100.0, [20.0, 2000.0, 0, 0])[1] > 20


# --- brake control --------------------------------------------------------------------------

CONTROL = {
    "rise_rate": 5e6,
    "fall_rate": 4e6,
    "pressure_max": 850e3,
    "release_rate": 5,
    "pedal_deceleration": 10,
    "rolling_resistance": 0.006,
    "filter_time": 0.3,
    "trim_gain": 0.8,
    "trim_max": 0.4,
    "trim_share": 0.3,
    "trim_speed_min": 2,
    "shaft_speed_off": 4,
    "shaft_speed_on": 7,
    "endurance_rate": 0.5,
    "hysteresis": 15e3,
    "hysteresis_time": 0.1,
    "hold_speed": 0.3,
    "hold_deceleration": 1.6,
    "hold_release_speed": 1,
    "hold_time_max": 5,
    "hold_uphill": 0.05,
}
ORDER = [
    "rise_rate",
    "fall_rate",
    "pressure_max",
    "release_rate",
    "pedal_deceleration",
    "rolling_resistance",
    "filter_time",
    "trim_gain",
    "trim_max",
    "trim_share",
    "trim_speed_min",
    "shaft_speed_off",
    "shaft_speed_on",
    "endurance_rate",
    "hysteresis",
    "hysteresis_time",
    "hold_speed",
    "hold_deceleration",
    "hold_release_speed",
    "hold_time_max",
    "hold_uphill",
]
DEMAND = {
    "xbr": 0,
    "pedal": 0,
    "xbr_mode": 2,
    "ebi": 0,
    "speed": 15,
    "mass": 25e3,
    "gravity": 9.81,
    "abs": 0,
    "abs_on_drive": 0,
    "shaft": 0,
    "shaft_max": 0,
    "uphill": 0,
    "reservoir": 1e6,
}
STATES = (
    *("initialized", "supply", "supply1", "supply2", "chamber", "chamber1", "chamber2"),
    *("effective", "effective1", "effective2", "lowering", "lowering1", "lowering2"),
    *("speed", "reference", "reference1", "xbr", "trim", "shaft", "shaft_max", "asked"),
    *("holding", "hold_time"),
)
SLOPE = 2 * 0.05 / 0.5  # force of a circuit per pressure
SPIN = 6 * 25 / 0.25  # mass of the wheels' inertia
RESPONSE = 0.3


def control(steps=1, *, h=0.01, start=None, effort=False, changes=None, **demand):
    """Runs the control at constant inputs; returns the state by name, or the shaft's demand."""
    state, out = np.zeros(len(STATES)), np.zeros(2)
    for name, value in (start or {}).items():
        state[STATES.index(name)] = value
    attributes = [{**CONTROL, **(changes or {})}[name] for name in ORDER]
    for _ in range(steps):
        law("brake_update", attributes, list({**DEMAND, **demand}.values()), h, state, out)
    return out if effort else dict(zip(STATES, state, strict=True))


def force(deceleration, mass=25e3):
    return (mass + SPIN) * deceleration - 0.006 * mass * 9.81


def pressures(friction, shaft=0.0, deceleration=0.0, mass=25e3):
    out = np.zeros(3)
    law("brake_pressures", list(CONTROL.values()), friction, shaft, deceleration, mass, out)
    return out


def test_force_is_shared_by_deceleration_and_mass():
    for deceleration, mass, shares in (
        (0, 10e3, [0.5, 0.3, 0.2]),
        (10, 10e3, [0.6, 0.2, 0.2]),
        (0, 40e3, [0.3, 0.4, 0.3]),
        (5, 25e3, [0.45, 0.3, 0.25]),
        (0, 5e3, [0.5, 0.3, 0.2]),
        (0, 60e3, [0.3, 0.4, 0.3]),
    ):
        expected = PUSH_OUT + 1e5 * np.array(shares) / SLOPE
        assert pressures(1e5, 0.0, float(deceleration), float(mass)) == pytest.approx(expected)


def test_braking_of_the_shaft_is_deducted_from_the_driven_wheels():
    # Of 100 kN in all, the shaft gives 20; friction on the driven wheels gives 30 - 20.
    expected = PUSH_OUT + 1e5 * np.array([0.5, 0.1, 0.2]) / SLOPE
    assert pressures(8e4, 2e4, 0.0, 10e3) == pytest.approx(expected)
    assert pressures(5e4, 5e4, 0.0, 10e3)[1] == PUSH_OUT
    assert pressures(8e4, -2e4, 0.0, 10e3)[1] == pytest.approx(PUSH_OUT + 8e4 * 0.3 / SLOPE)
    assert pressures(0.0, 0.0) == pytest.approx(PUSH_OUT)


def test_demand_in_motion_becomes_the_pressures_of_its_force():
    friction = force(3)
    s = control(100, xbr=3, speed=15, start={"initialized": 1, "speed": 15 + 0.9}, h=0.001)
    # No trim yet, for the reference lags; the state has a deceleration of about 3 m/s2.
    expected = pressures(friction + (25e3 + SPIN) * s["trim"], 0.0, 3 + s["trim"])
    assert [s["supply"], s["supply1"], s["supply2"]] == pytest.approx(expected, rel=1e-3)


def test_supply_valves_have_rate_limits_and_the_reservoirs_pressure():
    assert control(xbr=9)["supply"] == pytest.approx(5e4)
    assert control(200, xbr=9, reservoir=3e5, speed=20)["supply"] == 3e5
    assert control(200, xbr=90, reservoir=1e6, speed=20)["supply"] == 850e3
    released = control(xbr=0, xbr_mode=0, start={"initialized": 1, "supply": 5e5, "speed": 15})
    assert released["supply"] == pytest.approx(5e5 - 4e4)


def test_driver_and_xbr_add_up_or_the_greater_one_counts():
    def wanted(**demand):
        s = control(300, h=0.01, speed=15, changes={"trim_gain": 0}, **demand)
        total = SLOPE * sum(s[f"supply{i}"] - PUSH_OUT for i in ("", 1, 2))
        return (total + 0.006 * 25e3 * 9.81) / (25e3 + SPIN)

    assert wanted(xbr=2, pedal=0.1, xbr_mode=1) == pytest.approx(3, rel=1e-6)
    assert wanted(xbr=2, pedal=0.1, xbr_mode=2) == pytest.approx(2, rel=1e-6)
    assert wanted(xbr=2, pedal=0.3, xbr_mode=2) == pytest.approx(3, rel=1e-6)
    assert wanted(xbr=2, pedal=0.3, xbr_mode=0) == pytest.approx(3, rel=1e-6)
    assert control(xbr=0, pedal=0.009)["supply"] == 0


def test_xbr_demand_ends_gradually_in_motion_and_at_once_at_rest():
    start = {"initialized": 1, "xbr": 3, "speed": 15}
    assert control(xbr=0, start=start)["xbr"] == pytest.approx(2.95)
    assert control(xbr=4, start=start)["xbr"] == 4
    assert control(xbr=0, speed=0.2, start=start)["xbr"] == 0
    assert control(xbr=3, xbr_mode=0, speed=-5, start=start)["xbr"] == pytest.approx(2.95)


def hold(steps=1, **demand):
    start = demand.pop("start", {})
    return control(steps, h=0.1, start={"initialized": 1, "holding": 1, **start}, **demand)


def test_brakes_hold_a_stopped_vehicle():
    stopped = control(xbr=2, speed=0.2, start={"initialized": 1, "hold_time": 3})
    assert (stopped["holding"], stopped["hold_time"]) == (1, 0)
    assert control(xbr=2, speed=0.4)["holding"] == 0
    assert control(xbr=0, speed=0.0)["holding"] == 0
    assert hold(xbr=2, speed=-1.1)["holding"] == 0
    # Afterwards only on an upgrade: 0.05 m/s2 times the mass, at the mean radius.
    uphill = 0.05 * 25e3 * 0.5
    assert hold(speed=0, uphill=1.01 * uphill)["holding"] == 1
    assert hold(speed=0, uphill=0.99 * uphill)["holding"] == 0
    assert hold(10, speed=0, uphill=2 * uphill)["hold_time"] == pytest.approx(1)
    assert hold(speed=0, uphill=2 * uphill, start={"hold_time": 5})["holding"] == 0
    assert hold(speed=0, uphill=2 * uphill, shaft=1.01 * 0.05 * 25e3)["holding"] == 0
    assert hold(speed=0, uphill=2 * uphill, shaft=0.99 * 0.05 * 25e3)["holding"] == 1
    held = hold(30, speed=0, uphill=2 * uphill, shaft_max=0)
    expected = pressures(force(1.6))
    assert [held["supply"], held["supply1"]] == pytest.approx(expected[:2], rel=1e-6)


def test_shaft_brakes_first_and_friction_gives_the_rest():
    quiet = {"trim_gain": 0}
    demand = {"xbr": 2, "speed": 15, "shaft": 15e3, "shaft_max": 3e4}
    for ebi in (0, 2):
        s = control(400, ebi=ebi, changes=quiet, **demand)
        expected = pressures(force(2) - 15e3, 15e3, 2.0)
        assert [s["supply"], s["supply1"]] == pytest.approx(expected[:2], rel=1e-5)
    # The endurance brakes alone: the brakes stay released, the shaft is asked for all.
    alone = {**demand, "ebi": 1, "changes": quiet}
    assert control(400, **alone)["supply"] == 0
    assert control(400, effort=True, **alone) == pytest.approx([force(2), 1])
    # A driver's demand still gets friction, up to its own deceleration.
    both = control(400, pedal=0.2, **alone)
    assert both["supply"] == pytest.approx(pressures(force(2) - 15e3, 15e3, 2.0)[0], rel=1e-5)
    strong = control(400, pedal=0.05, **{**alone, "shaft": 0.0, "xbr": 3})
    assert strong["supply"] == pytest.approx(pressures(force(0.5), 0.0, 3.0)[0], rel=1e-5)


def test_demand_on_the_shaft_fades_near_walking_speed_and_ends_under_abs():
    def asked(**demand):
        effort = control(
            3000, effort=True, xbr=2, shaft_max=1e6, changes={"trim_gain": 0}, **demand
        )
        return effort[0] / force(2)

    assert asked(ebi=2, speed=15) == pytest.approx(1)
    assert asked(ebi=2, speed=5.5) == pytest.approx(0.5)
    assert asked(ebi=2, speed=3.9) == 0
    assert asked(ebi=1, speed=3.9) == pytest.approx(1)
    assert asked(ebi=0, speed=15) == 0
    assert asked(ebi=2, speed=15, abs=1) == 0


@pytest.mark.parametrize("ebi", [0, 1, 2])
def test_deceleration_that_rolling_resistance_gives_needs_no_brake(ebi):
    less = {"xbr": 0.5 * 0.006 * 9.81, "ebi": ebi, "shaft_max": 1e5, "changes": {"trim_gain": 0}}
    assert control(200, effort=True, **less) == pytest.approx([0, 1])
    assert control(200, **less)["supply"] == pytest.approx(0 if ebi == 1 else PUSH_OUT)


def test_demand_on_the_shaft_rises_no_faster_than_friction_can_fall():
    effort = control(1, effort=True, xbr=2, ebi=2, shaft_max=1e6)
    assert effort == pytest.approx([0.5 * 25e3 * 0.01, 1])
    start = {"initialized": 1, "asked": 3e4, "speed": 15}
    capped = control(1, effort=True, xbr=2, ebi=2, shaft_max=1e4, start=start)
    assert capped[0] == pytest.approx(1e4 + 125)
    assert control(1, effort=True, xbr=2, ebi=1, shaft_max=1e6)[0] == pytest.approx(force(2))
    assert control(1, effort=True, xbr=0) == pytest.approx([0, 0])


def test_force_of_the_shaft_is_extrapolated_by_the_response_time():
    # It falls from 10 to 9 kN: friction expects 8 kN.
    start = {"initialized": 1, "shaft": 10e3, "shaft_max": 5e4, "speed": 15, "supply": 50e3}
    s = control(1, xbr=2, shaft=9e3, shaft_max=5e4, start={**start}, changes={"trim_gain": 0})
    assert s["shaft"] == pytest.approx(10e3 - 1e3 * 0.01 / 0.31)
    slow = control(
        1, xbr=2, shaft=9e3, shaft_max=5e4, start=start, changes={"rise_rate": 1e12, "trim_gain": 0}
    )
    assert slow["supply"] == pytest.approx(pressures(force(2) - 8e3, 8e3, 2.0)[0], rel=1e-6)
    # The greatest force falls as well, from 10 to 6 kN: 2 kN are expected.
    start = {"initialized": 1, "shaft": 9e3, "shaft_max": 10e3, "speed": 15}
    less = control(
        1, xbr=2, shaft=9e3, shaft_max=6e3, start=start, changes={"rise_rate": 1e12, "trim_gain": 0}
    )
    assert less["supply"] == pytest.approx(pressures(force(2) - 2e3, 2e3, 2.0)[0], rel=1e-6)


def test_shaft_that_is_expected_to_give_nothing_leaves_all_to_friction():
    # Its greatest force falls from 10 to 1 kN, which would be -8 kN after the response time.
    start = {"initialized": 1, "shaft": 9e3, "shaft_max": 10e3, "speed": 15}
    quick = {"rise_rate": 1e12, "trim_gain": 0}
    s = control(1, xbr=2, shaft=9e3, shaft_max=1e3, start=start, changes=quick)
    assert s["supply"] == pytest.approx(pressures(force(2), 0.0, 2.0)[0], rel=1e-6)


def trim(*, deceleration=0.0, reference=1.0, speed=15.0, h=0.01, old=0.0, **demand):
    """The trim after one step in which the filtered deceleration and the reference are given."""
    start = {
        "initialized": 1,
        "speed": speed + deceleration * (0.3 + h),
        "trim": old,
        "reference": reference,
        "reference1": reference,
        "supply": 2e5,
        "supply1": 2e5,
        "supply2": 2e5,
        **demand.pop("start", {}),
    }
    return control(1, h=h, start=start, **{"xbr": 1, "speed": speed, **demand})


def test_trim_integrates_the_deficit_of_deceleration():
    s = trim(deceleration=0.8)
    assert s["reference"] == pytest.approx(1)
    assert s["trim"] == pytest.approx(0.01 * 0.8 * 0.2)
    assert s["speed"] == pytest.approx(15 + 0.8 * 0.31 - 0.8 * 0.01)
    assert trim(deceleration=1.2)["trim"] == pytest.approx(-0.01 * 0.8 * 0.2)
    assert trim(speed=1.9)["trim"] == 0
    # Brakes at their limit, or released.
    assert trim(reservoir=30e3)["trim"] == 0
    assert (
        trim(shaft=1e5, shaft_max=1e5, deceleration=2.0, start={"shaft": 1e5, "shaft_max": 1e5})[
            "trim"
        ]
        == 0
    )
    assert trim(shaft=1e5, shaft_max=1e5, start={"shaft": 1e5, "shaft_max": 1e5})["trim"] > 0


def test_trim_is_bounded_by_a_constant_and_a_share_of_the_demand_and_by_the_demand():
    for wanted, bound in ((0.2, 0.2), (1.0, 0.7), (3.0, 1.3)):
        assert trim(xbr=wanted, old=9.0)["trim"] == pytest.approx(bound)
        assert trim(xbr=wanted, old=-9.0)["trim"] == pytest.approx(-bound)
    assert trim(xbr=0, xbr_mode=0, old=0.5, start={"xbr": 0})["trim"] == 0


def test_reference_follows_the_demand_as_far_as_the_supply_gives_it():
    start = {"supply": 0, "supply1": 0, "supply2": 0}
    slow = trim(reference=0.0, xbr=1, start=start, changes={"rise_rate": 1e6})
    share = 1e4 / pressures(force(1), 0.0, 1.0)[0]
    assert slow["reference"] == pytest.approx(share * 0.01 / 0.31, rel=1e-6)
    assert slow["reference1"] == pytest.approx(slow["reference"] * 0.01 / 0.31)
    # Under ABS the reference is no more than the deceleration.
    held = trim(abs=1, reference=3.0, deceleration=0.6)
    assert (held["reference"], held["reference1"]) == pytest.approx((0.6, 0.6))
    assert held["trim"] == 0
    assert trim(abs=1, reference=0.2, deceleration=0.6)["reference1"] < 0.3


def test_supply_falls_below_its_target_by_the_hysteresis_of_the_brakes():
    quiet = {"trim_gain": 0, "rolling_resistance": 0, "fall_rate": 1e9}
    target = pressures((25e3 + SPIN) * 1.0, 0.0, 1.0)[0]
    start = {"initialized": 1, "speed": 15, "supply": target + 5e3, "chamber": target + 5e3}
    start["effective"] = target + 5e3
    first = control(1, xbr=1, start=start, changes=quiet)
    assert first["lowering"] == pytest.approx(5e3 / 15e3 * 0.01 / 0.1)
    assert first["supply"] == pytest.approx(target - first["lowering"] * 15e3)
    chamber = target + 5e3 + (first["supply"] - target - 5e3) * 0.01 / 0.31
    assert first["chamber"] == pytest.approx(chamber)
    assert first["effective"] == pytest.approx(target + 5e3)
    later = control(300, xbr=1, start=start, changes=quiet)
    assert later["effective"] == pytest.approx(target, abs=20)
    # An increasing demand is followed at once, beyond a tenth of the hysteresis.
    for below, lowering in ((1.6e3, 0), (1.4e3, 0.5)):
        low = {**start, "chamber": target - 10e3, "effective": target - below, "lowering": 0.5}
        assert control(1, xbr=1, start=low, changes=quiet)["lowering"] == lowering
    full = {**start, "effective": target + 15e3, "chamber": target + 1e3, "lowering": 0.99}
    assert control(1, xbr=1, start=full, changes=quiet)["lowering"] == 1


def test_engaged_brakes_wait_at_the_push_out_pressure():
    # The shaft gives all: the supply stands at push-out, without lowering.
    s = control(300, xbr=1, shaft=1e5, shaft_max=1e5)
    assert [s[n] for n in ("supply", "supply1", "supply2")] == pytest.approx([PUSH_OUT] * 3)
    assert s["lowering"] == 0
