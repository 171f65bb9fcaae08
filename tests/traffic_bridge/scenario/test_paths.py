"""Road users on paths and on roads of their own."""

import itertools
import math

import numpy as np
import pytest

from iits_mj.core.errors import InputError
from iits_mj.road import RoadMap, Route
from tests.traffic_bridge.scenario.scene import FRONT, ROAD, SPEED, START, STEP, drive
from tests.traffic_bridge.scripted_truck import ego_at
from traffic_bridge import (
    ChangeLane,
    ChangeSpeed,
    EventSim,
    FollowPath,
    InterSim,
    KeepDistance,
    PlaceVehicle,
    Recorder,
    ReSim,
    Swerve,
    Synchronize,
    TrafficConfig,
)
from traffic_bridge.scenario.paths import Path, points_on_route

TWO_WAY = """<OpenDRIVE><header revMajor="1" revMinor="6"/>
<road id="1" length="2000" junction="-1"><planView>
<geometry s="0" x="0" y="0" hdg="0" length="2000"><line/></geometry></planView>
<lanes><laneSection s="0"><left>
<lane id="2" type="driving"><width sOffset="0" a="4" b="0" c="0" d="0"/></lane>
<lane id="1" type="driving"><width sOffset="0" a="4" b="0" c="0" d="0"/></lane>
</left><center><lane id="0" type="none"/></center><right>
<lane id="-1" type="driving"><width sOffset="0" a="4" b="0" c="0" d="0"/></lane>
</right></laneSection></lanes></road></OpenDRIVE>"""


@pytest.fixture(scope="module")
def two_way(tmp_path_factory) -> Route:
    path = tmp_path_factory.mktemp("map") / "road.xodr"
    path.write_text(TWO_WAY)
    return RoadMap.from_opendrive(path).route(along="turns:1_-1")


def truck_in(route: Route):
    """The offset of the truck in `drive`."""
    return float(route.lane_offset(0, START))


CORNER = [(400.0, 2.0), (420.0, 2.0), (420.0, 12.0)]


def test_a_path_has_the_length_of_its_pieces_and_headings_without_jumps():
    path = Path(CORNER, 1.0, ROAD)
    assert path.length == pytest.approx(30.0)
    places = np.linspace(-2.0, 32.0, 3401)
    points = [path.evaluate(float(s)) for s in places]
    headings = np.array([p.heading for p in points])
    assert headings[0] == 0.0
    assert headings[-1] == pytest.approx(0.5 * math.pi)
    assert np.abs(np.diff(headings)).max() < 0.03
    ways = [math.dist(a[:2], b[:2]) for a, b in itertools.pairwise(points)]
    assert ways == pytest.approx(np.diff(places), abs=1e-2)
    # Half way round the corner the body is diagonal.
    assert path.evaluate(20.0).heading == pytest.approx(0.25 * math.pi)


def test_a_place_on_a_path_is_found_again_with_its_side():
    path = Path(CORNER, 1.0, ROAD)
    for station, offset in ((-3.0, 0.5), (7.0, -1.0), (26.0, 2.0), (33.0, 0.0)):
        point = path.evaluate(station, offset)
        assert path.locate(point.x, point.y) == pytest.approx((station, offset), abs=1e-9)
    # A path that crosses itself: the first place counts.
    loop = Path([(0.0, 0.0), (10.0, 0.0), (10.0, 10.0), (5.0, 10.0), (5.0, -5.0)], 1.0, ROAD)
    assert loop.locate(5.0, 0.0) == pytest.approx((5.0, 0.0))


def test_a_path_of_points_on_the_route_follows_its_bends():
    route = RoadMap.builtin().route()
    points, numbers = points_on_route(route, [(1000.0, 0.0), (1300.0, 3.0)])
    assert numbers == [0, len(points) - 1]
    for point in points:
        station, offset = route.locate(*point[:2], 1150.0)
        assert offset == pytest.approx(3.0 * (station - 1000.0) / 300.0, abs=0.01)
        assert point[2] == pytest.approx(float(route.evaluate(station, offset).z), abs=1e-6)


def test_points_that_are_none_make_no_path():
    for points in ([(0.0, 0.0)], [(0.0, 0.0), (0.0, 1e-5)]):
        with pytest.raises(InputError, match="two or more"):
            Path(points, 1.0, ROAD)


