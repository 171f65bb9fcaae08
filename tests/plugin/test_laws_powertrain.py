"""Laws of engine, driveline, retarder and endurance brakes, each called alone.

The engine is that of laws_truck.h: idle 62.8 rad/s, governed 219.9 rad/s with a droop of 4 %.
"""

import numpy as np
import pytest

from tests.plugin.laws_direct import law

IDLE, GOVERNED, DROOP = 62.8, 219.9, 0.04
RISE, RISE_LOW, FALL, FALL_LOW = 300, 2000, 800, 3000  # [N m/s]
THRESHOLD, FALL_THRESHOLD = 220, 150
LAG, SPOOL, REFERENCE = 0.4, 3, 2700


def drag(speed):
    return float(np.interp(speed, [104.7, 254.5], [131, 200]))


def full(speed):
    return float(np.interp(speed, [62.8, 105, 167, 220], [1400, 2580, 2450, 1870]))


def limit(speed):
    governor = min(max((GOVERNED - speed) / (DROOP * GOVERNED), 0), 1)
    return governor * (full(speed) + drag(speed)) - drag(speed)


def brake_max(speed):
    if speed <= 85:
        return 0
    return min(1, (speed - 85) / 20) * 350e3 / 240.9 * (speed / 240.9) ** 0.4


@pytest.mark.parametrize("speed", [60.0, 90.0, 130.0, 200.0, 214.0, 219.0, 230.0])
def test_engine_has_its_curves_with_the_governors_droop_and_the_fading_brake(speed):
    point = np.zeros(5)
    law("engine_at", speed, point)
    assert point == pytest.approx([speed, drag(speed), limit(speed), brake_max(speed), 0], rel=1e-5)


def test_pedal_demands_its_share_of_the_map_between_drag_and_limit():
    assert law("engine_pedal_torque", 130.0, 0.0) == pytest.approx(-drag(130))
    # The map is linear from pedal 0 to 0.5 and in the speed.
    s = (130 - 60) / 160
    wanted = 0.25 / 0.5 * ((1 - s) * 1900 + s * 50)
    assert law("engine_pedal_torque", 130.0, 0.25) == pytest.approx(wanted)
    assert law("engine_pedal_torque", 130.0, 1.0) == pytest.approx(limit(130))
    # Within the first 5 % of travel, from the drag on.
    wanted = 0.025 / 0.5 * ((1 - s) * 1900 + s * 50)
    torque = 0.5 * (wanted + drag(130)) - drag(130)
    assert law("engine_pedal_torque", 130.0, 0.025) == pytest.approx(torque)


def test_fuel_follows_the_map_the_willans_line_and_the_overrun():
    def rate(torque, speed=126.0):
        return law("engine_fuel_rate", [speed, torque + drag(speed), 0, 0, 0, 0])

    assert rate(1170.0) == pytest.approx(5.1e-8 * 1170 * 126)
    assert rate(117.0, 73.0) == pytest.approx(9.8e-8 * 117 * 73)
    no_load = 0.0006 * 126 / IDLE
    assert rate(0.0) == pytest.approx(no_load)
    assert rate(58.5) == pytest.approx((no_load + 8.6e-8 * 117 * 126) / 2)
    assert rate(-0.5 * drag(126)) == pytest.approx(no_load / 2)
    assert rate(-drag(126)) == 0


PEDAL, CUT, SPEED = 0, 1, 2
STATES = ("speed", "torque", "boost_demand", "boost", "integral", "brake")


def engine(*, mode=PEDAL, h=0.01, steps=1, request=None, **state):
    """The engine's state after some steps at constant speed and request."""
    r = {
        "pedal": 0,
        "brake": 0,
        "left": 0,
        "target": 0,
        "inertia": 2.5,
        "limited": 0,
        "torque": 0,
        **(request or {}),
    }
    start = {**dict.fromkeys(STATES, 0), "speed": 130, **state}
    values = np.array([start[name] for name in STATES], float)
    for _ in range(steps):
        law("engine_update", [mode, *r.values()], h, values)
    return dict(zip(STATES, values, strict=True))


