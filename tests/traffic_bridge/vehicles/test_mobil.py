import dataclasses
import math

import pytest

from traffic_bridge import default_types
from traffic_bridge.network.lane_graph import LaneGraph
from traffic_bridge.network.net_file import NetLane
from traffic_bridge.vehicles.lane_changing import LanePosition, Occupancy, decide
from traffic_bridge.vehicles.mobil import LaneNeighbors, MobilDriver, idm_acceleration, incentive

CAR = default_types()[0]
TRUCK = next(t for t in default_types() if t.kind == "articulated")
# Round figures for the hand-computed cases.
PLAIN = dataclasses.replace(
    CAR,
    length=5.0,
    minimum_gap=2.0,
    time_headway=1.5,
    acceleration=1.0,
    deceleration=4.0,
    politeness=0.0,
    change_threshold=0.1,
    keep_right_bias=0.0,
    safe_braking=4.0,
)


def driver(name="me", speed=10.0, desired=20.0, kind=PLAIN, movable=True, **changes):
    return MobilDriver(name, speed, desired, dataclasses.replace(kind, **changes), movable)


def straight_road(lanes=3, length=1000.0):
    """Edge A, then edge B, with as many lanes."""
    found = [NetLane(f"{edge}_{i}", edge, i, length) for edge in "AB" for i in range(lanes)]
    return LaneGraph(found, {f"A_{i}": [(f"B_{i}", "B")] for i in range(lanes)})


def on(graph, lane, position, who):
    return LanePosition(who, graph.lanes[lane], position, {"A": "B"}.get)


def anywhere(_place, _lane):
    return True


def around(graph, places, name, lane):
    occupancy = Occupancy(graph, places)
    return occupancy.neighbors(occupancy.places[name], graph.lanes[lane])


def test_idm_is_zero_at_the_desired_speed_and_at_the_equilibrium_gap():
    assert idm_acceleration(driver(speed=15.0, desired=15.0)) == pytest.approx(0.0)
    # s_e = (s0 + v T) / sqrt(1 - (v / v0)^4), Treiber and Kesting.
    gap = (2.0 + 10.0 * 1.5) / (1.0 - (10.0 / 15.0) ** 4) ** 0.5
    assert idm_acceleration(driver(desired=15.0), gap, 10.0) == pytest.approx(0.0, abs=1e-9)


def test_idm_agrees_with_a_value_computed_by_hand():
    # v = 10, v0 = 20, T = 1.5, s0 = 2, a = 1, b = 4, leader 6 m/s at 20 m:
    # s* = 2 + 15 + 10 * 4 / (2 * 2) = 27; a = 1 - 1/16 - (27/20)^2 = -0.885.
    assert idm_acceleration(driver(), 20.0, 6.0) == pytest.approx(-0.885)


def test_gain_of_a_selfish_driver_is_the_difference_of_two_idm_accelerations():
    here = LaneNeighbors(gap_ahead=20.0, speed_ahead=6.0)
    # Free lane: 1 - 1/16 = 0.9375; own lane -0.885; threshold 0.1.
    assert incentive(driver(), here, LaneNeighbors(), to_right=False) == pytest.approx(1.7225)


def test_politeness_counts_new_and_old_follower_under_the_symmetric_rule():
    new, old = driver("new"), driver("old")
    here = LaneNeighbors(20.0, 6.0, 17.0, old)
    there = LaneNeighbors(math.inf, 0.0, 34.0, new)
    # New follower: free 0.9375 before; behind me, gap 34, equal speed: s* = 17, so 0.9375 - 0.25.
    # Old follower: behind me, gap 17: 0.9375 - 1 = -0.0625; behind the leader, gap 17 + 5 + 20 = 42
    # at 4 m/s closing: s* = 27: 0.9375 - (27/42)^2 = 0.524235.
    others = -0.25 + (0.9375 - (27.0 / 42.0) ** 2 + 0.0625)
    selfish = incentive(driver(), here, there, to_right=False)
    for politeness in (0.5, 1.0):
        value = incentive(driver(politeness=politeness), here, there, to_right=False)
        assert value - selfish == pytest.approx(politeness * others)


def test_keep_right_rule_counts_the_follower_on_the_left_lane_only():
    new, old = driver("new"), driver("old")
    here = LaneNeighbors(20.0, 6.0, 17.0, old)
    there = LaneNeighbors(math.inf, 0.0, 34.0, new)
    own = 0.9375 + 0.885 - 0.1
    me = driver(politeness=1.0, keep_right_bias=0.3)
    assert incentive(me, here, there, to_right=False) == pytest.approx(own - 0.3 - 0.25)
    relief = 0.9375 - (27.0 / 42.0) ** 2 + 0.0625
    assert incentive(me, here, there, to_right=True) == pytest.approx(own + 0.3 + relief)


