import itertools
import math

import numpy as np
import pytest

from iits_mj.road import RoadMap, Route
from tests.traffic_bridge.scenario.scene import ROAD, SPEED, START, STEP, drive
from traffic_bridge import (
    Brake,
    ChangeLane,
    ChangeSpeed,
    CrossRoad,
    CutIn,
    Drift,
    LoseCargo,
    PlaceVehicle,
    Swerve,
)

CAR = PlaceVehicle(name="car", gap=150.0, speed_difference=0.0)
LEFT = PlaceVehicle(name="car", gap=-30.0, relative_lane=1, speed_difference=4.0)
SOON = {"measure": "time", "above": 2.0}


def speeds(run, name="car"):
    return np.array([vehicle.speed for vehicle in run.track(name) if vehicle is not None])


def offsets(run, name="car", lane=0):
    return np.array([v.offset - float(ROAD.lane_offset(lane, 0.0)) for v in run.track(name)])


def test_a_placed_vehicle_has_its_gap_lane_and_speed_from_the_first_frame():
    run = drive([PlaceVehicle(name="a", gap=25.0, relative_lane=1, speed=17.0, type="van")], 1.0)
    first = run.track("a")[0]
    assert run.gap("a", 0.0) == pytest.approx(25.0)
    assert (first.kind, first.lane, first.speed) == ("van", 1, 17.0)
    assert run.gap("a", 1.0) == pytest.approx(25.0 - 3.0)
    behind = drive([PlaceVehicle(name="b", gap=-10.0)], 1.0).track("b")[0]
    # The truck is 16.5 m long.
    assert START + 1.4 - 16.5 - behind.station - 0.5 * behind.length == pytest.approx(10.0)
    assert behind.speed == SPEED


def test_a_vehicle_is_placed_as_soon_as_its_place_is_free_and_removed_at_the_end():
    slow = PlaceVehicle(name="slow", gap=30.0, speed=5.0, reactive=False, duration=2.0)
    late = PlaceVehicle(name="late", station=START + 40.0, lane=0, speed=0.0)
    run = drive([slow, late], 3.0)
    assert run.track("late")[0] is None
    assert run.record("late").begun > 0.0
    assert run.record("slow").ended == pytest.approx(2.0)
    assert run.track("slow")[19] is not None
    assert run.track("slow")[21] is None


@pytest.mark.parametrize("difference", [-3.0, 0.0, 2.0])
@pytest.mark.parametrize("start", [-30.0, 40.0])
def test_a_cut_in_begins_at_its_gap_with_its_speed_difference(difference, start):
    place = PlaceVehicle(name="car", gap=start, relative_lane=1, speed_difference=1.0)
    cut_in = CutIn(actor="car", gap=15.0, speed_difference=difference, duration=3.0, when=SOON)
    run = drive([place, cut_in], 60.0)
    aside = offsets(run, lane=1)
    began = int(np.argmax(np.abs(aside) > 1e-6)) - 1
    assert run.gap("car", began * STEP) == pytest.approx(15.0, abs=0.01)
    assert speeds(run)[began] == pytest.approx(SPEED + difference, abs=0.02)
    over = began + 30
    assert run.record("cut_in").ended == pytest.approx(over * STEP)
    assert offsets(run)[over] == pytest.approx(0.0, abs=1e-9)
    # It drives at a constant speed while it changes lanes.
    assert np.ptp(speeds(run)[began : over + 1]) < 0.02


def test_the_gap_of_a_cut_in_is_relative_to_a_truck_that_changes_its_speed():
    cut_in = CutIn(actor="car", gap=12.0, speed_difference=-1.0, when=SOON)
    run = drive([LEFT, cut_in], 40.0, speed=lambda t: 20.0 - 4.0 * math.sin(0.3 * t))
    began = int(np.argmax(np.abs(offsets(run, lane=1)) > 1e-6)) - 1
    assert run.gap("car", began * STEP) == pytest.approx(12.0, abs=0.05)


@pytest.mark.parametrize("shape", ["sinusoidal", "cubic", "linear"])
def test_a_lane_change_is_half_done_at_half_its_time_for_every_shape(shape):
    change = ChangeLane(actor="car", relative_lane=1, duration=4.0, shape=shape, when=SOON)
    run = drive([CAR, change], 8.0)
    width = float(ROAD.lane_offset(1, 0.0) - ROAD.lane_offset(0, 0.0))
    began = round(run.record("change_lane").begun / STEP)
    way = offsets(run)
    assert way[began + 20] == pytest.approx(0.5 * width)
    assert way[began + 40] == pytest.approx(width)
    assert (np.diff(way) >= 0.0).all()


def test_braking_keeps_rate_and_jerk_and_reaches_its_speed():
    brake = Brake(actor="car", deceleration=6.0, jerk=20.0, to_speed=8.0, when=SOON)
    run = drive([CAR, brake], 10.0)
    v = speeds(run)
    a = np.diff(v) / STEP
    assert a.min() == pytest.approx(-6.0, abs=1e-9)
    assert np.abs(np.diff(a)).max() <= 20.0 * STEP + 1e-6
    assert v[-1] == pytest.approx(8.0, abs=0.05)
    # Ramps of 0.3 s at both ends, each worth 0.9 m/s.
    needed = (20.0 - 8.0) / 6.0 + 6.0 / 20.0
    record = run.record("brake")
    assert record.ended - record.begun == pytest.approx(needed, abs=0.25)


