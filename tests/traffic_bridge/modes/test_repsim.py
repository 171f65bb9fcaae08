import dataclasses
import itertools
import json
import math
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from iits_mj.core.errors import InputError
from iits_mj.core.messages import EgoState, TrackedVehicle
from iits_mj.road import Route
from tests.traffic_bridge.recorded_drive import changed, record
from tests.traffic_bridge.scripted_truck import ego_at
from traffic_bridge import Recording, RepSim, ReSim, VehicleFrame
from traffic_bridge.recording.replay import InterpolatedRecording


@pytest.fixture(scope="module")
def recorded(straight, tmp_path_factory):
    return record(straight, tmp_path_factory.mktemp("recording") / "drive", "mobil")


def replay_of(times, *tracks: dict[float, TrackedVehicle]) -> InterpolatedRecording:
    """A replay of tracks given as state by time."""
    frames = [[track[t] for track in tracks if t in track] for t in times]
    return InterpolatedRecording(Recording.of_frames({}, np.array(times), frames))


def test_replay_equals_the_recorded_frames(straight, recorded):
    path, frames = recorded
    with RepSim(straight, path) as replay:
        assert replay.reset() == frames[0]
        for frame in frames[1:]:
            assert replay.step() == frame
        assert len(replay.step()) == 0


def test_replay_does_not_depend_on_the_truck(straight, recorded):
    path, frames = recorded
    replay = RepSim(straight, path)
    assert replay.reset(ego_at(straight, 0.0, 1000.0, 9.0, 4.0)) == frames[0]
    assert replay.step(ego_at(straight, 0.1, 3000.0, 0.0, 0.0)) == frames[1]


