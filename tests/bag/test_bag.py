"""A drive's bag, read by MCAP's own ROS 2 reader, and its modules repeated."""

import dataclasses
import json
import math

import numpy as np
import pytest

from iits_mj import cli
from iits_mj.bag import message_types
from iits_mj.bag.mcap_file import TOPICS, BagWriter, read_bag, typestore
from iits_mj.bag.stages import STAGES, run_stage
from iits_mj.core.errors import InputError
from iits_mj.core.messages import (
    Decision,
    LightState,
    RoadSignals,
    Scene,
    SpeedZone,
    TrackedVehicle,
    TrafficLight,
    VehicleCommand,
)
from iits_mj.simulation import DriveConfig, Observer, Simulation
from iits_mj.simulation.drive_log import BusLog
from tests.combinations import load
from tests.paths import ROOT

pytest.importorskip("rosbags")
pytest.importorskip("libsumo")
mcap_reader = pytest.importorskip("mcap.reader")
mcap_ros2 = pytest.importorskip("mcap_ros2.decoder")

DURATION = 6.0


@pytest.fixture(scope="module")
def drive(tmp_path_factory):
    """Folder of a drive's bag, the frames of the drive, and the number of CAN frames."""
    folder = tmp_path_factory.mktemp("drive")
    seen = []

    class Watch(Observer):
        period = 0.1

        def observe(self, simulation, frame):
            seen.append(frame)

    config = DriveConfig(density="dense", duration=DURATION, seed=2, decision="mobil")
    with (
        Simulation(config, visuals=False) as simulation,
        BusLog(folder / "bus.log", simulation.truck) as log,
        BagWriter(folder / "bag", simulation) as bag,
    ):
        simulation.run([log, bag, Watch()])
    return folder, seen, log.count


@pytest.fixture(scope="module")
def read(drive):
    """(time [s], message) by topic, from the independent reader."""
    (path,) = (drive[0] / "bag").glob("*.mcap")
    found = {}
    with path.open("rb") as stream:
        reader = mcap_reader.make_reader(stream, decoder_factories=[mcap_ros2.DecoderFactory()])
        for schema, channel, message, decoded in reader.iter_decoded_messages():
            assert (schema.encoding, channel.message_encoding) == ("ros2msg", "cdr")
            assert schema.name == TOPICS[channel.topic]
            found.setdefault(channel.topic, []).append((message.log_time * 1e-9, decoded))
    return found


def test_all_topics_have_their_rates(read):
    assert set(read) == set(TOPICS)
    for topic, period in (
        ("/traffic/scene", 0.1),
        ("/planning/trajectory", 0.1),
        ("/vehicle/state", 0.02),
        ("/control/command", 0.02),
        ("/tf", 0.02),
    ):
        times = np.array([time for time, _ in read[topic]])
        assert times[0] == 0.0
        np.testing.assert_allclose(np.diff(times), period, atol=1e-6)
    settings = json.loads(read["/drive"][0][1].data)
    assert settings["options"]["decision"] == "mobil"


def test_odometry_twist_and_transforms_are_those_of_the_truck(drive, read):
    frames = {round(frame.time, 3): frame for frame in drive[1]}
    transforms = dict(read["/tf"])
    twists = dict(read["/vehicle/twist"])
    compared = 0
    for time, message in read["/vehicle/odometry"]:
        frame = frames.get(round(time, 3))
        if frame is None:
            continue
        ego = frame.ego
        compared += 1
        assert message.child_frame_id == "tractor"
        place = message.pose.pose.position
        assert (place.x, place.y, place.z) == (ego.x, ego.y, ego.z)
        assert message.twist.twist.linear.x == ego.speed
        assert twists[time].twist.angular.z == ego.yaw_rate
        tractor, trailer = transforms[time].transforms
        assert _yaw(tractor.transform.rotation) == pytest.approx(ego.yaw, abs=1e-4)
        assert _yaw(trailer.transform.rotation) == pytest.approx(-ego.articulation, abs=1e-9)
        assert trailer.transform.translation.x == pytest.approx(-3.6)
    assert compared == round(DURATION / 0.1)


def _yaw(turn):
    return math.atan2(
        2.0 * (turn.w * turn.z + turn.x * turn.y), 1.0 - 2.0 * (turn.y**2 + turn.z**2)
    )


