"""Sensors see what a radar or a camera sees, and repeat bit for bit."""

import math

import pytest

from iits_mj.core.errors import InputError
from iits_mj.core.messages import EgoFootprint, EgoState, TrackedVehicle
from iits_mj.core.vehicles import VehicleFrame
from iits_mj.road import Route
from iits_mj.simulation import DriveConfig, Simulation
from iits_mj.simulation.sensors import SUITES, Perception, Sensor, visible

ROUTE = Route.straight(length=2000.0)
EGO = EgoState(x=500.0, station=500.0, speed=20.0)
FRONT = Sensor(0.0, 0.0, 0.0, 200.0, math.radians(15.0), 0.4, math.radians(0.3))


def car(name, ahead, left=0.0, **more):
    x = 501.4 + ahead
    return TrackedVehicle(name, x=x, y=left, station=x, offset=left, **more)


def seen(*vehicles, sensor=FRONT, ego=EGO):
    frame = VehicleFrame.of(vehicles)
    return [frame.ids[k] for k in visible(sensor, ego, frame, 1.4)]


def test_a_sensor_sees_within_its_range_and_its_field_of_view():
    assert seen(car("near", 50.0), car("far", 250.0), car("behind", -50.0)) == ["near"]
    assert seen(car("inside", 50.0, 12.0), car("outside", 50.0, 20.0)) == ["inside"]


def test_a_sensor_does_not_see_what_a_truck_hides():
    truck = car("truck", 30.0, length=12.0, width=2.5)
    assert seen(truck, car("hidden", 60.0)) == ["truck"]
    assert seen(truck, car("beside", 60.0, 4.0)) == ["beside", "truck"]


def test_a_sensor_turns_with_the_truck():
    ego = EgoState(x=500.0, station=500.0, speed=20.0, yaw=math.pi)
    assert seen(car("ahead", 50.0), car("behind", -60.0), ego=ego) == ["behind"]


def test_side_radars_see_beside_the_trailer_but_not_behind_it():
    left = next(s for s in SUITES["surround"] if s.left > 0.0)
    vehicles = car("beside", -10.0, 3.7), car("behind", -35.0), car("right", -10.0, -3.7)
    assert seen(*vehicles, sensor=left) == ["beside"]


def perceive(seed, count=20):
    perception = Perception(SUITES["surround"], ROUTE, EgoFootprint(), seed)
    frames = []
    for k in range(count):
        ego = EgoState(time=0.1 * k, x=500.0 + 2.0 * k, station=500.0 + 2.0 * k, speed=20.0)
        vehicles = [car("a", 60.0 + 1.0 * k, speed=10.0), car("b", 30.0 + 2.0 * k, 3.7, speed=20.0)]
        frames.append(perception.see(ego, VehicleFrame.of(vehicles)))
    return frames


def test_the_same_seed_gives_the_same_tracks():
    assert perceive(1) == perceive(1)
    assert perceive(1) != perceive(2)


def test_tracks_begin_with_the_drive_and_come_late_after_it():
    first, last = perceive(1)[0], perceive(1)[-1]
    assert len(first) == 2
    slow = min(last, key=lambda v: v.speed)
    assert slow.speed == pytest.approx(10.0, abs=0.3)
    assert slow.x == pytest.approx(501.4 + 60.0 + 19.0, abs=0.6)
    assert slow.id != "a"


def test_a_vehicle_that_appears_is_reported_after_latency_and_confirmation():
    perception = Perception(SUITES["front"], ROUTE, EgoFootprint(), 0)
    counts = []
    for k in range(20):
        vehicles = [car("a", 80.0)] if k >= 5 else []
        counts.append(
            len(perception.see(EgoState(time=0.1 * k, x=500.0), VehicleFrame.of(vehicles)))
        )
    assert not any(counts[:7])
    assert all(counts[12:])


def test_ghosts_alone_are_not_reported_where_the_camera_looks():
    perception = Perception(SUITES["front"], ROUTE, EgoFootprint(), 4)
    reported = 0
    for k in range(600):
        ego = EgoState(time=0.1 * k, x=500.0, station=500.0, speed=20.0)
        for v in perception.see(ego, VehicleFrame.empty()):
            ahead, left = v.x - 501.0, v.y
            covered = math.hypot(ahead, left) < 140.0 and abs(math.atan2(left, ahead)) < 0.8
            reported += covered
    assert reported == 0


def test_perfect_sensors_show_the_traffic_itself():
    config = DriveConfig(traffic_mode="none", duration=1.0, speed_planner="cruise", decision="keep")
    with Simulation(config, visuals=False) as simulation:
        assert simulation.perception is None
        assert simulation.scene.vehicles is simulation.vehicles


def test_a_drive_knows_only_tracks_and_its_gaps_are_the_real_ones(tmp_path):
    events = tmp_path / "lead.toml"
    events.write_text(
        '[[events]]\nevent = "place_vehicle"\nname = "lead"\ngap = 40.0\nspeed = 15.0\n'
    )
    config = DriveConfig(
        traffic_mode="none", events=events, duration=2.0, sensors="front", start_station=300.0,
        speed_planner="cruise", decision="keep",
    )  # fmt: skip
    with Simulation(config, visuals=False) as simulation:
        frames = [simulation.cycle() for _ in range(15)]
        (lead,) = simulation.vehicles
    track = min(frames[-1].scene.vehicles, key=lambda vehicle: vehicle.x)
    assert track.id.startswith("track")
    assert track.x != lead.x
    assert track.x == pytest.approx(lead.x, abs=1.0)
    front = frames[-1].ego.station + 1.4
    assert frames[-1].gap_ahead == pytest.approx(lead.station - 0.5 * lead.length - front, abs=0.01)


def test_wrong_settings_are_refused():
    with pytest.raises(InputError, match="sensors"):
        DriveConfig(sensors="lidar")
    with pytest.raises(InputError, match=r"detection = 1\.5"):
        Sensor(0.0, 0.0, 0.0, 100.0, 1.0, 0.1, 0.01, detection=1.5)
    with pytest.raises(InputError, match="reach"):
        Sensor(0.0, 0.0, 0.0, math.nan, 1.0, 0.1, 0.01)