def test_replay_needs_no_sumo(recorded, tmp_path):
    script = (
        "import sys\nfrom iits_mj.road import Route\nfrom traffic_bridge import RepSim\n"
        f"replay = RepSim(Route.straight(length=4000.0), {str(recorded[0])!r})\n"
        "replay.reset(); replay.step(); replay.at(0.123)\n"
        "assert 'libsumo' not in sys.modules\n"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


def test_velocity_and_yaw_rate_are_continuous(straight, recorded):
    replay = RepSim(straight, recorded[0]).replay
    worst, speeds, h = 0.0, [], 1e-4
    for k in range(2, 60):
        before = replay.at(0.1 * k - 2 * h), replay.at(0.1 * k - h)
        after = replay.at(0.1 * k + h), replay.at(0.1 * k + 2 * h)
        if before[0].ids != after[0].ids:
            continue
        rates = [
            (pair[1].columns("x", "y", "yaw") - pair[0].columns("x", "y", "yaw")) / h
            for pair in (before, after)
        ]
        worst = max(worst, float(np.abs(rates[1] - rates[0]).max()))
        speeds.append(rates[0][0])
    assert np.concatenate(speeds).max() > 10.0
    # Curvature of the curve times the two intervals between which the rates are taken.
    assert worst < 6.0 * 3 * h * 10


def test_vehicles_move_as_fast_as_recorded_between_frames(straight, recorded):
    replay = RepSim(straight, recorded[0])
    tracks = [replay.at(t) for t in np.arange(0.0, replay.duration, 0.02)]
    checked = 0
    for a, b in itertools.pairwise(tracks):
        if a.ids != b.ids:
            continue
        way = np.hypot(b.column("x") - a.column("x"), b.column("y") - a.column("y"))
        assert np.abs(way - 0.02 * a.column("speed")).max() < 0.02
        checked += len(a)
    assert checked > 1000


def test_constant_acceleration_is_replayed_exactly_even_at_uneven_times():
    times = [0.0, 0.1, 0.25, 0.3, 0.5]
    track = {
        t: TrackedVehicle("a", x=3.0 * t + t * t, y=2.0 * t * t, speed=3.0 + 2.0 * t) for t in times
    }
    replay = replay_of(times, track)
    for t in np.linspace(0.1, 0.3, 21):
        assert replay.at(t)[0].x == pytest.approx(3.0 * t + t * t, abs=1e-12)
        assert replay.at(t)[0].y == pytest.approx(2.0 * t * t, abs=1e-12)


def test_a_stopped_vehicle_does_not_move_before_it_starts():
    times = [0.1 * k for k in range(6)]
    where = dict(zip(times, [5.0, 5.0, 5.0, 5.5, 6.5, 8.0], strict=True))
    replay = replay_of(times, {t: TrackedVehicle("a", x=x) for t, x in where.items()})
    x = np.array([replay.at(t)[0].x for t in np.linspace(0.0, 0.5, 501)])
    assert (np.diff(x) >= -1e-12).all()
    assert (x[:200] == 5.0).all()


def test_yaw_is_interpolated_along_the_shorter_arc():
    times = [0.0, 0.1]
    track = {
        0.0: TrackedVehicle("a", yaw=math.pi - 0.1),
        0.1: TrackedVehicle("a", yaw=-math.pi + 0.1),
    }
    replay = replay_of(times, track)
    assert abs(replay.at(0.05)[0].yaw) == pytest.approx(math.pi, abs=1e-9)
    assert all(abs(replay.at(t)[0].yaw) <= math.pi for t in np.linspace(0.0, 0.1, 33))


def test_vehicles_enter_and_leave_at_their_recorded_times():
    times = [0.0, 0.1, 0.2, 0.3]
    stays = {t: TrackedVehicle("stays", x=10.0 * t) for t in times}
    enters = {t: TrackedVehicle("enters", y=4.0) for t in (0.2, 0.3)}
    leaves = {t: TrackedVehicle("leaves", y=8.0) for t in (0.0, 0.1)}
    replay = replay_of(times, stays, enters, leaves)
    seen = {t: replay.at(t).ids for t in (0.0, 0.05, 0.1, 0.15, 0.2, 0.25, 0.3)}
    assert seen == {
        0.0: ("leaves", "stays"),
        0.05: ("leaves", "stays"),
        0.1: ("leaves", "stays"),
        0.15: ("stays",),
        0.2: ("enters", "stays"),
        0.25: ("enters", "stays"),
        0.3: ("enters", "stays"),
    }


def test_only_vehicles_within_the_view_range_are_reported(straight, recorded):
    path, frames = recorded
    ego = ego_at(straight, 0.0, 1000.0, 9.0, 4.0)
    near = RepSim(straight, path, view_range=100.0).reset(ego)
    assert 0 < len(near) < len(frames[0])
    assert all(math.hypot(v.x - ego.x, v.y - ego.y) <= 100.0 for v in near)


def test_a_recording_of_another_map_is_refused_unless_allowed(recorded):
    other = Route.straight(length=3990.0)
    with pytest.raises(InputError, match="made on map"):
        RepSim(other, recorded[0])
    assert RepSim(other, recorded[0], other_map=True).reset() == recorded[1][0]


@pytest.mark.parametrize(
    "wrong", [{"view_range": 0.0}, {"view_range": math.nan}, {"step_length": math.nan}]
)
def test_unusable_arguments_are_refused(straight, recorded, wrong):
    with pytest.raises(InputError, match="must be positive"):
        RepSim(straight, recorded[0], **wrong)


def test_a_time_that_is_not_finite_is_refused_and_other_times_are_empty(straight, recorded):
    replay = RepSim(straight, recorded[0])
    with pytest.raises(InputError, match="must be finite"):
        replay.at(math.nan)
    assert replay.at(-1.0) == replay.at(1e9) == VehicleFrame.empty()


def test_a_file_of_schema_1_is_replayed_with_the_slope_of_the_road(highway, tmp_path):
    path = version_1(tmp_path / "old.npz", highway)
    frame = RepSim(highway, path).reset()
    assert frame.column("x").tolist() == [100.0, 100.0]
    point = highway.evaluate(700.0, 2.0)
    assert abs(float(point.grade)) > 1e-3
    assert frame.find("with").pitch == pytest.approx(-math.atan(float(point.grade)))
    assert frame.find("against").pitch == pytest.approx(math.atan(float(point.grade)), abs=1e-9)


def version_1(path: Path, route: Route) -> Path:
    """A file as the first version wrote it: two vehicles, one in each direction."""
    heading = float(route.evaluate(700.0).heading)
    rows = {
        "x": [100.0, 100.0],
        "y": [0.0, 0.0],
        "z": [1.0, 1.0],
        "yaw": [heading + math.pi, heading],
        "speed": [10.0, 10.0],
        "acceleration": [0.0, 0.0],
        "lateral_speed": [0.0, 0.0],
        "station": [700.0, 700.0],
        "offset": [2.0, 2.0],
    }
    names = [f.name for f in dataclasses.fields(EgoState) if f.name != "brake_pressures"]
    meta = {"schema": 1, "mode": "PureSim", "map_hash": route.road_map.content_hash}
    np.savez(
        path,
        meta=np.array(json.dumps(meta)),
        time=np.array([0.0]),
        ego=np.full((1, len(names)), math.nan),
        ego_columns=np.array(names),
        vehicle_id=np.array(["against", "with"]),
        vehicle_kind=np.array(["car", "van"]),
        vehicle_size=np.array([[4.0, 2.0, 1.5], [5.0, 2.0, 2.0]]),
        frame_start=np.array([0, 2]),
        vehicle=np.array([0, 1], dtype=np.int32),
        lane=np.array([0, 0], dtype=np.int16),
        **{name: np.array(values) for name, values in rows.items()},
    )
    return path


def test_a_rerun_of_schema_1_is_refused_with_the_reason(highway, tmp_path):
    with pytest.raises(InputError, match="made with schema 1, here is 2"):
        ReSim(highway, version_1(tmp_path / "old.npz", highway))


def test_a_file_with_another_map_name_keeps_its_poses(recorded, tmp_path, straight):
    path = changed(recorded[0], tmp_path / "named.npz", map_name="other")
    assert RepSim(straight, path).reset() == recorded[1][0]
