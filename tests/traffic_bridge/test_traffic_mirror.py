import math

import mujoco
import numpy as np
import pytest
from scripted_truck import ego_at

from iits_mj.errors import InputError
from iits_mj.messages import TrackedVehicle
from iits_mj.road import Route
from traffic_bridge import InterSim, Mirror, TrafficConfig, default_types

TYPES = {kind.kind: kind for kind in default_types()}
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


def test_bodies_lie_on_a_slope():
    route = Route.straight(length=1000.0, grade=0.05)
    mirror = Mirror(route, {"car": 2})
    model, data = scene(mirror)
    mirror.update(data, [vehicle("a", route, 100.0, 4.0)], (90.0, 0.0))
    position, axes = frame(model, data, mirror.slot_of("a"))
    np.testing.assert_allclose(position, [100.0, 4.0, 5.0], atol=1e-9)
    slope = math.atan(0.05)
    np.testing.assert_allclose(axes[:, 0], [math.cos(slope), 0.0, math.sin(slope)], atol=1e-9)
    # Oncoming: the nose points downhill.
    mirror.update(data, [vehicle("a", route, 100.0, 4.0, yaw=math.pi)], (90.0, 0.0))
    _, axes = frame(model, data, mirror.slot_of("a"))
    np.testing.assert_allclose(axes[:, 0], [-math.cos(slope), 0.0, -math.sin(slope)], atol=1e-9)


def test_bodies_are_tangent_to_the_road_everywhere(highway):
    mirror = Mirror(highway, {"car": 1})
    model, data = scene(mirror)
    for station in np.linspace(200.0, highway.length - 200.0, 25):
        v = vehicle("a", highway, float(station), 1.0)
        mirror.update(data, [v], (v.x, v.y))
        position, axes = frame(model, data, mirror.slot_of("a"))
        p = [highway.evaluate(float(station) + d, 1.0 + e) for d, e in ((-1, 0), (1, 0), (0, 1))]
        point = np.array([[float(q.x), float(q.y), float(q.z)] for q in p])
        along = (point[1] - point[0]) / np.linalg.norm(point[1] - point[0])
        left = (point[2] - position) / np.linalg.norm(point[2] - position)
        normal = np.cross(along, left) / np.linalg.norm(np.cross(along, left))
        # A twentieth of a degree: 2 mm over a car's length.
        assert np.dot(axes[:, 0], along) > math.cos(1e-3)
        assert np.dot(axes[:, 2], normal) > math.cos(1e-3)


def test_vehicles_move_on_between_traffic_steps(straight):
    mirror = Mirror(straight, {"car": 1})
    model, data = scene(mirror)
    v = vehicle("a", straight, 100.0, 4.0, speed=10.0, acceleration=2.0, lateral_speed=1.0)
    mirror.update(data, [v], (100.0, 0.0))
    mirror.update(data, None, (100.0, 0.0), elapsed=0.05)
    position, _ = frame(model, data, mirror.slot_of("a"))
    np.testing.assert_allclose(position[:2], [100.5025, 4.05], atol=1e-9)


def test_extrapolation_meets_the_next_traffic_step(straight):
    mirror = Mirror(straight)
    model, data = scene(mirror)
    config = TrafficConfig(density=0.2, fill_ahead=600.0, fill_behind=600.0)
    worst = 0.0
    with InterSim(straight, config, seed=1) as traffic:
        vehicles = traffic.reset(ego_at(straight, 0.0, 1000.0, 9.0, 4.0))
        for k in range(1, 101):
            ego = ego_at(straight, 0.1 * k, 1000.0 + 0.9 * k, 9.0, 4.0)
            mirror.update(data, vehicles, (ego.x, ego.y), elapsed=0.1)
            vehicles = traffic.step(ego)
            for v in vehicles:
                slot = mirror.slot_of(v.id)
                if slot is not None:
                    position, _ = frame(model, data, slot)
                    worst = max(worst, math.hypot(position[0] - v.x, position[1] - v.y))
    # What a camera would see as a jump at the next step.
    assert 0.0 < worst < 0.15


