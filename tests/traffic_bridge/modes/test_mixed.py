import itertools

import numpy as np
import pytest

from iits_mj.core.errors import InputError
from iits_mj.core.messages import TrackedVehicle
from iits_mj.road import Route
from tests.traffic_bridge.scripted_truck import ego_at
from traffic_bridge import InterSim, MixedSim, Recorder, Recording, ReSim, TrafficConfig

STEPS = 300


def convoy(route: Route, speed: float = 6.0, steps: int = STEPS) -> Recording:
    """Four vehicles side by side in two lanes, so that no vehicle can overtake them."""
    frames = []
    for k in range(steps + 1):
        frame = []
        for lane, number in itertools.product((0, 1), range(2)):
            station = 800.0 - 60.0 * number + 0.1 * k * speed
            offset = float(route.lane_offset(lane, station))
            point = route.evaluate(station, offset)
            frame.append(
                TrackedVehicle(
                    f"old.{lane}{number}",
                    kind="truck",
                    x=float(point.x),
                    y=float(point.y),
                    yaw=float(point.heading),
                    speed=speed,
                    station=station,
                    offset=offset,
                    lane=lane,
                    length=10.0,
                    width=2.5,
                    height=3.5,
                )
            )
        frames.append(frame)
    meta = {"mode": "data", "map_hash": route.road_map.content_hash, "map_name": "straight"}
    return Recording.of_frames(meta, 0.1 * np.arange(steps + 1), frames)


def config(lane_change="lc2013", **settings) -> TrafficConfig:
    return TrafficConfig(
        **{"density": 0.1, "speed_limit": 15.0, "fill_ahead": 2000.0} | settings,
        lane_change=lane_change,
    )


@pytest.fixture(scope="module")
def two_lanes():
    return Route.straight(length=4000.0, lanes=2)


@pytest.fixture(scope="module", params=["lc2013", "mobil"])
def mixed(two_lanes, request):
    """Frames of a drive in which the convoy is slower than the live traffic."""
    recording = convoy(two_lanes)
    with MixedSim(two_lanes, recording, config(request.param), seed=4) as traffic:
        frames = [traffic.reset()]
        frames += [traffic.step() for _ in range(STEPS)]
        return recording, frames, traffic.conflicts


def test_replayed_vehicles_have_exactly_their_recorded_states(mixed):
    recording, frames, _ = mixed
    for frame, recorded in zip(frames, recording.frames, strict=True):
        assert [v for v in frame if not v.id.startswith("live.")] == list(recorded)


def test_live_traffic_brakes_behind_replayed_vehicles_and_keeps_its_gap(mixed):
    _, frames, conflicts = mixed
    assert conflicts == ()
    followers, least = set(), np.inf
    for frame in frames:
        last = frame.find("old.01").station
        for vehicle in frame:
            if not vehicle.id.startswith("live."):
                continue
            gap = last - 5.0 - vehicle.station - 0.5 * vehicle.length
            if vehicle.station < last:
                least = min(least, gap)
                if gap < 20.0 and abs(vehicle.speed - 6.0) < 0.7:
                    followers.add(vehicle.id)
    assert len(followers) >= 2
    assert least > 0.5


def test_live_traffic_does_not_pass_replayed_vehicles_that_block_all_lanes(mixed):
    _, frames, _ = mixed
    behind = {v.id for v in frames[0] if v.id.startswith("live.") and v.station < 735.0}
    last = frames[-1]
    rear = last.find("old.01").station
    assert behind
    assert all(v.station < rear for v in last if v.id in behind)


def test_live_traffic_stops_behind_the_truck(straight):
    recording = convoy(straight, steps=100)
    with MixedSim(straight, recording, config(), seed=4) as traffic:
        traffic.reset(ego_at(straight, 0.0, 400.0, 0.0, 0.0))
        for k in range(1, 101):
            frame = traffic.step(ego_at(straight, 0.1 * k, 400.0, 0.0, 0.0))
        lane = int(straight.lane_at(400.0, 0.0))
        own = [v for v in frame if v.lane == lane and v.id.startswith("live.")]
        behind = [v for v in own if v.station < 400.0]
        assert behind
        assert all(v.station + 0.5 * v.length < 383.5 for v in behind)


def test_one_seed_gives_one_recording_and_the_recording_can_be_replayed(two_lanes, tmp_path):
    recording = convoy(two_lanes, steps=20)
    made = []
    for _ in range(2):
        with Recorder(MixedSim(two_lanes, recording, config(), seed=1)) as recorder:
            recorder.reset()
            for _ in range(20):
                recorder.step()
            made.append(recorder.recording)
    assert made[0].meta["digest"] == made[1].meta["digest"]
    with MixedSim(two_lanes, made[0], config(density="empty"), seed=1) as again:
        assert again.reset() == made[0].frames[0]
        assert again.step() == made[0].frames[1]
    path = made[0].save(tmp_path / "mixed")
    with pytest.raises(InputError, match="'MixedSim' cannot be re-run"):
        ReSim(two_lanes, path)


def test_live_traffic_continues_after_the_end_of_the_recording(two_lanes):
    with MixedSim(two_lanes, convoy(two_lanes, steps=5), config(), seed=4) as traffic:
        traffic.reset()
        for _ in range(10):
            frame = traffic.step()
        assert len(frame) > 0
        assert all(v.id.startswith("live.") for v in frame)
        replayed = [n for n in traffic.session.api.vehicle.getIDList() if n.startswith("replayed.")]
        assert replayed == []


def test_without_replayed_vehicles_mixedsim_equals_intersim(two_lanes):
    recording = convoy(two_lanes, steps=5)
    far = Recording.of_frames(recording.meta, recording.time[:1], [[]])
    ego = ego_at(two_lanes, 0.0, 400.0, 0.0, 0.0)
    with MixedSim(two_lanes, far, config(), seed=4) as traffic:
        mixed = [traffic.reset(ego), traffic.step(ego)]
    with InterSim(two_lanes, config(), seed=4) as traffic:
        plain = [traffic.reset(ego), traffic.step(ego)]
    for a, b in zip(mixed, plain, strict=True):
        assert a.ids == tuple("live." + name for name in b.ids)
        assert np.array_equal(a.values, b.values)


def test_a_recording_of_another_map_is_refused(straight, two_lanes):
    with pytest.raises(InputError, match="made on map"):
        MixedSim(straight, convoy(two_lanes, steps=1))
