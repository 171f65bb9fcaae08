"""Traffic of a whole map: turns, places out of sight, and the number of vehicles."""

import math
import re
from collections import Counter

import numpy as np
import pytest

from iits_mj.core.errors import InputError
from iits_mj.road import RoadMap
from tests.model.crossing import crossing
from tests.traffic_bridge.scripted_truck import ego_at
from traffic_bridge import InterSim, MapNetwork, PureSim, TrafficConfig
from traffic_bridge.network.lane_graph import LaneGraph
from traffic_bridge.vehicles.map_demand import MapDemand, Occupied, Sight


@pytest.fixture(scope="module")
def town(tmp_path_factory):
    path = tmp_path_factory.mktemp("maps") / "crossing.xodr"
    # Without the sidewalks, whose order netconvert takes for that of lanes.
    path.write_text(re.sub(r'<lane id="-?2".*?</lane>', "", crossing()))
    return RoadMap.from_opendrive(path)


def demand(town, seed=0, **more):
    net = MapNetwork.of(town).net
    config = TrafficConfig(scope="map", **more)
    return MapDemand(net, LaneGraph.of(net), config, np.random.default_rng(seed))


def turns_from(made, lane):
    """Shares of the ways that trips from a lane take at the crossing."""
    ends = Counter(made.start(lane).edges[1] for _ in range(600))
    return {edge: count / 600 for edge, count in ends.items()}


def test_trips_turn_at_a_junction_by_the_shares(town):
    made = demand(town, turning_shares=(0.1, 0.7, 0.2))
    entrance = made.entrances[0].id
    shares = sorted(turns_from(made, entrance).values())
    assert shares == pytest.approx([0.1, 0.2, 0.7], abs=0.06)


def test_no_trip_makes_a_turn_with_the_share_zero(town):
    made = demand(town, turning_shares=(0.0, 1.0, 0.0))
    assert max(turns_from(made, made.entrances[0].id).values()) > 0.99


def test_a_trip_of_a_map_with_exits_ends_at_an_exit(town):
    made = demand(town)
    trip = made.start(made.entrances[0].id)
    assert trip.ended
    assert len(trip.edges) == 2


def test_a_lane_has_room_only_away_from_its_vehicles():
    here = Occupied([(60.0, 55.0, 10.0)])
    assert not here.has_room(50.0, 5.0, 10.0)  # the leader is too near
    assert not here.has_room(70.0, 5.0, 10.0)  # the follower would have to brake
    assert here.has_room(30.0, 5.0, 10.0)
    assert here.has_room(90.0, 5.0, 10.0)


def test_new_vehicles_begin_out_of_sight_of_the_truck_and_apart(town):
    made = demand(town, density=0.3, speed_limit=10.0)
    occupied = {lane.id: Occupied() for lane in made.lanes}
    lane = made.lanes[0]
    sight = Sight(*made.place_of(lane, 0.5 * lane.length), 60.0)
    kind = TrafficConfig().type_of("car")
    found = 0
    for where, position, vehicle, _ in made.free_places(
        occupied, sight, lambda _: (kind, 10.0), 10
    ):
        assert sight.distance(*made.place_of(where, position)) >= 60.0
        front = position
        for other, rear, _ in occupied[where.id].places:
            assert front - vehicle.length > other or rear > front
        occupied[where.id].places.append((front, front - vehicle.length, 10.0))
        found += 1
    assert found > 0


def test_vehicles_appear_and_disappear_only_out_of_sight_of_the_truck(town):
    settings = TrafficConfig(density="E", scope="map", speed_limit=10.0, clear_distance=40.0)
    route = town.route()
    offset = route.lane_offset(0, 60.0)
    ends = []
    with InterSim(route, settings, seed=3) as traffic:
        ego = ego_at(route, 0.0, 60.0, 0.0, offset)
        before = {v.id: (v.x, v.y) for v in traffic.reset(ego)}
        for k in range(600):
            frame = {
                v.id: (v.x, v.y)
                for v in traffic.step(ego_at(route, 0.1 * (k + 1), 60.0, 0.0, offset))
            }
            ends += [frame[name] for name in frame.keys() - before.keys()]
            ends += [before[name] for name in before.keys() - frame.keys()]
            before = frame
    assert len(ends) > 5
    assert all(math.dist(place, (ego.x, ego.y)) > 35.0 for place in ends)


def test_one_seed_gives_one_traffic_with_turns(town):
    def poses():
        with PureSim(town.route(), TrafficConfig(density="D", scope="map"), seed=3) as traffic:
            traffic.reset()
            return [traffic.step().values.tobytes() for _ in range(150)]

    assert poses() == poses()


def test_no_message_of_sumo_reaches_the_terminal(town, capfd):
    settings = TrafficConfig(density="D", scope="map", speed_limit=14.0)
    with PureSim(town.route(), settings, seed=1) as traffic:
        traffic.reset()
        for _ in range(300):
            traffic.step()
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize(
    "shares", [(0.5, 0.5), (0.0, 0.0, 0.0), (0.5, math.nan, 0.5), (-0.1, 1.0, 0.1), "right"]
)
def test_turning_shares_that_are_not_usable_are_refused(shares):
    with pytest.raises(InputError, match="turning_shares"):
        TrafficConfig(turning_shares=shares)


def test_turning_shares_survive_a_stored_configuration():
    settings = TrafficConfig(turning_shares=[0.2, 0.6, 0.2])
    assert TrafficConfig.from_dict(settings.as_dict()) == settings
