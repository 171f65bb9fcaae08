import math

import numpy as np
import pytest

from controllers.decision import make
from controllers.decision.base import DecisionContext
from controllers.decision.rules import CAR, HARDEST_BRAKING, TRUCK, ClearanceRule, LookAhead, Mobil
from controllers.planning.config import SafetyConfig
from controllers.planning.following import idm_acceleration
from controllers.planning.safety import front_gap_needed, rear_gap_needed
from iits_mj.core.errors import InputError
from iits_mj.core.messages import Decision, EgoState, Scene
from iits_mj.road import Route
from tests.controllers.scenes import car

ROUTE = Route.straight(length=5000.0)
FRONT = 1001.4
CLEARANCE = [("conservative", 150.0), ("neutral", 100.0), ("aggressive", 50.0)]


def context(*vehicles, lane=0, speed=16.0, lanes=(0, 1), may_pass=True):
    ego = EgoState(station=1000.0, offset=float(ROUTE.lane_offset(lane, 1000.0)), speed=speed)
    return DecisionContext(
        scene=Scene(0.0, ego, tuple(vehicles)),
        route=ROUTE,
        lane=lane,
        lanes=lanes,
        reference_speed=16.67,
        observation=np.zeros(216, dtype=np.float32),
        may_pass=may_pass,
    )


def ahead(gap, lane, speed=12.0, name="ahead"):
    return car(ROUTE, name, FRONT + gap + 2.4, lane, speed)


def behind(gap, lane, speed=12.0, name="behind"):
    return car(ROUTE, name, FRONT - 16.5 - gap - 2.4, lane, speed)


@pytest.mark.parametrize(("name", "d"), CLEARANCE)
def test_a_rule_changes_lanes_only_if_the_leader_is_closer_than_d(name, d):
    rule = make(name)
    assert rule.decide(context(ahead(d - 1.0, 0))) is Decision.LEFT
    assert rule.decide(context(ahead(d + 1.0, 0))) is Decision.KEEP


@pytest.mark.parametrize(("name", "d"), CLEARANCE)
def test_a_rule_needs_the_other_lane_free_for_d_ahead_and_behind(name, d):
    rule, obstacle = make(name), ahead(d - 10.0, 0)
    assert rule.decide(context(obstacle, ahead(d - 1.0, 1, name="x"))) is Decision.KEEP
    assert rule.decide(context(obstacle, behind(d - 1.0, 1))) is Decision.KEEP
    both = (ahead(d + 1.0, 1, name="x"), behind(d + 1.0, 1))
    assert rule.decide(context(obstacle, *both)) is Decision.LEFT


def test_a_vehicle_beside_the_trailer_prevents_a_change():
    beside = car(ROUTE, "beside", 992.0, 1, 16.0)
    assert make("aggressive").decide(context(ahead(40.0, 0), beside)) is Decision.KEEP


def test_a_rule_prefers_left_and_changes_right_from_the_left_lane():
    rule = make("neutral")
    assert rule.decide(context(ahead(60.0, 1), lane=1, lanes=(0, 1, 2))) is Decision.LEFT
    assert rule.decide(context(ahead(60.0, 1), lane=1)) is Decision.RIGHT


def test_a_rule_keeps_the_left_lane_on_a_free_road():
    assert make("aggressive").decide(context(lane=1)) is Decision.KEEP


@pytest.mark.parametrize("name", ["mobil", "lookahead"])
def test_mobil_and_lookahead_overtake_a_slow_leader(name):
    assert make(name).decide(context(ahead(45.0, 0, 11.0))) is Decision.LEFT


@pytest.mark.parametrize("name", ["mobil", "lookahead"])
def test_mobil_and_lookahead_keep_the_lane_if_the_other_leader_is_slower(name):
    slower = ahead(45.0, 1, 9.0, "slower")
    assert make(name).decide(context(ahead(45.0, 0, 12.0), slower)) is Decision.KEEP


