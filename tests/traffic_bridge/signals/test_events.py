import dataclasses
import json
import math
from itertools import combinations

import numpy as np
import pytest

from iits_mj.core.errors import InputError
from iits_mj.road import Route
from tests.paths import ROOT
from tests.traffic_bridge.scripted_truck import ego_at, overlap, vehicle_box
from traffic_bridge import (
    Departure,
    InterSim,
    LaneClosure,
    PureSim,
    Recorder,
    ReSim,
    SlowConvoy,
    SpeedLimit,
    StoppedVehicle,
    TrafficConfig,
    VehicleChange,
    read_events,
)

MODELS = ("lc2013", "mobil")


@pytest.fixture(scope="module")
def road():
    return Route.straight(length=2000.0)


def touching(vehicles, low, high):
    """Pairs of vehicles between two stations whose boxes overlap."""
    near = [v for v in vehicles if low < v.station < high]
    return [
        (a.id, b.id)
        for a, b in combinations(near, 2)
        if abs(a.station - b.station) < 20.0 and overlap(vehicle_box(a), vehicle_box(b))
    ]


@pytest.mark.parametrize("model", MODELS)
def test_drivers_merge_before_a_closure_and_pass_it(model, road):
    closure = LaneClosure(lane=0, start=900.0, end=1000.0, at_time=2.0)
    config = TrafficConfig(density=0.15, lane_change=model, events=(closure,))
    before, passed, driving_in = set(), set(), 0
    with PureSim(road, config, seed=4) as traffic:
        traffic.reset()
        for step in range(700):
            vehicles = traffic.step()
            if step % 10 == 0:
                assert not touching(vehicles, 400.0, 1100.0)
            if traffic.time > 15.0:
                before |= {v.id for v in vehicles if 500.0 < v.station < 850.0}
                passed |= {v.id for v in vehicles if 1010.0 < v.station < 1100.0}
            if traffic.time > 40.0:
                driving_in += sum(
                    v.lane == 0 and 910.0 < v.station < 990.0 and v.speed > 0.5 for v in vehicles
                )
        waiting = [v for v in vehicles if v.speed < 0.5 and not v.id.startswith("blocker")]
    assert driving_in == 0
    assert len(before & passed) > 12
    assert len(waiting) <= 2


@pytest.mark.parametrize("model", MODELS)
def test_traffic_passes_a_stopped_vehicle_which_drives_on_at_the_end(model, road):
    event = StoppedVehicle(station=900.0, lane=1, type="articulated", at_time=1.0, until=50.0)
    config = TrafficConfig(density=0.1, lane_change=model, events=(event,))
    passed = set()
    with PureSim(road, config, seed=2) as traffic:
        traffic.reset()
        for step in range(700):
            vehicles = traffic.step()
            if step % 10 == 0:
                assert not touching(vehicles, 400.0, 1100.0)
            standing = vehicles.find("stopped.0")
            if 12.0 < traffic.time < 50.0:
                assert standing.speed == 0.0
                assert standing.station + 0.5 * standing.length == pytest.approx(900.0, abs=0.01)
                passed |= {v.id for v in vehicles if 920.0 < v.station < 960.0}
        assert standing.speed > 5.0
    assert len(passed) > 5
    assert all(v.speed > 1.0 for v in vehicles)


@pytest.mark.parametrize("model", MODELS)
def test_dense_traffic_lets_waiting_vehicles_in_before_a_closure(model):
    # More than the capacity of one lane: without zipper merges the closed lane waits for minutes.
    config = TrafficConfig(
        density=0.3, lane_change=model, events=(LaneClosure(lane=0, start=500.0, end=560.0),)
    )
    waiting, let_in = set(), set()
    with PureSim(Route.straight(length=900.0, lanes=2), config, seed=3) as traffic:
        traffic.reset()
        for _ in range(1500):
            frame = traffic.step()
            fronts = frame.column("station") + 0.5 * frame.column("length")
            standing = (fronts > 90.0) & (fronts < 500.0) & (frame.column("speed") < 0.5)
            waiting |= {frame.ids[k] for k in np.flatnonzero(standing & (frame.lanes == 0))}
            let_in |= waiting & {frame.ids[k] for k in np.flatnonzero(fronts > 510.0)}
    assert len(let_in) >= 3


