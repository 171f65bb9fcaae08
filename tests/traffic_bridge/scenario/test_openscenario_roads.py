"""Stories of OpenSCENARIO files beside the truck's route: oncoming, crossing, merging, on paths."""

import itertools
import math

import pytest

from iits_mj.core.messages import LightState
from iits_mj.road import RoadMap
from iits_mj.simulation.frame import read_signals
from tests.traffic_bridge.scenario.test_openscenario import STEP, TRUCK, path_of, play
from tests.traffic_bridge.scripted_truck import ego_at
from traffic_bridge import EventSim, TrafficConfig
from traffic_bridge.scenario.openscenario import read_scenario


def rows(frames, name):
    return [frame.find(name) for frame in frames]


def at(frames, name, time):
    return frames[round(time / STEP)].find(name)


def moves_without_jumps(track, turn=0.5):
    """Checks that each step is as long as the speed says, and headings [rad] do not jump."""
    for before, after in itertools.pairwise([row for row in track if row is not None]):
        way = math.dist((before.x, before.y), (after.x, after.y))
        assert way == pytest.approx(0.5 * (before.speed + after.speed) * STEP, abs=0.12)
        assert abs(math.remainder(after.yaw - before.yaw, 2.0 * math.pi)) < turn
    return True


def test_lane_change_an_oncoming_truck_changes_to_the_trucks_lane_after_3_s():
    start, frames, records = play(path_of("lane_change"), 12.0)
    assert (start.lane, start.speed) == (0, 20.0)
    # A parameter becomes 11 at 3 s; the lane change waits for more than 10.
    assert records["Dummy parameter event"].begun == pytest.approx(3.1)
    change = records["Lane change Target event"]
    assert 3.1 <= change.begun <= 3.2
    assert change.ended - change.begun == pytest.approx(2.0, abs=STEP + 1e-9)
    truck = rows(frames, "Truck")
    # At s = 300 m of the road, of which the route is the beginning.
    assert truck[0].station == pytest.approx(300.0, abs=15.0)
    assert truck[0].kind == "articulated"
    assert truck[0].length > 20.0
    for row in truck[:31]:
        assert row.offset == pytest.approx(1.8, abs=0.1)
    assert truck[0].station - truck[30].station == pytest.approx(60.0, abs=0.5)
    assert truck[60].offset == pytest.approx(-1.8, abs=0.1)
    # It never counts as a vehicle of the truck's lane: it comes towards it.
    assert {row.lane for row in truck if row is not None} == {-1}
    assert moves_without_jumps(truck, 0.05)


def test_pedestrian_crosses_after_the_truck_has_driven_5_m():
    start, frames, records = play(path_of("pedestrian"), 18.0)
    assert (start.lane, start.speed) == (0, 10.0)
    begun = records["ped_event"].begun
    assert begun == pytest.approx(0.6)
    walker = rows(frames, "pedestrian_adult")
    assert {row.kind for row in walker} == {"pedestrian"}
    assert {(row.x, row.y, row.speed) for row in walker[:6]} == {(walker[0].x, walker[0].y, 0.0)}
    # 2 m/s2 up to 1.5 m/s.
    assert at(frames, "pedestrian_adult", begun + 0.5).speed == pytest.approx(1.0)
    assert at(frames, "pedestrian_adult", 5.0).speed == pytest.approx(1.5)
    # From the left to the right of the truck's road, at a right angle.
    crossing = [row for row in walker if -2.0 < row.offset < 2.0]
    assert len(crossing) == pytest.approx(4.0 / 1.5 / STEP, abs=2)
    assert crossing[0].offset < 0.0 < crossing[-1].offset
    assert {row.lane for row in crossing} <= {0, -1}
    assert crossing[0].station == pytest.approx(crossing[-1].station, abs=0.3)
    # It goes on along the pavement, until it is 5 m from the end of the road.
    assert records["end_drive"].begun > records["ped_event 2"].ended
    assert moves_without_jumps(walker)


def test_the_truck_takes_its_place_from_a_trajectory():
    scenario = read_scenario(path_of("lane-change_trajectory_wp"), "Car")
    assert "trajectory of Car" in " ".join(scenario.notes)
    start, frames, records = play(path_of("lane-change_trajectory_wp"), 9.0, ego="Car")
    assert start.station + TRUCK.front_overhang == pytest.approx(50.0 + 1.4 + 2.52, abs=0.05)
    assert (start.lane, start.speed) == (0, pytest.approx(50.0 / 3.6))
    assert all(len(frame) == 0 for frame in frames)
    assert records["end_drive"].begun == pytest.approx(8.1)


