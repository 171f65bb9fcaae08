import dataclasses

import pytest

from traffic_bridge import default_types
from traffic_bridge.mobil import Driver, decide, idm_acceleration, incentive, neighbors

CAR = default_types()[0]
EVEN = dataclasses.replace(CAR, politeness=0.0, keep_right_bias=0.0)


def driver(name, station, lane, speed=15.0, desired=15.0, kind=EVEN, movable=True):
    return Driver(name, station, lane, speed, desired, kind, movable)


def anywhere(_, lane):
    return 0 <= lane < 3


def test_idm_is_zero_at_the_desired_speed_and_at_the_equilibrium_gap():
    free = driver("a", 0.0, 0)
    assert idm_acceleration(free, None) == pytest.approx(0.0)
    slow = driver("a", 0.0, 0, speed=10.0)
    # s_e = (s0 + v T) / sqrt(1 - (v / v0)^4), Treiber and Kesting.
    gap = (CAR.minimum_gap + 10.0 * CAR.time_headway) / (1.0 - (10.0 / 15.0) ** 4) ** 0.5
    leader = driver("b", gap + CAR.length, 0, speed=10.0)
    assert idm_acceleration(slow, leader) == pytest.approx(0.0, abs=1e-9)


def test_neighbors_are_the_nearest_on_the_lane():
    me = driver("me", 100.0, 0)
    others = [driver("a", 130.0, 1), driver("b", 120.0, 1), driver("c", 80.0, 1), me]
    ahead, behind = neighbors(others, me, 1)
    assert (ahead.name, behind.name) == ("b", "c")


def test_a_blocked_driver_goes_to_the_free_lane():
    drivers = [driver("me", 100.0, 1), driver("slow", 125.0, 1, speed=6.0)]
    assert decide(drivers, anywhere)["me"] in (0, 2)


def test_nobody_cuts_in_before_a_fast_follower():
    drivers = [
        driver("me", 100.0, 0, speed=8.0),
        driver("slow", 115.0, 0, speed=6.0),
        driver("fast", 85.0, 1, speed=20.0, desired=20.0),
    ]
    assert incentive(drivers, drivers[0], 1) is None
    assert "me" not in decide(drivers, lambda d, lane: lane in (0, 1))


def test_nobody_changes_into_the_side_of_a_long_vehicle():
    truck = next(t for t in default_types() if t.kind == "articulated")
    drivers = [
        driver("me", 100.0, 0, speed=8.0),
        driver("slow", 112.0, 0, speed=6.0),
        driver("ego", 110.0, 1, kind=truck, movable=False),
    ]
    assert incentive(drivers, drivers[0], 1) is None


def test_a_polite_driver_spares_the_follower():
    selfish = dataclasses.replace(EVEN, politeness=0.0)
    polite = dataclasses.replace(EVEN, politeness=1.0)
    gains = []
    for kind in (selfish, polite):
        drivers = [
            driver("me", 100.0, 0, speed=12.0, kind=kind),
            driver("slow", 140.0, 0, speed=10.0),
            driver("follower", 70.0, 1, speed=15.0, desired=18.0),
        ]
        gains.append(incentive(drivers, drivers[0], 1))
    assert gains[1] < gains[0]


def test_two_drivers_do_not_take_the_same_gap():
    drivers = [
        driver("a", 100.0, 0),
        driver("slow.a", 120.0, 0, speed=5.0),
        driver("b", 101.0, 2),
        driver("slow.b", 121.0, 2, speed=5.0),
    ]
    changes = decide(drivers, lambda d, lane: lane == 1)
    assert len(changes) == 1
    # The order in which the drivers are given does not matter.
    assert changes == decide(drivers[::-1], lambda d, lane: lane == 1)
