"""Lane changes of both models in running simulations; `test_mobil` tests MOBIL's equations."""

import dataclasses

import pytest

from iits_mj.road import Route
from tests.traffic_bridge.merge_map import write_merge_map
from traffic_bridge import PureSim, TrafficConfig, default_types
from traffic_bridge.network.lane_graph import LaneGraph
from traffic_bridge.network.nets import build_network
from traffic_bridge.vehicles.lane_changing import LaneChanger
from traffic_bridge.vehicles.mobil import idm_acceleration


def changes_and_braking(politeness):
    """Number of lane changes, and mean of the hardest braking of new followers in 2 s [m/s2]."""
    types = tuple(
        dataclasses.replace(kind, politeness=politeness, keep_right_bias=0.0)
        for kind in default_types()
    )
    config = TrafficConfig(
        density=0.4,
        lane_change="mobil",
        types=types,
        fill_ahead=2000.0,
        speed_limit=20.0,
        lane_change_duration=0.0,
    )
    changes, hardest = 0, []
    watched = {}
    with PureSim(Route.straight(length=2000.0), config, seed=2) as traffic:
        before = {v.id: v for v in traffic.reset()}
        for k in range(200):
            now = {v.id: v for v in traffic.step()}
            for name, (end, braking) in list(watched.items()):
                if name in now and k < end:
                    watched[name] = (end, max(braking, -now[name].acceleration))
                else:
                    hardest.append(watched.pop(name)[1])
            for name, v in now.items():
                if name in before and before[name].lane != v.lane:
                    changes += 1
                    row = [w for w in now.values() if w.lane == v.lane and w.station < v.station]
                    follower = max(row, key=lambda w: w.station, default=None)
                    if follower is not None and v.station - follower.station < 60.0:
                        watched[follower.id] = (k + 20, 0.0)
            before = now
    return changes, sum(hardest) / len(hardest)


def test_polite_drivers_change_lanes_less_and_make_followers_brake_less():
    selfish, polite = changes_and_braking(0.0), changes_and_braking(1.0)
    assert polite[0] < 0.5 * selfish[0]
    assert polite[1] < 0.5 * selfish[1]


def test_keep_right_traffic_uses_the_right_lane_more_than_symmetric_traffic():
    shares = []
    for bias in (0.0, 0.4):
        types = tuple(dataclasses.replace(k, keep_right_bias=bias) for k in default_types())
        config = TrafficConfig(
            density=0.03, lane_change="mobil", types=types, fill_ahead=2000.0, speed_limit=20.0
        )
        right = total = 0
        with PureSim(Route.straight(length=2500.0), config, seed=3) as traffic:
            traffic.reset()
            for k in range(600):
                vehicles = traffic.step()
                if k >= 300:
                    right += int((vehicles.lanes == 0).sum())
                    total += len(vehicles)
        shares.append(right / total)
    assert shares[1] > shares[0] + 0.1


def test_accelerations_in_mobil_agree_with_those_in_sumo(highway):
    # Also in bends and across the ends of edges.
    config = TrafficConfig(
        density=0.3, lane_change="mobil", fill_ahead=2000.0, lane_change_duration=0.0
    )
    worst, behind_others = 0.0, 0
    with PureSim(highway, config, seed=1) as traffic:
        traffic.reset()
        graph = LaneGraph.of(build_network(highway))
        changer = LaneChanger(traffic.session, graph, traffic.vehicles, config)
        api = traffic.session.api.vehicle
        for _ in range(30):
            for name in api.getIDList():
                api.setLaneChangeMode(name, 0)  # no vehicle changes lanes
            occupancy = changer.occupancy()
            predicted = {}
            for name, place in occupancy.places.items():
                around = occupancy.neighbors(place, place.lane)
                predicted[name] = idm_acceleration(
                    place.driver, around.gap_ahead, around.speed_ahead
                )
                behind_others += around.gap_ahead < 100.0
            for v in traffic.step():
                if v.id in predicted:
                    worst = max(worst, abs(v.acceleration - predicted[v.id]))
    assert behind_others > 300
    # SUMO does not look beyond some 200 m, where the influence of a leader is negligible.
    assert worst < 0.005


@pytest.mark.parametrize("lane_change", ["lc2013", "mobil"])
def test_traffic_merges_where_a_ramp_joins_and_lanes_end(lane_change, tmp_path):
    route = write_merge_map(tmp_path / "merge.xodr").route()
    config = TrafficConfig(
        density=0.1, lane_change=lane_change, speed_limit=20.0, scope="map", fill_ahead=3000.0
    )
    standing: dict[str, int] = {}
    arrived = set()
    with PureSim(route, config, seed=1) as traffic:
        traffic.reset()
        api = traffic.session.api
        for _ in range(450):
            for v in traffic.step():
                standing[v.id] = standing.get(v.id, 0) + 1 if v.speed < 0.1 else 0
                assert standing[v.id] < 50, v
                if v.station > route.length - 100.0:
                    arrived.add(v.id)
            assert not api.simulation.getCollidingVehiclesIDList()
    assert len(arrived) > 5
