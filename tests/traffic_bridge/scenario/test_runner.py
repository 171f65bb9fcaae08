import itertools
import math

import numpy as np
import pytest

from iits_mj.core.errors import InputError
from tests.traffic_bridge.scenario.scene import ROAD, SPEED, START, STEP, drive
from tests.traffic_bridge.scripted_truck import ego_at
from traffic_bridge import (
    Brake,
    ChangeLane,
    CutIn,
    EventSim,
    FrictionChange,
    InterSim,
    LaneClosure,
    PlaceVehicle,
    PureSim,
    Recorder,
    Recording,
    RepSim,
    ReSim,
    SpeedLimit,
    Swerve,
    TrafficConfig,
    Wind,
)

CAR = PlaceVehicle(name="car", gap=-10.0, relative_lane=1, speed_difference=3.0)
CUT_IN = CutIn(
    actor="car", gap=15.0, speed_difference=-2.0, when={"measure": "ahead", "to": "car", "above": 0}
)
BRAKE = Brake(actor="car", to_speed=10.0, when={"event": "cut_in", "delay": 1.0})
STORY = (CAR, CUT_IN, BRAKE)


def test_events_follow_each_other_by_their_conditions():
    run = drive(STORY, 30.0)
    car, cut_in, brake = (run.record(name) for name in ("car", "cut_in", "brake"))
    assert [r.event.title for r in run.records] == ["car", "cut_in", "brake"]
    begun = round(cut_in.begun / STEP)
    ahead = [run.track("car")[k].station + 2.35 - run.stations[k] - 1.4 for k in (begun - 1, begun)]
    assert ahead[0] <= 0.0 < ahead[1]
    assert car.begun == 0.0
    assert car.ended is None
    assert brake.begun == pytest.approx(cut_in.ended + 1.0, abs=STEP + 1e-9)
    assert {r.actor for r in run.records} == {"car"}


@pytest.mark.parametrize("make", [InterSim, PureSim])
def test_a_scenario_on_an_empty_road_is_the_same_in_sumo(make):
    assert drive(STORY, 25.0, make=make).frames == drive(STORY, 25.0).frames


def test_the_vehicle_of_a_role_becomes_an_actor_without_a_jump():
    swerve = Swerve(actor="left_leader", offset=1.0, when={"measure": "time", "above": 5.0})
    run = drive([swerve], 20.0, make=InterSim, density="dense", clear_distance=40.0, seed=3)
    record = run.record("swerve")
    track = [vehicle for vehicle in run.track(record.actor) if vehicle is not None]
    assert len(track) > 150
    begun = round(record.begun / STEP)
    actor = run.track(record.actor)[begun]
    others = [v for v in run.frames[begun] if v.lane == 1 and v.station > run.stations[begun] + 1.4]
    assert actor == min(others, key=lambda v: v.station)
    for before, after in itertools.pairwise(track):
        assert abs(after.speed - before.speed) < 9.5 * STEP
        assert abs(after.offset - before.offset) < 2.5 * STEP
        way = after.station - before.station
        assert way == pytest.approx(before.speed * STEP, abs=0.1)
    assert {v.kind for v in track} == {actor.kind}


def test_sumo_vehicles_brake_for_an_actor():
    stop = Brake(actor="leader", deceleration=5.0, when={"measure": "time", "above": 3.0})
    run = drive(
        [stop], 30.0, make=InterSim, density=0.2, clear_distance=40.0, seed=1, lane=0,
        speed=lambda t: max(20.0 - 2.0 * t, 0.0),
    )  # fmt: skip
    name = run.record("brake").actor
    last = run.frames[-1]
    for lane in (0, 1, 2):
        row = sorted((v for v in last if v.lane == lane), key=lambda v: v.station)
        for behind, ahead in itertools.pairwise(row):
            gap = ahead.station - behind.station - 0.5 * (ahead.length + behind.length)
            assert gap > 0.0, (behind.id, ahead.id)
    assert last.find(name).speed == 0.0


def test_an_actor_brakes_for_a_slower_truck_after_its_event():
    behind = PlaceVehicle(name="car", gap=-40.0, relative_lane=1, speed=25.0)
    merge = ChangeLane(actor="car", relative_lane=-1, duration=2.0)
    run = drive([behind, merge], 30.0, speed=lambda _: 15.0)
    car = run.track("car")[-1]
    rear = run.stations[-1] + 1.4 - 16.5
    assert rear - car.station - 0.5 * car.length > 2.0
    assert car.speed == pytest.approx(15.0, abs=0.3)


