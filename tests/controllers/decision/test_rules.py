import numpy as np
import pytest

from controllers.decision import make
from controllers.decision.base import DecisionContext
from iits_mj.core.errors import InputError
from iits_mj.core.messages import Decision, EgoState, Scene
from iits_mj.road import Route
from tests.controllers.scenes import car

ROUTE = Route.straight(length=5000.0)
FRONT = 1001.4
CLEARANCE = [("conservative", 150.0), ("neutral", 100.0), ("aggressive", 50.0)]


def context(*vehicles, lane=0, speed=16.0, lanes=(0, 1)):
    ego = EgoState(station=1000.0, offset=float(ROUTE.lane_offset(lane, 1000.0)), speed=speed)
    return DecisionContext(
        scene=Scene(0.0, ego, tuple(vehicles)),
        route=ROUTE,
        lane=lane,
        lanes=lanes,
        reference_speed=16.67,
        observation=np.zeros(216, dtype=np.float32),
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
