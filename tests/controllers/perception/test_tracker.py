"""The tracker follows objects through noise, gaps and crossings."""

import dataclasses
import math

import numpy as np
import pytest

from controllers.perception.tracker import Detection, Tracker
from iits_mj.core.messages import TrackedVehicle
from iits_mj.road import Route

ROUTE = Route.straight(length=2000.0)
SIGMA = 0.3


def seen(x, y, speed, noise=(0.0, 0.0, 0.0), yaw=0.0):
    look = TrackedVehicle("", x=x, y=y, yaw=yaw, station=x, offset=y)
    sight = math.atan2(y, x - 50.0)
    along = speed * math.cos(yaw - sight)
    return Detection(
        *(x + SIGMA * noise[0], y + SIGMA * noise[1], (SIGMA**2, 0.0, SIGMA**2)),
        *((math.cos(sight), math.sin(sight)), along + 0.12 * noise[2], 0.12, look),
    )


def follow(path, duration, tracker=None, detected=lambda k: True):
    """Tracks one object; `path` returns x, y and speed at a time."""
    random, tracker = np.random.default_rng(5), tracker or Tracker(ROUTE)
    shown = []
    for k in range(round(duration / 0.1)):
        found = [seen(*path(0.1 * k), random.normal(size=3))] if detected(k) else []
        tracker.update(0.1 * k, [(False, found)])
        shown.append(tracker.vehicles(0.1 * k))
    return shown


def test_a_steady_car_is_tracked_better_than_it_is_measured():
    shown = follow(lambda t: (100.0 + 15.0 * t, 2.0, 15.0), 6.0)
    late = [frame[0] for frame in shown[30:]]
    off = [v.x - (100.0 + 15.0 * 0.1 * (k + 30)) for k, v in enumerate(late)]
    assert np.std(off) < 0.6 * SIGMA
    assert np.std([v.speed - 15.0 for v in late]) < 0.12
    assert {v.id for v in late} == {late[0].id}


def test_the_place_of_a_standing_car_is_averaged_across_its_heading():
    shown = follow(lambda t: (150.0, 3.0, 0.0), 6.0)
    aside = [frame[0].y - 3.0 for frame in shown[10:]]
    assert max(map(abs, aside)) < SIGMA
    assert np.std(aside) < 0.3 * SIGMA


def test_a_slow_car_that_moves_aside_is_followed_aside():
    # 1 m/s across at 5 m/s along, with its heading as it steers.
    yaw = math.atan2(1.0, 5.0)
    tracker, random = Tracker(ROUTE), np.random.default_rng(5)
    for k in range(30):
        noise = random.normal(size=3)
        found = seen(150.0 + 0.5 * k, 0.1 * k, math.hypot(5.0, 1.0), noise, yaw)
        tracker.update(0.1 * k, [(False, [found])])
    car = tracker.vehicles(2.9)[0]
    assert car.y == pytest.approx(2.9, abs=SIGMA)
    assert car.lateral_speed == pytest.approx(1.0, abs=0.3)


def test_a_braking_is_known_within_a_second():
    def path(t):
        braked = max(t - 3.0, 0.0)
        return 100.0 + 20.0 * t - 3.0 * braked**2, 0.0, 20.0 - 6.0 * braked

    shown = follow(path, 4.5)
    assert shown[30][0].acceleration == pytest.approx(0.0, abs=1.0)
    assert shown[38][0].acceleration == pytest.approx(-6.0, abs=1.5)


def test_a_ghost_beside_a_car_with_another_speed_does_not_brake_it():
    tracker = Tracker(ROUTE)
    for k in range(30):
        x = 100.0 + 1.5 * k
        tracker.update(0.1 * k, [(False, [seen(x, 0.0, 15.0)])])
    # The ghost hides the car in one scan.
    x = 100.0 + 1.5 * 30
    tracker.update(3.0, [(False, [seen(x, 0.3, 11.0)])])
    car = next(v for v in tracker.vehicles(3.0) if v.id == "track000001")
    assert car.speed == pytest.approx(15.0, abs=0.1)
    assert car.acceleration == pytest.approx(0.0, abs=0.5)


