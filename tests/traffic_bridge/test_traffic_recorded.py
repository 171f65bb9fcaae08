import itertools
import json
import math

import numpy as np
import pytest
from scripted_truck import ego_at

from iits_mj.errors import InputError, TrafficError
from iits_mj.messages import TrackedVehicle
from iits_mj.road import Route
from traffic_bridge import InterSim, Recorder, Recording, RepSim, ReSim, TrafficConfig
from traffic_bridge.replay import between

CONFIG = TrafficConfig(density=0.2, fill_ahead=600.0, fill_behind=600.0)


@pytest.fixture(scope="module")
def recorded(straight, tmp_path_factory):
    with Recorder(InterSim(straight, CONFIG, seed=9)) as recorder:
        frames = [recorder.reset(ego_at(straight, 0.0, 1000.0, 9.0, 4.0))]
        for k in range(1, 121):
            frames.append(recorder.step(ego_at(straight, 0.1 * k, 1000.0 + 0.9 * k, 9.0, 4.0)))
        path = recorder.save(tmp_path_factory.mktemp("recording") / "drive")
    return path, frames


def test_repsim_has_distance_zero_to_its_source(straight, recorded):
    path, frames = recorded
    with RepSim(straight, path) as replay:
        assert replay.reset() == frames[0]
        for frame in frames[1:]:
            assert replay.step() == frame
        assert replay.step() == []


def test_repsim_moves_smoothly_between_frames(straight, recorded):
    path, _ = recorded
    replay = RepSim(straight, path)
    times = np.arange(0.0, replay.duration, 0.02)
    tracks = [{v.id: v for v in replay.at(t)} for t in times]
    checked = 0
    for a, b in itertools.pairwise(tracks):
        for name in a.keys() & b.keys():
            way = math.hypot(b[name].x - a[name].x, b[name].y - a[name].y)
            assert abs(way - 0.02 * a[name].speed) < 0.02
            checked += 1
    assert checked > 1000


def test_repsim_reports_only_what_is_in_range(straight, recorded):
    path, frames = recorded
    ego = ego_at(straight, 0.0, 1000.0, 9.0, 4.0)
    near = RepSim(straight, path, view_range=100.0).reset(ego)
    assert 0 < len(near) < len(frames[0])
    assert all(math.hypot(v.x - ego.x, v.y - ego.y) <= 100.0 for v in near)


def test_resim_runs_again_bit_for_bit_whatever_the_truck_does(straight, recorded):
    path, frames = recorded
    with ReSim(straight, path) as again:
        assert again.reset() == frames[0]
        assert again.step(ego_at(straight, 0.1, 2000.0, 3.0, 0.0)) == frames[1]
        assert len(again.verify()) == 64
        with pytest.raises(TrafficError, match="ends after 120 steps"):
            again.step()


def test_resim_refuses_another_map_option_or_version(straight, recorded, tmp_path):
    path, _ = recorded
    with pytest.raises(InputError, match="made on map"):
        ReSim(Route.straight(length=3990.0), path)
    with pytest.raises(InputError, match="other options: density"):
        ReSim(straight, path, TrafficConfig(density=0.1, fill_ahead=600.0, fill_behind=600.0))
    with np.load(path) as file:
        arrays = dict(file)
    meta = json.loads(str(arrays["meta"]))
    meta["versions"]["libsumo"] = "0.0.1"
    changed = tmp_path / "old.npz"
    np.savez(changed, **{**arrays, "meta": np.array(json.dumps(meta))})
    with pytest.raises(InputError, match=r"libsumo 0\.0\.1"):
        ReSim(straight, changed)


def test_resim_says_when_the_poses_differ(straight, recorded, tmp_path):
    path, _ = recorded
    with np.load(path) as file:
        arrays = dict(file)
    meta = json.loads(str(arrays["meta"]))
    meta["digest"] = "0" * 64
    changed = tmp_path / "changed.npz"
    np.savez(changed, **{**arrays, "meta": np.array(json.dumps(meta))})
    with ReSim(straight, changed) as again, pytest.raises(TrafficError, match="differs"):
        again.verify()


@pytest.mark.parametrize("content", [b"", b"PK\x03\x04 broken", b"\x93NUMPY", b"time,x\n0,1\n"])
def test_damaged_recordings_give_one_clear_error(tmp_path, content):
    path = tmp_path / "damaged.npz"
    path.write_bytes(content)
    with pytest.raises(InputError, match=r"damaged\.npz"):
        Recording.load(path)


def test_recordings_with_missing_or_unusable_columns_are_refused(recorded, tmp_path):
    path, _ = recorded
    with np.load(path) as file:
        arrays = dict(file)
    arrays["x"][3] = math.nan
    bad = tmp_path / "bad.npz"
    np.savez(bad, **arrays)
    with pytest.raises(InputError, match="'x' has values"):
        Recording.load(bad)
    del arrays["speed"]
    np.savez(bad, **arrays)
    with pytest.raises(InputError, match="has no speed"):
        Recording.load(bad)


def test_interpolation_turns_the_short_way_round():
    a = TrackedVehicle("a", yaw=math.pi - 0.1, speed=0.0)
    b = TrackedVehicle("a", yaw=-math.pi + 0.1, speed=0.0)
    assert abs(abs(between(a, b, 0.5, 0.1).yaw) - math.pi) < 1e-9
