import dataclasses
import math

import mujoco
import numpy as np
import pytest

from iits_mj.core.errors import InputError
from iits_mj.core.messages import TrackedVehicle
from iits_mj.road import RoadMap
from tests.paths import outside
from tests.traffic_bridge.scripted_truck import ego_at
from traffic_bridge import InterSim, Mirror, PureSim, TrafficConfig, VehicleFrame, default_types
from traffic_bridge.vehicles.types import road_user_types

TYPES = {kind.name: kind for kind in (*default_types(), *road_user_types())}
TRUCK = """
<mujoco>
  <worldbody>
    <geom name="ground" type="plane" size="1 1 1"/>
    <body name="tractor" pos="0 0 1">
      <freejoint/>
      <geom type="box" size="3 1.25 0.9" contype="2" conaffinity="5" mass="8000"/>
    </body>
    <body name="trailer" pos="-9 0 2">
      <freejoint/>
      <geom type="box" size="5 1.25 1.5" contype="2" conaffinity="5" mass="8000"/>
    </body>
  </worldbody>
</mujoco>
"""


def scene(mirror):
    spec = mujoco.MjSpec.from_string(TRUCK)
    mirror.add_to(spec)
    model = spec.compile()
    mirror.bind(model)
    return model, mujoco.MjData(model)


def vehicle(name, route, station, offset=0.0, kind="car", speed=10.0, **values):
    p = route.evaluate(station, offset)
    t = TYPES[kind]
    return TrackedVehicle(
        id=name,
        kind=kind,
        x=float(p.x),
        y=float(p.y),
        z=float(p.z),
        yaw=values.pop("yaw", float(p.heading)),
        speed=speed,
        station=station,
        offset=offset,
        length=t.length,
        width=t.width,
        height=t.height,
        **values,
    )


def frame(model, data, name):
    index = model.body_mocapid[model.body(name).id]
    rotation = np.empty(9)
    mujoco.mju_quat2Mat(rotation, data.mocap_quat[index])
    return data.mocap_pos[index].copy(), rotation.reshape(3, 3)


def pose(model, data, mirror, name):
    return frame(model, data, mirror.bodies_of(name)[0])


def test_bodies_have_the_pitch_and_roll_of_their_frame(straight):
    mirror = Mirror({"car": 2}, visuals=False)
    model, data = scene(mirror)
    # Uphill, and the left side higher than the right (ISO 8855: nose up is negative pitch).
    seen = vehicle("a", straight, 100.0, 4.0, yaw=0.3, pitch=-0.05, roll=0.03)
    mirror.update(data, [seen], (90.0, 0.0))
    position, axes = pose(model, data, mirror, "a")
    np.testing.assert_allclose(position, [100.0, 4.0, 0.0], atol=1e-12)
    nose = [math.cos(0.3) * math.cos(0.05), math.sin(0.3) * math.cos(0.05), math.sin(0.05)]
    np.testing.assert_allclose(axes[:, 0], nose, atol=1e-12)
    assert axes[2, 1] == pytest.approx(math.sin(0.03) * math.cos(0.05), abs=1e-12)


def test_motion_between_steps_meets_sumos_positions_before_and_after(straight):
    mirror = Mirror({"car": 1}, visuals=False)
    model, data = scene(mirror)
    v = vehicle("a", straight, 100.0, speed=10.0, acceleration=2.0, pitch=-math.atan(0.04))
    mirror.update(data, [v], (100.0, 0.0))
    for elapsed, way in ((-0.1, -1.0), (0.0, 0.0), (0.05, 0.5075), (0.1, 1.02)):
        mirror.update(data, None, (100.0, 0.0), elapsed=elapsed)
        position, _ = pose(model, data, mirror, "a")
        np.testing.assert_allclose(position, [100.0 + way, 0.0, 0.04 * way], atol=1e-12)


def test_a_braking_vehicle_stops_and_does_not_roll_back(straight):
    mirror = Mirror({"car": 1}, visuals=False)
    model, data = scene(mirror)
    v = vehicle("a", straight, 100.0, speed=0.3, acceleration=-6.0)
    mirror.update(data, [v], (100.0, 0.0))
    places = []
    for elapsed in np.linspace(0.0, 0.1, 11):
        mirror.update(data, None, (100.0, 0.0), elapsed=float(elapsed))
        places.append(pose(model, data, mirror, "a")[0][0])
    assert min(places) == 100.0