def test_torque_rises_at_the_rate_of_the_unboosted_engine_and_falls_at_its_rates():
    warm = {"boost_demand": 3000, "boost": 3000}
    up = engine(request={"torque": 2000}, torque=500, **warm)
    assert up["torque"] == pytest.approx(500 + RISE_LOW * 0.01)
    down = engine(request={"torque": 0}, torque=1500, **warm)
    assert down["torque"] == pytest.approx(1500 - FALL * 0.01)
    assert engine(torque=149, request={"torque": -drag(130)})["torque"] == pytest.approx(149 - 30)
    # A cut by the brakes is faster: the reference torque within 0.15 s.
    cut = engine(request={"torque": 0, "limited": 1}, torque=1500, **warm)
    assert cut["torque"] == pytest.approx(1500 - REFERENCE / 0.15 * 0.01)
    assert engine(request={"torque": 2000}, steps=3000)["torque"] == pytest.approx(2000 + drag(130))
    high = engine(request={"torque": 9000}, steps=3000)
    assert high["torque"] == pytest.approx(limit(130) + drag(130))
    assert engine(request={"torque": 9000}, torque=9999, **warm)["torque"] == pytest.approx(
        limit(130) + drag(130)
    )


def test_charge_pressure_follows_the_demand_within_its_rate_behind_its_lag():
    demand = 1000 + drag(130)
    s = engine(request={"torque": 1000}, boost_demand=600, boost=500, torque=500)
    rise = max(RISE, (demand - 600) / SPOOL) * 0.01
    assert s["boost_demand"] == pytest.approx(600 + rise)
    assert s["boost"] == pytest.approx(500 + (100 + rise) * 0.01 / 0.41)
    assert s["torque"] == pytest.approx(min(s["boost"], 500 + RISE_LOW * 0.01))
    big = engine(request={"torque": 2300}, boost_demand=600, boost=600)
    assert big["boost_demand"] == pytest.approx(600 + (2300 + drag(130) - 600) / SPOOL * 0.01)
    fall = engine(request={"torque": 0}, boost_demand=2000, boost=2000)
    assert fall["boost_demand"] == pytest.approx(2000 - FALL_LOW * 0.01)
    assert fall["boost"] == pytest.approx(2000 - FALL_LOW * 0.01 * 0.01 / 0.41)
    # Without charge the engine still has the torque of its free breathing.
    low = engine(request={"torque": 2000})
    assert low["boost_demand"] > THRESHOLD
    assert low["boost"] >= THRESHOLD
    assert engine(mode=SPEED, boost_demand=300, boost=300, steps=1500)["boost"] == pytest.approx(
        220
    )


def test_idle_governor_is_proportional_and_integral_near_idle_and_forgets_elsewhere():
    s = engine(speed=60, request={"torque": -drag(60)}, integral=50)
    assert s["integral"] == pytest.approx(50 + 0.01 * 30 * 2.8)
    far = engine(speed=90, integral=50)
    assert far["integral"] == pytest.approx(50 - 50 * 0.01 / 0.21)
    assert engine(speed=55, integral=399.9)["integral"] == 400
    assert engine(speed=70, integral=-99.9)["integral"] == -100
    # 2 rad/s too slow: drag, 40 N m and the integral.
    slow = engine(speed=60.8, integral=100, torque=1e3, request={"torque": -drag(60.8)}, steps=1)
    assert slow["torque"] == pytest.approx(1e3 - FALL * 0.01)
    torques = engine(
        speed=60.8, integral=0, torque=271, boost=1e3, request={"torque": -131}, h=0.001
    )
    wanted = drag(60.8) + 20 * 2 + 0.001 * 30 * 2
    assert torques["torque"] == pytest.approx(max(wanted, 271 - FALL * 0.001))
    settled = engine(speed=60.8, torque=171.5, boost=1e3, request={"torque": -131}, h=0.001)
    assert settled["torque"] == pytest.approx(wanted)
    assert engine(speed=100, request={"torque": -131}, steps=300)["torque"] == 0


def test_torque_is_cut_to_zero_at_the_end_of_the_time_left():
    cut = engine(mode=CUT, request={"left": 0.1}, torque=1000)
    assert cut["torque"] == pytest.approx(900)
    assert engine(mode=CUT, request={"left": 0.001}, torque=1000)["torque"] == 0
    assert engine(mode=CUT, request={"left": -1}, torque=1000)["torque"] == 0