def test_a_pedestrian_walks_round_a_corner_and_stays_at_the_end():
    walk = PlaceVehicle(name="a", points=CORNER, speed=2.0, type="pedestrian", stays=True)
    track = drive([walk], 20.0).track("a")
    assert (track[0].x, track[0].y) == pytest.approx(CORNER[0])
    assert (track[100].x, track[100].y) == pytest.approx((420.0, 2.0), abs=0.01)
    assert (track[-1].x, track[-1].y) == pytest.approx(CORNER[2])
    assert track[-1].speed == 0.0
    assert track[140].yaw == pytest.approx(0.5 * math.pi)
    assert track[140].lateral_speed == pytest.approx(2.0)


def test_a_vehicle_is_at_each_point_at_its_time_and_drives_on_in_its_lane():
    offset = float(ROAD.lane_offset(1, 0.0))
    points = [(340.0, offset), (380.0, offset), (400.0, offset), (460.0, offset)]
    place = PlaceVehicle(name="a", station=342.4, lane=1, speed=10.0, reactive=False)
    follow = FollowPath(actor="a", points=points, frame="route", times=[0.0, 4.0, 6.0, 10.0])
    run = drive([place, follow], 14.0)
    track = run.track("a")
    for time, (station, _) in zip((0.0, 4.0, 6.0, 10.0), points, strict=True):
        assert track[round(time / STEP)].station == pytest.approx(station, abs=0.06)
    speeds = [row.speed for row in track]
    assert max(abs(b - a) for a, b in itertools.pairwise(speeds[1:])) < 0.9
    assert run.record("follow_path").ended == pytest.approx(10.0, abs=STEP)
    assert track[-1].lane == 1
    assert track[-1].station > 480.0


def test_an_actor_joins_a_path_beside_it_without_a_jump():
    place = PlaceVehicle(name="a", gap=20.0, lane=1, speed=20.0, reactive=False)
    points = [(300.0, ROAD.lane_offset(1, 0.0) + 1.0), (800.0, ROAD.lane_offset(1, 0.0) + 1.0)]
    follow = FollowPath(actor="a", points=points, frame="route", at_time=1.0)
    track = drive([place, follow], 6.0).track("a")
    steps = np.diff([row.offset for row in track])
    assert track[-1].offset - track[0].offset == pytest.approx(1.0, abs=1e-6)
    assert np.abs(steps).max() < 0.1
    assert np.diff([row.station for row in track]) == pytest.approx(2.0, abs=0.02)


def test_an_oncoming_vehicle_counts_to_no_lane_and_has_negative_pace(two_way):
    car = PlaceVehicle(name="car", along="turns:1_1", station=1500.0, lane=1, speed=15.0)
    run = drive([car], 10.0, road=two_way)
    track = run.track("car")
    # Its station on its own road counts from the other end.
    assert track[0].station - 0.5 * track[0].length == pytest.approx(500.0)
    assert track[0].offset == pytest.approx(2.0)
    assert track[-1].station == pytest.approx(track[0].station - 150.0, abs=0.1)
    assert {(row.lane, row.speed) for row in track} == {(-1, 15.0)}
    assert math.cos(track[0].yaw) == pytest.approx(-1.0)


def test_an_oncoming_vehicle_changes_its_lanes_and_brakes_for_the_one_ahead(two_way):
    here = {"along": "turns:1_1", "lane": 1}
    slow = PlaceVehicle(name="slow", station=1480.0, speed=5.0, reactive=False, **here)
    fast = PlaceVehicle(name="fast", station=1400.0, speed=15.0, **here)
    aside = ChangeLane(actor="fast", relative_lane=-1, at_time=20.0)
    run = drive([slow, fast, aside], 26.0, road=two_way, speed=lambda _: 1.0)
    fast, slow = run.track("fast"), run.track("slow")
    gaps = [f.station - s.station - 4.7 for f, s in zip(fast, slow, strict=True)]
    assert min(gaps[:200]) > 1.5
    assert fast[195].speed == pytest.approx(5.0, abs=0.8)
    # Its right is the truck's left.
    assert fast[-1].offset - fast[195].offset == pytest.approx(4.0, abs=0.01)


def test_own_roads_and_paths_are_the_same_beside_sumos_vehicles(two_way):
    events = (
        PlaceVehicle(name="car", along="turns:1_1", station=1400.0, lane=1, speed=15.0),
        PlaceVehicle(name="a", points=CORNER, speed=2.0, type="pedestrian", stays=True),
    )
    alone = drive(events, 15.0, road=two_way)
    among = drive(events, 15.0, road=two_way, make=InterSim, density=0.2, clear_distance=80.0)
    for name in ("car", "a"):
        assert among.track(name) == alone.track(name)
    assert max(len(frame) for frame in among.frames) > 3