def test_a_vehicle_that_brakes_for_a_time_drives_on_afterwards():
    brake = Brake(actor="car", when=SOON, duration=4.0)
    run = drive([CAR, brake], 30.0)
    v = speeds(run)
    assert v.min() == 0.0
    assert v[-1] > 15.0
    stopped = speeds(drive([CAR, Brake(actor="car", when=SOON)], 20.0))
    assert (stopped[120:] == 0.0).all()


def test_a_change_of_speed_ends_at_the_difference_to_the_truck():
    run = drive([CAR, ChangeSpeed(actor="car", speed_difference=3.0, when=SOON)], 15.0)
    assert speeds(run)[-1] == pytest.approx(SPEED + 3.0, abs=0.05)
    assert np.diff(speeds(run)).max() / STEP <= 1.5 + 1e-9


def test_a_swerve_reaches_its_offset_and_returns():
    run = drive([CAR, Swerve(actor="car", offset=-1.2, duration=4.0, when=SOON)], 10.0)
    way = offsets(run)
    assert way.min() == pytest.approx(-1.2, abs=1e-6)
    assert way[-1] == pytest.approx(0.0, abs=1e-9)


def test_a_driver_who_falls_asleep_drifts_at_constant_rate_and_jerks_back():
    run = drive([CAR, Drift(actor="car", offset=1.5, lateral_speed=0.5, when=SOON)], 12.0)
    way = offsets(run)
    began = round(run.record("drift").begun / STEP)
    assert way[began + 20] == pytest.approx(1.0, abs=1e-6)
    assert way.max() == pytest.approx(1.5, abs=0.05)
    assert way[-1] == pytest.approx(0.0, abs=1e-9)
    asleep = drive([CAR, Drift(actor="car", offset=1.5, recovery=0.0, when=SOON)], 12.0)
    assert offsets(asleep)[-1] == pytest.approx(1.5)


def test_lost_cargo_slides_to_a_stop_behind_the_vehicle():
    lose = LoseCargo(actor="car", name="box", deceleration=5.0, when=SOON)
    run = drive([CAR, lose], 10.0)
    box = [b for b in run.track("box") if b is not None]
    assert box[0].kind == "obstacle"
    assert box[0].speed == pytest.approx(SPEED)
    assert box[-1].speed == 0.0
    way = box[-1].station - box[0].station
    assert way == pytest.approx(SPEED**2 / (2.0 * 5.0), abs=1.0)
    step = next(k for k, b in enumerate(run.track("box")) if b is not None)
    car = run.track("car")[step]
    assert box[0].station + 0.5 * box[0].length < car.station - 0.5 * car.length


@pytest.mark.parametrize(("side", "sign"), [("right", 1.0), ("left", -1.0)])
def test_a_pedestrian_crosses_the_road_at_a_right_angle(side, sign):
    walk = CrossRoad(name="walker", station=500.0, side=side, speed=1.5, when=SOON)
    run = drive([walk], 20.0)
    track = [w for w in run.track("walker") if w is not None]
    assert {w.station for w in track} == {500.0}
    assert track[0].kind == "pedestrian"
    steps = np.diff([w.offset for w in track])
    assert sign * steps == pytest.approx(np.full(len(steps), 0.15))
    heading = float(ROAD.evaluate(500.0).heading)
    assert track[1].yaw - heading == pytest.approx(sign * 0.5 * math.pi)
    right, left = ROAD.surface_edges(500.0)
    assert run.record("walker").ended - run.record("walker").begun == pytest.approx(
        float(left - right) / 1.5, abs=0.11
    )
    assert run.track("walker")[-1] is None


def test_a_pedestrian_with_a_distance_stops_there_and_stays():
    run = drive([CrossRoad(name="walker", station=500.0, distance=1.0, speed=1.0)], 3.0)
    last = run.track("walker")[-1]
    right, _ = ROAD.surface_edges(500.0)
    assert last.offset == pytest.approx(float(right) + 1.0)
    assert last.speed == 0.0


def test_actors_stay_on_a_road_with_bends_and_hills_and_move_at_their_speed():
    road = RoadMap.builtin().route()
    events = [
        PlaceVehicle(name="car", gap=30.0, relative_lane=1, speed=22.0),
        CutIn(actor="car", gap=20.0, speed_difference=0.0, when=SOON),
    ]
    run = drive(events, 60.0, road=road)
    track = run.track("car")
    for before, after in itertools.pairwise(track):
        way = math.dist((before.x, before.y), (after.x, after.y))
        mean = 0.5 * (before.speed + after.speed)
        assert way == pytest.approx(mean * STEP, abs=0.03)
    for car in track[::20]:
        assert car.z == pytest.approx(float(road.evaluate(car.station, car.offset).z), abs=1e-9)


def test_a_vehicle_leaves_at_the_end_of_the_route():
    road = Route.straight(length=600.0, lanes=2)
    run = drive([PlaceVehicle(name="car", gap=200.0, speed=25.0)], 6.0, road=road)
    assert run.track("car")[0] is not None
    assert run.track("car")[-1] is None