def test_vehicles_in_a_bend_move_along_the_circle(straight):
    mirror = Mirror({"car": 1}, visuals=False)
    model, data = scene(mirror)
    radius, speed = 50.0, 15.0
    v = vehicle("a", straight, 100.0, speed=speed, yaw_rate=speed / radius)
    mirror.update(data, [v], (100.0, 0.0))
    for elapsed in (-0.1, 0.05, 0.1):
        mirror.update(data, None, (100.0, 0.0), elapsed=elapsed)
        position, axes = pose(model, data, mirror, "a")
        angle = elapsed * speed / radius
        place = [100.0 + radius * math.sin(angle), radius * (1.0 - math.cos(angle)), 0.0]
        np.testing.assert_allclose(position, place, atol=1e-4)
        assert math.atan2(axes[1, 0], axes[0, 0]) == pytest.approx(angle, abs=1e-12)


def jumps(traffic, mirror, egos):
    """Distances between bodies and vehicles at a traffic step: along, across, up [m].

    Only of vehicles of one body whose acceleration changes by less than 0.05 m/s2.
    """
    model, data = scene(mirror)
    found = []
    first, *others = egos
    before = traffic.reset(first)
    for ego in others:
        x, y = (0.0, 0.0) if ego is None else (ego.x, ego.y)
        mirror.update(data, before, (x, y), elapsed=0.1)
        now = traffic.step(ego)
        for name in mirror.shown:
            old, new = before.find(name), now.find(name)
            if new is None or new.kind == "articulated":
                continue
            if abs(new.acceleration - old.acceleration) < 0.05:
                position, _ = pose(model, data, mirror, name)
                dx, dy, dz = np.array([new.x, new.y, new.z]) - position
                c, s = math.cos(new.yaw), math.sin(new.yaw)
                found.append((dx * c + dy * s, dy * c - dx * s, dz))
        before = now
    assert len(found) > 500
    return np.abs(np.array(found))


@pytest.mark.parametrize("model_of_changes", ["lc2013", "mobil"])
def test_bodies_do_not_jump_when_the_traffic_steps(highway, model_of_changes):
    config = TrafficConfig(
        density=0.1, lane_change=model_of_changes, fill_ahead=600.0, fill_behind=600.0
    )
    egos = [ego_at(highway, 0.1 * k, 2000.0 + 1.2 * k, 12.0, -2.0) for k in range(101)]
    with InterSim(highway, config, seed=1) as traffic:
        found = jumps(traffic, Mirror(visuals=False), egos)
    along, across, up = np.percentile(found, 99, axis=0)
    assert along < 2e-3
    assert across < 1e-3
    assert up < 1e-3
    # The greatest ones are where the road's curvature changes.
    assert found.max() < 2e-2


@pytest.mark.parametrize("name", ["e6mini", "curves_elevation", "crest-curve", "velodrome"])
def test_bodies_do_not_jump_on_esmini_maps(name):
    route = RoadMap.from_opendrive(outside(f"xodr/esmini_{name}.xodr")).route()
    mirror = Mirror({"car": 60, "van": 20, "truck": 20}, view_range=1e5, visuals=False)
    with PureSim(route, TrafficConfig(density=0.2), seed=3) as traffic:
        found = jumps(traffic, mirror, [None] * 201)
    along, across, up = np.percentile(found, 98, axis=0)
    assert along < 2e-3
    assert across < 1.5e-3
    # The grade of crest-curve has corners.
    assert up < (7e-3 if name == "crest-curve" else 1e-3)


