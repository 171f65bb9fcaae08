import dataclasses

import numpy as np
import pytest

from iits_mj.core.errors import InputError
from iits_mj.road import Route
from traffic_bridge import PureSim, TrafficConfig, calibrated_types, default_types
from traffic_bridge.config import Departure
from traffic_bridge.datasets import Pair
from traffic_bridge.vehicles.calibration import (
    PairBlock,
    calibrate,
    calibrate_each,
    calibrate_headways,
    evaluate,
    trimmed,
)
from traffic_bridge.vehicles.idm import (
    IdmParameters,
    acceleration,
    equilibrium_flow,
    equilibrium_gap,
    gain,
    slopes,
)

DRIVER = IdmParameters(25.0, 1.2, 2.0, 1.0, 1.5)


def _pair(parameters, seed=0, steps=400):
    """A pair whose follower drives exactly by the given parameters."""
    rng = np.random.default_rng(seed)
    time = 0.1 * np.arange(steps)
    speed = 9.0 + 3.0 * np.sin(2.0 * np.pi * time / 25.0 + rng.uniform(0.0, 6.0))
    leader = 40.0 + np.concatenate([[0.0], np.cumsum(0.1 * speed[1:])])
    zeros = np.zeros(steps)
    raw = Pair("f", "l", "car", 0, 4.5, time, zeros, zeros + 8.0, zeros, leader, speed, zeros)
    gaps, speeds = PairBlock([raw]).simulate(parameters.as_array().reshape(5, 1, 1))
    station = leader - 4.5 - gaps[:, 0, 0]
    return dataclasses.replace(raw, station=station, speed=speeds[:, 0, 0])


def test_acceleration_is_zero_at_the_equilibrium_gap():
    speed = np.array([0.0, 5.0, 12.0, 24.0])
    gap = equilibrium_gap(DRIVER.as_array(), speed)
    assert acceleration(DRIVER.as_array(), gap, speed, speed) == pytest.approx(0.0, abs=1e-12)
    assert gap[0] == DRIVER.minimum_gap
    with pytest.raises(InputError, match="equilibrium"):
        equilibrium_gap(DRIVER.as_array(), 25.0)


def test_flow_is_greatest_between_standstill_and_desired_speed():
    flow = equilibrium_flow(DRIVER.as_array(), np.linspace(0.0, 24.9, 250), 4.5)
    assert 50 < int(np.argmax(flow)) < 245
    assert 1500.0 < 3600.0 * flow.max() < 2500.0


def test_slopes_are_the_derivatives_of_the_acceleration():
    gap, v = float(equilibrium_gap(DRIVER.as_array(), 10.0)), 10.0
    values, h = DRIVER.as_array(), 1e-5
    by_gap, by_speed, by_leader = slopes(DRIVER, v)
    for found, (dg, dv, dl) in ((by_gap, (h, 0, 0)), (by_speed, (0, h, 0)), (by_leader, (0, 0, h))):
        up = acceleration(values, gap + dg, v + dv, v + dl)
        down = acceleration(values, gap - dg, v - dv, v - dl)
        assert (up - down) / (2 * h) == pytest.approx(found, rel=1e-6)


def test_slow_oscillations_pass_unchanged_and_sluggish_drivers_amplify_faster_ones():
    lazy = dataclasses.replace(DRIVER, acceleration=0.3, time_headway=0.8)
    frequency = np.array([1e-4, 0.02, 0.05])
    assert gain(DRIVER, 10.0, frequency)[0] == pytest.approx(1.0, abs=1e-3)
    assert gain(lazy, 10.0, frequency).max() > 1.05


def test_a_follower_in_sumo_moves_as_the_calibration_simulates_it():
    kind = dataclasses.replace(
        default_types()[0],
        time_headway=DRIVER.time_headway,
        minimum_gap=DRIVER.minimum_gap,
        acceleration=DRIVER.acceleration,
        deceleration=DRIVER.deceleration,
    )
    config = TrafficConfig(
        density="empty",
        speed_limit=25.0,
        types=(kind,),
        mix=((kind.name, 1.0),),
        departures=tuple(
            Departure(time=0.0, type=kind.name, lane=0, station=200.0 - 60.0 * i, speed=25.0)
            for i in range(2)
        ),
    )
    rows = []
    with PureSim(Route.straight(2000.0, lanes=1, speed_limit=25.0), config) as traffic:
        frame = traffic.reset()
        for step in range(400):
            if len(frame) == 2:
                order = np.argsort(-frame.column("station"))
                wanted = 12.0 + 4.0 * np.sin(0.05 * step)
                traffic.vehicles.change(frame.ids[int(order[0])], desired_speed=float(wanted))
                rows.append([*frame.column("station")[order], *frame.column("speed")[order]])
            frame = traffic.step()
    x = np.array(rows)[1:]
    front = x[:, :2] + 0.5 * kind.length
    zeros = np.zeros(len(x))
    pair = Pair(
        "f", "l", "car", 0, kind.length, 0.1 * np.arange(len(x)),
        front[:, 1], x[:, 3], zeros, front[:, 0], x[:, 2], zeros,
    )  # fmt: skip
    gaps, speeds = PairBlock([pair]).simulate(DRIVER.as_array().reshape(5, 1, 1))
    assert len(x) > 300
    assert gaps[:, 0, 0] == pytest.approx(pair.gap, abs=1e-6)
    assert speeds[:, 0, 0] == pytest.approx(pair.speed, abs=1e-6)