def test_engine_brake_acts_with_the_pedal_up_and_releases_faster():
    braking = engine(request={"brake": 0.5, "pedal": 0.01}, brake=100)
    assert braking["brake"] == pytest.approx(
        100 + (0.5 * brake_max(130) - 100) * 0.01 / 0.26, rel=1e-4
    )
    for request, mode in (({"brake": 0.5, "pedal": 0.02}, PEDAL), ({"brake": 0.5, "left": 1}, CUT)):
        released = engine(request=request, mode=mode, brake=100)
        assert released["brake"] == pytest.approx(100 - 100 * 0.01 / 0.06)
    # Off at once where the engine is too slow for it.
    assert engine(speed=80, request={"brake": 1}, brake=100)["brake"] == 0
    assert engine(request={}, brake=0)["brake"] == 0


def test_free_engine_is_brought_to_the_speed_of_the_new_gear():
    def synchronized(target):
        return engine(mode=SPEED, request={"target": target, "inertia": 2.5}, integral=9)

    up = synchronized(131)
    assert up["torque"] == pytest.approx(2.5 * 1 / 0.09 + drag(130))
    assert (up["brake"], up["integral"]) == (0, 0)
    assert synchronized(200)["torque"] == pytest.approx(0.3 * REFERENCE)
    down = synchronized(120)
    assert down["torque"] == 0
    assert down["brake"] == pytest.approx(2.5 * 10 / 0.09 - drag(130))
    assert synchronized(60)["brake"] == pytest.approx(0.4 * brake_max(130), rel=1e-4)


@pytest.mark.parametrize(
    ("before", "demand", "level"),
    [(500, 2000, 1500), (500, 900, 800), (1500, 2300, 2300), (800, 2000, 900)],
)
def test_recovery_after_a_pause_is_that_of_the_simulated_engine(before, demand, level):
    friction, pause = drag(130), 0.9
    out = np.zeros(2)
    law("engine_recovery", settled(before), pause, float(demand), float(level), friction, out)
    impulse, time = integrate(before, demand, level, pause)
    assert out[0] == pytest.approx(impulse, rel=0.13)
    assert out[1] == pytest.approx(time, rel=0.15, abs=0.3) or level == demand


@pytest.mark.parametrize(("before", "demand", "level"), [(500, 2000, 1500), (500, 900, 800)])
def test_build_up_of_the_torque_is_that_of_the_simulated_engine(before, demand, level):
    out = np.zeros(2)
    law("engine_recovery", settled(before), 0.0, float(demand), float(level), drag(130), out)
    impulse, time = integrate(before, demand, level, 0)
    assert out[0] == pytest.approx(impulse, rel=0.1)
    assert out[1] == pytest.approx(time, rel=0.1)


def settled(torque):
    """Returns the engine at 130 rad/s that has given a torque for long."""
    indicated = torque + drag(130)
    return np.array([130, indicated, indicated, indicated, 0, 0], float)


def integrate(before, demand, level, pause, h=1e-3):
    """Missing impulse and time until the torque reaches `level`, from the engine's own steps."""
    friction = drag(130)
    values = settled(before)
    for _ in range(round(pause / h)):
        law("engine_update", [CUT, 0, 0, 0, 0, 2.5, 0, 0], h, values)
    impulse = time = 0.0
    while values[1] - friction < 0.999 * level and time < 20:
        law("engine_update", [PEDAL, 1, 0, 0, 0, 2.5, 0, demand], h, values)
        impulse += h * max(level + friction - values[1], 0)
        time += h
    return impulse, time


def test_build_up_is_quicker_while_the_charge_is_ahead_of_its_pressure():
    """The demand of a ramp leads the pressure by the lag. A steady engine has no lead."""
    rising, out, steady = settled(1000), np.zeros(2), np.zeros(2)
    rising[2] += 120
    for state, found in ((rising, out), (settled(1000), steady)):
        law("engine_recovery", state, 0.0, 2400.0, 2000.0, drag(130), found)
    assert 0 < out[0] < steady[0]
    assert 0 < out[1] < steady[1]


