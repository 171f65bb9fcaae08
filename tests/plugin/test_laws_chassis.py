"""Laws of tire, road, fifth wheel, steering and air, each called alone."""

import math

import numpy as np
import pytest

from tests.plugin.laws_direct import law

TIRE = {
    "count": 2,
    "free_radius": 0.5425,
    "rolling_radius": 0.5267,
    "vertical_stiffness": 1350e3,
    "vertical_damping": 4000,
    "cornering_coefficient": 5.8,
    "pneumatic_trail": 0.045,
    "nominal_load": 35e3,
    "friction_lateral": 0.82,
    "friction_longitudinal": 0.8,
    "friction_load_slope": 0.08,
    "shape_lateral": 1.35,
    "shape_longitudinal": 1.6,
    "curvature_lateral": -0.3,
    "curvature_longitudinal": 0,
    "load_saturation": 2.3,
    "slip_stiffness": 11,
    "relaxation_lateral": 0.6,
    "relaxation_load_exponent": 0.7,
    "relaxation_longitudinal": 0.15,
    "rolling_resistance": 0.006,
    "rolling_resistance_load": 30e3,
    "rolling_resistance_exponent": 1,
}
DEFLECTION = 0.02
PLANE = (0, 0, 0, 1, 1, 0.8, 0)


def wheel(*, velocity=(0, 0, 0), angular=(0, 0, 0), spin=0.0, deflection=DEFLECTION, **more):
    """A WheelMotion that is upright and heads along x."""
    height = TIRE["free_radius"] - deflection
    arm, axle = more.get("arm", (0, 0, 0)), more.get("axle", (0, 1, 0))
    return np.array([height, *arm, *axle, *velocity, *angular, spin, more.get("carry", 1e9)], float)


def settled(motion, steps=400, *, road=PLANE, lost=0.0, bristles=(0, 0, 0), h=0.002, **changes):
    """Names the parts of TireForces after some steps; `lost` is the share of a tire's pressure."""
    out, bristles = np.zeros(17), np.array(bristles, float)
    attributes = list({**TIRE, **changes}.values())
    law("tire_steps", attributes, motion, road, lost, steps, h, bristles, out)
    names = ("fx", "fy", "fz", "mz", "slip", "angle", "deflection", "friction")
    return {
        "force": out[:3],
        "moment": out[3:6],
        "next": out[6:9],
        **dict(zip(names, out[9:], strict=True)),
    }


def step(motion, **options):
    return settled(motion, 1, **options)


LOAD = 2 * 1350e3 * DEFLECTION
ROLLING = TIRE["rolling_radius"] + (35e3 / 1350e3 - DEFLECTION) / 3


def relaxation(load):
    return 0.6 * (load / 70e3) ** 0.7


def stiffness(load):
    """Cornering stiffness over load of the wheel end."""
    x, s = load / 70e3, 2.3
    return 5.8 * (1 + 1 / s**2) / (1 + (x / s) ** 2)


def test_load_is_stiffness_times_deflection_plus_damping_times_its_rate():
    assert step(wheel())["fz"] == pytest.approx(LOAD)
    sinking = step(wheel(velocity=(0, 0, -0.1)))
    assert sinking["fz"] == pytest.approx(LOAD + 2 * 4000 * 0.1)
    assert sinking["deflection"] == pytest.approx(DEFLECTION)


@pytest.mark.parametrize(
    "motion",
    [wheel(deflection=-0.001), wheel(deflection=0.001, velocity=(0, 0, 1)), wheel(deflection=0)],
)
def test_tire_neither_pulls_nor_acts_in_the_air(motion):
    motion[13] = 20  # spins
    out = step(motion, bristles=(0.01, 0.01, 0.005))
    assert not out["force"].any()
    assert not out["moment"].any()
    assert not out["next"].any()
    assert out["fz"] == out["friction"] == 0


def test_load_acts_along_the_roads_normal():
    grade = 0.1
    norm = 1 / math.hypot(1, grade)
    out = step(wheel(), road=(0, -grade, 0, 1, norm, 0.8, 0))
    distance = (TIRE["free_radius"] - DEFLECTION) * norm
    load = 2 * 1350e3 * (TIRE["free_radius"] - distance)
    assert out["fz"] == pytest.approx(load)
    assert out["force"] == pytest.approx(load * norm * np.array([-grade, 0, 1]), abs=1e-6)