def test_calibration_finds_the_driver_that_made_the_pairs():
    pairs = [_pair(DRIVER, seed) for seed in range(6)]
    found = calibrate(pairs, seed=1, generations=80)
    assert found.error < 0.02
    assert found.parameters.time_headway == pytest.approx(DRIVER.time_headway, abs=0.15)
    own = calibrate_each(pairs[:2], begin=found.parameters)
    assert all(entry.error < 0.005 for entry in own)
    assert calibrate(pairs, seed=1, generations=5).parameters == (
        calibrate(pairs, seed=1, generations=5).parameters
    )


def test_headways_of_single_drivers_are_identified():
    pairs = [
        _pair(dataclasses.replace(DRIVER, time_headway=t), i) for i, t in enumerate((0.7, 1.2, 1.9))
    ]
    found = [entry.parameters.time_headway for entry in calibrate_headways(pairs, DRIVER)]
    assert found == pytest.approx([0.7, 1.2, 1.9], abs=0.011)


def test_the_first_gap_reveals_a_drivers_headway():
    headways, speed, time = (0.7, 1.2, 1.9), 9.0, 0.1 * np.arange(300)
    drivers = [dataclasses.replace(DRIVER, time_headway=t) for t in headways]
    station, zeros = speed * time, np.zeros(300)
    steady = Pair(
        "f", "l", "car", 0, 4.5, time, station, zeros + speed, zeros, station, zeros, zeros
    )
    pairs = [
        dataclasses.replace(
            steady,
            leader_station=station + 4.5 + equilibrium_gap(driver.as_array(), speed),
            leader_speed=zeros + speed,
        )
        for driver in drivers
    ]
    values = DRIVER.as_array().reshape(5, 1, 1)
    assert PairBlock(pairs).first_headways(values)[0] == pytest.approx(headways)
    # With a very long memory drivers keep the recorded headway; with a very short one they have the
    # headway of the parameters.
    assert evaluate(pairs, DRIVER, memory=1e6).error < 0.02
    without = evaluate(pairs, DRIVER)
    assert evaluate(pairs, DRIVER, memory=1e-3).pair_errors == pytest.approx(
        without.pair_errors, rel=0.05
    )
    found = calibrate(pairs, generations=15, with_memory=True)
    assert found.memory is not None
    assert found.error < without.error


def test_measures_weigh_small_gaps_differently():
    pair = _pair(DRIVER)
    other = dataclasses.replace(DRIVER, time_headway=1.6)
    errors = {m: evaluate([pair], other, m).error for m in ("mixed", "relative", "absolute")}
    assert len(set(errors.values())) == 3
    assert min(errors.values()) > 0.1
    expected = PairBlock([pair]).simulate(other.as_array().reshape(5, 1, 1))[0][:, 0, 0] - pair.gap
    assert errors["absolute"] == pytest.approx(np.sqrt(np.mean(expected**2)) / pair.gap.mean())
    assert errors["relative"] == pytest.approx(np.sqrt(np.mean((expected / pair.gap) ** 2)))


def test_trimmed_pairs_lose_their_ends_and_short_pairs_are_omitted():
    pair = _pair(DRIVER, steps=301)
    (kept,) = trimmed([pair])
    assert (kept.time[0], kept.time[-1]) == pytest.approx((5.0, 27.0))
    assert len(kept.gap) == len(kept.time)
    assert trimmed([_pair(DRIVER, steps=100)]) == ()


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: calibrate([]), "no leader-follower pair"),
        (lambda: calibrate([_pair(DRIVER)], "squared"), "measure 'squared'"),
        (lambda: calibrate([_pair(DRIVER)], desired_speed=float("nan")), "desired_speed nan"),
        (lambda: trimmed([_pair(DRIVER)], begin=-1.0), "trim of -1.0 s"),
        (lambda: IdmParameters(25.0, 1.2, 2.0, float("nan"), 1.5), "acceleration = nan"),
        (
            lambda: calibrate([dataclasses.replace(_pair(DRIVER), station=np.full(400, 60.0))]),
            "least gap",
        ),
    ],
)
def test_wrong_input_is_one_clear_error(call, message):
    with pytest.raises(InputError, match=message):
        call()


def test_calibrated_types_differ_from_the_default_types_only_in_the_car():
    for ours, default in zip(calibrated_types(), default_types(), strict=True):
        assert (ours == default) == (ours.name != "car")
    assert TrafficConfig(types=calibrated_types()).types[0].time_headway == 1.09
