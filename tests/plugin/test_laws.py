"""The plugin's laws compile without MuJoCo, for double, float and dual numbers."""

import math
import os
import shutil
import subprocess
from pathlib import Path

import pytest

import iits_mj

PACKAGE = Path(iits_mj.plugin.__file__).parents[1]
if not (PACKAGE / "plugin" / "laws").is_dir():
    pytest.skip("the plugin's sources are not installed", allow_module_level=True)
COMPILER = next(filter(None, map(shutil.which, (os.environ.get("CXX", "c++"), "g++"))), None)


@pytest.fixture(scope="module")
def values(tmp_path_factory):
    """Returns the printed values by name; the compiler has no include path to MuJoCo."""
    if COMPILER is None:
        pytest.skip("no C++ compiler")
    program = tmp_path_factory.mktemp("laws") / "laws"
    source = Path(__file__).parent / "laws.cc"
    flags = ["-std=c++17", "-O1", "-Wall", "-Wextra", "-Werror", "-ffp-contract=off"]
    subprocess.run([COMPILER, *flags, f"-I{PACKAGE}", source, "-o", program], check=True)
    printed = subprocess.run([program], check=True, capture_output=True, text=True).stdout
    return {name: float(value) for name, value in map(str.split, printed.splitlines())}


def test_laws_include_no_mujoco_header():
    for header in (PACKAGE / "plugin" / "laws").glob("*.h"):
        includes = [line for line in header.read_text().splitlines() if line.startswith("#include")]
        assert all("<" in line or "plugin/laws/" in line for line in includes)
        assert not any("mujoco" in line for line in includes)


def test_dual_numbers_have_the_values_of_doubles(values):
    duals = [name for name in values if name.endswith(".dual")]
    assert len(duals) > 30
    for name in duals:
        assert values[name] == values[name.removesuffix(".dual")], name


def test_floats_have_the_values_of_doubles_within_their_precision(values):
    floats = [n for n in values if n.endswith(".float") and not n.startswith(("drive", "stop"))]
    assert len(floats) > 25
    for name in floats:
        value = values[name.removesuffix(".float")]
        assert values[name] == pytest.approx(value, rel=1e-4, abs=1e-4), name


def test_slope_of_the_lateral_force_at_zero_slip_is_the_cornering_stiffness(values):
    load, nominal, saturation = 30e3, 35e3, 2.3
    shape = math.sin(2 * math.atan(load / (saturation * nominal)))
    stiffness = 2 * 5.8 * nominal * shape / math.sin(2 * math.atan(1 / saturation))
    assert values["tire_fy_at_zero_slip"] == 0
    assert values["tire_fy_at_zero_slip.slope"] == pytest.approx(stiffness, rel=1e-9)
    assert values["tire_fx_at_zero_slip.slope"] == pytest.approx(11 * 60e3, rel=1e-9)

    grip = 0.82 * (1 - 0.08 * (load / nominal - 1)) * 60e3
    b = stiffness * 0.2 / grip / 1.35
    force = grip * math.sin(1.35 * math.atan(b + 0.3 * (b - math.atan(b))))
    assert values["tire_fy_at_slip"] == pytest.approx(force, rel=1e-6)


def test_tires_computed_in_pairs_equal_single_tires_bit_for_bit(values):
    assert values["tire_pair_differs"] == 0


@pytest.mark.parametrize(
    ("name", "value", "slope"),
    [
        ("tire_fz", 2 * 1350e3 * 0.02, -2 * 1350e3),
        ("tire_slip_angle", -math.atan(0.03), 0),
        ("road_height", 4, 0.1),
        ("road_friction_left", 0.7, 0),
        ("road_station", 40, 1),
        ("fifth_wheel_roll_closed", -2e6 * 0.01, -2e6),
        ("fifth_wheel_roll_open", -0.5 * 0.9 * 150e3, 0),
        ("fifth_wheel_yaw", -8e3, 0),
        ("steering_step", 1 - math.exp(-0.02), 1 - math.exp(-0.02)),
        ("air_drag", -0.5 * 1.2 * 6 * 20 * 20, -0.5 * 1.2 * 6 * 20),
        ("engine_full_torque", 2515, -130 / 62),
        ("engine_overrun", -(131 + 69 * 45.3 / 149.8), -69 / 149.8),
        ("engine_fuel", 5.1e-8 * 1170 * 126, 0),
        ("retarder_half_speed", 3500 / 4, 3500 / 2 / 22.5),
        ("retarder_power", 550e3 / 300, -550e3 / 300**2),
        ("clutch_slip", 800, 1),
        ("chamber_filled", 5e5 * (1 - math.exp(-1)), 1 - math.exp(-1)),
        ("brake_torque", 0.0276 * (5e5 * (1 - math.exp(-1)) - 25e3), 0.0276 * (1 - math.exp(-1))),
        ("brake_slides", 1000, 1),
        ("delayed_ramp", 151e3, 0),
    ],
)
def test_law_has_its_analytic_value_and_slope(values, name, value, slope):
    assert values[name] == pytest.approx(value, rel=1e-6)
    assert values[f"{name}.slope"] == pytest.approx(slope, rel=1e-6, abs=1e-12)


def test_engine_brake_follows_its_power_law(values):
    torque = 350e3 / 240.9 * (200 / 240.9) ** 0.4
    assert values["engine_brake"] == pytest.approx(torque, rel=1e-5)
    assert values["engine_brake.slope"] == pytest.approx(0.4 * torque / 200, rel=1e-2)


def test_knuckles_turn_about_one_center(values):
    left, right = values["steering_left"], values["steering_right"]
    assert 1 / math.tan(right) - 1 / math.tan(left) == pytest.approx(2.05 / 3.6)


def test_abs_holds_pressure_half_way_between_its_slip_thresholds(values):
    assert values["abs_duty"] == pytest.approx(0, abs=1e-9)
    assert values["abs_duty.slope"] < 0


@pytest.mark.parametrize("strategy", ["tables", "adaptive"])
def test_powertrain_without_mujoco_accelerates_and_conserves_energy(values, strategy):
    assert values[f"drive_{strategy}_19000_speed_30"] > 6
    assert values[f"drive_{strategy}_gear_30"] > 1
    assert values[f"drive_{strategy}_19000_speed_40"] < values[f"drive_{strategy}_19000_speed_30"]
    assert abs(values[f"drive_{strategy}_energy_40"]) < 1e-9


def test_air_brake_without_mujoco_stops_the_vehicle(values):
    assert values["stop_9000_speed_2"] == pytest.approx(15 - 3 * (2 - 0.27), abs=0.1)
    assert values["stop_9000_speed_8"] < 0.02
    assert 0.9e6 < values["stop_air_left"] < 1e6


@pytest.mark.parametrize(
    ("run", "mass", "end"),
    [("drive_tables", 19000, "speed_40"), ("stop", 9000, "speed_2"), ("stop", 9000, "speed_8")],
)
def test_derivative_of_a_run_by_mass_equals_the_difference_of_two_runs(values, run, mass, end):
    rise = values[f"{run}_{mass + 1}_{end}"] - values[f"{run}_{mass - 1}_{end}"]
    assert values[f"{run}_{mass}_{end}.slope"] == pytest.approx(rise / 2, rel=1e-3)