@pytest.mark.parametrize("name", ["mobil", "lookahead"])
def test_mobil_and_lookahead_do_not_cut_in_before_a_fast_follower(name):
    fast = behind(15.0, 1, 24.0)
    assert make(name).decide(context(ahead(45.0, 0, 11.0), fast)) is Decision.KEEP


@pytest.mark.parametrize("name", ["keep", "conservative", "mobil", "lookahead"])
def test_no_decision_maker_changes_lanes_on_an_empty_road(name):
    maker = make(name)
    maker.reset()
    assert maker.name == name
    assert maker.decide(context()) is Decision.KEEP
    assert maker.decide(context(lane=1)) is Decision.KEEP


def test_unknown_names_and_weights_for_a_rule_are_refused():
    with pytest.raises(InputError, match="bold"):
        make("bold")
    with pytest.raises(InputError, match="takes no weights"):
        make("keep", weights="policy.npz")


def python_form(maker, context):
    """The rules as one writes them in Python: the reference of the compiled ones."""
    neighbors, route, ego = context.scene.neighbors, context.route, context.scene.ego
    desired, length = context.reference_speed, context.scene.footprint.length

    def ends(lane):
        return neighbors.leader_in_lane(route, lane), neighbors.follower_in_lane(route, lane)

    def behind(leader, speed, wish, config, gap=None):
        if gap is None:
            gap = math.inf if leader is None else leader.gap
        return idm_acceleration(speed, wish, gap, 0.0 if leader is None else leader.speed, config)

    def allow(leader, follower):
        if leader and leader.gap < front_gap_needed(ego.speed, leader.speed, SafetyConfig()):
            return False
        return follower is None or follower.gap >= rear_gap_needed(
            ego.speed, follower.speed, SafetyConfig()
        )

    def loss(follower, leader):
        """Accelerations with the truck ahead and without it."""
        wish = max(follower.speed, desired)
        gap = math.inf if leader is None else follower.gap + length + leader.gap
        with_truck = idm_acceleration(follower.speed, wish, follower.gap, ego.speed, CAR)
        return with_truck, behind(leader, follower.speed, wish, CAR, gap)

    def incentive(lane):
        (old, follows), (new, newly) = ends(context.lane), ends(lane)
        if not allow(new, newly):
            return -math.inf
        gain = behind(new, ego.speed, desired, TRUCK) - behind(old, ego.speed, desired, TRUCK)
        others = 0.0
        if newly is not None:
            with_truck, free = loss(newly, new)
            if with_truck < -maker.safe_deceleration:
                return -math.inf
            others += free - with_truck
        if follows is not None and follows.gap > 0.0:
            with_truck, free = loss(follows, old)
            others -= free - with_truck
        return gain - maker.politeness * others

    def roll_out(leader):
        speed, distance = ego.speed, 0.0
        gap, ahead = (math.inf, 0.0) if leader is None else (leader.gap, leader.speed)
        for _ in range(round(maker.horizon / maker.step)):
            a = idm_acceleration(speed, desired, gap, ahead, TRUCK)
            after = max(0.0, speed + max(a, -HARDEST_BRAKING) * maker.step)
            moved = 0.5 * (speed + after) * maker.step
            distance, gap, speed = distance + moved, gap + ahead * maker.step - moved, after
        return distance

    if isinstance(maker, ClearanceRule):
        leader, _ = ends(context.lane)
        if leader is None or leader.gap >= maker.clearance:
            return Decision.KEEP
        free = (s for s, k in context.sides() if neighbors.least_gap(route, k) >= maker.clearance)
        return next(free, Decision.KEEP)
    best = 0.0 if isinstance(maker, Mobil) else roll_out(ends(context.lane)[0])
    choice = Decision.KEEP
    for side, lane in context.sides():
        if isinstance(maker, Mobil):
            worth = incentive(lane) + (maker.right_bias * int(side) - maker.threshold)
        elif allow(*ends(lane)):
            worth = roll_out(ends(lane)[0]) - maker.change_cost + maker.right_gain * int(side)
        else:
            continue
        if worth > best:
            best, choice = worth, side
    return choice