def test_on_a_single_lane_traffic_queues_until_the_stopped_vehicle_drives_on():
    config = TrafficConfig(
        density=0.2, events=(StoppedVehicle(station=500.0, at_time=0.0, until=60.0),)
    )
    with PureSim(Route.straight(length=1200.0, lanes=1), config, seed=1) as traffic:
        traffic.reset()
        for _ in range(590):
            vehicles = traffic.step()
        standing = [v for v in vehicles if v.speed < 0.1]
        assert len(standing) >= 3
        assert max(v.station for v in standing) == vehicles.find("stopped.0").station
        for _ in range(300):
            vehicles = traffic.step()
        assert all(v.speed > 1.0 for v in vehicles)


def test_a_convoy_keeps_speed_and_lane_until_it_is_released(road):
    convoy = SlowConvoy(station=400.0, lane=0, count=4, speed=6.0, at_time=1.0, until=40.0)
    with PureSim(road, TrafficConfig(density=0.03, events=(convoy,)), seed=3) as traffic:
        traffic.reset()
        for step in range(390):
            vehicles = traffic.step()
            # A change of their type does not apply to the vehicles of an event.
            if step == 200:
                traffic.vehicles.change("truck", desired_speed=14.0)
        slow = [v for v in vehicles if v.id.startswith("convoy")]
        assert len(slow) == 4
        assert {v.lane for v in slow} == {0}
        assert max(v.speed for v in slow) == pytest.approx(6.0, abs=0.05)
        gaps = [b.station - a.station for a, b in zip(slow[1:], slow, strict=False)]
        assert min(gaps) > slow[0].length + 4.0
        for _ in range(200):
            vehicles = traffic.step()
        assert vehicles.find("convoy.0.00").speed > 9.0


def test_an_event_at_a_station_begins_once_when_the_truck_reaches_it(road):
    event = SpeedLimit(limit=5.0, at_station=300.0, duration=3.0)
    limits = []
    with InterSim(road, TrafficConfig(density="empty", events=(event,))) as traffic:
        traffic.reset(ego_at(road, 0.0, 250.0, 20.0, 2.0))
        for step in range(100):
            # Forward and back over the station: the event does not begin a second time.
            station = 250.0 + 2.0 * step if step < 60 else 370.0 - 4.0 * (step - 60)
            traffic.step(ego_at(road, 0.1 * step, station, 20.0, 2.0))
            limits.append(traffic.signals.speed_limit(1000.0))
    assert [round(limit) for limit in limits] == [25] * 25 + [5] * 30 + [25] * 45


def test_no_vehicle_appears_where_the_truck_is_or_could_not_stop(road):
    stopped = StoppedVehicle(station=310.0)
    first = None
    with InterSim(road, TrafficConfig(density="empty", events=(stopped,))) as traffic:
        traffic.reset(ego_at(road, 0.0, 250.0, 20.0, 0.0))
        for step in range(1, 60):
            ego = ego_at(road, 0.1 * step, 250.0 + 2.0 * step, 20.0, 0.0)
            if traffic.step(ego).find("stopped.0") is not None and first is None:
                first = ego.station
    rear = first + 1.4 - 16.5
    # It waited until the combination was past it.
    assert 310.0 < rear < 320.0


def test_departures_enter_at_their_time_with_their_type_lane_and_speed(road):
    departures = (
        Departure(time=5.0, type="truck", lane=1, speed=9.0),
        Departure(time=2.0, type="van", lane=0, station=300.0, speed=12.0),
    )
    config = TrafficConfig(density="empty", departures=departures)
    first = {}
    with PureSim(road, config) as traffic:
        traffic.reset()
        for _ in range(100):
            for v in traffic.step():
                first.setdefault(v.id, (traffic.time, v))
    (van_time, van), (truck_time, truck) = first["van.d00000"], first["truck.d00001"]
    assert (van.kind, van.lane, truck.kind, truck.lane) == ("van", 0, "truck", 1)
    assert van_time == pytest.approx(2.1)
    assert truck_time == pytest.approx(5.1)
    assert van.station + 0.5 * van.length == pytest.approx(300.0 + 1.2, abs=0.05)
    assert (van.speed, truck.speed) == pytest.approx((12.0, 9.0), abs=0.01)