def test_highway_merge_vehicles_come_from_the_other_road():
    start, frames, records = play(path_of("highway_merge"), 18.0)
    assert (start.lane, start.speed) == (0, 25.0)
    for name, kind, speed in (
        ("A1", "car", 25.0), ("A2", "car", 25.0), ("A3", "car", 25.0),
        ("A4", "bicycle", 40.0), ("A5", "truck", 40.0),
    ):  # fmt: skip
        row = frames[0].find(name)
        assert (row.kind, row.speed, row.lane) == (kind, speed, -1), name
    ids = ("A1", "A2", "A3")
    assert all(frames[0].find(a).x > frames[0].find(b).x for a, b in itertools.pairwise(ids))
    assert {row.speed for row in rows(frames, "A1")} == {25.0}
    # After the junction they are on the truck's lanes.
    assert at(frames, "A1", 15.0).lane == 0
    assert at(frames, "A4", 10.0).lane == 1
    # A2 closes up to 1 s behind A1, A3 to 1.5 s behind A2, within 2 m/s2 and 5 m/s2.
    for name, ahead, time_gap in (("A2", "A1", 1.0), ("A3", "A2", 1.5)):
        assert records[f"{name}DistEvent"].begun == pytest.approx(0.1)
        own, other = frames[-1].find(name), frames[-1].find(ahead)
        gap = other.station - own.station - 0.5 * (own.length + other.length)
        assert gap == pytest.approx(time_gap * own.speed, rel=0.1)
        rates = {round(row.acceleration, 6) for row in rows(frames, name)}
        assert min(rates) >= -5.0
        assert max(rates) <= 2.0
        assert moves_without_jumps(rows(frames, name), 0.05)


def test_traffic_lights_switch_by_distance_and_time_and_pedestrians_walk_on_green():
    start, frames, records = play(path_of("traffic_lights"), 25.0)
    assert (start.lane, start.speed) == (0, pytest.approx(13.889))
    # Yellow when the truck's reference point is less than 50 m before s = 109 m, from s = 10 m.
    yellow = records["StopLightEvent"].begun
    assert yellow == pytest.approx((109.0 - 50.0 - 10.0) / 13.889, abs=STEP)
    for event, seconds in (
        ("StopLightEvent2", 3.0),  # red
        ("PedestrianLightEvent", 6.0),
        ("WalkOnGreenEvent1", 6.5),
        ("WalkOnGreenEvent2", 7.0),
        ("PedestrianLightEvent2", 12.0),
        ("StopLightEvent3", 13.0),  # green again
    ):
        assert records[event].begun - yellow == pytest.approx(seconds, abs=0.11), event
    states = [r.event.value for r in records.values() if r.event.kind == "set_value"]
    assert states.count("off;on;off") == 1
    for name, begun, speed in (
        ("Pedestrian_1", records["WalkOnGreenEvent1"].begun, 2.0),
        ("Pedestrian_2", records["WalkOnGreenEvent2"].begun, 3.3),
    ):
        track = rows(frames, name)
        assert {row.speed for row in track[: round(begun / STEP) + 1]} == {0.0}
        assert max(row.speed for row in track) == pytest.approx(speed)
        # Across the whole road, within the time of red.
        assert track[0].offset * track[-1].offset < 0.0
        assert moves_without_jumps(track[round(begun / STEP) + 1 :], 1.2)


def test_trailers_trucks_turn_at_junctions_with_all_their_trailers():
    start, frames, _ = play(path_of("trailers"), 10.0)
    assert (start.lane, start.speed) == (0, pytest.approx(0.8 * 50.0 / 3.6))
    assert set(frames[0].ids) == {"Semi_truck", "Semi_truck_with_extra_trailer", "Semi_tractor"}
    lengths = {row.id: row.length for row in frames[0]}
    # From the tractor's front to the rear of the last trailer, by hitches and couplers.
    assert lengths["Semi_truck"] == pytest.approx(5.05 + 9.055, abs=0.01)
    assert lengths["Semi_tractor"] > lengths["Semi_truck_with_extra_trailer"] > 20.0
    for row in frames[0]:
        assert row.kind == "articulated"
        assert row.speed == pytest.approx(50.0 / 3.6)
    # The first one turns left into the road on which the truck comes, and drives against it.
    turned = at(frames, "Semi_truck", 7.0)
    assert (turned.lane, turned.offset > 0.0) == (-1, True)
    turn = math.remainder(turned.yaw - at(frames, "Semi_truck", 0.0).yaw, 2.0 * math.pi)
    assert turn == pytest.approx(0.5 * math.pi, abs=0.15)
    for name in frames[0].ids:
        assert moves_without_jumps(rows(frames, name), 0.15)