@pytest.mark.parametrize("map_name", ["built-in", "curves_elevation", "velodrome"])
def test_bodies_are_tangent_to_the_road_in_both_directions(map_name, highway):
    route = highway
    if map_name != "built-in":
        route = RoadMap.from_opendrive(outside(f"xodr/esmini_{map_name}.xodr")).route()
    mirror = Mirror({"car": 40}, view_range=1e5, visuals=False)
    model, data = scene(mirror)
    config = TrafficConfig(density=0.2, scope="both", mix={"car": 1.0}, fill_ahead=4000.0)
    checked, senses = 0, set()
    with PureSim(route, config, seed=3) as traffic:
        traffic.reset()
        for k in range(100):
            vehicles = traffic.step()
            if k % 10:
                continue
            mirror.update(data, vehicles, (0.0, 0.0))
            for name in mirror.shown:
                v = vehicles.find(name)
                if v.lateral_speed != 0.0 or not 5.0 < v.station < route.length - 5.0:
                    continue
                places = [(-1.0, 0.0), (1.0, 0.0), (0.0, 1.0), (0.0, 0.0)]
                p = [route.evaluate(v.station + s, v.offset + d) for s, d in places]
                back, front, left, here = (
                    np.array([float(q.x), float(q.y), float(q.z)]) for q in p
                )
                along, across = front - back, left - here
                normal = np.cross(along, across) / np.linalg.norm(np.cross(along, across))
                position, axes = pose(model, data, mirror, name)
                sense = math.copysign(1.0, axes[:, 0] @ along)
                assert np.linalg.norm(position - here) < 0.05
                # The frame's pitch is that of the reference line; beside it the path is up to 2 %
                # steeper where the cross slope changes.
                assert sense * axes[:, 0] @ along > math.cos(0.02) * np.linalg.norm(along)
                assert axes[:, 2] @ normal > math.cos(0.02)
                checked += 1
                senses.add(sense)
    assert checked > 100
    # The other two maps have lanes in one direction only.
    assert senses == ({1.0, -1.0} if map_name == "curves_elevation" else {1.0})


def test_bodies_follow_a_crest_and_a_changing_cross_slope(straight):
    # Grade falls by 1 in 500 m; beside the reference line the road climbs by another 1 %.
    def car(k):
        x = 100.0 + 2.0 * k
        grade = -(x - 100.0) / 500.0
        return dataclasses.replace(
            vehicle("a", straight, x, speed=20.0, pitch=-math.atan(grade)),
            z=-0.5 * (x - 100.0) ** 2 / 500.0 + 0.01 * x,
        )

    mirror = Mirror({"car": 1}, visuals=False)
    model, data = scene(mirror)
    for k in range(3):
        mirror.update(data, [car(k)], (100.0, 0.0), elapsed=0.1)
    position, axes = pose(model, data, mirror, "a")
    assert position[2] == pytest.approx(car(3).z, abs=1e-5)
    assert math.asin(-axes[2, 0]) == pytest.approx(car(3).pitch, abs=1e-5)


def test_extrapolation_follows_the_distance_of_the_last_step(straight):
    mirror = Mirror({"car": 1}, visuals=False)
    model, data = scene(mirror)
    # Steps 2 % shorter than speed times time, as on the inner lane of a bend.
    for station in (100.0, 100.98):
        mirror.update(data, [vehicle("a", straight, station, speed=10.0)], (100.0, 0.0))
    mirror.update(data, None, (100.0, 0.0), elapsed=0.1)
    assert pose(model, data, mirror, "a")[0][0] == pytest.approx(101.96, abs=1e-9)
    # After a teleport the speed counts.
    mirror.update(data, [vehicle("a", straight, 130.0, speed=10.0)], (100.0, 0.0), elapsed=0.1)
    assert pose(model, data, mirror, "a")[0][0] == pytest.approx(131.0, abs=1e-9)


def test_slots_are_kept_and_reused(straight):
    mirror = Mirror({"car": 2, "articulated": 1}, visuals=False)
    _, data = scene(mirror)
    cars = [vehicle(f"car.{i}", straight, 100.0 + 30.0 * i) for i in range(4)]
    assert mirror.update(data, cars, (100.0, 0.0)) == 2
    slots = {name: mirror.bodies_of(name) for name in ("car.0", "car.1")}
    assert mirror.shown == ("car.0", "car.1")
    # Still among the nearest: the same body.
    mirror.update(data, cars[::-1], (110.0, 0.0))
    assert {name: mirror.bodies_of(name) for name in slots} == slots
    # The vehicles are gone: other vehicles get their bodies.
    mirror.update(data, cars[2:], (160.0, 0.0))
    assert {mirror.bodies_of("car.2"), mirror.bodies_of("car.3")} == set(slots.values())
    mirror.update(data, [], (160.0, 0.0))
    assert np.all(data.mocap_pos[:, 2] < -100.0)
    parked = data.mocap_pos[:, None, :] - data.mocap_pos[None, :, :]
    distance = np.linalg.norm(parked, axis=-1) + 1e3 * np.eye(len(data.mocap_pos))
    assert distance.min() > 20.0