def test_a_type_changed_by_an_event_is_restored_at_its_end(road):
    event = VehicleChange(
        target="car", parameters={"time_headway": 4.0, "desired_speed": 6.0}, until=20.0
    )
    with PureSim(road, TrafficConfig(density=0.1, events=(event,)), seed=1) as traffic:
        traffic.reset()
        for _ in range(150):
            vehicles = traffic.step()
        assert max(v.speed for v in vehicles if v.kind == "car") < 6.1
        for _ in range(250):
            vehicles = traffic.step()
        cars = [v.id for v in vehicles if v.kind == "car"]
        for name in cars:
            found = traffic.vehicles.in_force(name)
            assert found["time_headway"] == pytest.approx(1.5)
            assert found["desired_speed"] > 6.1
        # Each vehicle has its own desired speed again, not that of the type.
        assert len({traffic.vehicles.desired_speed(name) for name in cars}) > 5


def test_overlapping_changes_by_events_restore_every_vehicle(road):
    events = (
        VehicleChange(target="car", parameters={"time_headway": 2.0}, at_time=1.0, until=3.0),
        VehicleChange(target="car", parameters={"time_headway": 4.0}, at_time=2.0, until=4.0),
        VehicleChange(target="car.00003", parameters={"time_headway": 3.0}, at_time=2.5, until=5.0),
    )
    with PureSim(road, TrafficConfig(density=0.1, mix={"car": 1.0}, events=events)) as traffic:
        cars = [v for v in traffic.reset() if v.id != "car.00003" and v.station < 1500.0]
        found = []
        for k in range(60):
            traffic.step()
            if k % 5 == 4:
                each = {traffic.vehicles.in_force(car.id)["time_headway"] for car in cars}
                one = traffic.vehicles.in_force("car.00003")["time_headway"]
                found.append((*each, one))
    # Every half second: the value of all other cars, then that of the single one.
    assert found == [
        *2 * [(1.5, 1.5)],
        *2 * [(2.0, 2.0)],
        (4.0, 4.0),
        *3 * [(4.0, 3.0)],
        *2 * [(1.5, 3.0)],
        *2 * [(1.5, 1.5)],
    ]


def test_an_event_waits_for_its_vehicle_and_ends_without_error_if_it_never_appears(road):
    events = tuple(
        VehicleChange(target=target, parameters={"color": (1.0, 0.0, 0.0)}, **when)
        for target, when in (
            ("van.d00000", {"until": 3.0}),
            ("car.00999", {"duration": 2.0}),
            ("convoy.0.01", {}),
        )
    )
    config = TrafficConfig(
        density="empty", events=events, departures=(Departure(time=1.0, type="van"),)
    )
    with PureSim(road, config) as traffic:
        traffic.reset()
        red = []
        for _ in range(40):
            vehicles = traffic.step()
            painted = [v.id for v in vehicles if traffic.vehicles.color(v.id) == (1.0, 0.0, 0.0)]
            red += painted
    assert red == ["van.d00000"] * 19


def test_an_event_for_a_vehicle_that_has_left_does_not_end_the_drive():
    event = VehicleChange(
        target="car.d00000", parameters={"time_headway": 3.0}, at_time=9.0, until=10.0
    )
    start = Departure(time=0.0, type="car", station=120.0, speed=15.0)
    config = TrafficConfig(density="empty", events=(event,), departures=(start,))
    with PureSim(Route.straight(length=200.0), config) as traffic:
        traffic.reset()
        for _ in range(120):
            vehicles = traffic.step()
    assert len(vehicles) == 0