def test_patch_slides_sideways_by_the_hubs_roll_rate_at_its_distance():
    # A hub that rolls about x, left side up: its patch, below, moves to the left.
    rate, distance = 0.01, TIRE["free_radius"] - DEFLECTION
    rolled = step(wheel(angular=(rate, 0, 0)), h=0.002)
    slid = step(wheel(velocity=(0, rate * distance, 0)), h=0.002)
    assert rolled["fy"] == pytest.approx(slid["fy"])
    assert rolled["fy"] < 0
    assert rolled["next"][1] == pytest.approx(-0.002 * rate * distance)


def test_hub_moves_with_the_angular_velocity_at_its_arm():
    # w = (0, 0, 1) at the arm (0, 0.5, 0): v = w x r = (-0.5, 0, 0), which half a step before was
    # that along the axes turned by w h / 2.
    turned = step(wheel(angular=(0, 0, 1), arm=(0, 0.5, 0)), h=0.002)
    moved = step(wheel(velocity=(-0.5, -0.5 * 0.001, 0)), h=0.002)
    for name in ("fx", "fy", "fz", "slip"):
        assert turned[name] == pytest.approx(moved[name])
    # The moment is about the point from which the arm leads.
    arm = np.array([0.3, 0.5, 0.2])
    there, here = step(wheel(arm=tuple(arm))), step(wheel())
    assert there["moment"] - here["moment"] == pytest.approx(np.cross(arm, here["force"]), abs=1e-6)


def test_bristles_approach_their_steady_deflection_by_the_trapezoidal_rule():
    speed, slid, sigma = 25.0, 0.05, relaxation(LOAD)
    for h in (0.001, 0.005):
        bristles = step(wheel(velocity=(speed, slid, 0), spin=speed / ROLLING), h=h)["next"]
        exact = -slid * sigma / speed * -math.expm1(-speed * h / sigma)
        half = 0.5 * speed * h / sigma
        assert bristles[1] == pytest.approx(-slid * h / (1 + half))
        assert bristles[1] == pytest.approx(exact, rel=half * half)


def test_bristles_do_not_swing_where_a_step_is_longer_than_the_relaxation_length():
    # At 400 m/s and 5 ms the patch rolls 2 m in a step.
    at = wheel(velocity=(400, 0, 0), spin=400 / ROLLING)
    bristles = step(at, bristles=(0, 0.001, 0), h=0.005)["next"]
    assert 0 <= bristles[1] < 1e-9


@pytest.mark.parametrize("camber", [-0.5, 0.3])
def test_cambered_wheel_rolls_freely_as_an_upright_one(camber):
    axle = (0, math.cos(camber), math.sin(camber))
    upright, leaning = (
        settled(wheel(velocity=(15, 0.3, 0), spin=14.9 / ROLLING, axle=axis))
        for axis in ((0, 1, 0), axle)
    )
    assert leaning["force"] == pytest.approx(upright["force"])
    assert leaning["slip"] == pytest.approx(-0.1 / 15)


def test_wheel_heads_along_its_axle():
    yaw = 0.1
    turned = settled(
        wheel(
            velocity=(10, 0, 0),
            spin=10 * math.cos(yaw) / ROLLING,
            axle=(-math.sin(yaw), math.cos(yaw), 0),
        )
    )
    # It heads to the left of its velocity, so the road pushes it to the left.
    assert turned["angle"] == pytest.approx(yaw)
    assert turned["force"][1] > 0


@pytest.mark.parametrize("load", [20e3, LOAD, 90e3])
def test_small_slips_give_forces_by_their_stiffnesses(load):
    slip, deflection = 1e-3, load / (2 * 1350e3)
    rolling = TIRE["rolling_radius"] + (35e3 / 1350e3 - deflection) / 3
    # 20 m/s: no damping of low speed.
    lateral = settled(wheel(velocity=(20, -20 * slip, 0), spin=20 / rolling, deflection=deflection))
    assert lateral["fy"] == pytest.approx(load * stiffness(load) * slip, rel=2e-3)
    assert lateral["angle"] == pytest.approx(math.atan(slip), rel=1e-6)
    spin = 20 * (1 + slip) / rolling
    driven = settled(wheel(velocity=(20, 0, 0), spin=spin, deflection=deflection))
    assert driven["slip"] == pytest.approx(slip)
    assert driven["fx"] == pytest.approx(load * 11 * slip / (1 + slip), rel=2e-3)


