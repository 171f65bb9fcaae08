"""Many fast worlds at once: independence, copies, masks, roll-outs, draws of what is hidden."""

from dataclasses import replace

import numpy as np
import pytest

from controllers.decision import make
from controllers.decision.fast_world.env import HighwayEnv
from controllers.decision.fast_world.worlds import FastWorlds
from controllers.decision.rules import LookAhead, Mobil, compiled
from controllers.decision.trip import ACTIONS, TripConfig, cell_trip
from iits_mj.core.errors import InputError

DENSE = cell_trip("dense", 12.5)
MOBIL = compiled(Mobil())


def started(count, trip=DENSE, seed=0):
    worlds = FastWorlds(count)
    for index in range(count):
        worlds.reset(index, np.random.default_rng(seed + index), trip)
    return worlds


def vehicles(worlds, index):
    state = worlds.states[index]
    return state["vehicles"][: state["count"]].tolist()


def test_a_world_gives_the_same_bits_alone_and_among_others_in_any_order():
    trips = [replace(DENSE, spawn_probability=p) for p in (0.02, 0.05, 0.3)]
    together = FastWorlds(3)
    for index in (2, 0, 1):
        together.reset(index, np.random.default_rng(index), trips[index])
    for _ in range(60):
        together.step(together.decide(MOBIL))
    for index, trip in enumerate(trips):
        alone = FastWorlds(1)
        alone.reset(0, np.random.default_rng(index), trip)
        for _ in range(60):
            alone.step(alone.decide(MOBIL))
        assert vehicles(alone, 0) == vehicles(together, index)
        assert np.array_equal(alone.observations[0], together.observations[index])
        assert alone.summary(0) == together.summary(index)


def test_a_copy_drives_on_as_its_original_and_leaves_it_alone():
    worlds = started(2)
    worlds.drive(MOBIL, 50.0)
    before = worlds.observations
    copies = worlds.copy([1, 0, 1])
    for _ in range(30):
        copies.step(copies.decide(MOBIL))
    assert np.array_equal(worlds.observations, before)
    for _ in range(30):
        worlds.step(worlds.decide(MOBIL))
    assert np.array_equal(copies.observations, worlds.observations[[1, 0, 1]])
    assert vehicles(copies, 2) == vehicles(worlds, 1)


def test_a_drive_by_a_rule_is_that_of_its_decisions_and_ends_after_its_time():
    by_steps, at_once = started(2), started(2)
    while (by_steps.states["time"] < 100.0 - 1e-6).all():
        by_steps.step(by_steps.decide(MOBIL))
    at_once.drive(MOBIL, 100.0)
    late = at_once.states["time"] - 100.0
    assert ((late > -1e-6) & (late < 9.0)).all()
    first = int(by_steps.states["time"].argmax())
    assert vehicles(by_steps, first) == vehicles(at_once, first)


def test_an_ended_trip_stays_as_it_is():
    worlds = started(1, replace(DENSE, duration=20.0))
    worlds.drive(MOBIL)
    assert worlds.states["truncated"][0]
    before = worlds.summary(0)
    worlds.step([0])
    worlds.drive(MOBIL)
    assert worlds.summary(0) == before


def test_allowed_decisions_are_those_that_are_carried_out():
    worlds = started(40)
    worlds.drive(compiled(make("aggressive")), 60.0)
    allowed = worlds.allowed()
    assert allowed[:, 1].all()
    for place, decision in enumerate(ACTIONS):
        copies = worlds.copy(np.arange(40))
        copies.step(np.full(40, int(decision)))
        refused = copies.states["refused"] - worlds.states["refused"]
        assert np.array_equal(refused == 0, allowed[:, place])
    assert 0.1 < allowed[:, [0, 2]].mean() < 0.9


def test_a_roll_out_compares_decisions_in_the_same_future_traffic():
    worlds = started(3)
    worlds.drive(MOBIL, 40.0)
    before = worlds.observations
    after = worlds.roll_out([[0, -1, 0]] * 3, MOBIL, 60.0)
    assert np.array_equal(worlds.observations, before)
    late = after.states["time"].reshape(3, 3) - worlds.states["time"][:, None] - 60.0
    assert ((late > -1e-6) & (late < 9.0)).all()
    for world in range(3):
        first, _, again = range(3 * world, 3 * world + 3)
        assert vehicles(after, first) == vehicles(after, again)
    way = after.states["distance"].reshape(3, 3) - worlds.states["distance"][:, None]
    assert (way > 300.0).all()
    assert (way[:, 0] != way[:, 1]).any()


def test_a_second_trip_with_one_generator_is_another_one():
    env, generator = HighwayEnv(), np.random.default_rng(0)
    first = env.reset(generator, DENSE)
    assert not np.array_equal(first, env.reset(generator, DENSE))