def test_events_are_stored_with_a_recording_and_run_again(tmp_path, road):
    events = (
        LaneClosure(lane=0, start=600.0, end=700.0, at_time=1.0, until=6.0),
        VehicleChange(target="car", parameters={"color": (1.0, 0.0, 0.0), "politeness": 0.0}),
        SpeedLimit(limit=7.0, start=300.0, end=501.0, at_time=3.0),
    )
    config = TrafficConfig(
        density=0.1, lane_change="mobil", events=events, departures=(Departure(time=1.0),)
    )
    assert TrafficConfig.from_dict(json.loads(json.dumps(config.as_dict()))) == config
    with Recorder(PureSim(road, config, seed=6)) as recorder:
        recorder.reset()
        for _ in range(100):
            recorder.step()
        path = recorder.save(tmp_path / "events.npz")
    with ReSim(road, path) as again:
        assert again.config.events == events
        again.verify()


@pytest.mark.parametrize(
    ("make", "text"),
    [
        (lambda: LaneClosure(lane=0, start=5.0, end=3.0), "start = 5 m must be before end = 3 m"),
        (lambda: LaneClosure(lane=-1, start=0.0, end=3.0), "lane = -1: allowed is a whole number"),
        (lambda: SpeedLimit(limit=math.nan), "limit = nan: allowed is 1 to 70"),
        (lambda: SpeedLimit(limit=9.0, at_time=1.0, at_station=2.0), "not both"),
        (lambda: SpeedLimit(limit=9.0, until=1.0, duration=2.0), "not both"),
        (lambda: SpeedLimit(limit=9.0, at_time=5.0, until=5.0), "after its beginning at 5 s"),
        (lambda: StoppedVehicle(station=math.inf), "station = inf"),
        (lambda: SlowConvoy(station=9.0, speed=5.0, count=0), "count = 0: allowed is a whole"),
        (lambda: VehicleChange(target="car", parameters={"mood": 1.0}), "'mood': allowed are"),
        (lambda: VehicleChange(target="car", parameters={}), "no parameter of car"),
        (lambda: Departure(time=-1.0), "time = -1.0: allowed is 0"),
        (lambda: TrafficConfig(events=("close",)), "'close' is no Event"),
        (lambda: TrafficConfig(events=SpeedLimit(limit=9.0)), "must be a sequence of Event"),
        (lambda: TrafficConfig(events=(StoppedVehicle(station=9.0, type="tram"),)), "types are"),
        (lambda: TrafficConfig(departures=(Departure(time=0.0, type="tram"),)), "types are"),
    ],
)
def test_unusable_events_are_refused_with_what_is_allowed(make, text):
    with pytest.raises(InputError, match=text):
        make()


@pytest.mark.parametrize(
    ("events", "text"),
    [
        ((LaneClosure(lane=5, start=5.0, end=30.0),), "lane_closure: lane 5 does not exist"),
        ((StoppedVehicle(station=9000.0),), "stopped_vehicle: car at station 9000 m: lane 0"),
        ((SlowConvoy(station=30.0, speed=9.0, count=9),), "slow_convoy: truck at station"),
        ((SpeedLimit(limit=9.0, lane=7),), "speed_limit: no lane 7"),
        ((VehicleChange(target="cart.1", parameters={"politeness": 0.1}),), "target 'cart.1'"),
    ],
)
def test_events_that_do_not_fit_the_route_are_refused_before_the_drive(events, text, road):
    with (
        PureSim(road, TrafficConfig(density="empty", events=events)) as traffic,
        pytest.raises(InputError, match=text),
    ):
        traffic.reset()


