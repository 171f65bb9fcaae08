"""The policy for every price: network, file, mask, and what the shipped one does."""

import dataclasses
import itertools
import math

import numpy as np
import pytest

from controllers.decision import make
from controllers.decision.fast_world.env import HighwayEnv
from controllers.decision.fast_world.worlds import FastWorlds
from controllers.decision.learning.rollouts import drive_step
from controllers.decision.policy import SHIPPED
from controllers.decision.priced import (
    EASE,
    EASED,
    EASES_FROM,
    IMPOSED_BRAKING_MAX,
    PRICED_LAYERS,
    PricedNetwork,
    PricedPolicy,
    load_priced,
    priced_layers,
    worth,
)
from controllers.decision.prices import PriceOptions, Prices
from controllers.decision.rules import CAR, compiled, imposed_braking
from controllers.decision.trip import VALIDATION_SEEDS, cell_trip
from iits_mj.core.errors import InputError
from iits_mj.core.messages import Decision
from tests.controllers.decision.test_rules import ahead, behind, context


def network(seed=0, members=2, bias=None, layers=PRICED_LAYERS):
    """A random network; with a bias, one whose outputs are the bias."""
    generator = np.random.default_rng(seed)
    weights = tuple(
        generator.normal(0.0, (bias is None) * math.sqrt(2.0 / n), (members, m, n)).astype("f4")
        for n, m in itertools.pairwise(layers)
    )
    biases = [np.zeros(w.shape[:2], "f4") for w in weights]
    if bias is not None:
        biases[-1][:] = bias
    return PricedNetwork(weights, tuple(biases))


# Both changes gain 500 m and cost one change.
EAGER = network(bias=[500.0, 1.0, 0.0, 0.0] * 2)


def test_layers_are_the_papers_hidden_ones_with_three_prices():
    assert PRICED_LAYERS == (219, 256, 512, 256, 8)


def test_worth_is_way_less_priced_changes_braking_and_left_time():
    parts = np.array([120.0, 1.5, 0.5, 20.0], np.float32)
    assert worth(parts, [60.0, 10.0, 0.5]) == pytest.approx(120.0 - 90.0 - 5.0 - 10.0)


def test_a_file_keeps_the_network_in_numbers_of_16_bits(tmp_path):
    first, path = network(), tmp_path / "priced.npz"
    first.save(path, command="a test")
    again = PricedNetwork.load(path)
    assert again.metadata["command"] == "a test"
    assert len(again) == 2
    seen = np.random.default_rng(1).uniform(-1.0, 1.0, (20, 216))
    found, wanted = (n.components(seen, [60.0, 0.0, 0.0]) for n in (again, first))
    assert np.abs(found - wanted).max() < 0.02 * np.abs(wanted).max()


def test_members_of_several_networks_are_joined():
    both = PricedNetwork.joined([network(0, 1), network(1, 1)])
    seen = np.zeros(216)
    parts = both.components(seen, [60.0, 0.0, 0.0])
    assert parts.shape == (2, 2, 4)
    np.testing.assert_array_equal(parts[1], network(1, 1).components(seen, [60.0, 0.0, 0.0])[0])


def test_a_network_of_other_shapes_or_not_finite_is_refused():
    good = network()
    with pytest.raises(InputError, match="must be members"):
        dataclasses.replace(good, weights=good.weights[:2])
    broken = good.weights[0].copy()
    broken[0, 0, 0] = np.nan
    with pytest.raises(InputError, match="not finite"):
        dataclasses.replace(good, weights=(broken, *good.weights[1:]))


def test_the_file_of_the_papers_policy_is_refused():
    with pytest.raises(InputError, match="has format"):
        PricedNetwork.load(SHIPPED)


@pytest.mark.parametrize(
    ("name", "value"),
    [("lane_change", 5.0), ("lane_change", math.nan), ("imposed_braking", -1.0), ("left_lane", 9)],
)
def test_prices_outside_the_training_are_refused(name, value):
    with pytest.raises(InputError, match=name.replace("_", "-")):
        Prices(**{name: value})


def test_flags_without_a_price_of_a_change_give_the_papers_policy():
    assert PriceOptions().prices() is None
    assert PriceOptions(lane_change_price=60.0).prices() == Prices(60.0, 0.0, 0.0)
    with pytest.raises(InputError, match="needs lane-change-price"):
        PriceOptions(left_lane_price=1.0).prices()
    with pytest.raises(InputError, match="takes no prices"):
        make("mobil", prices=Prices())