def test_keep_right_driver_returns_to_a_free_right_lane_and_a_symmetric_one_stays():
    alone = LaneNeighbors()
    assert incentive(driver(keep_right_bias=0.2), alone, alone, to_right=True) == pytest.approx(0.1)
    assert incentive(driver(), alone, alone, to_right=True) == pytest.approx(-0.1)


def test_above_the_critical_speed_passing_on_the_right_has_no_incentive():
    me = driver(speed=25.0, desired=30.0, keep_right_bias=0.2)
    slower_left = LaneNeighbors(gap_ahead=60.0, speed_ahead=20.0)
    free_right = LaneNeighbors()
    # The free right lane counts no more than the left one: bias minus threshold remains.
    assert incentive(me, slower_left, free_right, to_right=True) == pytest.approx(0.2 - 0.1)
    slow = driver(speed=14.0, desired=30.0, keep_right_bias=0.2)
    queue_left = LaneNeighbors(gap_ahead=30.0, speed_ahead=10.0)
    assert incentive(slow, queue_left, free_right, to_right=True) > 0.5


@pytest.mark.parametrize(
    "there",
    [
        LaneNeighbors(gap_ahead=1.9, speed_ahead=30.0),
        LaneNeighbors(gap_ahead=-4.0, speed_ahead=30.0),
        LaneNeighbors(gap_behind=1.9, follower=driver("new", speed=1.0)),
        # 20 m/s behind 10 m/s at 15 m: s* = 2 + 30 + 20 * 10 / 4 = 82, far beyond b_safe.
        LaneNeighbors(gap_behind=15.0, follower=driver("new", speed=20.0)),
        LaneNeighbors(gap_ahead=5.0, speed_ahead=0.0),
    ],
)
def test_a_change_without_room_or_with_hard_braking_is_not_safe(there):
    here = LaneNeighbors(gap_ahead=3.0, speed_ahead=0.0)
    assert incentive(driver(), here, there, to_right=False) is None


def test_neighbors_are_the_nearest_on_the_lane():
    graph = straight_road()
    places = [
        on(graph, "A_0", 100.0, driver("me")),
        on(graph, "A_1", 130.0, driver("a", speed=3.0)),
        on(graph, "A_1", 120.0, driver("b", speed=4.0)),
        on(graph, "A_1", 80.0, driver("c")),
        on(graph, "A_1", 60.0, driver("d")),
    ]
    found = around(graph, places, "me", "A_1")
    assert (found.gap_ahead, found.speed_ahead) == (15.0, 4.0)
    assert (found.gap_behind, found.follower.name) == (15.0, "c")


def test_neighbors_are_found_across_the_ends_of_edges():
    graph = straight_road()
    places = [
        on(graph, "A_0", 990.0, driver("me")),
        on(graph, "B_1", 30.0, driver("ahead")),
        on(graph, "B_2", 10.0, driver("at the beginning")),
        on(graph, "A_2", 950.0, driver("behind")),
    ]
    assert around(graph, places, "me", "A_1").gap_ahead == pytest.approx(10.0 + 30.0 - 5.0)
    found = around(graph, places, "at the beginning", "B_2")
    assert found.gap_behind == pytest.approx(10.0 + 50.0 - 5.0)
    assert found.follower.name == "behind"


def test_the_rear_of_a_long_vehicle_counts_on_the_edge_that_it_leaves():
    graph = straight_road()
    places = [
        on(graph, "A_0", 995.0, driver("me")),
        on(graph, "B_1", 8.0, driver("lorry", kind=TRUCK)),
    ]
    found = around(graph, places, "me", "A_1")
    assert found.gap_ahead == pytest.approx(5.0 + 8.0 - TRUCK.length)


def test_where_lanes_join_the_nearest_follower_counts():
    merged = [
        NetLane("A_0", "A", 0, 100.0),
        NetLane("R_0", "R", 0, 100.0),
        NetLane("B_0", "B", 0, 500.0),
    ]
    graph = LaneGraph(merged, {"A_0": [("B_0", "B")], "R_0": [("B_0", "B")]})
    places = [
        on(graph, "B_0", 20.0, driver("me")),
        on(graph, "A_0", 50.0, driver("main")),
        on(graph, "R_0", 90.0, driver("ramp")),
    ]
    assert around(graph, places, "me", "B_0").follower.name == "ramp"