def test_wrong_calls_of_the_controller_are_refused_and_leave_the_traffic_running(road):
    with PureSim(road, TrafficConfig(density="empty")) as traffic:
        traffic.reset()
        signals = traffic.signals
        for wrong, text in [
            (lambda: signals.close_lane(0, 100.0, 9e5), "lane 0 does not exist at station"),
            (lambda: signals.close_lane(None, 100.0, 200.0), "lane = None: allowed is"),
            (lambda: signals.close_lane(0, "a", 200.0), "start = 'a': allowed is"),
            (lambda: signals.close_lane(0, 100.0, 200.0, math.nan), "notice = nan"),
            (lambda: signals.stop_vehicle(math.nan), "station = nan"),
            (lambda: signals.stop_vehicle(3.0), "lane 0 does not exist at station -1.7"),
            (lambda: signals.stop_vehicle(500.0, type="tram"), "allowed are car"),
            (lambda: signals.stop_vehicle(500.0, notice=math.nan), "notice = nan"),
            (lambda: signals.convoy(500.0, math.nan), "speed = nan"),
            (lambda: signals.convoy(500.0, 5.0, count=0), "count = 0"),
            (lambda: signals.convoy(500.0, 5.0, count=90), "truck at station .* does not exist"),
            (lambda: signals.open_lane("x"), r"closure 'x': there are \[\]"),
            (lambda: signals.release([1]), r"scripted vehicles \[1\]: there are \[\]"),
        ]:
            with pytest.raises(InputError, match=text):
                wrong()
        assert len(traffic.step()) == 0


def test_events_are_read_from_a_file(tmp_path):
    path = tmp_path / "events.toml"
    path.write_text(
        """
        [[events]]
        event = "lane_closure"
        lane = 0
        start = 900.0
        end = 1100.0
        at_time = 20
        until = 120.0

        [[events]]
        event = "vehicle_change"
        target = "car"
        parameters = {time_headway = 2.5, color = [1, 0, 0]}
        at_station = 500.0
        """,
        encoding="utf-8",
    )
    assert read_events(path) == (
        LaneClosure(lane=0, start=900.0, end=1100.0, at_time=20, until=120.0),
        VehicleChange(
            target="car",
            parameters=(("time_headway", 2.5), ("color", (1, 0, 0))),
            at_station=500.0,
        ),
    )


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("[[events]", "not TOML"),
        ("[[event]]\nlane = 0", "'event' is unknown; the file has tables"),
        ("events = 3", "must be tables"),
        ('[[events]]\nevent = "flood"', "event 1: event = 'flood': allowed are light_state"),
        ("[[events]]\nlane = 0", "event 1: event = None"),
        ('[[events]]\nevent = "speed_limit"', "event 1: speed_limit: limit is missing"),
        (
            '[[events]]\nevent = "speed_limit"\nlimit = 9\nlan = 0',
            "'lan' is unknown .did you mean lane",
        ),
        ('[[events]]\nevent = "speed_limit"\nlimit = "fast"', "limit = 'fast': allowed is 1"),
        ('[[events]]\nevent = "speed_limit"\nlimit = nan', "limit = nan: allowed is 1"),
        ("\xff", "not TOML|UTF-8"),
        ("[[events]]\n" * 1001, "1001 events are more than 1000 allowed"),
        ("events." * 5000 + "a = 1", "nested deeper than 32 levels"),
    ],
)
def test_a_file_that_cannot_be_used_is_named_with_the_reason(tmp_path, text, reason):
    path = tmp_path / "events.toml"
    path.write_text(text, encoding="latin-1")
    with pytest.raises(InputError, match=reason) as caught:
        read_events(path)
    assert str(path) in str(caught.value)


def test_the_example_runs_on_the_built_in_highway(highway):
    events = read_events(ROOT / "examples/traffic_events.toml")
    assert len(events) == 4
    with PureSim(highway, TrafficConfig(density="sparse", events=events)) as traffic:
        traffic.reset()
        assert traffic.signals.speed_limit(800.0) == 10.0
        assert traffic.signals.speed_limit(650.0) > 10.0


def test_a_missing_file_of_events_is_named(tmp_path):
    with pytest.raises(InputError, match=r"none\.toml. cannot be read"):
        read_events(tmp_path / "none.toml")


def test_events_are_immutable():
    event = SpeedLimit(limit=9.0)
    with pytest.raises(dataclasses.FrozenInstanceError):
        event.limit = 3.0