def test_force_builds_up_over_the_relaxation_length():
    # After a share of the length, the force has 1 - exp(-share) of its steady value.
    slip, h = 1e-3, 1e-5
    for path, velocity, spin in (
        (relaxation(LOAD), (20, -20 * slip, 0), 20 / ROLLING),
        (0.15, (20, 0, 0), 20 * (1 + slip) / ROLLING),
    ):
        motion = wheel(velocity=velocity, spin=spin)
        steps = round(path / (ROLLING * spin * h))
        begun, steady = settled(motion, steps=steps, h=h), settled(motion, steps=20000, h=h)
        force = "fy" if velocity[1] else "fx"
        assert begun[force] / steady[force] == pytest.approx(1 - math.exp(-1), rel=2e-3)


def test_relaxation_length_has_a_floor_of_a_decimeter():
    # A load of a hundredth of the nominal one would have 24 mm.
    load, slip, h = 700.0, 1e-3, 1e-5
    deflection = load / (2 * 1350e3)
    rolling = TIRE["rolling_radius"] + (35e3 / 1350e3 - deflection) / 3
    motion = wheel(velocity=(20, -20 * slip, 0), spin=20 / rolling, deflection=deflection)
    begun = settled(motion, steps=round(0.1 / (20 * h)), h=h)
    steady = settled(motion, steps=10000, h=h)
    assert begun["fy"] / steady["fy"] == pytest.approx(1 - math.exp(-1), rel=2e-3)


def test_longitudinal_relaxation_is_stable_at_any_step():
    # Load over relaxation length times h^2 is at most 0.9 J / (K r^2).
    carry = law("tire_carry", list(TIRE.values()), 34.0)
    assert carry == pytest.approx(0.9 * 34 / (11 * 0.5267**2))
    h = 0.02
    out = step(wheel(velocity=(1e-3, 0, 0), carry=carry), h=h)
    bound = carry / (h * h * LOAD)
    assert bound < 1 / 0.15
    # Damping adds to the spring; the strain is h v, its share the slip.
    damping = 2 * 6000 * min(LOAD / 70e3, 1) * (1 - step_slide(h * 1e-3 * bound))
    assert out["fx"] == pytest.approx(-(LOAD * 11 * h * bound + damping) * 1e-3, rel=1e-3)


def step_slide(slip):
    """Third of the normalized longitudinal slip."""
    return 11 * slip / (0.8 * (1 - 0.08 * (LOAD / 70e3 - 1))) / 3


def sliding_friction(direction, rho):
    """Friction of a sliding tire along one axis at a normalized slip."""
    shape, e = TIRE[f"shape_{direction}"], TIRE[f"curvature_{direction}"]
    b = rho / shape
    return TIRE[f"friction_{direction}"] * math.sin(shape * math.atan(b - e * (b - math.atan(b))))


@pytest.mark.parametrize("surface", [0.8, 0.3])
def test_locked_wheel_slides_against_its_velocity_with_the_roads_friction(surface):
    out = settled(wheel(velocity=(8, 6, 0)), road=(*PLANE[:5], surface, 0))
    fade = surface / 0.8 * (1 - 0.08 * (LOAD / 70e3 - 1))
    rho = math.hypot(11 * 0.8 / 0.8, stiffness(LOAD) * 0.6 / 0.82) / fade
    assert rho > 9
    assert out["friction"] == surface
    assert out["fx"] == pytest.approx(-0.8 * fade * LOAD * sliding_friction("longitudinal", rho))
    assert out["fy"] == pytest.approx(-0.6 * fade * LOAD * sliding_friction("lateral", rho))
    assert abs(out["mz"]) < 1e-6  # it ends with the adhesion


@pytest.mark.parametrize(("rho", "turned"), [(3, 0), (4, 1 / 6), (6, 0.5), (8.5, 5.5 / 6)])
def test_force_turns_from_the_normalized_to_the_true_slip_between_three_and_nine(rho, turned):
    fade = 1 - 0.08 * (LOAD / 70e3 - 1)
    slip = rho * fade / math.hypot(11 * 0.8 / 0.8, stiffness(LOAD) * 0.6 / 0.82)
    sx, sy = 0.8 * slip, 0.6 * slip
    # Theoretical slips are over the rolling speed.
    motion = wheel(velocity=(20 * (1 - sx), -20 * sy, 0), spin=20 / ROLLING)
    out = settled(motion, steps=2000)
    friction = [sliding_friction(n, rho) for n in ("longitudinal", "lateral")]
    slide = fade * LOAD * np.array([0.8, 0.6]) * friction
    stick = LOAD * np.array([11 * sx, stiffness(LOAD) * sy]) / rho
    stick *= friction / np.array([0.8, 0.82])
    expected = turned * slide + (1 - turned) * stick
    assert [out["fx"], out["fy"]] == pytest.approx(expected, rel=1e-4)