def test_an_event_waits_for_its_actor_and_never_begins_without_it():
    braking = Brake(actor="leader")
    late = PlaceVehicle(name="car", gap=60.0, at_time=2.0)
    assert drive([braking, late], 4.0).record("brake").begun == pytest.approx(2.1)
    assert not drive([braking], 4.0).records
    # A cut-in from the truck's own lane is none.
    assert len(drive([PlaceVehicle(name="car", gap=60.0), CutIn(actor="car")], 3.0).records) == 1


@pytest.mark.parametrize("make", [EventSim, InterSim])
def test_two_runs_have_the_same_bits_and_a_recording_is_run_again(make, tmp_path):
    density = "empty" if make is EventSim else "dense"
    config = TrafficConfig(density=density, events=STORY, clear_distance=40.0)
    paths = []
    for number in range(2):
        with Recorder(make(ROAD, config, 2)) as traffic:
            for step in range(200):
                station = START + SPEED * STEP * step
                ego = ego_at(ROAD, step * STEP, station, SPEED, float(ROAD.lane_offset(0, station)))
                traffic.step(ego) if step else traffic.reset(ego)
            paths.append(traffic.save(tmp_path / f"{number}.npz"))
    first, second = map(Recording.load, paths)
    assert first.meta["digest"] == second.meta["digest"]
    with ReSim(ROAD, paths[0]) as again:
        assert again.verify() == first.meta["digest"]
        assert again.config.events == STORY
    frames = RepSim(ROAD, paths[0])
    assert frames.at(10.0).find("car") is not None


def test_events_take_place_among_recorded_vehicles():
    config = TrafficConfig(density="dense", clear_distance=40.0)

    def ego(step):
        station = START + SPEED * STEP * step
        return ego_at(ROAD, step * STEP, station, SPEED, float(ROAD.lane_offset(0, station)))

    with Recorder(InterSim(ROAD, config, 0)) as traffic:
        traffic.reset(ego(0))
        for step in range(1, 60):
            traffic.step(ego(step))
        recording = traffic.recording
    stop = Brake(actor="left_leader", deceleration=3.0, at_time=1.0)
    events = TrafficConfig(events=(stop,))
    with EventSim(ROAD, events, recorded=RepSim(ROAD, recording)) as mixed:
        frames = [mixed.reset(ego(0)), *(mixed.step(ego(k)) for k in range(1, 60))]
        (record,) = mixed.running_scenario().records
    same, changed = recording.frames[10], recording.frames[50]
    assert frames[9] == recording.frames[9].near(ego(9).x, ego(9).y, 400.0)
    assert frames[10].ids == same.near(ego(10).x, ego(10).y, 400.0).ids
    assert frames[50].find(record.actor).speed < changed.find(record.actor).speed - 5.0


def test_an_event_of_sumo_may_have_conditions_and_ends_after_its_time():
    when = {"measure": "station", "above": START + 1.4 + 50.0}
    limit = SpeedLimit(limit=8.0, when=when, duration=3.0)
    run = drive([limit, Brake(actor="leader", when={"event": "speed_limit"})], 8.0, make=InterSim)
    (record,) = run.records
    assert record.begun == pytest.approx(2.6)
    assert record.ended == pytest.approx(5.6)
    with pytest.raises(InputError, match="speed_limit needs SUMO"):
        drive([limit], 8.0)
    with pytest.raises(InputError, match="lane_closure needs SUMO"):
        EventSim(ROAD, TrafficConfig(events=(LaneClosure(lane=0, start=1.0, end=2.0),)))


def test_events_of_the_truck_last_from_their_conditions_to_their_ends():
    gust = Wind(speed=20.0, duration=2.0, at_time=1.0)
    ice = FrictionChange(friction=0.2, at_time=2.0, until=4.0)
    run = drive([gust, ice], 5.0)
    assert [(r.begun, r.ended) for r in run.records] == [
        (pytest.approx(1.0), pytest.approx(3.0)),
        (pytest.approx(2.0), pytest.approx(4.0)),
    ]


def test_every_number_of_an_actor_is_finite():
    for frame in drive(STORY, 30.0).frames:
        assert np.isfinite(frame.values).all()
    assert not math.isnan(drive(STORY, 1.0).gap("car", 0.5))