def test_synchronize_four_vehicles_box_the_truck_in_and_leave_again():
    start, frames, records = play(path_of("synchronize"), 31.0)
    assert (start.lane, start.speed) == (1, 20.0)
    # The truck's front, that of the file's car, is from 103.92 m to 303.92 m at 20 m/s.
    arrival = 200.0 / 20.0
    for name, lane, target, free in (
        ("NPC1", 2, 305.0, 30.0), ("NPC2", 1, 285.0, 0.0),
        ("NPC3", 0, 297.0, 17.0), ("NPC4", 1, 330.0, 0.0),
    ):  # fmt: skip
        track = rows(frames, name)
        assert (track[0].lane, track[0].speed) == (lane, 0.0)
        row = at(frames, name, arrival)
        # Its reference point is 1.0 m to 1.6 m behind the center of its box.
        assert row.station == pytest.approx(target + 1.4, abs=1.6), name
        assert row.speed == pytest.approx(20.0, abs=0.3)
        assert at(frames, name, 15.0).speed == 20.0
        assert max(abs(row.acceleration) for row in track[:100]) < 12.0
        assert frames[-1].find(name).speed == pytest.approx(free, abs=1e-6)
    ended = [r.ended for r in records.values() if r.event.kind == "synchronize"]
    assert ended == pytest.approx([arrival] * 4, abs=0.15)
    # Free again where the truck's reference point is 5 m before s = 500 m.
    free = records["Free_Speed_Event_NPC"].begun
    assert free == pytest.approx((500.0 - 5.0 - 100.0) / 20.0, abs=0.11)


def test_swarm_vehicles_drive_on_both_sides_around_the_truck():
    start, frames, records = play(path_of("swarm"), 20.0)
    assert (start.lane, start.speed) == (1, 10.0)
    assert records["swarm"].begun == 0.0
    first = frames[0]
    # On 100 m before and behind the circle of 200 m, not all of the 75 vehicles have room.
    assert 20 < len(first) <= 75
    ego = start.station
    for row in first:
        assert 195.0 < abs(row.station - ego) < 305.0
        assert row.speed == 30.0
        assert row.kind == "car"
    own = [row for row in first if row.lane >= 0]
    assert {row.lane for row in own} == {0, 1, 2}
    oncoming = [row for row in first if row.lane < 0]
    assert len(oncoming) > 8
    assert all(row.offset > 0.0 and math.cos(row.yaw - own[0].yaw) < -0.9 for row in oncoming)
    # Later there are vehicles beside the truck, which come from the ring.
    assert any(abs(row.station - ego - 200.0) < 100.0 for row in frames[-1])


def test_the_driver_sees_the_light_of_the_map_in_the_state_that_the_file_sets():
    scenario = read_scenario(path_of("traffic_lights"))
    route = RoadMap.from_opendrive(scenario.map).route(along=scenario.route)
    start = scenario.start(route, TRUCK)
    seen = {}
    with EventSim(route, TrafficConfig(events=scenario.events(route))) as traffic:
        # The truck stands 20 m before the light, which is yellow 0.1 s after that.
        ego = ego_at(route, 0.0, start.station + 70.0, 0.0, float(route.lane_offset(0, 80.0)))
        for step in range(150):
            traffic.step(ego) if step else traffic.reset(ego)
            light = read_signals(traffic, ego, route, TRUCK).light
            assert light.station == pytest.approx(109.0, abs=0.1)
            seen.setdefault(light.state, step * STEP)
    assert seen == {
        LightState.GREEN: 0.0,
        LightState.YELLOW: pytest.approx(0.2, abs=0.11),
        LightState.RED: pytest.approx(3.2, abs=0.21),
    }


def test_without_states_set_by_events_no_light_is_shown():
    scenario = read_scenario(path_of("pedestrian"))
    route = RoadMap.from_opendrive(scenario.map).route(along=scenario.route)
    with EventSim(route, TrafficConfig(events=scenario.events(route))) as traffic:
        ego = ego_at(route, 0.0, 40.0, 0.0, float(route.lane_offset(0, 40.0)))
        traffic.reset(ego)
        assert read_signals(traffic, ego, route, TRUCK).light is None