def test_wheel_that_lies_flat_has_finite_forces():
    out = step(wheel(axle=(0, 0, 1), velocity=(1, 1, 0)))
    assert np.isfinite(out["force"]).all()
    assert out["force"][2] == pytest.approx(LOAD)


@pytest.mark.parametrize(
    ("load", "slope", "fade"), [(140e3, 0.08, 0.92), (140e3, 0.5, 0.5), (250e3, 0.5, 0.3)]
)
def test_friction_falls_with_the_load_down_to_a_floor_of_30_percent(load, slope, fade):
    deflection = load / (2 * 1350e3)
    rolling = TIRE["rolling_radius"] + (35e3 / 1350e3 - deflection) / 3
    forces = [
        settled(
            wheel(velocity=(20, -20 * angle, 0), spin=20 / rolling, deflection=deflection),
            steps=200,
            h=0.01,
            friction_load_slope=slope,
        )["fy"]
        for angle in np.geomspace(0.02, 2, 200)
    ]
    assert max(forces) / load / 0.82 == pytest.approx(fade, rel=2e-3)


def test_aligning_moment_is_the_side_force_at_the_brush_models_trail():
    for slip in (0.005, 0.02, 0.05, 0.2):
        out = settled(wheel(velocity=(20, -20 * slip, 0), spin=20 / ROLLING))
        grip = 0.82 * (1 - 0.08 * (LOAD / 70e3 - 1))
        r = min(stiffness(LOAD) * slip / grip / 3, 1)
        trail = 0.045 * (1 - r) ** 3 / (1 - r + r * r / 3)
        assert out["mz"] == pytest.approx(-trail * out["fy"], rel=5e-3)
        assert out["moment"][2] == pytest.approx(out["mz"])


def test_carcass_deflection_and_patch_distance_are_the_arm_of_the_side_force():
    out = settled(wheel(velocity=(20, -0.1, 0), spin=20 / ROLLING))
    arm = TIRE["free_radius"] - DEFLECTION + relaxation(LOAD) / stiffness(LOAD)
    assert out["moment"][0] == pytest.approx(out["fy"] * arm, rel=1e-4)


def test_rolling_resistance_winds_up_over_10_mrad_and_opposes_the_spin():
    for sign in (1, -1):
        spin = sign * 20 / ROLLING
        rolling = settled(wheel(velocity=(sign * 20, 0, 0), spin=spin))
        moment = -sign * 0.006 * LOAD * ROLLING
        assert rolling["moment"][1] == pytest.approx(moment - ROLLING * rolling["fx"], rel=1e-3)
        assert rolling["next"][2] == pytest.approx(sign * 0.01)
    half = step(wheel(), bristles=(0, 0, 0.005))
    assert half["moment"][1] == pytest.approx(-0.5 * 0.006 * LOAD * ROLLING)
    # Damping of 0.08 s over the stiffness: 5 mrad and 25 mrad/s are 7 mrad.
    damped = step(wheel(spin=0.025), bristles=(0, 0, 0.005 - 0.002 * 0.025))
    resistance = 0.7 * 0.006 * LOAD * ROLLING
    assert damped["moment"][1] == pytest.approx(-resistance - ROLLING * damped["fx"], rel=1e-3)


@pytest.mark.parametrize("exponent", [0.9, 1.0, 1.1])
@pytest.mark.parametrize("deflection", [0.002, 0.02, 0.1])
def test_rolling_resistance_grows_with_a_power_of_the_load_per_tire(deflection, exponent):
    load = 1350e3 * deflection
    wound = step(
        wheel(deflection=deflection),
        bristles=(0, 0, 0.01),
        rolling_resistance_exponent=exponent,
    )
    rolling = TIRE["rolling_radius"] + (35e3 / 1350e3 - deflection) / 3
    moment = -0.006 * 30e3 * (load / 30e3) ** exponent * 2 * rolling
    assert wound["moment"][1] == pytest.approx(moment, rel=1e-6)


