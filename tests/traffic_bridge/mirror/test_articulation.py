import math

import mujoco
import numpy as np
import pytest

from iits_mj.core.messages import TrackedVehicle
from iits_mj.kernels import Table
from traffic_bridge import Mirror, VehicleFrame
from traffic_bridge.mirror import units as vehicle_units
from traffic_bridge.mirror.articulation import Articulation, TrailerMemory

TRUCK = Articulation.of_length(16.5)
KINGPIN, AXLES = TRUCK.kingpin, TRUCK.axles


def angle(a, b):
    return math.remainder(float(a) - float(b), 2.0 * math.pi)


def test_pulled_semitrailer_follows_the_tractrix():
    # The semitrailer starts at right angles to x and is pulled along x: its axles follow the curve
    # x = d (t - tanh t), y = d / cosh t, with the distance t in units of d.
    for way in (0.5, 3.0, 12.0):
        yaw = TRUCK.pulled(-0.5 * math.pi, 0.0, way)
        t = way / AXLES
        axles = way - AXLES * math.cos(yaw), -AXLES * math.sin(yaw)
        assert axles == pytest.approx((AXLES * (t - math.tanh(t)), AXLES / math.cosh(t)))


def test_a_pull_is_reversible_and_independent_of_its_division_into_parts():
    start, direction = 0.4, -0.3
    whole = TRUCK.pulled(start, direction, 3.0)
    parts = start
    for _ in range(30):
        parts = TRUCK.pulled(parts, direction, 0.1)
    assert parts == pytest.approx(whole, abs=1e-12)
    assert TRUCK.pulled(whole, direction, -3.0) == pytest.approx(start, abs=1e-12)


@pytest.mark.parametrize("radius", [12.0, -20.0, 100.0])
def test_the_axles_reach_the_concentric_circle_in_a_long_bend(radius):
    memory = TrailerMemory()
    yaw = 0.0
    for _ in range(300):
        yaw += 0.5 / radius
        x, y = radius * math.sin(yaw), radius * (1.0 - math.cos(yaw))
        # The memory starts straight, without knowledge of the bend.
        (trailer,) = memory.follow(["t"], [TRUCK], [(x, y, yaw, 0.0)])
    axles = np.array([x - AXLES * math.cos(trailer), y - AXLES * math.sin(trailer)])
    expected = math.sqrt(radius**2 - AXLES**2)
    assert np.hypot(axles[0], axles[1] - radius) == pytest.approx(expected, rel=2e-3)
    # A truck that appears in the bend has the same angle.
    settled = TRUCK.settled(yaw, 1.0 / radius)
    assert angle(settled, trailer) == pytest.approx(0.0, abs=0.012 * 12.0 / abs(radius))


def test_the_tractor_points_in_the_direction_in_which_the_kingpin_moves():
    yaw, trailer, step = 0.5, 0.1, 1e-6
    moved = TRUCK.pulled(trailer, yaw, step)

    def kingpin(way, psi):
        return np.array([way * math.cos(0.5), way * math.sin(0.5)]) + KINGPIN * np.array(
            [math.cos(psi), math.sin(psi)]
        )

    motion = kingpin(step, moved) - kingpin(0.0, trailer)
    expected = math.atan2(motion[1], motion[0])
    now, place, turned = (Table(np.zeros(shape)) for shape in ((6, 1), (2, 3), (2, 4)))
    now.numbers[3] = yaw
    tables = now, Table([KINGPIN, AXLES]), Table([trailer]), place, turned
    vehicle_units._articulate(0, 1, *[table.address for table in tables])
    tractor, semitrailer = 2.0 * np.arctan2(turned.numbers[:, 3], turned.numbers[:, 0])
    assert tractor == pytest.approx(expected, abs=1e-5)
    assert semitrailer == pytest.approx(trailer, abs=1e-12)


def scene(mirror):
    spec = mujoco.MjSpec()
    mirror.add_to(spec)
    model = spec.compile()
    mirror.bind(model)
    return model, mujoco.MjData(model)


def on_turn(way, radius, arc, speed):
    """A truck that drives straight along x, through a bend of an arc, and straight on."""
    turned = min(max(way, 0.0), arc)
    yaw = turned / radius
    x = min(way, 0.0) + radius * math.sin(yaw) + max(way - arc, 0.0) * math.cos(yaw)
    y = radius * (1.0 - math.cos(yaw)) + max(way - arc, 0.0) * math.sin(yaw)
    rate = speed / radius if 0.0 <= way < arc else 0.0
    return TrackedVehicle(
        "t", "articulated", x, y, yaw=yaw, speed=speed, yaw_rate=rate,
        length=16.5, width=2.55, height=4.0,
    )  # fmt: skip