def test_torque_up_to_a_level_needs_a_demand_of_at_least_that_level():
    for pause in (0.9, 0.0):
        low, exact = np.zeros(2), np.zeros(2)
        law("engine_recovery", settled(500), pause, 300.0, 1500.0, drag(130), low)
        law("engine_recovery", settled(500), pause, 1500.0, 1500.0, drag(130), exact)
        assert low.tolist() == exact.tolist()
        assert low.min() > 0


def test_no_torque_needs_no_recovery():
    out = np.ones(2)
    law("engine_recovery", settled(500), 0.9, 1000.0, 0.0, drag(130), out)
    assert not out.any()
    law("engine_recovery", settled(1000), 0.0, 1000.0, 900.0, drag(130), out)
    assert not out.any()


# --- driveline ------------------------------------------------------------------------------


def test_clutch_is_a_spring_and_damper_that_slips_at_its_capacity():
    state, h = np.array([0.01, 101.0]), 0.002
    torque = law("clutch_step", 6e4, 6e2, 200.0, 2.5, 100.0, 5e3, h, state)
    free = 101 + h * 200 / 2.5
    gain = 6e4 * h + 6e2
    assert torque == pytest.approx((6e4 * 0.01 + gain * (free - 100)) / (1 + gain * h / 2.5))
    assert state[1] == pytest.approx(free - h * torque / 2.5)
    assert state[0] == pytest.approx((h * torque + 6e2 * 0.01) / gain)
    # The torque is that of the speed at the step's end.
    assert torque == pytest.approx(6e4 * state[0] + 6e2 * (state[0] - 0.01) / h)
    for sign in (1, -1):
        state = np.array([0.0, 100.0])
        assert (
            law("clutch_step", 6e4, 6e2, 0.0, 2.5, 100 - sign * 50.0, 800.0, h, state) == sign * 800
        )
    state = np.array([0.0, 0.1])
    law("clutch_step", 6e4, 6e2, -5e3, 2.5, 0.0, 100.0, h, state)
    assert state[1] == 0


def test_clutch_engages_with_the_engine_speed_and_opens_near_idle():
    def update(engagement, engine_speed, input_speed, pedal, h=10.0):
        return law(
            "clutch_control", float(engagement), float(engine_speed), float(input_speed), pedal, h
        )

    share = 2700 / 4000
    assert update(0, 82.8, 0, 0.5) == pytest.approx(0.5 * share)
    assert update(0, 200, 0, 0.5) == pytest.approx(share)
    assert update(0, 60, 0, 0.5) == 0
    assert update(0.5, 82.8, 0, 0.01) == 0
    # Moving: it closes when the speeds are alike, and opens below a share of idle.
    assert update(0, 82.8, 80, 0.5) == 1
    assert update(0, 82.8, 70, 0.5) == pytest.approx(0.5 * share)
    assert update(0, 70, 82.8, 0.0) == pytest.approx(0.5 * share)
    assert update(1, 82.8, 70, 0.5) == 1
    assert update(1, 63, 0.93 * IDLE, 0.5) == 1
    assert update(1, 62, 0.91 * IDLE, 0.5) == 0
    assert update(1, 63, 1.04 * IDLE, 0.0) == 0
    assert update(1, 63, 1.06 * IDLE, 0.0) == 1
    # 0.5 s to close, 0.1 s to open.
    assert update(0.2, 200, 0, 0.5, h=0.01) == pytest.approx(0.22)
    assert update(0.5, 62, 0, 0.0, h=0.01) == pytest.approx(0.4)


def test_clutch_releases_before_the_engine_stalls():
    for share, capacity in ((0.79, 0), (0.85, 0.5), (0.9, 1), (1.2, 1)):
        assert law("clutch_stall_guard", share * IDLE) == pytest.approx(capacity, abs=1e-9)


SHAFT_STIFFNESS, SHAFT_DAMPING = 6e5 / 2.85**2, 6e3 / 2.85**2


def driveline(
    gear, engine_torque, retarder, shaft_speed, engine_speed, state, auxiliary=0, drag=0, h=0.002
):
    state, work = np.array(state, float), np.zeros(7)
    torques = [engine_torque, auxiliary, retarder, drag]
    speed = law("driveline_step", [*gear, 0.95], torques, shaft_speed, h, engine_speed, state, work)
    return speed, state, work