def test_a_full_braking_from_one_scan_to_the_next_is_followed():
    tracker = Tracker(ROUTE)
    for k in range(45):
        t = max(0.1 * k - 3.0, 0.0)
        path = 100.0 + 20.0 * 0.1 * k - 4.5 * t**2, 0.0, 20.0 - 9.0 * t
        tracker.update(0.1 * k, [(False, [seen(*path)])])
    (car,) = tracker.vehicles(4.4)
    assert car.id == "track000001"
    assert car.speed == pytest.approx(20.0 - 9.0 * 1.4, abs=0.3)


def test_a_track_is_reported_after_three_scans_and_survives_a_short_gap():
    shown = follow(lambda t: (150.0, 0.0, 0.0), 3.5, detected=lambda k: not 10 <= k < 16)
    assert [len(frame) for frame in shown[:3]] == [0, 0, 1]
    assert {frame[0].id for frame in shown[2:]} == {shown[2][0].id}


def test_a_track_ends_when_its_object_is_gone():
    shown = follow(lambda t: (150.0, 0.0, 0.0), 3.0, detected=lambda k: k < 10)
    assert len(shown[12]) == 1
    assert len(shown[-1]) == 0


def test_a_ghost_of_two_scans_is_never_reported():
    shown = follow(lambda t: (150.0, 0.0, 0.0), 2.0, detected=lambda k: k < 2)
    assert all(len(frame) == 0 for frame in shown)


def test_where_a_camera_looks_a_radar_alone_confirms_nothing():
    radar, both = Tracker(ROUTE), Tracker(ROUTE)
    for k in range(10):
        found = [seen(150.0, 0.0, 0.0)]
        covered = lambda places: np.ones(len(places), bool)  # noqa: E731
        radar.update(0.1 * k, [(False, found), (True, [])], covered)
        both.update(0.1 * k, [(False, found), (True, found)], covered)
    assert len(radar.vehicles(0.9)) == 0
    assert len(both.vehicles(0.9)) == 1


def test_cars_that_pass_each_other_keep_their_names():
    tracker, random = Tracker(ROUTE), np.random.default_rng(2)
    for k in range(60):
        places = (100.0 + 2.0 * k, 1.8, 20.0), (130.0 + 1.0 * k, -1.8, 10.0)
        scan = [seen(*place, random.normal(size=3)) for place in places]
        tracker.update(0.1 * k, [(False, scan[:: 1 if k % 2 else -1])])
        if k == 5:
            fast = max(tracker.vehicles(0.5), key=lambda v: v.speed).id
    last = max(tracker.vehicles(5.9), key=lambda v: v.speed)
    assert last.id == fast
    assert last.offset == pytest.approx(1.8, abs=0.4)


def test_a_track_is_predicted_to_the_present():
    tracker = Tracker(ROUTE)
    for k in range(30):
        tracker.update(0.1 * k, [(False, [seen(100.0 + 2.0 * k, 0.0, 20.0)])])
    assert tracker.vehicles(3.1)[0].x == pytest.approx(100.0 + 62.0, abs=0.1)


@pytest.mark.parametrize(("kind", "moves"), [("car", False), ("pedestrian", True)])
def test_what_has_wheels_and_stands_does_not_move_aside(kind, moves):
    tracker, random, aside = Tracker(ROUTE), np.random.default_rng(7), []
    for k in range(40):
        found = seen(100.0, 3.0, 0.0, random.normal(size=3))
        look = dataclasses.replace(found.look, kind=kind)
        tracker.update(0.1 * k, [(False, [dataclasses.replace(found, look=look)])])
        aside += [abs(vehicle.lateral_speed) for vehicle in tracker.vehicles(0.1 * k)]
    # The noise of the position alone is that of a slow lane change.
    assert (max(aside) > 0.15) == moves


def test_a_slow_lane_change_keeps_its_lateral_speed():
    shown = follow(lambda t: (100.0 + 6.0 * t, 4.0 - 1.0 * t, 6.0), 3.5)
    assert shown[-1][0].lateral_speed == pytest.approx(-1.0, abs=0.25)
