"""Standard maneuvers at a coarse step, and the estimators behind them."""

import numpy as np
import pytest

from iits_mj.parameters import TruckParameters, shipped_trucks
from iits_mj.validation.handling import lane_change, low_speed_turn, rollover, yaw_damping
from iits_mj.validation.handling.roll_plane import RollPlane
from iits_mj.validation.handling.yaw_damping import damping_ratio
from iits_mj.validation.pbs.limits import STANDARDS, level_of_length
from iits_mj.validation.pbs.maneuvers import LaneChange
from iits_mj.validation.pbs.measures import turn_measures

STEP = 0.005
LADEN = 36_000.0
TRUCK = TruckParameters.load()


def _decay(ratio, offset=0.0, phase=0.3):
    time = np.arange(0.0, 12.0, 0.01)
    swing = np.cos(3.0 * np.sqrt(1.0 - ratio**2) * time + phase)
    return np.exp(-ratio * 3.0 * time) * swing + offset


@pytest.mark.parametrize("ratio", [0.02, 0.05, 0.15, 0.3, 0.5, 0.65])
@pytest.mark.parametrize("offset", [0.0, -0.4])
@pytest.mark.parametrize("phase", [0.0, 1.0, 2.5])
def test_damping_of_a_synthetic_decay_is_found(ratio, offset, phase):
    assert damping_ratio(_decay(ratio, offset, phase)) == pytest.approx(ratio, rel=1e-3)


def test_damping_of_a_noisy_decay_is_found():
    noise = np.random.default_rng(3).normal(0.0, 1e-4, 1200)
    assert damping_ratio(_decay(0.1) + noise) == pytest.approx(0.1, rel=0.15)


@pytest.mark.parametrize("ratio", [1.0, 1.5, 4.0])
def test_an_aperiodic_decay_has_damping_one(ratio):
    time = np.arange(0.0, 12.0, 0.01)
    fast, slow = ratio + np.sqrt(ratio**2 - 1.0), ratio - np.sqrt(ratio**2 - 1.0)
    assert damping_ratio(np.exp(-slow * time) - 0.2 * np.exp(-fast * time)) == 1.0
    assert damping_ratio(np.zeros(100)) == 1.0


def test_a_growing_swing_has_negative_damping():
    time = np.arange(0.0, 12.0, 0.01)
    found = damping_ratio(np.exp(0.2 * time) * np.cos(3.0 * time))
    assert found == pytest.approx(-0.2 / np.hypot(0.2, 3.0), rel=1e-3)


def test_a_signal_that_is_not_finite_has_no_damping():
    assert np.isnan(damping_ratio(np.array([1.0, np.nan, 0.5])))


@pytest.mark.parametrize("payload", [LADEN, 0.0])
def test_yaw_damping_is_near_the_linear_models(payload):
    done = yaw_damping.pulse(TRUCK, payload, 88.0 / 3.6, STEP)
    found, model = done.damping()["hitch angle"], done.model_damping()["hitch angle"]
    assert found > yaw_damping.REQUIRED
    assert found == pytest.approx(model, abs=0.1)
    assert model == pytest.approx(done.system.damping_ratio(), abs=0.1)


def test_damping_falls_with_speed():
    slow, fast = (
        yaw_damping.pulse(TRUCK, 0.0, kph / 3.6, STEP).damping()["hitch angle"]
        for kph in (70.0, 100.0)
    )
    assert fast < slow


def test_100_kmh_is_held_through_a_lane_change():
    done = lane_change.sine_steer(TRUCK, 0.0, 100.0 / 3.6, STEP)
    assert done.speed_error() < lane_change.SPEED_TOLERANCE
    assert done.peak() == pytest.approx(lane_change.SINE_PEAK, rel=0.1)
    assert done.amplification() == pytest.approx(done.model_amplification(), rel=0.1)