def units(model, data, mirror):
    found = []
    for name in mirror.bodies_of("t"):
        index = model.body_mocapid[model.body(name).id]
        rotation = np.empty(9)
        mujoco.mju_quat2Mat(rotation, data.mocap_quat[index])
        found.append((data.mocap_pos[index].copy(), rotation.reshape(3, 3)))
    return found


def test_articulation_grows_and_vanishes_without_jumps_in_a_right_angle_turn():
    mirror = Mirror({"articulated": 1}, visuals=False)
    model, data = scene(mirror)
    radius, speed = 12.0, 5.0
    arc = 0.5 * math.pi * radius
    bends, last, centers = [], None, []
    for k in range(160):
        way = -10.0 + 0.5 * k
        mirror.update(data, [on_turn(way, radius, arc, speed)], (0.0, 0.0))
        for elapsed in np.arange(0.0, 0.1, 0.02):
            mirror.update(data, None, (0.0, 0.0), elapsed=float(elapsed))
            (hitch, tractor), (same, trailer) = units(model, data, mirror)
            np.testing.assert_allclose(hitch, same, atol=1e-12)
            # The box's center, which the traffic reports, is on the semitrailer.
            center = hitch - KINGPIN * trailer[:, 0]
            if elapsed == 0.0:
                truth = on_turn(way, radius, arc, speed)
                np.testing.assert_allclose(center[:2], [truth.x, truth.y], atol=1e-9)
            psi = [math.atan2(axes[1, 0], axes[0, 0]) for axes in (tractor, trailer)]
            bends.append(angle(*psi))
            if last is not None:
                # 20 ms later: 0.1 m further, and both units turned a little.
                assert np.linalg.norm(hitch - last[0]) < 0.15
                assert max(abs(angle(a, b)) for a, b in zip(psi, last[1], strict=True)) < 0.05
            last = hitch, psi
            centers.append(center)
    assert 0.5 < max(bends) < 1.1
    assert min(bends) > -0.02
    assert bends[-1] == pytest.approx(0.0, abs=0.01)
    assert last[1] == pytest.approx([0.5 * math.pi] * 2, abs=0.01)


def test_a_truck_at_standstill_keeps_its_articulation_angle():
    mirror = Mirror({"articulated": 1}, visuals=False)
    model, data = scene(mirror)
    arc = 0.5 * math.pi * 12.0
    for k in range(30):
        mirror.update(data, [on_turn(0.5 * k, 12.0, arc, 5.0)], (0.0, 0.0))
    before = units(model, data, mirror)
    for _ in range(50):
        standing = on_turn(14.5, 12.0, arc, 0.0)
        mirror.update(data, [standing], (0.0, 0.0))
    for (p, r), (q, s) in zip(before, units(model, data, mirror), strict=True):
        np.testing.assert_allclose(p, q, atol=1e-9)
        np.testing.assert_allclose(r, s, atol=1e-9)


def test_a_teleported_truck_is_settled_at_its_new_place():
    mirror = Mirror({"articulated": 1}, visuals=False)
    model, data = scene(mirror)
    arc = 0.5 * math.pi * 12.0
    for k in range(30):
        mirror.update(data, [on_turn(0.5 * k, 12.0, arc, 5.0)], (0.0, 0.0))
    mirror.update(data, VehicleFrame.of([on_turn(200.0, 12.0, arc, 5.0)]), (0.0, 0.0))
    (_, tractor), (_, trailer) = units(model, data, mirror)
    np.testing.assert_allclose(tractor, trailer, atol=1e-12)


def test_units_lie_in_the_plane_of_the_road_under_the_truck():
    mirror = Mirror({"articulated": 1}, visuals=False)
    model, data = scene(mirror)
    v = TrackedVehicle(
        "t", "articulated", 10.0, 5.0, 2.0, yaw=0.7, pitch=-0.05, roll=0.04, speed=5.0,
        yaw_rate=0.3, length=16.5, width=2.55, height=4.0,
    )  # fmt: skip
    mirror.update(data, [v], (0.0, 0.0))
    (hitch, tractor), (_, trailer) = units(model, data, mirror)
    normal = tractor[:, 2]
    np.testing.assert_allclose(trailer[:, 2], normal, atol=1e-12)
    assert (hitch - [10.0, 5.0, 2.0]) @ normal == pytest.approx(0.0, abs=1e-12)
    assert normal[2] == pytest.approx(math.cos(0.05) * math.cos(0.04))
    assert abs(tractor[:, 0] @ trailer[:, 0]) < math.cos(0.2)
