"""The instrument panel shows the values of the frame."""

import time
from types import SimpleNamespace

import numpy as np
import pytest

from iits_mj.core.messages import (
    Decision,
    EgoState,
    PlanMode,
    Scene,
    TrackedVehicle,
    Trajectory,
    VehicleCommand,
)
from iits_mj.render.overlay import Overlay
from iits_mj.road import Route

SIZE = (960, 540)


@pytest.fixture(scope="module")
def route():
    return Route.straight(length=2000.0)


def frame(**changes):
    n = 40
    t = np.arange(n) * 0.1
    zero = np.zeros(n)
    plan = Trajectory(
        t, 100 + 15 * t, zero, 100 + 15 * t, zero, zero, zero, zero, zero + 15, zero,
        mode=changes.pop("mode", PlanMode.LANE_KEEPING), reason="lane is free",
    )  # fmt: skip
    vehicles = changes.pop("vehicles", ())
    state = {"time": 0.0, "station": 100.0, "speed": 15.0, "gear": 10, "engine_speed": 130.0}
    ego = EgoState(**{**state, **changes.pop("ego", {})})
    values = {
        "time": 0.0,
        "ego": ego,
        "scene": Scene(0.0, ego, vehicles),
        "trajectory": plan,
        "command": VehicleCommand(),
        "decision": Decision.KEEP,
        "lane": 0,
        "lane_count": 3,
        "grade": 0.0,
        "curvature": 0.0,
        "speed_limit": 25.0,
        "reference_speed": 16.67,
        "gap_ahead": float("inf"),
        "gap_behind": float("inf"),
        "box_distance": float("inf"),
        "distance": 80.0,
        "lane_changes": 0,
        "refused": 0,
    }
    return SimpleNamespace(**{**values, **changes})


def drawn(route, size=SIZE, **changes):
    gray = np.full((size[1], size[0], 3), 110, dtype=np.uint8)
    return Overlay(size, route).draw(gray, frame(**changes))


def test_overlay_changes_only_its_corners(route):
    picture = drawn(route)
    assert picture.shape == (540, 960, 3)
    assert np.all(picture[170:300, 20:800] == 110)
    assert np.all(picture[60:540, 400:800] == 110)
    assert np.any(picture[60:160, 20:370] != 110)
    assert np.any(picture[330:520, 850:940] != 110)


@pytest.mark.parametrize(
    "changes",
    [
        {"ego": {"speed": 20.0}},
        {"ego": {"gear": 11}},
        {"ego": {"engine_speed": 190.0}},
        {"ego": {"brake_pressures": (3e5, 3e5, 2e5, 2e5, 4e5)}},
        {"command": VehicleCommand(accelerator_pedal=0.7)},
        {"command": VehicleCommand(xbr_demand=-2.0)},
        {"command": VehicleCommand(retarder=0.5)},
        {"command": VehicleCommand(engine_brake=0.5)},
        {"grade": 0.04},
        {"mode": PlanMode.EMERGENCY},
        {"lane_changes": 3},
        {"vehicles": (TrackedVehicle("a", station=130.0, offset=4.0),)},
    ],
    ids=str,
)
def test_every_instrument_shows_a_change(route, changes):
    assert np.any(drawn(route, **changes) != drawn(route))


def test_vehicle_to_the_left_is_drawn_to_the_left_of_the_truck(route):
    base = drawn(route).astype(int)
    left = drawn(route, vehicles=(TrackedVehicle("a", station=100.0, offset=4.0),))
    right = drawn(route, vehicles=(TrackedVehicle("a", station=100.0, offset=-3.0),))
    columns = [np.argwhere(np.any(p != base, axis=-1))[:, 1].mean() for p in (left, right)]
    assert columns[0] < columns[1]


@pytest.mark.parametrize("size", [(160, 120), (640, 360), (1280, 720), (400, 800)])
def test_overlay_fits_every_size(route, size):
    assert drawn(route, size).shape == (size[1], size[0], 3)


def test_extreme_values_are_drawn(route):
    wild = {"speed": -40.0, "gear": -1, "engine_speed": 900.0, "brake_pressures": (1e9,) * 5}
    drawn(route, ego={**wild, "station": 5000.0}, grade=9.0, speed_limit=float("inf"))


def test_overlay_takes_milliseconds(route):
    overlay = Overlay(SIZE, route)
    picture = np.zeros((540, 960, 3), dtype=np.uint8)
    example = frame(vehicles=tuple(TrackedVehicle(str(i), station=60.0 + 9 * i) for i in range(8)))
    overlay.draw(picture, example)
    best = min(_cpu_time(lambda: overlay.draw(picture, example)) for _ in range(5))
    # About 3 ms; the bound leaves room for slow machines.
    assert best < 0.025


def _cpu_time(action):
    start = time.process_time()
    action()
    return time.process_time() - start