def test_two_vehicles_at_the_edge_of_the_view_do_not_alternate(straight):
    mirror = Mirror({"car": 1}, visuals=False)
    _, data = scene(mirror)

    def shown(ahead, behind):
        cars = [vehicle("a", straight, 1000.0 + ahead), vehicle("b", straight, 1000.0 - behind)]
        mirror.update(data, cars, (1000.0, 0.0))
        return mirror.shown

    assert shown(99.0, 100.0) == ("a",)
    assert [shown(100.0 + d, 100.0 - d) for d in (1.0, 3.0, 5.0)] == 3 * [("a",)]
    assert shown(110.0, 90.0) == ("b",)
    assert shown(95.0, 105.0) == ("b",)


def test_no_hidden_vehicle_is_much_nearer_than_a_shown_one(straight):
    mirror = Mirror(
        {"car": 6, "van": 2, "truck": 2, "articulated": 2}, view_range=5000.0, visuals=False
    )
    _, data = scene(mirror)
    rng = np.random.default_rng(5)
    kinds = [*TYPES][:4]
    places = rng.uniform(200.0, 1800.0, 60)
    speeds = rng.uniform(5.0, 25.0, 60)
    changes = 0
    for k in range(200):
        ego = 1000.0 + 0.5 * k * 15.0
        cars = [
            vehicle(f"v{i:02}", straight, s, kind=kinds[i % 4])
            for i, s in enumerate((places + 0.5 * k * speeds).tolist())
        ]
        before = mirror.shown
        mirror.update(data, cars, (ego, 0.0))
        changes += len(set(before) ^ set(mirror.shown)) if k else 0
        for kind in kinds:
            of_kind = [c for c in cars if c.kind == kind]
            seen = [abs(c.x - ego) for c in of_kind if c.id in mirror.shown]
            hidden = [abs(c.x - ego) for c in of_kind if c.id not in mirror.shown]
            assert len(seen) == (6 if kind == "car" else 2)
            assert min(hidden) > 0.85 * max(seen) - 1e-9
    assert 10 < changes < 200


def test_a_parked_body_is_preferred_to_one_that_loses_its_vehicle(straight):
    mirror = Mirror({"car": 2}, visuals=False)
    _, data = scene(mirror)
    mirror.update(data, [vehicle("a", straight, 100.0)], (100.0, 0.0))
    left = mirror.bodies_of("a")
    mirror.update(data, [vehicle("b", straight, 130.0)], (100.0, 0.0))
    assert mirror.bodies_of("b") != left
    assert mirror.bodies_of("a") == ()


def test_vehicles_out_of_range_or_of_unknown_kind_are_not_shown(straight):
    mirror = Mirror({"car": 3}, view_range=200.0, visuals=False)
    _, data = scene(mirror)
    seen = [
        vehicle("far", straight, 500.0),
        vehicle("long", straight, 120.0, kind="articulated"),
        dataclasses.replace(vehicle("odd", straight, 110.0), kind="tram"),
    ]
    assert mirror.update(data, seen, (100.0, 0.0)) == 0


def test_a_vehicle_gets_a_free_body_of_its_own_color(straight):
    car = TYPES["car"]

    def paint(model, mirror, name):
        geom = model.geom(f"{mirror.bodies_of(name)[0]}_paint")
        return tuple(np.round(model.mat_rgba[geom.matid[0]][:3], 6).tolist())

    mirror = Mirror({"car": 2 * len(car.colors)})
    model, data = scene(mirror)
    for others in range(3):
        names = [f"other.{i}" for i in range(others)] + ["car.7"]
        cars = [vehicle(n, straight, 100.0 + 30.0 * i) for i, n in enumerate(names)]
        mirror.update(data, [], (100.0, 0.0))
        mirror.update(data, cars, (100.0, 0.0))
        for name in names:
            assert paint(model, mirror, name) == pytest.approx(car.color_of(name), abs=1e-6)