@pytest.mark.parametrize(("gap", "speed"), [(25.0, 12.0), (60.0, 15.0), (200.0, 10.0)])
def test_imposed_braking_is_the_interaction_term_of_a_car(gap, speed):
    found = imposed_braking(context(behind(gap, 1, speed), speed=13.0))[Decision.LEFT]
    closing = speed * (speed - 13.0) / (2.0 * math.sqrt(CAR.acceleration_max * CAR.deceleration))
    wanted = CAR.standstill_gap + max(0.0, speed * CAR.time_gap + closing)
    assert found == pytest.approx(CAR.acceleration_max * (wanted / gap) ** 2, rel=1e-6)


def test_no_braking_is_imposed_on_an_empty_lane_and_none_is_possible_without_a_lane():
    braking = imposed_braking(context(speed=13.0))
    assert braking == {Decision.LEFT: 0.0, Decision.RIGHT: math.inf}
    assert imposed_braking(context(ahead(3.0, 1)))[Decision.LEFT] == math.inf


def test_the_policy_changes_only_where_the_new_follower_need_not_brake_hard():
    policy = PricedPolicy(EAGER, Prices())
    answers = {}
    for gap in np.arange(10.0, 80.0, 2.0):
        at = context(behind(gap, 1, 12.0), speed=12.0)
        answers[imposed_braking(at)[Decision.LEFT]] = policy.decide(at)
    assert {b for b, d in answers.items() if d is Decision.LEFT} == {
        b for b in answers if b < IMPOSED_BRAKING_MAX
    }
    assert len(set(answers.values())) == 2


def test_the_policy_never_asks_for_a_lane_that_does_not_exist():
    policy = PricedPolicy(network(bias=[0.0, 1.0, 0.0, 0.0, 900.0, 1.0, 0.0, 0.0]), Prices())
    assert policy.decide(context(lane=0)) is Decision.KEEP
    assert policy.decide(context(lane=1)) is Decision.RIGHT


def test_a_change_that_gains_less_than_its_price_is_not_made():
    at = context()
    assert PricedPolicy(EAGER, Prices(lane_change=400.0)).decide(at) is Decision.LEFT
    half = network(bias=[300.0, 1.0, 0.0, 0.0] * 2)
    assert PricedPolicy(half, Prices(lane_change=400.0)).decide(at) is Decision.KEEP


# To ease off gains 50 m; changes gain nothing.
EASING = network(bias=[0.0] * 8 + [50.0, 0.0, 0.0, 0.0], layers=priced_layers(3))


def test_a_policy_with_the_speed_action_eases_off_from_the_speed_at_which_it_began():
    policy = PricedPolicy(EASING, Prices())
    assert policy.decide(context(speed=15.0)) is Decision.KEEP
    assert policy.speed_max == 15.0 - EASED
    policy.decide(context(speed=14.2))
    assert policy.speed_max == 15.0 - EASED
    policy.reset()
    assert policy.speed_max == math.inf
    policy.decide(context(speed=EASES_FROM - 0.1))
    assert policy.speed_max == math.inf


def test_a_change_that_is_worth_more_ends_easing_off():
    network_of_both = network(bias=[500.0, 1.0, *[0.0] * 6, 50.0, 0, 0, 0], layers=priced_layers(3))
    policy = PricedPolicy(network_of_both, Prices())
    beside = behind(-5.0, 1, 15.0)
    assert policy.decide(context(beside, speed=15.0)) is Decision.KEEP
    assert policy.speed_max == 15.0 - EASED
    assert policy.decide(context(speed=14.0)) is Decision.LEFT
    assert policy.speed_max == math.inf


def test_worlds_and_contexts_ease_off_alike():
    env, worlds, policy = HighwayEnv(), FastWorlds(1), PricedPolicy(EASING, Prices())
    for world in (env, worlds):
        arguments = (np.random.default_rng(4), cell_trip("sparse", 12.5))
        world.reset(*arguments) if world is env else world.reset(0, *arguments)
    for _ in range(20):
        env.step(policy.decide(env.context()), policy.speed_max)
        drive_step(worlds, np.array([EASE]))
        assert env.state["speed"] == worlds.states["speed"][0]
        assert env.state["speed_max"] == worlds.states["speed_max"][0] < math.inf