def test_low_speed_damping_fades_out_at_2_meters_per_second():
    slow, fast = (
        step(wheel(velocity=(v, 0.01, 0), spin=v / ROLLING), bristles=(0, 0, 0))["fy"]
        for v in (1.0, 3.0)
    )
    sigma = relaxation(LOAD)
    spring = [
        -LOAD * stiffness(LOAD) * 0.002 * 0.01 / (1 + 0.002 * v / sigma) / sigma for v in (1, 3)
    ]
    damping = 2 * 6000 * 0.5 * (LOAD / 70e3) * 0.01
    assert slow == pytest.approx(spring[0] - damping, rel=1e-2)
    assert fast == pytest.approx(spring[1], rel=1e-2)


def test_slip_signals_stay_finite_at_rest():
    out = step(wheel(velocity=(0, 0.1, 0), spin=0.2))
    assert out["angle"] == pytest.approx(-math.atan(0.1 / 0.5))
    assert out["slip"] == pytest.approx(ROLLING * 0.2 / 0.5)


@pytest.mark.parametrize("lost", [1.0, 7.0])
def test_twin_with_a_flat_tire_is_the_other_tire_alone(lost):
    motion = wheel(velocity=(15, 0.6, -0.05), spin=14 / ROLLING)
    flat, single = settled(motion, lost=lost), settled(motion, count=1)
    assert flat["fz"] == pytest.approx(LOAD / 2 + 4000 * 0.05)
    for name in ("force", "moment", "next"):
        assert flat[name] == pytest.approx(single[name])
    # A sound twin takes no harm from a negative loss, and one at half pressure is in between.
    assert (settled(motion, lost=-1.0)["force"] == settled(motion)["force"]).all()
    assert settled(wheel(), lost=0.5)["fz"] == pytest.approx(0.75 * LOAD)


def test_single_flat_tire_runs_on_its_rim():
    """Flat, it is 0.1 m smaller, has 0.3 of the cornering stiffness and 10 times the resistance."""
    v, slip = 15.0, 1e-3
    motion = wheel(velocity=(v, v * slip, 0), spin=v / ROLLING)
    low = wheel(velocity=(v, v * slip, 0), spin=v / (ROLLING - 0.1), deflection=DEFLECTION + 0.1)
    sound, flat = settled(motion, count=1), settled(low, count=1, lost=1.0)
    assert flat["fz"] == pytest.approx(sound["fz"])
    assert step(motion, count=1, lost=1.0)["fz"] == 0
    assert flat["fx"] == pytest.approx(0, abs=1)
    assert flat["fy"] == pytest.approx(0.3 * sound["fy"], rel=1e-3)
    dragged = 10 * 0.006 * sound["fz"] * (ROLLING - 0.1)
    assert flat["moment"][1] == pytest.approx(-dragged, rel=1e-3)


# --- road -----------------------------------------------------------------------------------


def road_at(rows, x, y, *, start=100.0, step=10.0, hint=-1e10):
    out = np.zeros(7)
    law("road_evaluate", np.ravel(rows).astype(float), len(rows), start, step, x, y, hint, out)
    return {
        **dict(zip(("height", "norm", "friction", "station"), out[[0, 4, 5, 6]], strict=True)),
        "up": out[1:4],
    }


def straight(count=8, heading=0.3, grade=0.05, tilt=0.02):
    stations = 10.0 * np.arange(count)
    c, s = math.cos(heading), math.sin(heading)
    return [
        [5 + r * c, -3 + r * s, 2 + r * grade, c, s, 0, grade, tilt, 0.7, 0.3, 0.5]
        for r in stations
    ]


@pytest.mark.parametrize(
    ("along", "left"), [(0.0, 0.0), (14.0, 1.5), (35.0, -2.0), (-5.0, 1.0), (80.0, 2.0)]
)
@pytest.mark.parametrize("hint", [-1e10, 100.0, 165.0, 1e4])
def test_straight_road_is_a_plane(along, left, hint):
    heading, grade, tilt = 0.3, 0.05, 0.02
    c, s = math.cos(heading), math.sin(heading)
    x, y = 5 + along * c - left * s, -3 + along * s + left * c
    point = road_at(straight(), x, y, hint=hint)
    assert point["station"] == pytest.approx(100 + along)
    assert point["height"] == pytest.approx(2 + grade * along + tilt * left)
    up = [tilt * s - grade * c, -grade * s - tilt * c, 1]
    assert point["up"] == pytest.approx(up)
    assert point["norm"] == pytest.approx(1 / math.sqrt(sum(v * v for v in up)))
    assert point["friction"] == pytest.approx(0.7 if left > 0.5 else 0.3)


