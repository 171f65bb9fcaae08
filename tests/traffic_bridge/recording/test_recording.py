import dataclasses
import math
import tracemalloc

import numpy as np
import pytest

from iits_mj.core.errors import InputError
from iits_mj.core.messages import (
    EgoState,
    LightState,
    RoadSignals,
    SignalLamp,
    TrackedVehicle,
    TrafficLight,
    VehicleCommand,
    XbrMode,
)
from tests.traffic_bridge.recorded_drive import STEPS, record
from tests.traffic_bridge.scripted_truck import ego_at
from traffic_bridge import PoseDigest, Recorder, Recording, RepSim, ReSim, VehicleFrame
from traffic_bridge.recording.recorder import PIECE, SpillTable
from traffic_bridge.recording.rows import ego_of, ego_row, signals_of


@pytest.fixture(scope="module")
def recorded(straight, tmp_path_factory):
    return record(straight, tmp_path_factory.mktemp("recording") / "drive")


class Invented:
    """Traffic without SUMO: `count` vehicles with random values, others in every frame."""

    mode, seed = "PureSim", 0

    def __init__(self, route, count):
        self.route, self.count, self.time = route, count, 0.0
        self.ids = tuple(f"car.{k:04d}" for k in range(count))
        self.config = type("Config", (), {"as_dict": staticmethod(dict)})

    def reset(self, ego=None):
        self.time = 0.0
        self.rng = np.random.default_rng(0)
        return self.frame()

    def step(self, ego=None):
        self.time += 0.1
        return self.frame()

    def frame(self):
        columns = self.rng.random((15, self.count))
        columns[12:] = 2.0
        lanes = np.zeros(self.count, dtype=np.intp)
        return VehicleFrame(self.ids, ("car",) * self.count, lanes, columns)

    def close(self):
        pass


def test_a_loaded_file_equals_the_recording_bit_for_bit(recorded, straight):
    path, frames = recorded
    loaded = Recording.load(path)
    assert len(loaded) == len(frames) == STEPS + 1
    assert all(a == b for a, b in zip(loaded.frames, frames, strict=True))
    assert loaded.frames[-1] == frames[-1]
    assert loaded.frames[2:4] == (frames[2], frames[3])
    assert loaded.ego_at(7) == ego_at(straight, 0.1 * 7, 1000.0 + 0.9 * 7, 9.0, 4.0)
    assert loaded.command_at(2) == VehicleCommand(accelerator_pedal=0.5 / 3)
    assert loaded.digest() == loaded.meta["digest"]


def test_a_recording_larger_than_a_block_keeps_every_frame(straight, tmp_path):
    traffic = Invented(straight, 40)
    with Recorder(traffic) as recorder:
        frames = [recorder.reset()]
        # Enough rows that most of them are in the temporary file.
        frames += [recorder.step() for _ in range(1500)]
        assert 4 * PIECE < 40 * 1500 * 100
        path = recorder.save(tmp_path / "long")
        recorder.reset()
        assert len(recorder.recording) == 1
    loaded = Recording.load(path)
    assert all(a == b for a, b in zip(loaded.frames, frames, strict=True))


def test_memory_does_not_grow_with_the_length_of_a_recording(straight, tmp_path):
    traffic = Invented(straight, 40)
    with Recorder(traffic) as recorder:
        recorder.reset()
        for _ in range(300):
            recorder.step()
        tracemalloc.start()
        try:
            for _ in range(1500):
                recorder.step()
            noted = tracemalloc.get_traced_memory()
            recorder.save(tmp_path / "long")
            saved = tracemalloc.get_traced_memory()[1]
        finally:
            tracemalloc.stop()
    rows = 1500 * 40 * 12 * 8
    assert noted[0] < rows / 10
    assert saved < 4 * PIECE + rows / 2


def test_a_missing_truck_is_recorded_as_none(straight, tmp_path):
    with Recorder(Invented(straight, 2)) as recorder:
        recorder.reset()
        recorder.step(EgoState(time=0.1, gear=-1, brake_pressures=(1.0, 2.0, 3.0, 4.0, 5.0)))
        loaded = Recording.load(recorder.save(tmp_path / "file"))
    first, second = loaded.ego_at(0), loaded.ego_at(1)
    assert first is None
    assert second is not None
    assert second.gear == -1
    assert second.brake_pressures == (1.0, 2.0, 3.0, 4.0, 5.0)


