"""Hidden tires and steering ratio must come back from a steered drive of the simulated truck."""

import numpy as np
import pytest

from iits_mj.core.messages import VehicleCommand
from iits_mj.identification import Log, Series, from_frames, identify
from iits_mj.identification.lateral import pitman_angle
from iits_mj.parameters import TruckParameters
from iits_mj.road import Route
from tests.identification.synthetic_drives import LATERAL, LONGITUDINAL, drive, frames
from tests.identification.truck_drives import hidden_truck

PARAMETERS = TruckParameters.load()
MASS = PARAMETERS.gross_mass(20_000.0)
HIDDEN = {
    "tires": {
        "steer": {"cornering_coefficient": 5.6},
        "drive": {"cornering_coefficient": 5.1},
        "trailer": {"cornering_coefficient": 6.4},
    },
    "steering": {"ratio": 19.5},
}


def _weave(time, state):
    """Single sines and short pulls of the steering wheel, with a return to the lane's heading."""
    rng = np.random.default_rng(int(time / 3.0))
    size = rng.uniform(0.3, 0.7) * rng.choice([-1.0, 1.0])
    sine = np.sin(2.0 * np.pi * (time % 3.0) / 3.0)
    wheel = size * (sine if int(time / 3.0) % 2 else 0.3) - 3.0 * state.yaw
    wanted = 17.0 + 4.0 * np.sin(2.0 * np.pi * time / 60.0)
    pedal = float(np.clip(0.3 + 0.5 * (wanted - state.speed), 0.0, 1.0))
    return VehicleCommand(accelerator_pedal=pedal, steering_wheel_angle=float(wheel))


@pytest.fixture(scope="module")
def log():
    road = Route.straight(length=5_000.0, lanes=6)
    truck = hidden_truck(20_000.0, HIDDEN, road, speed=17.0)
    rows = drive(truck, _weave, 80.0)
    return from_frames(frames(rows, PARAMETERS, {**LONGITUDINAL, **LATERAL}), PARAMETERS)


@pytest.fixture(scope="module")
def found(log):
    return identify(log, PARAMETERS, mass=MASS, groups=("steering",))


@pytest.mark.parametrize("kind", ["steer", "drive", "trailer"])
def test_hidden_cornering_stiffness_comes_back_within_10_percent(found, kind):
    estimate = found[f"cornering_coefficient_{kind}"]
    truth = HIDDEN["tires"][kind]["cornering_coefficient"]
    assert estimate.identifiable, estimate.reason
    assert estimate.value == pytest.approx(truth, rel=0.1)
    assert abs(estimate.value - truth) < 1.5 * estimate.half_width


def test_steering_ratio_comes_back_within_1_percent(found):
    assert found["steering_ratio"].value == pytest.approx(19.5, rel=0.01)
    assert abs(found["steering_ratio"].value - 19.5) < found["steering_ratio"].half_width


@pytest.mark.slow
def test_steering_ratio_comes_back_from_motion_without_the_road_wheel_angle(log):
    blind = log.only([name for name in log.signals if name != "road_wheel_angle"])
    result = identify(blind, PARAMETERS, mass=MASS, groups=("steering",))
    assert result["steering_ratio"].value == pytest.approx(19.5, rel=0.05)
    assert result["cornering_coefficient_drive"].value == pytest.approx(5.1, rel=0.1)


@pytest.mark.slow
def test_tractor_alone_does_not_show_the_trailers_tires(log):
    alone = Log(
        {
            name: Series(series.time[:2000], series.value[:2000])
            for name in ("speed", "yaw_rate", "road_wheel_angle")
            if (series := log.series(name))
        }
    )
    result = identify(alone, PARAMETERS, mass=MASS, groups=("steering",))
    estimate = result["cornering_coefficient_trailer"]
    assert not estimate.identifiable
    assert "too weak" in estimate.reason


def test_stiffness_is_not_identified_without_a_mass(log):
    level = log.only([name for name in log.signals if name != "engine_torque"])
    result = identify(level, PARAMETERS, groups=("steering",))
    for kind in ("steer", "drive", "trailer"):
        assert not result[f"cornering_coefficient_{kind}"].identifiable
        assert "mass" in result[f"cornering_coefficient_{kind}"].reason
    assert result["steering_ratio"].identifiable


def test_gear_follows_the_wheel_behind_its_play():
    wheel = np.array([0.0, 0.1, 0.1, 0.08, 0.0, -0.1])
    assert pitman_angle(wheel, 0.04) == pytest.approx([0.0, 0.08, 0.08, 0.08, 0.02, -0.08])