def test_height_is_the_cubic_through_heights_and_grades():
    # z = 1e-4 s^3 - 2e-3 s^2, which a Hermite cubic reproduces.
    def row(s):
        return [s, 0, 1e-4 * s**3 - 2e-3 * s**2, 1, 0, 0, 3e-4 * s**2 - 4e-3 * s, 0, 0.8, 0.8, 0]

    rows = [row(10.0 * i) for i in range(6)]
    for s in (0.0, 3.0, 17.0, 33.3, 49.0):
        point = road_at(rows, s, 0.0)
        assert point["height"] == pytest.approx(1e-4 * s**3 - 2e-3 * s**2, abs=1e-12)
        assert -point["up"][0] == pytest.approx(3e-4 * s**2 - 4e-3 * s, abs=1e-12)
    assert road_at(rows, 60.0, 0.0)["height"] == pytest.approx(row(50.0)[2] + 10 * row(50.0)[6])


def test_tilt_and_friction_change_linearly_between_rows():
    rows = [[0, 0, 0, 1, 0, 0, 0, 0.01, 0.8, 0.4, 0], [10, 0, 0, 1, 0, 0, 0, 0.05, 0.6, 0.2, 0]]
    point = road_at(rows, 2.5, 2.0, start=0.0)
    assert point["height"] == pytest.approx(2 * 0.02)
    assert point["up"] == pytest.approx([-2 * 0.004, -0.02, 1])
    assert point["friction"] == pytest.approx(0.75)
    assert road_at(rows, 2.5, -2.0, start=0.0)["friction"] == pytest.approx(0.35)


def test_grade_is_steeper_on_the_inside_of_a_bend():
    radius, grade = 50.0, 0.06
    angles = np.arange(8) * 10.0 / radius
    rows = [
        [
            radius * math.sin(a),
            radius * (1 - math.cos(a)),
            grade * radius * a,
            math.cos(a),
            math.sin(a),
            1 / radius,
            grade,
            0,
            0.8,
            0.8,
            0,
        ]
        for a in angles
    ]
    for offset in (0.0, 5.0, -5.0):
        a = 0.7
        x, y = (radius - offset) * math.sin(a), radius - (radius - offset) * math.cos(a)
        point = road_at(rows, x, y, start=0.0)
        assert point["station"] == pytest.approx(a * radius, abs=0.02)
        assert math.hypot(*point["up"][:2]) == pytest.approx(
            grade / (1 - offset / radius), rel=5e-3
        )
    # Near the bend's center the line would have no length; its stretch is at least a fifth.
    x, y = 2 * math.sin(0.7), radius - 2 * math.cos(0.7)
    assert math.hypot(*road_at(rows, x, y, start=0.0)["up"][:2]) == pytest.approx(
        5 * grade, rel=0.05
    )


@pytest.mark.parametrize("hint", [0.0, 1500.0, 100.0, 2990.0])
def test_search_finds_the_section_of_a_long_road_from_any_hint(hint):
    rows = [[10.0 * i, 0, i, 1, 0, 0, 0.1, 0, 0.8, 0.8, 0] for i in range(300)]
    for x in (4.0, 777.0, 1511.0, 2985.0):
        assert road_at(rows, x, 1.0, start=0.0, hint=hint)["height"] == pytest.approx(0.1 * x)


def test_road_that_passes_over_itself_keeps_the_level_of_the_hint():
    # Out along x at height 0, back at height 6 above it, by way of a half circle.
    out = [[10.0 * i, 0, 0, 1, 0, 0, 0, 0, 0.8, 0.8, 0] for i in range(40)]
    back = [[390.0 - 10 * i, 60, 6, -1, 0, 0, 0, 0, 0.8, 0.8, 0] for i in range(40)]
    rows = out + back
    assert road_at(rows, 105.0, 25.0, start=0.0, hint=100.0)["height"] == 0
    # A point far off the road is sought again, and is nearer to the other carriageway.
    assert road_at(rows, 105.0, 59.0, start=0.0, hint=100.0)["height"] == pytest.approx(6)


# --- fifth wheel, steering, air -------------------------------------------------------------

PLATE = [2e6, 2e4, 0.02, 0.9, 120e3, 8e3, 0]
LIFT = 0.5 * 0.9 * 120e3


