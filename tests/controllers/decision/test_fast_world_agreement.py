"""The compiled fast world against its NumPy form: the same seed drives the same trip."""

from dataclasses import replace

import numpy as np
import pytest

from controllers.decision import make
from controllers.decision.fast_world import state
from controllers.decision.fast_world.env import HighwayEnv
from controllers.decision.fast_world.worlds import FastWorlds
from controllers.decision.rules import LookAhead, Mobil, compiled
from controllers.decision.trip import CELLS, TripConfig, cell_trip
from iits_mj.core.messages import Decision
from tests.controllers.decision import numpy_world

FAST_TRAFFIC = {"traffic_speed": 30.0, "reference_speed": 22.2}
SETTINGS = {
    "free": {},
    "keep right": {"keeps_right": True},
    "three lanes": {"lanes": 3},
    "keep right at 30 m/s": {"keeps_right": True, "lanes": 3, **FAST_TRAFFIC},
    "truck keeps right": {"truck_keeps_right": True, "spawn_probability": 0.02},
    "limit of trucks": {"lanes": 3, "truck_speed_limit": 11.0},
    "ramps": {"ramp_probability": 0.15, "ramp_interval": 500.0},
    "end of the road": {"length": 900.0},
    "laden on hills": {"payload": 36_000.0, "spawn_probability": 0.005, "reference_speed": 22.0},
    "all": {
        "keeps_right": True,
        "truck_keeps_right": True,
        "lanes": 3,
        "truck_speed_limit": 22.2,
        "ramp_probability": 0.1,
        **FAST_TRAFFIC,
    },
}
MAKERS = {
    **{name: make(name) for name in ("keep", "conservative", "neutral", "aggressive")},
    "mobil": Mobil(),
    "eager mobil": Mobil(politeness=0.0, threshold=0.02, right_bias=0.3, safe_deceleration=3.0),
    "lookahead": LookAhead(),
    "far lookahead": LookAhead(horizon=30.0, change_cost=25.0, right_gain=5.0),
}


def worlds(trip, seed):
    reference, compiled_world = numpy_world.HighwayEnv(), HighwayEnv()
    for world in (reference, compiled_world):
        world.reset(np.random.default_rng(seed), trip)
    return reference, compiled_world


def check_traffic(reference, world, tolerance=1e-6):
    """Every vehicle is in the same place: 1e-6 m, where 1e-3 m after 25 s is asked for."""
    order, ours = (np.argsort(one.traffic.serial) for one in (reference, world))
    for name in ("serial", "lane", "kind"):
        found = getattr(world.traffic, name)[ours]
        assert np.array_equal(getattr(reference.traffic, name)[order], found), name
    for name in ("front", "speed", "acceleration", "length", "desired"):
        found = getattr(world.traffic, name)[ours]
        np.testing.assert_allclose(found, getattr(reference.traffic, name)[order], atol=tolerance)
    truck = reference.truck
    place = [truck.front, truck.speed, truck.acceleration, reference.lane, reference.time]
    found = world.state[["front", "speed", "acceleration", "lane", "time"]].tolist()
    np.testing.assert_allclose(found, place, atol=tolerance)


@pytest.mark.parametrize("setting", SETTINGS)
def test_random_decisions_have_the_same_outcomes_and_observations(setting):
    trip = replace(cell_trip("dense", 12.5, TripConfig(duration=90.0)), **SETTINGS[setting])
    reference, world = worlds(trip, seed=11)
    generator = np.random.default_rng(4)
    over = False
    while not over:
        decision = Decision(int(generator.integers(-1, 2)))
        expected, found = reference.step(decision), world.step(decision)
        check_traffic(reference, world)
        np.testing.assert_allclose(found.observation, expected.observation, atol=1e-6)
        assert vars(found.reward) == pytest.approx(vars(expected.reward), abs=1e-9)
        ends = ("seconds", "terminated", "truncated")
        assert [getattr(found, n) for n in ends] == [getattr(expected, n) for n in ends]
        over = expected.terminated or expected.truncated
    check_totals(reference, world)
    assert world.summary.refused > 5


def test_a_highest_speed_has_the_same_effect_in_both():
    reference, world = worlds(cell_trip("medium", 15.0, TripConfig(duration=60.0)), seed=3)
    generator = np.random.default_rng(5)
    while reference.time < 50.0:
        decision, top = Decision(int(generator.integers(-1, 2))), generator.uniform(5.0, 20.0)
        reference.step(decision, top)
        world.step(decision, top)
        check_traffic(reference, world)
    check_totals(reference, world)


def check_totals(reference, world):
    expected, found = dict(vars(reference.summary)), dict(vars(world.summary))
    for part in ("reward", "quality"):
        parts = [vars(totals.pop(part)) for totals in (expected, found)]
        assert parts[1] == pytest.approx(parts[0], abs=1e-6), part
    assert found == pytest.approx(expected, abs=1e-6)


def test_the_random_numbers_are_those_of_numpy():
    """8 000 vehicles: the tails of the distributions take other ways through the code."""
    trip = TripConfig(spawn_probability=0.5, lanes=3)
    for seed in range(40):
        check_traffic(*worlds(trip, seed), tolerance=1e-9)


@pytest.mark.parametrize("name", MAKERS)
def test_a_rule_decides_in_the_compiled_world_as_it_does_on_the_scene(name):
    maker = MAKERS[name]
    table = compiled(maker)
    decisions = []
    right = {"truck_keeps_right": True, "spawn_probability": 0.02, "lanes": 3}
    for setting in ({}, {"keeps_right": True}, {"lanes": 3}, right):
        trip = replace(cell_trip("dense", 12.5, TripConfig(duration=400.0)), **setting)
        fast = FastWorlds(1)
        fast.reset(0, np.random.default_rng(2), trip)
        world = HighwayEnv()
        world.reset(np.random.default_rng(2), trip)
        over = False
        while not over:
            decision = maker.decide(world.context())
            assert fast.decide(table)[0] == int(decision)
            decisions.append(decision)
            step = world.step(decision)
            fast.step([int(decision)])
            over = step.terminated or step.truncated
    assert name == "keep" or Decision.LEFT in decisions


@pytest.mark.parametrize("cell", CELLS)
@pytest.mark.parametrize("name", ["aggressive", "mobil", "lookahead"])
def test_trips_of_the_rules_agree_decision_for_decision(cell, name):
    maker = make(name)
    trip = cell_trip(*cell, TripConfig(duration=60.0))
    reference, world = worlds(trip, seed=23)
    over = False
    while not over:
        decision = maker.decide(reference.context())
        assert decision is maker.decide(world.context())
        step = reference.step(decision)
        world.step(decision)
        over = step.terminated or step.truncated
    check_traffic(reference, world)
    check_totals(reference, world)


@pytest.mark.slow
@pytest.mark.parametrize("setting", SETTINGS)
@pytest.mark.parametrize("name", ["conservative", "mobil", "lookahead"])
def test_whole_trips_agree(setting, name):
    maker = make(name)
    trip = replace(cell_trip("dense", 12.5, TripConfig(duration=1000.0)), **SETTINGS[setting])
    reference, world = worlds(trip, seed=31)
    over = False
    while not over:
        step = reference.step(maker.decide(reference.context()))
        over = step.terminated or step.truncated
    world.drive(maker)
    check_traffic(reference, world, tolerance=1e-3)
    check_totals(reference, world)


def test_the_state_has_the_fields_of_the_compiled_world():
    assert state.world_size() == state.WORLD_SIZE