@pytest.mark.parametrize("rear", [((), ()), ((0.1, -0.2), (0.3, 0.4))])
def test_a_truck_state_equals_the_state_of_its_row(rear):
    rng = np.random.default_rng(1)
    values = {f.name: float(rng.normal()) for f in dataclasses.fields(EgoState)}
    values |= {"rear_articulations": rear[0], "rear_articulation_rates": rear[1]}
    values |= {"gear": 7, "shift_in_process": True, "brake_pressures": (1.0, 2.0, 0.1, 4.0, 5.0)}
    state = EgoState(**values)
    assert ego_of(np.array(ego_row(state))) == state
    with pytest.raises(InputError, match=r"ego\.pitch = nan"):
        ego_row(dataclasses.replace(state, pitch=math.nan))


def test_commands_that_are_not_finite_are_refused(straight):
    recorder = Recorder(Invented(straight, 2))
    with pytest.raises(InputError, match="must be finite"):
        recorder.note_command(0.0, VehicleCommand(steering_wheel_angle=math.nan))
    recorder.note_command(0.0, VehicleCommand(xbr_demand=-1.0, xbr_mode=XbrMode.MAXIMUM))


def test_a_name_with_two_sizes_keeps_the_size_of_each_frame():
    frames = [[TrackedVehicle("a", length=4.0)], [TrackedVehicle("a", length=5.0)]]
    made = Recording.of_frames({}, np.array([0.0, 0.1]), frames)
    assert [frame[0].length for frame in made.frames] == [4.0, 5.0]


def test_rows_in_any_order_become_sorted_frames():
    made = Recording.of_rows(
        {"mode": "data"},
        np.array([0.0, 0.1, 0.2]),
        ["b", "a"],
        ["car", "truck"],
        np.full((2, 3), 2.0),
        frame=np.array([2, 0, 2]),
        vehicle=np.array([0, 0, 1]),
        lane=np.array([1, 2, 3]),
        columns=np.arange(36.0).reshape(12, 3),
    )
    assert [frame.ids for frame in made.frames] == [("b",), (), ("a", "b")]
    assert made.frames[2].find("a").x == 2.0
    assert made.frames[2].kinds == ("truck", "car")
    assert made.meta["digest"] == made.digest()


def test_a_vehicle_twice_in_a_frame_is_refused():
    with pytest.raises(InputError, match="'a' is twice in a frame"):
        Recording.of_rows(
            {},
            np.array([0.0]),
            ["a"],
            ["car"],
            np.full((1, 3), 2.0),
            np.array([0, 0]),
            np.array([0, 0]),
            np.array([0, 0]),
            np.zeros((12, 2)),
        )


@pytest.mark.parametrize(
    "content",
    [b"", b"PK\x03\x04 broken", b"\x93NUMPY", b"time,x\n0,1\n", b"PK\x05\x06" + 18 * b"\0"],
)
def test_damaged_files_give_one_clear_error(tmp_path, content):
    path = tmp_path / "damaged.npz"
    path.write_bytes(content)
    with pytest.raises(InputError, match=r"damaged\.npz"):
        Recording.load(path)


def test_a_file_cut_off_anywhere_is_refused(recorded, tmp_path):
    whole = recorded[0].read_bytes()
    path = tmp_path / "cut.npz"
    for part in (0.1, 0.5, 0.9, 0.999):
        path.write_bytes(whole[: int(part * len(whole))])
        with pytest.raises(InputError, match=r"cut\.npz"):
            Recording.load(path)


def test_flipped_bytes_are_refused_or_change_nothing(recorded, tmp_path):
    whole = recorded[0].read_bytes()
    digest = Recording.load(recorded[0]).digest()
    path = tmp_path / "flipped.npz"
    rng = np.random.default_rng(3)
    refused = 0
    for place in rng.integers(0, len(whole), 30).tolist():
        path.write_bytes(whole[:place] + bytes([whole[place] ^ 0x55]) + whole[place + 1 :])
        try:
            assert Recording.load(path).digest() == digest
        except InputError:
            refused += 1
    assert refused > 20