@pytest.mark.parametrize("side", [1, -1])
def test_plate_resists_roll_until_it_opens_and_the_kingpin_beyond_the_lash(side):
    opens = LIFT / 2e6

    def moment(roll, rate=0.0):
        return -side * law("fifth_wheel_roll", PLATE, side * roll, side * rate)

    assert moment(0.5 * opens) == pytest.approx(0.5 * LIFT)
    assert moment(0.5 * opens, 0.1) == pytest.approx(0.5 * LIFT + 2e3)
    # In the lash the load acts on the plate's edge, without stiffness or damping.
    assert moment(opens + 0.01) == pytest.approx(LIFT)
    assert moment(opens + 0.01, 0.3) == pytest.approx(LIFT)
    assert moment(opens + 0.02 + 0.005) == pytest.approx(LIFT + 2e6 * 0.005)
    assert moment(opens + 0.02 + 0.005, 0.1) == pytest.approx(LIFT + 2e6 * 0.005 + 2e3)
    # The open plate pushes only, whatever the damping.
    assert moment(opens + 0.02 + 1e-4, -50.0) == 0
    assert moment(0.5 * opens, -50.0) == pytest.approx(0.5 * LIFT - 1e6)


@pytest.mark.parametrize("load", [0.0, 120e3])
def test_turntable_neither_opens_nor_has_a_lash(load):
    ring = [2e6, 2e4, 0.02, 0.9, load, 8e3, 1]
    for roll, rate in ((0.001, 0.0), (0.1, 0.3), (-0.1, 0.0), (0.001, -5.0), (0.0, 0.1)):
        assert law("fifth_wheel_roll", ring, roll, rate) == pytest.approx(-2e6 * roll - 2e4 * rate)


@pytest.mark.parametrize("roll", [-0.3, 0.0, 0.2])
def test_coupling_without_stiffness_only_damps_the_roll(roll):
    eye = [0, 50, 0, 0, 0, 0, 0]
    for rate in (-0.5, 0.0, 0.5):
        assert law("fifth_wheel_roll", eye, roll, rate) == pytest.approx(-50 * rate)


def test_plate_friction_winds_up_over_2_mrad_and_then_is_constant():
    wind_up = np.zeros(1)
    assert law("fifth_wheel_yaw", PLATE, 0.1, 0.01, wind_up) == pytest.approx(-4e3)
    assert wind_up[0] == pytest.approx(0.001)
    assert law("fifth_wheel_yaw", PLATE, 0.5, 0.01, wind_up) == pytest.approx(-8e3)
    assert law("fifth_wheel_yaw", PLATE, -0.1, 0.01, wind_up) == pytest.approx(-4e3)
    assert law("fifth_wheel_yaw", PLATE, -1.0, 0.01, wind_up) == pytest.approx(8e3)


STEERING = [20, 0.1, 30, 15, 1e5, 0.1, 3.6, 2.05]


def test_inner_knuckle_turns_more_and_both_about_the_rear_axle():
    targets = np.zeros(2)
    for angle in (4.0, -4.0):
        law("steering_targets", STEERING, 1, 0, angle, targets)
        inner, outer = targets if angle > 0 else -targets[::-1]
        assert inner > outer > 0
        assert 1 / math.tan(outer) - 1 / math.tan(inner) == pytest.approx(2.05 / 3.6)
        middle = math.atan(2 / (1 / math.tan(inner) + 1 / math.tan(outer)))
        assert middle == pytest.approx(abs(angle) / 20)


@pytest.mark.parametrize("angle", [6.0, -3.0])
def test_all_wheels_of_several_steered_axles_turn_about_one_center(angle):
    """Two front axles, and one behind the center line that turns to the other side."""
    wheelbases, tracks = (5.4, 3.6, -1.2), (2.05, 2.0, 1.9)
    attributes = [*STEERING[:6], *wheelbases, *tracks]
    center = wheelbases[0] / math.tan(angle / 20)  # to the left, on the line without side slip
    for axle, (ahead, track) in enumerate(zip(wheelbases, tracks, strict=True)):
        targets = np.zeros(2)
        law("steering_targets", attributes, 3, axle, angle, targets)
        for side, found in zip((0.5, -0.5), targets, strict=True):
            assert math.tan(found) == pytest.approx(ahead / (center - side * track), rel=1e-9)