def test_the_end_of_a_lane_is_an_obstacle_and_the_end_of_the_way_is_not():
    lanes = [
        NetLane("A_0", "A", 0, 500.0),
        NetLane("A_1", "A", 1, 500.0),
        NetLane("B_0", "B", 0, 500.0),
    ]
    graph = LaneGraph(lanes, {"A_1": [("B_0", "B")]})
    places = [on(graph, "A_1", 450.0, driver("me")), on(graph, "B_0", 450.0, driver("far"))]
    assert around(graph, places, "me", "A_0").gap_ahead == pytest.approx(50.0)
    assert around(graph, places, "far", "B_0").gap_ahead == math.inf
    leaving = [on(graph, "A_0", 420.0, driver("me"))]
    assert decide(graph, Occupancy(graph, leaving), anywhere)["me"].id == "A_1"


def test_a_blocked_driver_changes_to_the_free_lane():
    graph = straight_road(lanes=2)
    places = [
        on(graph, "A_1", 100.0, driver("me")),
        on(graph, "A_1", 125.0, driver("slow", speed=6.0, movable=False)),
    ]
    changes = decide(graph, Occupancy(graph, places), anywhere)
    assert {name: lane.id for name, lane in changes.items()} == {"me": "A_0"}


def test_a_driver_does_not_change_lanes_beside_a_long_vehicle():
    graph = straight_road(lanes=2)
    places = [
        on(graph, "A_0", 100.0, driver("me", speed=8.0)),
        on(graph, "A_0", 112.0, driver("slow", speed=6.0)),
        on(graph, "A_1", 110.0, driver("ego", kind=TRUCK, movable=False)),
    ]
    assert "me" not in decide(graph, Occupancy(graph, places), anywhere)


def test_two_drivers_do_not_take_the_same_gap():
    graph = straight_road()
    places = [
        on(graph, "A_0", 100.0, driver("a")),
        on(graph, "A_0", 120.0, driver("slow.a", speed=5.0, movable=False)),
        on(graph, "A_2", 101.0, driver("b")),
        on(graph, "A_2", 121.0, driver("slow.b", speed=5.0, movable=False)),
    ]

    def middle(_place, lane):
        return lane.id == "A_1"

    changes = decide(graph, Occupancy(graph, places), middle)
    assert list(changes) == ["a"]
    # The order of the drivers does not matter.
    again = [
        dataclasses.replace(p, lane=graph.lanes[lane])
        for p, lane in zip(places[::-1], ("A_2", "A_2", "A_0", "A_0"), strict=True)
    ]
    assert decide(graph, Occupancy(graph, again), middle) == changes


def test_a_later_decision_includes_the_place_that_an_earlier_driver_left():
    graph = straight_road(lanes=2)
    places = [
        on(graph, "A_0", 150.0, driver("a", speed=5.0)),
        on(graph, "A_0", 170.0, driver("block", speed=0.0, movable=False)),
        on(graph, "A_0", 120.0, driver("b", speed=5.0)),
    ]
    occupancy = Occupancy(graph, places)
    decide(graph, occupancy, lambda place, lane: place.driver.name == "a")
    assert occupancy.neighbors(occupancy.places["b"], graph.lanes["A_0"]).gap_ahead == 45.0


def test_a_driver_does_not_change_to_a_place_that_another_one_is_leaving():
    graph = straight_road()
    places = [
        on(graph, "A_1", 100.0, driver("a")),
        on(graph, "A_1", 120.0, driver("slow.a", speed=5.0, movable=False)),
        on(graph, "A_2", 103.0, driver("b")),
        on(graph, "A_2", 123.0, driver("slow.b", speed=2.0, movable=False)),
    ]

    def to_the_right(place, lane):
        return lane.index < place.lane.index

    occupancy = Occupancy(graph, places)
    assert list(decide(graph, occupancy, to_the_right)) == ["a"]
    assert not occupancy.is_clear(occupancy.places["b"], graph.lanes["A_1"])
    # A faster vehicle from behind touches it if it leaves within 3 s, but not within 1 s.
    for time, clear in ((3.0, False), (1.0, True)):
        fast = Occupancy(graph, [*places, on(graph, "A_2", 80.0, driver("fast", speed=15.0))])
        fast.note_leaving("a", "A_1", time)
        assert fast.is_clear(fast.places["fast"], graph.lanes["A_1"]) is clear
    # Afterwards the place is free.
    later = Occupancy(graph, occupancy.places.values())
    assert later.is_clear(later.places["b"], graph.lanes["A_1"])