def test_trucks_do_not_exceed_their_own_limit():
    worlds = started(1, replace(DENSE, traffic_speed=30.0, truck_speed_limit=22.0))
    worlds.drive(compiled(make("keep")), 100.0)
    rows = worlds.states["vehicles"][0, : worlds.states["count"][0]]
    trucks = rows["kind"] >= 2
    assert trucks.any()
    assert rows["speed"][trucks].max() <= 22.0
    assert rows["speed"][~trucks].max() > 22.0


def test_traffic_that_keeps_right_uses_the_right_lane_more():
    share = {}
    for keeps_right in (False, True):
        trip = replace(DENSE, traffic_speed=15.0, keeps_right=keeps_right)
        worlds = started(5, trip)
        worlds.drive(compiled(make("keep")), 300.0)
        lanes = np.concatenate([[v[1] for v in vehicles(worlds, k)] for k in range(5)])
        share[keeps_right] = (lanes == 0).mean()
    assert share[True] > share[False] + 0.15


def test_vehicles_merge_from_a_ramp_before_it_ends():
    trip = replace(DENSE, ramp_probability=0.1, ramp_interval=1000.0)
    worlds = started(1, trip)
    merged, on_ramp = set(), set()
    for _ in range(300):
        worlds.step([0])
        for serial, lane, _, front, *_ in vehicles(worlds, 0):
            if lane < 0:
                on_ramp.add(serial)
                assert front % 1000.0 < 250.0
            elif serial in on_ramp:
                merged.add(serial)
    assert len(merged) > 10
    # Vehicles on a ramp are not on a lane of the route.
    assert worlds.states["collisions"][0] == 0


def test_three_lanes_are_used_by_traffic_and_truck():
    worlds = started(1, replace(DENSE, lanes=3))
    used, traffic = set(), set()
    for _ in range(400):
        worlds.step(worlds.decide(compiled(LookAhead(change_cost=1.0, right_gain=0.0))))
        used.add(int(worlds.states["lane"][0]))
        traffic |= {lane for _, lane, *_ in vehicles(worlds, 0)}
    assert used == traffic == {0, 1, 2}


def test_nonsense_is_refused_with_the_allowed_values():
    worlds = started(2)
    with pytest.raises(InputError, match="2 of -1"):
        worlds.step([0])
    with pytest.raises(InputError, match="2 of -1"):
        worlds.step([0, 2])
    with pytest.raises(InputError, match=r"use \(2, m\)"):
        worlds.roll_out([0, 0], MOBIL, 60.0)
    with pytest.raises(InputError, match="0 to 1"):
        worlds.copy([2])
    with pytest.raises(InputError, match="MT19937"):
        worlds.reset(0, np.random.Generator(np.random.MT19937(0)), DENSE)
    for wrong in ({"lanes": 4}, {"ramp_probability": 2.0}, {"truck_speed_limit": 0.0}):
        with pytest.raises(InputError, match=next(iter(wrong))):
            TripConfig(**wrong)


def test_time_to_a_collision_and_time_in_the_right_lane_are_those_of_the_trip():
    worlds = started(1, replace(DENSE, traffic_speed=15.0))
    rule = compiled(LookAhead())
    times, right = [], 0.0
    while not worlds.states["truncated"][0]:
        before = worlds.copy([0]).states[0]
        worlds.step(worlds.decide(rule))
        now = worlds.states[0]
        right += float(now["seconds"]) * (now["lane"] == 0)
        if now["changes"] == before["changes"]:
            continue
        front, speed = float(before["front"]), float(before["speed"])
        rows = before["vehicles"][: before["count"]]
        rows = rows[rows["lane"] == now["lane"]]
        times += [
            (v["front"] - v["length"] - front) / (speed - v["speed"])
            for v in rows[rows["front"] > front][:1]
            if v["speed"] < speed
        ]
        times += [
            (front - float(before["truck_length"]) - v["front"]) / (v["speed"] - speed)
            for v in rows[rows["front"] <= front][-1:]
            if v["speed"] > speed
        ]
    assert len(times) > 3
    found = min(now["collision_time_front"], now["collision_time_rear"])
    assert found == pytest.approx(min(times))
    assert now["right_time"] == pytest.approx(right)


def test_wide_gaps_impose_no_hard_braking_and_spend_less_time_beside_others():
    figures = {}
    for name in ("conservative", "lookahead"):
        worlds = started(60)
        worlds.drive(compiled(make(name)))
        states = worlds.states
        share = states["imposed_brakings"].sum() / states["changes"].sum()
        figures[name] = share, (states["beside_time"] / states["driven_time"]).mean()
    assert figures["conservative"][0] == 0.0
    assert 0.0 < figures["lookahead"][0] < 0.2
    assert figures["conservative"][1] < figures["lookahead"][1] < 0.5
