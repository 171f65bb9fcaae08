import dataclasses
import math

import numpy as np
import pytest
from osi_utilities import ChannelSpecification, open_channel

from iits_mj.cli import main
from iits_mj.core.messages import EgoState
from iits_mj.export.osi import GroundTruthWriter, OsiLog, unit_motions
from iits_mj.parameters import TruckParameters
from iits_mj.road import Route
from iits_mj.simulation import DriveConfig, Simulation
from traffic_bridge import Recording

TRUCK = TruckParameters.load(None)


@pytest.fixture(scope="module")
def truths(drive, tmp_path_factory):
    path = tmp_path_factory.mktemp("osi") / "drive.mcap"
    assert main(["export", str(drive), "--osi", str(path)]) == 0
    return read(path)


def read(path):
    """The messages of a file, by ASAM's own reader."""
    with open_channel(ChannelSpecification(path=path, topic="ground_truth")) as channel:
        return list(channel)


def by_name(truth):
    return {each.source_reference[0].identifier[0]: each for each in truth.moving_object}


def test_every_frame_has_the_truck_its_trailer_and_the_car(truths):
    assert len(truths) == 41
    for step, truth in enumerate(truths):
        time = truth.timestamp.seconds + 1e-9 * truth.timestamp.nanos
        assert time == pytest.approx(0.1 * step, abs=1e-9)
        assert [each.id.value for each in truth.moving_object] == [1, 2, 1001]
        assert truth.host_vehicle_id.value == 1
        tractor, trailer, car = truth.moving_object
        types = type(tractor).VehicleClassification
        kinds = [each.vehicle_classification.type for each in (tractor, trailer, car)]
        assert kinds == [types.TYPE_SEMITRACTOR, types.TYPE_SEMITRAILER, types.TYPE_CAR]
        assert tractor.vehicle_classification.trailer_id.value == trailer.id.value
        assert not trailer.vehicle_classification.has_trailer


def test_poses_and_sizes_are_those_of_the_recording(truths, drive):
    recording = Recording.load(drive)
    for truth, frame in zip(truths, recording.frames, strict=True):
        car, vehicle = by_name(truth)["car"].base, frame.find("car")
        assert (car.position.x, car.position.y) == (vehicle.x, vehicle.y)
        # The position is the middle of the box, half its height above the road.
        assert car.position.z == pytest.approx(vehicle.z + 0.5 * vehicle.height)
        assert car.dimension.length == vehicle.length
        assert car.orientation.yaw == vehicle.yaw


def test_velocities_are_the_rates_of_the_positions(truths):
    for name in ("tractor", "trailer", "car"):
        bases = [by_name(truth)[name].base for truth in truths]
        x = np.array([[b.position.x, b.position.y] for b in bases])
        v = np.array([[b.velocity.x, b.velocity.y] for b in bases])
        mean = 0.5 * (v[1:] + v[:-1])
        assert np.abs(np.diff(x, axis=0) / 0.1 - mean).max() < 0.05, name


@pytest.mark.parametrize("name", ["tractor_semitrailer_6x4", "b_double", "rigid_drawbar"])
def test_units_of_a_turning_truck_are_joined_and_move_as_one(name):
    # 1 ms of a truck whose joints turn: each unit's velocity is the rate of its place.
    parameters = TruckParameters.load(name)
    joints = len(parameters.units) - 1
    rates = tuple(0.05 * (k + 1) for k in range(joints))
    route = Route.straight(length=2000.0)
    step = 1e-3

    def state(time):
        yaw = 0.2 + 0.1 * time
        angles = tuple(0.3 + rate * time for rate in rates)
        along, across = 15.0, 0.4
        return EgoState(
            x=500.0 + time * (along * math.cos(0.2) - across * math.sin(0.2)),
            y=time * (along * math.sin(0.2) + across * math.cos(0.2)),
            yaw=yaw,
            station=500.0,
            speed=along,
            lateral_speed=across,
            yaw_rate=0.1,
            articulation=angles[0] if joints else 0.0,
            articulation_rate=rates[0] if joints else 0.0,
            rear_articulations=angles[1:],
            rear_articulation_rates=rates[1:],
        )

    before, now = (unit_motions(state(t), parameters, route) for t in (-step, step))
    middle = unit_motions(state(0.0), parameters, route)
    for old, mid, new in zip(before, middle, now, strict=True):
        assert mid.speed_x == pytest.approx((new.x - old.x) / (2 * step), abs=1e-3)
        assert mid.speed_y == pytest.approx((new.y - old.y) / (2 * step), abs=1e-3)
        assert mid.yaw_rate == pytest.approx((new.yaw - old.yaw) / (2 * step), abs=1e-9)


def test_a_trailer_stands_on_its_own_piece_of_road():
    # A crest: the tractor goes down already, the trailer still climbs.
    from iits_mj.road import RoadMap

    highway = RoadMap.builtin().route()
    stations = np.arange(100.0, 14_000.0, 5.0)
    grades = np.asarray(highway.evaluate(stations).grade)
    top = float(stations[np.argmax((grades[:-1] > 0.0) & (grades[1:] <= 0.0))])
    point = highway.evaluate(top + 6.0)
    ego = EgoState(
        x=float(point.x), y=float(point.y), z=float(point.z), yaw=float(point.heading),
        pitch=-math.atan(float(point.grade)), station=top + 6.0,
    )  # fmt: skip
    tractor, trailer = unit_motions(ego, TRUCK, highway)
    assert tractor.pitch > 0.0 > trailer.pitch


def test_the_log_of_a_drive_equals_the_export_of_its_recording(drive, truths, tmp_path):
    stored = Recording.load(drive)
    events = drive.parent / "events.toml"
    config = DriveConfig(traffic_mode="none", events=events, start_station=300.0, duration=4.0)
    with (
        Simulation(config, visuals=False) as simulation,
        OsiLog(tmp_path / "d.mcap", simulation) as log,
    ):
        simulation.run([log])
    again = read(tmp_path / "d.mcap")
    assert len(again) == len(stored.time)
    assert [each.SerializeToString() for each in again] == [
        each.SerializeToString() for each in truths
    ]


def test_kinds_of_road_users(tmp_path):
    from iits_mj.core.vehicles import TrackedVehicle

    kinds = ("car", "van", "truck", "articulated", "pedestrian", "bicycle", "obstacle")
    writer = GroundTruthWriter(tmp_path / "k.mcap", None, Route.straight(length=500.0))
    writer.write(0.0, None, [TrackedVehicle(kind, kind=kind, x=10.0) for kind in kinds])
    writer.close()
    (truth,) = read(tmp_path / "k.mcap")
    objects = by_name(truth)
    user = type(objects["car"])
    assert not truth.HasField("host_vehicle_id")
    assert objects["pedestrian"].type == user.TYPE_PEDESTRIAN
    assert objects["obstacle"].type == user.TYPE_OTHER
    assert objects["articulated"].vehicle_classification.type == 7  # heavy truck
    assert objects["bicycle"].vehicle_classification.type == 11
    assert len({each.id.value for each in objects.values()}) == len(kinds)


def test_an_interrupted_file_leaves_the_older_one(tmp_path):
    path = tmp_path / "old.mcap"
    path.write_bytes(b"old")
    writer = GroundTruthWriter(path, TRUCK, Route.straight(length=500.0))
    writer.write(0.0, dataclasses.replace(EgoState(), x=50.0, station=50.0), [])
    writer.abandon()
    assert path.read_bytes() == b"old"
    assert list(tmp_path.iterdir()) == [path]