def test_rotations_are_those_of_a_rotation_matrix():
    from iits_mj.bag.message_types import StandardMessages
    from iits_mj.parameters import TruckParameters

    standard = StandardMessages(typestore().types.__getitem__, TruckParameters.load())
    turn = standard.quaternion(0.4, 0.1, -0.2)
    # Nose down by 0.1 rad: points ahead are lower. Rolled by -0.2 rad: the left side is low.
    assert 2.0 * (turn.x * turn.z - turn.w * turn.y) == pytest.approx(-math.sin(0.1))
    left = 2.0 * (turn.y * turn.z + turn.w * turn.x)
    assert left == pytest.approx(math.cos(0.1) * math.sin(-0.2))
    assert turn.x**2 + turn.y**2 + turn.z**2 + turn.w**2 == pytest.approx(1.0)


@pytest.mark.parametrize(
    ("name", "frames", "hitches"),
    [
        ("alone", ["tractor"], []),
        ("b_double", ["tractor", "trailer", "second"], [3.6, 7.9]),
        ("dolly", ["tractor", "trailer", "dolly", "second"], [3.6, 11.0, 4.6]),
    ],
)
def test_every_unit_has_its_transform_from_the_one_ahead(name, frames, hitches):
    from iits_mj.bag.message_types import StandardMessages

    angles = (0.1, 0.2, 0.3)[: len(hitches)]
    ego = dataclasses.replace(
        _ego(), yaw=0.5, articulation=sum(angles[:1]), rear_articulations=angles[1:]
    )
    standard = StandardMessages(typestore().types.__getitem__, load(name))
    found = standard.transforms(ego).transforms
    assert [each.child_frame_id for each in found] == frames
    assert [each.header.frame_id for each in found] == ["map", *frames[:-1]]
    assert [-each.transform.translation.x for each in found[1:]] == pytest.approx(hitches)
    turned = [_yaw(each.transform.rotation) for each in found]
    assert turned == pytest.approx([0.5, *(-angle for angle in angles)])


def test_markers_are_the_vehicles_and_the_path_is_the_plan(drive, read):
    for (_, markers), (_, scene) in zip(
        read["/traffic/markers"], read["/traffic/scene"], strict=True
    ):
        clear, *boxes = markers.markers
        assert clear.action == 3
        assert [box.text for box in boxes] == [vehicle.id for vehicle in scene.vehicles]
        for box, vehicle in zip(boxes, scene.vehicles, strict=True):
            assert (box.scale.x, box.pose.position.x) == (vehicle.length, vehicle.x)
    assert any(len(markers.markers) > 3 for _, markers in read["/traffic/markers"])
    path, plan = read["/planning/path"][10][1], read["/planning/trajectory"][10][1]
    assert [pose.pose.position.x for pose in path.poses] == list(plan.x)


def test_can_frames_are_those_of_the_bus_log(drive, read):
    assert len(read["/can"]) == drive[2]
    message = read["/can"][0][1]
    assert message.is_extended
    assert 0 < message.id < 1 << 29
    assert len(message.data) == 8


def test_messages_of_a_bag_are_bit_identical(drive):
    bag = read_bag(drive[0] / "bag")
    frames = drive[1]
    assert len(bag.scenes) == len(frames)
    for scene, plan, frame in zip(bag.scenes, bag.trajectories, frames, strict=True):
        assert scene.ego == frame.scene.ego
        assert scene.vehicles == tuple(frame.scene.vehicles)
        for field in dataclasses.fields(plan):
            np.testing.assert_equal(
                getattr(plan, field.name), getattr(frame.trajectory, field.name)
            )


def test_optional_values_are_read_back():
    store = typestore()
    signals = RoadSignals(
        TrafficLight(120.0, LightState.RED, None, None),
        (SpeedZone(1.0, 2.0, 13.9), SpeedZone(3.0, 4.0, 8.0, lane=0)),
    )
    scene = Scene(1.5, dataclasses.replace(Scene(0.0, _ego()).ego, gear=-1), (TrackedVehicle("a"),))
    for message in (scene, dataclasses.replace(scene, signals=signals), VehicleCommand(0.25)):
        kind = message_types.type_name(type(message))
        raw = store.serialize_cdr(message_types.encode(message, store.types.__getitem__), kind)
        assert message_types.decode(store.deserialize_cdr(raw, kind), type(message)) == message


def _ego():
    from iits_mj.core.messages import EgoState

    return EgoState(brake_pressures=(1.0, 2.0, 3.0, 4.0, 5.0), shift_in_process=True)


@pytest.mark.parametrize("stage", STAGES)
def test_each_repeated_module_is_bit_identical(drive, stage):
    found = run_stage(read_bag(drive[0] / "bag"), stage)
    assert found.count >= (4 if stage == "decision" else round(DURATION / 0.1))
    assert (found.differing, found.first, found.largest) == (0, None, {})