@pytest.mark.parametrize("ratio", [3.2, -4.0])
def test_driveline_passes_the_clutchs_torque_less_losses(ratio):
    # A torsion that passes 800 N m, with equal speeds.
    stiffness = SHAFT_STIFFNESS / ratio**2
    shaft = 100 / ratio
    speed, state, work = driveline(
        [ratio, 2.4, 0.98], 800.0, 50.0, shaft, 100.0, [800 / stiffness, 1, 2.4, stiffness]
    )
    assert state[2:] == pytest.approx([2.4, stiffness])
    torque = work[3] / ratio
    assert torque == pytest.approx(800, rel=1e-3)
    assert work[4] == 50
    assert work[5] == pytest.approx((torque * 0.98 * ratio - 50) * 0.95 if ratio > 0 else work[5])
    assert work[6] == shaft
    # The flywheel's work is that of the mean speed.
    assert work[0] == pytest.approx(0.002 * 800 * (100 + speed) / 2)
    assert work[0] - work[2] == pytest.approx(
        law("driveline_energy", state, speed)
        - law("driveline_energy", [800 / stiffness, 1, 2.4, stiffness], 100.0),
        abs=1e-6,
    )


def test_losses_change_their_sign_gradually_near_standstill():
    stiffness = SHAFT_STIFFNESS
    start = [-500 / stiffness, 1, 2.4, stiffness]
    _, _, work = driveline([1.0, 2.4, 0.98], -500.0, 0.0, 1.0, 1.0, start)
    # The engine stands nearly still, and the clutch carries nothing.
    assert work[5] == 0
    _, _, work = driveline(
        [40.0, 2.4, 0.98],
        -500.0,
        0.0,
        2.5,
        100.0,
        [-500 / (stiffness / 1600), 1, 2.4, stiffness / 1600],
    )
    fast = work[5] / work[3]
    _, _, work = driveline(
        [100.0, 2.4, 0.98],
        -500.0,
        0.0,
        1.0,
        100.0,
        [-500 / (stiffness / 1e4), 1, 2.4, stiffness / 1e4],
    )
    slow = work[5] / work[3]
    assert fast == pytest.approx(1 / 0.98 / 0.95)
    assert slow == pytest.approx(1 / 0.98 * (0.95 + 0.5 * (1 / 0.95 - 0.95)))


def test_neutral_separates_engine_and_wheels():
    speed, state, work = driveline([0, 2.4, 0.98], 240.0, 60.0, 50.0, 100.0, [0.01, 1, 2.5, 5e4])
    assert speed == pytest.approx(100.2)
    assert state == pytest.approx([0, 0, 2.4, 0])
    assert work[3] == 0
    # Only the retarder acts; its torque is against the motion, with the loss.
    assert work[5] == pytest.approx(-60 / 0.95)
    assert driveline([0, 2.4, 0.98], -1e6, 0.0, 0.0, 1.0, [0, 0, 2.4, 0])[0] == 0


def test_every_torques_work_is_booked_with_the_mean_speed():
    account = np.array([1, 2, 3, 4, 5], float)
    law("book_work", [10, 2, 7, 300, 40, 250, 20], 22.0, 0.01, account)
    angle = 0.01 * 21
    assert account == pytest.approx([11, 2 + 7 - 300 * angle, 3 + 10 * angle, 4 + 40 * angle, 7])
    assert law("driveline_energy", [0.1, 1, 2.5, 400], 10.0) == pytest.approx(125 + 2)


# --- retarder and endurance brakes ----------------------------------------------------------

RETARDER = [3500, 45, 550e3, 300e3, 14.8, 0.9, 0.35, 0.2]


def test_retarder_has_its_rating_its_parabola_and_its_power_by_heat():
    def available(speed, heat=0.0):
        return law("retarder_available", RETARDER, float(speed), heat)

    assert available(22.5) == pytest.approx(3500 / 4)
    assert available(100) == 3500
    assert available(200) == pytest.approx(550e3 / 200)
    assert available(200, 0.9) == pytest.approx(550e3 / 200)
    assert available(200, 0.95) == pytest.approx(425e3 / 200)
    assert available(200, 1.0) == available(200, 1.3) == pytest.approx(300e3 / 200)
    assert available(0) == available(-10) == 0