def test_slots_are_kept_and_reused(straight):
    mirror = Mirror(straight, {"car": 2, "articulated": 1})
    _, data = scene(mirror)
    cars = [vehicle(f"car.{i}", straight, 100.0 + 30.0 * i) for i in range(4)]
    assert mirror.update(data, cars, (100.0, 0.0)) == 2
    slots = {name: mirror.slot_of(name) for name in ("car.0", "car.1")}
    assert None not in slots.values()
    assert mirror.slot_of("car.2") is None
    # Still among the nearest: the same body.
    mirror.update(data, cars[::-1], (110.0, 0.0))
    assert {name: mirror.slot_of(name) for name in slots} == slots
    # Gone: the bodies serve others.
    mirror.update(data, cars[2:], (160.0, 0.0))
    assert {mirror.slot_of("car.2"), mirror.slot_of("car.3")} == set(slots.values())
    mirror.update(data, [], (160.0, 0.0))
    assert np.all(data.mocap_pos[:, 2] < -100.0)
    parked = data.mocap_pos[:, None, :] - data.mocap_pos[None, :, :]
    distance = np.linalg.norm(parked, axis=-1) + 1e3 * np.eye(len(data.mocap_pos))
    assert distance.min() > 20.0


def test_vehicles_out_of_range_or_of_unknown_kind_are_not_shown(straight):
    mirror = Mirror(straight, {"car": 3}, view_range=200.0)
    _, data = scene(mirror)
    seen = [vehicle("far", straight, 500.0), vehicle("long", straight, 120.0, kind="articulated")]
    assert mirror.update(data, seen, (100.0, 0.0)) == 0


def test_contact_names_the_pair_and_exerts_no_force(straight):
    mirror = Mirror(straight, {"car": 3, "van": 1})
    model, data = scene(mirror)
    model.opt.gravity[:] = 0.0
    seen = [
        vehicle("front", straight, 4.0),
        vehicle("side", straight, -9.0, 2.0, kind="van"),
        vehicle("near", straight, 1.0, 2.3),
        vehicle("touching.each.other", straight, 1.5, 2.9),
    ]
    mirror.update(data, seen, (0.0, 0.0))
    mujoco.mj_step(model, data)
    assert mirror.contacts(data) == [("front", "tractor"), ("side", "trailer")]
    assert np.abs(data.qvel).max() == 0.0
    assert np.abs(data.qfrc_constraint).max() == 0.0
    mirror.update(data, [], (0.0, 0.0))
    mujoco.mj_step(model, data)
    assert mirror.contacts(data) == []


def test_the_real_trucks_hull_is_met_at_both_units():
    from iits_mj import Truck

    route = Route.straight(length=1000.0)
    mirror = Mirror(route, {"car": 2})
    truck = Truck.load(route=route, visuals=False, edit_spec=mirror.add_to)
    mirror.bind(truck.model)
    truck.reset(station=100.0, offset=0.0)
    seen = [vehicle("a", route, 102.0), vehicle("b", route, 88.0, 1.5)]
    mirror.update(truck.data, seen, (100.0, 0.0))
    mujoco.mj_forward(truck.model, truck.data)
    pairs = mirror.contacts(truck.data)
    assert {name for name, _ in pairs} == {"a", "b"}
    assert ("a", "tractor") in pairs
    assert ("b", "trailer") in pairs


def test_misuse_is_explained(straight):
    with pytest.raises(InputError, match="kinds are"):
        Mirror(straight, {"bus": 1})
    mirror = Mirror(straight)
    with pytest.raises(InputError, match="bind"):
        mirror.update(mujoco.MjData(mujoco.MjModel.from_xml_string(TRUCK)), [], (0.0, 0.0))
    with pytest.raises(InputError, match="add_to"):
        mirror.bind(mujoco.MjModel.from_xml_string(TRUCK))