def test_differences_of_another_module_are_reported(drive):
    bag = read_bag(drive[0] / "bag")
    light = run_stage(bag, "vehicle", payload=0.0)
    assert light.differing == light.count
    assert light.first == 0.0
    assert light.largest["mass"] == 36_000.0
    assert 0.0 < light.largest["speed"] < 10.0
    # A recorded decision that MOBIL never makes: a change to a missing lane.
    first, *others = bag.decided
    strange = dataclasses.replace(first, decision=Decision.RIGHT)
    found = run_stage(dataclasses.replace(bag, decided=[strange, *others]), "decision")
    assert (found.differing, found.first) == (1, first.time)
    assert found.largest["decision"] == abs(Decision.RIGHT - first.decision)


def test_commands_write_a_bag_and_replay_its_stages(drive, tmp_path, capsys):
    folder = tmp_path / "bag"
    code = cli.main(
        ["drive", "--duration", "1", "--no-video", "--traffic-mode", "none", "--bag", str(folder),
         "--out", str(tmp_path / "out")]
    )  # fmt: skip
    assert code == 0
    assert (folder / "metadata.yaml").exists()
    capsys.readouterr()
    assert cli.main(["replay-stage", str(folder), "--json"]) == 0
    settings = json.loads(capsys.readouterr().out)
    assert [check["value"] for check in settings["checks"]] == [0.0] * 4
    assert cli.main(["replay-stage", str(folder), "--stage", "vehicle", "--payload", "0"]) == 1
    assert "mass: at most 3.6e+04 apart" in capsys.readouterr().out
    assert cli.main(["replay-stage", str(folder), "--stage", "traffic"]) == 2
    assert "had no traffic" in capsys.readouterr().err


def test_unusable_bags_are_refused(drive, tmp_path):
    with pytest.raises(InputError, match="cannot be read"):
        read_bag(tmp_path)
    bag = read_bag(drive[0] / "bag")
    with pytest.raises(InputError, match="stage 'brakes' is unknown"):
        run_stage(bag, "brakes")
    with pytest.raises(InputError, match="leave --map out"):
        run_stage(bag, "planning", tmp_path / "map.xodr")
    with pytest.raises(InputError, match="a version with other options: colour"):
        dataclasses.replace(bag, options={**bag.options, "colour": "red"}).config()
    with (
        Simulation(DriveConfig(duration=1.0, traffic_mode="none"), visuals=False) as simulation,
        pytest.raises(InputError, match="cannot be written"),
    ):
        BagWriter(drive[0] / "bag", simulation)
    # A bag of another program.
    from rosbags.rosbag2 import StoragePlugin, Writer

    store = typestore()
    with Writer(tmp_path / "other", version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        kind = "std_msgs/msg/String"
        connection = writer.add_connection("/chatter", kind, typestore=store)
        message = store.types[kind](data="hello")
        writer.write(connection, 0, store.serialize_cdr(message, kind))
    with pytest.raises(InputError, match=r"holds no drive: it lacks /drive"):
        read_bag(tmp_path / "other")


def test_own_parts_of_a_bag_must_be_named_again(drive, monkeypatch):
    monkeypatch.chdir(ROOT)
    bag = read_bag(drive[0] / "bag")
    own = {"decision": "os:abort", "lateral": "examples/own_lateral.py:Stanley"}
    bag = dataclasses.replace(bag, options=bag.options | own)
    assert bag.config(parts=()).lateral == "preview"
    assert run_stage(bag, "vehicle").differing == 0
    with pytest.raises(InputError, match="decision maker os:abort, which a bag does not hold"):
        run_stage(bag, "decision")
    with pytest.raises(InputError, match=r"name it by --lateral$"):
        run_stage(bag, "control")
    assert run_stage(bag, "control", lateral="preview").differing == 0
    found = run_stage(bag, "control", lateral="examples/own_lateral.py:Stanley:gain=0.2")
    assert list(found.largest) == ["steering_wheel_angle"]


def test_a_drive_that_fails_leaves_no_bag(tmp_path):
    with (
        Simulation(DriveConfig(duration=1.0, traffic_mode="none"), visuals=False) as simulation,
        pytest.raises(ZeroDivisionError),
        BagWriter(tmp_path / "bag", simulation),
    ):
        raise ZeroDivisionError
    assert not (tmp_path / "bag").exists()
    assert simulation.observers == ()


def test_a_full_disk_is_named_and_leaves_no_bag(tmp_path, full_disk):
    config = DriveConfig(duration=20.0, traffic_mode="none", decision="keep")
    with (
        Simulation(config, visuals=False) as simulation,
        pytest.raises(InputError, match=r"bag .*bag' cannot be written: File too large"),
        full_disk(200_000),
        BagWriter(tmp_path / "bag", simulation) as bag,
    ):
        simulation.run([bag])
    assert list(tmp_path.iterdir()) == []