def test_retarder_fills_and_empties_with_its_lags_and_heats_by_its_power():
    def update(wanted, fill, heat=0.0, available=2000.0):
        state = np.array([fill, heat])
        torque = law("retarder_update", RETARDER, wanted, available, 100.0, 0.01, state)
        return torque, *state

    torque, fill, heat = update(1000.0, 0.0)
    assert fill == pytest.approx(0.5 * 0.01 / 0.36)
    assert torque == pytest.approx(2000 * fill)
    assert heat == pytest.approx(torque * 100 / 300e3 * 0.01 / 14.81)
    assert update(1000.0, 1.0)[1] == pytest.approx(1 - 0.5 * 0.01 / 0.21)
    assert update(9e3, 1.0)[1] == 1
    assert update(-5.0, 0.5)[1] == update(0.0, 0.5)[1] == pytest.approx(0.5 - 0.5 * 0.01 / 0.21)
    assert update(500.0, 0.5, available=0.0)[0] == 0
    assert update(0.0, 0.0, heat=0.5)[2] == pytest.approx(0.5 - 0.5 * 0.01 / 14.81)


def endurance(levers=(0, 0, 0), demand=(0, 0), gearing=(5, 1.05, 0), held=0.0, brake_max=1000.0):
    out, held_back = np.zeros(3), np.array([held])
    demand = (*demand, 0, 0, 0)[:4]  # torque, cut, whether by traction control, relief
    law(
        "endurance_update",
        [0.02, 1],
        levers,
        demand,
        gearing,
        150.0,
        brake_max,
        3000.0,
        0.01,
        held_back,
        out,
    )
    return *out, held_back[0]


def test_brakes_cut_the_accelerator_at_once_and_return_it_over_time():
    assert endurance((0.6, 0, 0), (0, 1)) == pytest.approx((0, 0, 0, 1))
    assert endurance((0.6, 0, 0), (0, 0), held=0.5) == pytest.approx((0.6 * 0.51, 0, 0, 0.49))
    assert endurance((0.6, 1, 1)) == pytest.approx((0.6, 0, 0, 0))
    assert endurance((0.6, 0, 0), (0, 7))[3] == 1


def test_levers_demand_their_share_and_abs_releases_it():
    assert endurance((0, 0.4, 0.5))[:3] == pytest.approx((0, 0.4, 1500))
    assert endurance((0, 0.4, 0.5), (-1, 0))[:3] == (0, 0, 0)
    assert endurance((0.019, 0.4, 0.5))[:2] == pytest.approx((0.019, 0.4))


def test_drag_torque_control_takes_the_torques_away_by_half_of_its_relief():
    for relief, left in ((0.1, 0.8), (0.25, 0.5), (0.5, 0), (1, 0)):
        given = endurance((0, 0.4, 0.5), (0, 0, 0, relief))
        assert given[1:3] == pytest.approx((0.4 * left, 1500 * left))
        given = endurance(demand=(5750 + 1050, 0, 0, relief))
        assert given[1:3] == pytest.approx((left, 1000 * left))


def test_engine_then_pulls_up_to_the_opposite_of_its_drag():
    reliefs, shares = (0, 0.5, 0.625, 0.75, 1, 7), (-1, -1, -0.5, 0, 1, 1)
    for relief, share in zip(reliefs, shares, strict=True):
        assert law("pull_torque", (0, 0, 0, relief), 150.0) == pytest.approx(150 * share)


def test_engine_brakes_first_and_the_retarder_gives_the_rest():
    # Drag and engine brake give 5 * 1150 N m at the shaft.
    assert endurance(demand=(700, 0))[1:3] == (0, 0)
    assert endurance(demand=(3250, 0))[1:3] == pytest.approx((0.5, 0))
    assert endurance(demand=(5750 + 1050, 0))[1:3] == pytest.approx((1, 1000))
    assert endurance(demand=(99e3, 0))[1:3] == pytest.approx((1, 3000))
    # In a gear change the retarder gives all.
    assert endurance(demand=(1050, 0), gearing=(0, 1.05, 0))[1:3] == pytest.approx((0, 1000))
    assert endurance(demand=(750, 0), brake_max=0.0)[1:3] == pytest.approx((0, 0))
    # The levers demand at least their share.
    assert endurance((0, 0.7, 0.1), (3250, 0))[1:3] == pytest.approx((0.7, 300))