@pytest.mark.parametrize(
    "maker",
    [
        *(make(name) for name in ("conservative", "neutral", "aggressive", "mobil", "lookahead")),
        Mobil(politeness=0.6, threshold=0.01, right_bias=0.4, safe_deceleration=4.0),
        LookAhead(horizon=30.0, step=1.0, change_cost=3.0, right_gain=2.5),
    ],
)
def test_a_compiled_rule_decides_as_its_python_form(maker):
    generator = np.random.default_rng(3)
    counts = dict.fromkeys(Decision, 0)
    for _ in range(400):
        vehicles = [
            car(ROUTE, str(k), 1000.0 + generator.uniform(-90.0, 160.0), lane, speed)
            for k, lane, speed in zip(
                range(7),
                generator.integers(3, size=7),
                generator.uniform(8.0, 20.0, 7),
                strict=True,
            )
        ]
        at = context(*vehicles, lane=1, speed=generator.uniform(9.0, 17.0), lanes=(0, 1, 2))
        decision = maker.decide(at)
        assert decision is python_form(maker, at)
        counts[decision] += 1
    assert min(counts.values()) > 3


@pytest.mark.parametrize("speed", [12.5, 15.6, 17.0])
def test_the_planners_gaps_are_those_of_the_compiled_rules(speed):
    """A change is just allowed, and just not allowed, at the gap that the planner needs."""
    rule, slow, config = LookAhead(change_cost=0.0), ahead(12.0, 0, 9.0), SafetyConfig()
    for place, needed in (
        (ahead, front_gap_needed(16.0, speed, config)),
        (behind, rear_gap_needed(16.0, speed, config)),
    ):
        scenes = [context(slow, place(needed + d, 1, speed, "new")) for d in (0.01, -0.01)]
        assert [rule.decide(scene) for scene in scenes] == [Decision.LEFT, Decision.KEEP]


def test_parameters_of_rules_out_of_range_are_refused():
    for wrong in ({"horizon": 0.1}, {"step": 0.0}, {"change_cost": -1.0}):
        with pytest.raises(InputError, match=next(iter(wrong))):
            LookAhead(**wrong)
    with pytest.raises(InputError, match="politeness"):
        Mobil(politeness=-0.1)
    for text in ("lookahead:horizon=nan", "lookahead:step=1e-9", "mobil:threshold=high"):
        with pytest.raises(
            InputError, match=f"decision maker '{text}': .*(horizon|step|threshold)"
        ):
            make(text)


def test_a_rule_is_named_with_its_options():
    assert make("lookahead:horizon=30,change_cost=25") == LookAhead(horizon=30, change_cost=25)
    assert make("mobil:threshold=0.4") == Mobil(threshold=0.4)
    # The vehicle ahead costs 5 m/s; behind the other one a change gains 3 m/s.
    scene = context(ahead(60.0, 0, 11.0), ahead(60.0, 1, 14.0, "faster"))
    for cost, decision in ((5.0, Decision.LEFT), (200.0, Decision.KEEP)):
        assert make(f"lookahead:horizon=30:change_cost={cost}").decide(scene) is decision


@pytest.mark.parametrize("name", ["conservative", "mobil", "lookahead"])
def test_a_rule_does_not_ask_to_pass_where_the_truck_may_not(name):
    slow, rule = ahead(45.0, 0, speed=9.0), make(name)
    assert rule.decide(context(slow)) is Decision.LEFT
    assert rule.decide(context(slow, may_pass=False)) is Decision.KEEP
    # A truck in the left lane may still change to the right.
    there = ahead(45.0, 1, speed=9.0)
    assert rule.decide(context(there, lane=1, may_pass=False)) is Decision.RIGHT