def _rewritten(path, target, change):
    with np.load(path) as file:
        arrays = dict(file)
    change(arrays)
    np.savez(target, **arrays)
    return target


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (lambda a: a["x"].__setitem__(3, math.nan), "'x' has values that are not finite"),
        (lambda a: a["vehicle_size"].__setitem__((0, 0), -1.0), "vehicle_size"),
        (lambda a: a.pop("speed"), "has no speed"),
        (lambda a: a.pop("command"), "has no command"),
        (lambda a: a["time"].__setitem__(2, 0.0), r"time does not increase: \[2\] = 0 s after"),
        (lambda a: a["vehicle"].__setitem__(0, 10_000), "not 0 to"),
        (lambda a: a["vehicle"].__setitem__(1, a["vehicle"][0]), "twice in a frame"),
        (lambda a: a["frame_start"].__setitem__(-1, 3), "frame_start"),
        (lambda a: a["vehicle_kind"].__setitem__(0, "bus"), "vehicle_kind"),
        (lambda a: a["ego"].__setitem__((4, 2), math.nan), "ego .* in frame 4"),
        (lambda a: a.__setitem__("vehicle", a["vehicle"] * 1.5), "cannot be read"),
        (lambda a: a.__setitem__("lane", a["lane"][:5]), "lane has the shape"),
        (lambda a: a.__setitem__("x", a["x"][:5]), "cannot be read"),
        (lambda a: a.__setitem__("meta", np.array("[1]")), "schema None"),
        (
            lambda a: a.__setitem__("meta", np.array('{"schema": 3}')),
            "schema 3: this version reads 1 and 2",
        ),
        (lambda a: a.__setitem__("meta", np.array("{")), "meta is not JSON"),
    ],
)
def test_unusable_contents_are_refused_with_the_reason(recorded, tmp_path, change, reason):
    with pytest.raises(InputError, match=reason):
        Recording.load(_rewritten(recorded[0], tmp_path / "bad.npz", change))


def test_a_file_that_cannot_be_written_leaves_nothing(recorded, tmp_path):
    loaded = Recording.load(recorded[0])
    with pytest.raises(InputError, match="cannot be written"):
        loaded.save(tmp_path / "nowhere" / "file.npz")
    occupied = tmp_path / "folder.npz"
    occupied.mkdir()
    with pytest.raises(InputError, match="cannot be written"):
        loaded.save(occupied)
    assert [path.name for path in tmp_path.iterdir()] == ["folder.npz"]


def test_an_interrupted_frame_is_left_out(straight, tmp_path):
    for owner, method in ((PoseDigest, "add"), (SpillTable, "append")):
        traffic = Invented(straight, 3)
        with Recorder(traffic) as recorder:
            frames = [recorder.reset(), recorder.step()]
            with pytest.MonkeyPatch.context() as patch:
                patch.setattr(owner, method, interrupt)
                with pytest.raises(KeyboardInterrupt):
                    recorder.step()
            loaded = Recording.load(recorder.save(tmp_path / method))
        assert list(loaded.frames) == frames
        assert loaded.digest() == loaded.meta["digest"]


def interrupt(*_):
    raise KeyboardInterrupt


def test_a_recording_without_frames_is_refused(straight, tmp_path):
    recorder = Recorder(Invented(straight, 3))
    path = recorder.save(tmp_path / "empty")
    for use in (RepSim, ReSim):
        with pytest.raises(InputError, match="has no frames"):
            use(straight, path)


def test_rows_in_the_temporary_file_keep_their_order():
    table = SpillTable(np.dtype([("a", "i8"), ("b", "f8", (3,))]))
    for k in range(0, 200_000, 1000):
        rows = table.room(1000)
        rows["a"] = np.arange(k, k + 1000)
    assert len(table) == 200_000
    assert (table.array()["a"] == np.arange(200_000)).all()
    table.clear()
    assert len(table) == 0
    assert len(table.array()) == 0


GREEN, RED = LightState.GREEN, LightState.RED
CHANGES = (
    (0, RoadSignals(TrafficLight(40.0, RED), lamps=(SignalLamp("1", RED), SignalLamp("2", GREEN)))),
    (7, RoadSignals(TrafficLight(40.0, GREEN), lamps=(SignalLamp("2", GREEN),))),
    (9, RoadSignals()),
)


def test_lights_are_those_of_the_last_change_and_a_file_without_them_has_none(recorded, tmp_path):
    path, _ = recorded
    before = Recording.load(path)
    assert before.signals == ()
    assert before.signals_at(3) == RoadSignals()
    lit = dataclasses.replace(before, signals=CHANGES)
    found = Recording.load(lit.save(tmp_path / "lit"))
    assert found.signals == CHANGES
    for frame, place in ((0, 0), (6, 0), (7, 1), (8, 1), (9, 2), (12, 2)):
        assert found.signals_at(frame) == CHANGES[place][1]
    # Files of earlier versions have no such array.
    with np.load(path) as file:
        arrays = {name: file[name] for name in file.files if name != "signals"}
    np.savez(tmp_path / "old.npz", **arrays)
    assert Recording.load(tmp_path / "old.npz").signals == ()


@pytest.mark.parametrize(
    "rows",
    [
        3,
        [[0, None]],
        [[0, None, {"1": "blue"}]],
        [[0, [math.nan, "red"], {}]],
        [[2, None, {}], [2, None, {}]],
        [[-1, None, {}]],
    ],
)
def test_unusable_lights_are_refused(rows):
    with pytest.raises(InputError, match=r"its signals: row \d is not usable"):
        signals_of(rows, "its signals")