def test_vehicles_of_two_types_of_one_look_get_bodies_of_their_own_size(straight):
    car = TYPES["car"]
    small = dataclasses.replace(car, name="small", look="car", length=3.6, width=1.7, height=1.5)
    mirror = Mirror({"car": 2, "small": 2}, types=[car, small], visuals=False)
    model, data = scene(mirror)
    seen = [
        vehicle("a", straight, 100.0),
        dataclasses.replace(vehicle("b", straight, 120.0), length=3.6, width=1.7),
    ]
    mirror.update(data, seen, (100.0, 0.0))
    lengths = [
        2.0 * model.geom(f"{mirror.bodies_of(name)[0]}_hull_0").size[0] for name in ("a", "b")
    ]
    assert lengths == pytest.approx([4.7, 3.6])


def test_update_is_a_function_of_the_frames_since_bind(straight):
    rng = np.random.default_rng(2)

    def frames():
        places, speeds = rng.uniform(0.0, 800.0, 40), rng.uniform(5.0, 25.0, 40)
        for k in range(30):
            yield VehicleFrame.of(
                [
                    vehicle(
                        f"v{i:02}",
                        straight,
                        s,
                        kind=[*TYPES][i % 4],
                        yaw_rate=0.1 * math.sin(0.3 * k + i),
                    )
                    for i, s in enumerate((places + 0.1 * k * speeds).tolist())
                ]
            )

    given = list(frames())
    mirror = Mirror(visuals=False)
    model, data = scene(mirror)
    runs = []
    for _ in range(2):
        mirror.bind(model)
        mujoco.mj_resetData(model, data)
        poses = []
        for k, now in enumerate(given):
            mirror.update(data, now, (400.0 + 1.5 * k, 0.0))
            mirror.update(data, None, (400.0 + 1.5 * k, 0.0), elapsed=0.062)
            poses.append(np.concatenate((data.mocap_pos, data.mocap_quat), axis=1))
        runs.append(np.array(poses))
    assert np.array_equal(*runs)


def test_wrong_arguments_are_refused_with_the_allowed_values(straight):
    with pytest.raises(InputError, match="types are car, van, truck, pedestrian"):
        Mirror({"bus": 1})
    for count in (-1, 501, 2.5, True):
        with pytest.raises(InputError, match="counts 0 to 500"):
            Mirror({"car": count})
    for name in ("view_range", "step_length"):
        for value in (0.0, -1.0, math.nan, math.inf, "far"):
            with pytest.raises(InputError, match=name):
                Mirror(**{name: value})
    with pytest.raises(InputError, match="pool 14"):
        Mirror(14)
    with pytest.raises(InputError, match="car, car: each name may occur once"):
        Mirror(types=[TYPES["car"], TYPES["car"]])
    short = dataclasses.replace(TYPES["articulated"], length=9.0)
    with pytest.raises(InputError, match=r"9\.0 m: two units need 12 m or more"):
        Mirror(types=[short])
    mirror = Mirror(visuals=False)
    with pytest.raises(InputError, match="bind"):
        mirror.update(mujoco.MjData(mujoco.MjModel.from_xml_string(TRUCK)), [], (0.0, 0.0))
    with pytest.raises(InputError, match="add_to"):
        mirror.bind(mujoco.MjModel.from_xml_string(TRUCK))
    _, data = scene(mirror)
    with pytest.raises(InputError, match="another model"):
        mirror.update(mujoco.MjData(mujoco.MjModel.from_xml_string(TRUCK)), [], (0.0, 0.0))
    for ego, elapsed in (((math.nan, 0.0), 0.0), ((0.0, math.inf), 0.0), ((0.0, 0.0), math.nan)):
        with pytest.raises(InputError, match="must be finite"):
            mirror.update(data, [], ego, elapsed)
    with pytest.raises(InputError, match="not finite"):
        mirror.update(data, [vehicle("a", straight, 10.0, speed=math.nan)], (0.0, 0.0))