def test_inverse_steer_moves_the_linear_steer_axle_along_the_path():
    from iits_mj.analytic import YawPlane, simulate

    system = YawPlane.from_parameters(TruckParameters.load(), 0.0).at(88.0 / 3.6)
    time = np.arange(0.0, 8.0, 0.01)
    path = LaneChange()
    wanted = path.peak * np.sin(2.0 * np.pi * np.clip(time, 0.0, 2.5) / 2.5)
    answer = simulate(system, time, lane_change.inverse_steer(system, time, wanted))
    np.testing.assert_allclose(answer.y, path.path(path.speed * time), atol=0.03)
    assert path.offset == pytest.approx(1.46, abs=0.01)


def test_last_axle_swings_beyond_the_path_and_steer_axle_stays_on_it():
    done = lane_change.follow_path(TRUCK, LADEN, 88.0 / 3.6, STEP)
    assert done.error < lane_change.PATH_TOLERANCE
    assert 0.1 < done.off_tracking() < STANDARDS["off_tracking"].limits[0]
    assert done.off_tracking() == pytest.approx(done.model_off_tracking(), abs=0.15)


@pytest.mark.parametrize("name", shipped_trucks())
@pytest.mark.parametrize("laden", [True, False])
def test_truck_tips_on_the_table_where_statics_say(name, laden):
    parameters = TruckParameters.load(name)
    payload = parameters.payload_max if laden else 0.0
    tilt = rollover.tilt_table(parameters, payload, STEP)
    compliant = RollPlane.from_parameters(parameters, payload).threshold()
    assert tilt.threshold == pytest.approx(compliant, rel=0.05)
    assert tilt.threshold < rollover.rigid_threshold(parameters, payload)
    assert np.all(np.diff(tilt.table) > 0.0)


def test_truck_tips_earlier_with_a_higher_load():
    parameters = TruckParameters.load()
    low, high = (
        RollPlane.from_parameters(parameters.with_payload_height(h), LADEN).threshold()
        for h in (1.8, 2.4)
    )
    assert high < 0.8 * low
    assert rollover.tilt_table(parameters, LADEN, STEP, 2.4).threshold == pytest.approx(
        high, rel=0.05
    )


def test_stiff_truck_tips_near_the_rigid_bound():
    from dataclasses import replace

    plane = RollPlane.from_parameters(TruckParameters.load(), LADEN)

    def stiff(body):
        supports = tuple(replace(s, suspension=1e9, tire=1e9) for s in body.supports)
        plate = body.coupling and replace(body.coupling, roll_stiffness=1e9, roll_lash=0.0)
        return replace(body, supports=supports, coupling=plate)

    rigid = RollPlane(tuple(map(stiff, plane.bodies)))
    bound = rollover.rigid_threshold(TruckParameters.load(), LADEN)
    assert rigid.threshold() == pytest.approx(bound, rel=0.06)


def test_outer_steer_tire_follows_the_pbs_arc():
    done = low_speed_turn.pbs_turn(TRUCK, LADEN, STEP)
    assert done.path_error() < 0.05
    assert np.rad2deg(done.recording.yaw[-1]) == pytest.approx(90.0, abs=1.0)
    assert done.tail_swing_on_exit() == 0.0


@pytest.mark.parametrize("name", shipped_trucks())
def test_low_speed_turn_sweeps_what_the_tractrix_chain_sweeps(name):
    truck = TruckParameters.load(name)
    done = low_speed_turn.pbs_turn(truck, truck.payload_max, 0.005)
    found, model = map(turn_measures, (done.driven, done.model))
    assert found["swept_path"] == pytest.approx(model["swept_path"], rel=0.03)
    for swing in ("frontal_swing", "tail_swing"):
        assert found[swing] == pytest.approx(model[swing], abs=0.05)
    assert ("front_paths" in found) is (len(truck.units) > 1)


@pytest.mark.parametrize(("length", "level"), [(16.5, 1), (25.0, 2), (31.0, 3), (50.0, 4)])
def test_longer_combinations_may_use_roads_of_a_higher_level(length, level):
    assert level_of_length(length) == level