def divided(spread):
    """A network of two members, one of which values a change to the left more by a way [m]."""
    members = [network(members=1, bias=[500.0 + x, 1.0, *[0.0] * 6]) for x in (0.0, spread)]
    return dataclasses.replace(PricedNetwork.joined(members), disagreement_max=0.5)


def test_members_that_disagree_leave_the_decision_to_the_rule():
    # The usual worth of a change is 70 m at a price of 100 m, and half of it is 35 m.
    sure, unsure = (PricedPolicy(divided(spread), Prices()) for spread in (69.0, 71.0))
    at, behind_slow = context(), context(ahead(40.0, 0, 8.0))
    assert sure.decide(at) is Decision.LEFT
    assert not sure.unsure
    # On a free road the rule gains nothing from a change; it passes a slow vehicle.
    assert unsure.decide(at) is Decision.KEEP
    assert unsure.unsure
    assert unsure.decide(behind_slow) is Decision.LEFT
    assert unsure.unsure_decisions == 2
    unsure.reset()
    assert unsure.unsure_decisions == 0


def test_a_road_of_five_lanes_leaves_the_decision_to_the_rule():
    policy = PricedPolicy(EAGER, Prices())
    five = dataclasses.replace(context(), lanes=(0, 1, 2, 3, 4))
    assert policy.decide(five) is Decision.KEEP
    assert policy.unsure_decisions == 1


def test_the_rule_also_makes_no_follower_brake_hard():
    policy = PricedPolicy(divided(500.0), Prices(20.0))
    close = context(ahead(30.0, 0, 8.0), behind(14.0, 1, 12.0), speed=12.0)
    assert policy.rule.decide(close) is Decision.LEFT
    assert imposed_braking(close)[Decision.LEFT] > IMPOSED_BRAKING_MAX
    assert policy.decide(close) is Decision.KEEP


def test_a_file_keeps_the_limit_of_disagreement(tmp_path):
    path = tmp_path / "priced.npz"
    for limit in (0.5, math.inf):
        dataclasses.replace(divided(1.0), disagreement_max=limit).save(path)
        assert PricedNetwork.load(path).disagreement_max == limit
    with pytest.raises(InputError, match="disagreement_max"):
        dataclasses.replace(divided(1.0), disagreement_max=math.nan)


def test_worlds_and_contexts_agree_on_imposed_braking():
    env, worlds = HighwayEnv(), FastWorlds(1)
    trip = cell_trip("medium", 12.5)
    env.reset(np.random.default_rng(4), trip)
    worlds.reset(0, np.random.default_rng(4), trip)
    rule = compiled(make("lookahead"))
    free = 0
    for _ in range(150):
        braking, seen = worlds.imposed_braking()[0], imposed_braking(env.context())
        assert braking[1] == 0.0
        for column, side in ((0, Decision.LEFT), (2, Decision.RIGHT)):
            if worlds.allowed()[0, column]:
                assert braking[column] == pytest.approx(seen[side])
                free += braking[column] < math.inf
            else:
                assert braking[column] == math.inf
        decision = worlds.decide(rule)
        worlds.step(decision)
        env.step(Decision(int(decision[0])))
    assert free > 20


def summaries(price, trips=6):
    """Trips of 5 km of the shipped policy in medium traffic."""
    policy, found = load_priced(lane_change=price), []
    for number in range(trips):
        env = HighwayEnv()
        trip = dataclasses.replace(cell_trip("medium", 12.5), length=5_000.0)
        env.reset(np.random.default_rng(VALIDATION_SEEDS + 900_000 + number), trip)
        env.drive(policy)
        found.append((env.summary, int(env.state["imposed_brakings"])))
    return found


def test_the_shipped_policy_trades_lane_changes_for_speed():
    calm, brisk = ([s for s, _ in summaries(price)] for price in (400.0, 20.0))
    changes = [sum(s.changes for s in trips) for trips in (calm, brisk)]
    losses = [sum(s.speed_loss for s in trips) for trips in (calm, brisk)]
    assert changes[0] < 0.8 * changes[1]
    assert losses[0] > losses[1]


def test_the_shipped_policy_collides_with_nobody_and_makes_nobody_brake_hard():
    found = summaries(60.0)
    assert sum(s.collisions + s.dangerous for s, _ in found) == 0
    assert sum(s.changes for s, _ in found) >= 10
    assert sum(hard for _, hard in found) == 0