def test_steering_wheel_lags_within_its_rate_and_its_angle():
    def turn(demand, h, state=(0, 0), **changes):
        state = np.array(state, float)
        attributes = np.array(STEERING, float)
        for index, value in changes.items():
            attributes[int(index[1:])] = value
        law("steering_step", attributes, demand, h, state)
        return state

    assert turn(0.5, 0.02)[0] == pytest.approx(0.5 * (1 - math.exp(-0.2)))
    assert turn(20.0, 0.02)[0] == pytest.approx(15 * 0.02)
    assert turn(-20.0, 0.02)[0] == pytest.approx(-15 * 0.02)
    assert turn(99.0, 10.0)[0] == pytest.approx(30)
    assert turn(-99.0, 10.0)[0] == pytest.approx(-30)
    assert turn(0.1, 0.02, _5=0)[0] == pytest.approx(0.1)  # without a lag
    assert turn(math.nan, 0.02, (0.3, 0.3))[0] == pytest.approx(0.3)
    # The play is 0.1 rad in all: the pitman arm follows 0.05 rad behind.
    assert turn(1.0, 10.0)[1] == pytest.approx(0.95)
    assert turn(0.0, 10.0, (1, 0.95))[1] == pytest.approx(0.05)
    assert turn(0.97, 10.0, (1, 0.95))[1] == pytest.approx(0.95)


def test_air_resists_along_each_axis_with_its_own_area():
    force = np.zeros(2)
    law("air_force", [1.2, 6, 40], 20.0, -3.0, 0.0, force)
    speed = math.hypot(20, 3)
    assert force == pytest.approx([-0.5 * 1.2 * 6 * speed * 20, 0.5 * 1.2 * 40 * speed * 3])


# --- arithmetic -----------------------------------------------------------------------------


def test_tables_interpolate_and_are_constant_beyond_their_ends():
    x, y = [1, 2, 4], [10, 30, -10]
    for at, value in ((0, 10), (1, 10), (1.5, 20), (2, 30), (3, 10), (4, -10), (9, -10)):
        assert law("curve", x, y, 3, float(at)) == pytest.approx(value)
    rows, columns = [0, 1, 3], [0, 10]
    values = [0, 1, 2, 5, 4, 9]
    for row, column, value in (
        (0, 0, 0),
        (0, 5, 0.5),
        (0.5, 5, 2),
        (2, 10, 7),
        (2, 5, 5),
        (9, 99, 9),
        (-1, -1, 0),
    ):
        assert law("map", rows, 3, columns, 2, values, float(row), float(column)) == pytest.approx(
            value
        )


def test_sampled_functions_pass_through_their_samples_and_between_them():
    for at in (2.0, 2.5, 3.0, 5.99, 6.0):
        grid = math.floor(2 * at) / 2
        value = grid**2 + (at - grid) * (2 * grid + 0.5)
        assert law("uniform_curve_of_squares", 2.0, 6.0, 8, at) == pytest.approx(value)
    assert law("uniform_curve_of_squares", 2.0, 6.0, 8, 1.0) == 4
    assert law("uniform_curve_of_squares", 2.0, 6.0, 8, 7.0) == 36
    # The last number below the end of the grid is rounded up to it.
    for at in (-1.0, -0.3, 0.0, 0.77, 1.9, math.nextafter(2.0, 0.0)):
        # h^4 / 384 of the fourth derivative.
        assert law("sampled_sine", -1.0, 2.0, 30, at) == pytest.approx(math.sin(at), abs=4e-7)
    assert law("sampled_sine", -1.0, 2.0, 30, 2.0) == 10
    assert law("sampled_sine", -1.0, 2.0, 30, -1.01) == 10
    assert law("sampled_sine", -1.0, 2.0, 30, math.nan) == 10


def test_arithmetic_of_vectors_lags_and_bounds():
    a, b, out = [1, 2, 3], [-4, 5, 7], np.zeros(3)
    law("cross", a, b, out)
    assert out == pytest.approx(np.cross(a, b))
    assert law("dot", a, b) == pytest.approx(np.dot(a, b))
    assert law("lag_share", 0.1, 0.2) == pytest.approx(1 - math.exp(-0.5), abs=3e-4)
    assert law("lag_share", 0.001, 0.2) == pytest.approx(1 - math.exp(-0.005), rel=1e-7)
    assert [law("clamp", float(x), 2.0, 3.0) for x in (1, 2.5, 4)] == [2, 2.5, 3]
    assert math.isnan(law("clamp", math.nan, 2.0, 3.0))