def test_an_oncoming_vehicle_swerves_to_its_own_left(two_way):
    car = PlaceVehicle(
        name="car", along="turns:1_1", station=1500.0, lane=1, speed=15.0, reactive=False
    )
    swerve = Swerve(actor="car", offset=1.0, back=False, duration=2.0)
    track = drive([car, swerve], 4.0, road=two_way).track("car")
    assert track[-1].offset == pytest.approx(1.0, abs=1e-6)


@pytest.mark.parametrize(("speed", "start"), [(None, 60.0), (12.0, 60.0), (25.0, -40.0)])
def test_two_vehicles_arrive_together_and_with_the_speed(speed, start):
    place = PlaceVehicle(name="a", gap=start, relative_lane=1, speed=15.0, reactive=False)
    meet = Synchronize(
        actor="a", station=START + 190.0, to_station=START + FRONT + 200.0, speed=speed
    )
    run = drive([place, meet], 14.0)
    record, track = run.record("synchronize"), run.track("a")
    assert record.ended == pytest.approx(10.0, abs=0.15)
    row = track[100]
    assert row.station + 0.5 * row.length == pytest.approx(START + 190.0, abs=1.0)
    if speed is not None:
        assert row.speed == pytest.approx(speed, abs=0.3)
    else:
        rates = [each.acceleration for each in track[2:95]]
        assert max(rates) - min(rates) < 0.2


def test_two_vehicles_arrive_together_also_if_the_truck_changes_its_speed():
    place = PlaceVehicle(name="a", gap=60.0, relative_lane=1, speed=15.0, reactive=False)
    meet = Synchronize(
        actor="a", station=START + 190.0, to_station=START + FRONT + 200.0, speed=12.0
    )
    run = drive([place, meet], 20.0, speed=lambda t: 20.0 if t < 5.0 else 12.5)
    ended = run.record("synchronize").ended
    assert ended == pytest.approx(5.0 + 100.0 / 12.5, abs=0.3)
    row = run.track("a")[round(ended / STEP)]
    assert row.station + 0.5 * row.length == pytest.approx(START + 190.0, abs=1.5)


@pytest.mark.parametrize(("wanted", "gap"), [({"gap": 15.0}, 15.0), ({"time_gap": 1.2}, 24.0)])
def test_a_vehicle_keeps_its_distance_behind_the_truck(wanted, gap):
    place = PlaceVehicle(name="a", gap=-60.0, speed=20.0, reactive=False)
    keep = KeepDistance(actor="a", acceleration=1.5, deceleration=3.0, **wanted)
    run = drive([place, keep], 40.0)
    track = run.track("a")
    rear = run.stations[-1] + FRONT - 16.5
    assert rear - track[-1].station - 0.5 * track[-1].length == pytest.approx(gap, abs=0.2)
    rates = [row.acceleration for row in track]
    assert min(rates) >= -3.0 - 1e-9
    assert max(rates) <= 1.5 + 1e-9


def test_a_distance_that_is_not_kept_ends_where_it_is_reached():
    place = PlaceVehicle(name="a", gap=-60.0, speed=20.0, reactive=False)
    keep = KeepDistance(actor="a", gap=30.0, continuous=False)
    later = ChangeSpeed(actor="a", speed=15.0, when={"event": "keep_distance"})
    run = drive([place, keep, later], 40.0)
    assert 5.0 < run.record("keep_distance").ended < 30.0
    assert run.record("change_speed").begun == pytest.approx(run.record("keep_distance").ended)


def test_a_road_that_the_map_does_not_have_is_refused_at_the_start():
    car = PlaceVehicle(name="car", along="turns:7", station=10.0, lane=0, speed=1.0)
    with pytest.raises(InputError, match="there is no road '7'"):
        drive([car], 1.0)


def test_paths_and_own_roads_are_recorded_and_repeated_bit_for_bit(two_way, tmp_path):
    events = (
        PlaceVehicle(name="car", along="turns:1_1", station=1400.0, lane=1, speed=15.0),
        PlaceVehicle(name="a", points=CORNER, speed=2.0, type="pedestrian", stays=True),
        FollowPath(actor="a", points=[[420, 2], [440, 9]], times=[0.0, 9.0], at_time=6.0),
    )
    config = TrafficConfig(density="empty", events=events)
    with Recorder(EventSim(two_way, config, 2)) as traffic:
        for step in range(150):
            station = START + SPEED * STEP * step
            ego = ego_at(two_way, step * STEP, station, SPEED, truck_in(two_way))
            traffic.step(ego) if step else traffic.reset(ego)
        path = traffic.save(tmp_path / "drive.npz")
    with ReSim(two_way, path) as again:
        assert again.verify()
        assert again.config.events == events
