import dataclasses
import math
import re

import mujoco
import numpy as np
import pytest

from controllers.stack import Stack
from iits_mj import Truck
from iits_mj.core.messages import TrackedVehicle, VehicleCommand
from iits_mj.parameters import TruckParameters
from iits_mj.road import Route
from iits_mj.simulation import DriveConfig, Simulation
from iits_mj.simulation.gaps import truck_boxes
from tests.core.box_distance import box_distance
from tests.traffic_bridge.mirror.test_mirror import scene, vehicle
from traffic_bridge import Mirror, VehicleFrame
from traffic_bridge.mirror.bodies import Outline, may_touch, separation
from traffic_bridge.mirror.mirror import DEFAULT_POOL
from traffic_bridge.modes.sumo_modes import Mode


def test_contact_names_the_pair_and_exerts_no_force(straight):
    mirror = Mirror({"car": 3, "van": 1}, visuals=False)
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


def test_a_vehicle_on_a_bridge_over_the_truck_does_not_touch_it(straight):
    mirror = Mirror({"car": 1}, visuals=False)
    model, data = scene(mirror)
    for height, touched in ((6.0, False), (1.0, True)):
        car = vehicle("a", straight, 0.0)
        above = TrackedVehicle("a", "car", x=car.x, y=car.y, z=height)
        mirror.update(data, [above], (0.0, 0.0))
        mujoco.mj_forward(model, data)
        assert bool(mirror.contacts(data)) == touched


@pytest.fixture(scope="module")
def driven():
    route = Route.straight(length=1000.0)
    mirror = Mirror(visuals=False)
    truck = Truck.load(route=route, visuals=False, edit_spec=mirror.add_to)
    return route, mirror, truck


@pytest.mark.parametrize(
    ("bits", "alone"),
    [((0, 0), True), ((8, 0), True), ((1, 1), False), ((4, 0), False), ((0, 2), False)],
)
def test_a_geom_that_may_touch_the_truck_makes_other_contacts_possible(bits, alone):
    mirror = Mirror({"car": 1}, visuals=False)

    def add(spec):
        mirror.add_to(spec)
        contype, conaffinity = bits
        size = [1.0, 0.0, 0.0]
        spec.worldbody.add_geom(size=size, contype=contype, conaffinity=conaffinity)

    mirror.bind(Truck.load(visuals=False, edit_spec=add).model)
    assert mirror.finds_all is alone


@pytest.mark.parametrize(
    ("ahead", "obstacle", "detects"), [(50.0, False, False), (0.0, False, True), (50.0, True, True)]
)
def test_a_drive_looks_for_contacts_only_near_vehicles_or_other_geoms(ahead, obstacle, detects):
    config = DriveConfig(start_speed=0.0)

    class OneCar(Mode):
        def __init__(self, route):
            station = config.start_station + ahead
            offset = route.lane_offset(config.start_lane, station)
            self.route, self.car = route, vehicle("a", route, station, offset, speed=0.0)

        def reset(self, ego=None):
            return VehicleFrame.of([self.car])

        step = reset

    def add(spec):
        if obstacle:
            spec.worldbody.add_geom(size=[1.0, 0.0, 0.0], pos=[0.0, 0.0, 500.0])

    with Simulation(
        config, visuals=False, edit_spec=add, traffic=lambda route, _: OneCar(route)
    ) as simulation:
        assert simulation.truck.detects_contacts is detects


def test_tractor_and_trailer_touch_cars_and_both_units_of_articulated_trucks(driven):
    route, mirror, truck = driven
    mirror.bind(truck.model)
    truck.reset(station=100.0, offset=0.0)
    seen = [
        vehicle("a", route, 102.0),
        vehicle("b", route, 88.0, 1.5),
        # Its semitrailer beside the tractor; its tractor behind the semitrailer.
        vehicle("c", route, 108.0, 2.0, kind="articulated"),
        vehicle("d", route, 78.2, -1.0, kind="articulated"),
    ]
    mirror.update(truck.data, seen, (100.0, 0.0))
    mujoco.mj_forward(truck.model, truck.data)
    pairs = mirror.contacts(truck.data)
    assert {name for name, _ in pairs} == {"a", "b", "c", "d"}
    assert {("a", "tractor"), ("b", "trailer"), ("c", "tractor"), ("d", "trailer")} <= set(pairs)


def test_a_collision_does_not_change_the_motion_of_the_truck(driven):
    route, mirror, truck = driven
    states = []
    for crowd in (False, True):
        mirror.bind(truck.model)
        ego = truck.reset(station=100.0, offset=0.0, speed=15.0)
        truck.command(VehicleCommand(accelerator_pedal=0.5, steering_wheel_angle=0.2))
        trace, touched = [], 0
        for k in range(100):
            seen = [
                vehicle(f"v{i}", route, ego.station + 12.0 * (i - 2), 0.5 * i, kind=kind)
                for i, kind in enumerate(("car", "van", "truck", "articulated", "car"))
            ]
            mirror.update(truck.data, seen if crowd else [], (ego.x, ego.y))
            truck.step(2)
            touched += len(mirror.contacts(truck.data))
            trace.append(np.concatenate((truck.data.qpos, truck.data.qvel, truck.data.act)))
            ego = truck.observe() if k % 10 == 9 else ego
        assert (touched > 50) == crowd
        states.append(np.array(trace))
    assert np.array_equal(*states)


def rectangle(rng, *, spread=12.0, speed=0.0):
    yaw = rng.uniform(-math.pi, math.pi)
    length, width = rng.uniform(0.5, 8.0, 2)
    x, y, vx, vy = *rng.uniform(-spread, spread, 2), *rng.uniform(-speed, speed + 1e-9, 2)
    return Outline(x, y, math.cos(yaw), math.sin(yaw), length, width, vx, vy)


def corners(box):
    ahead = box.half_length * np.array([box.ahead_x, box.ahead_y])
    left = box.half_width * np.array([-box.ahead_y, box.ahead_x])
    signs = ((1, -1), (1, 1), (-1, 1), (-1, -1))
    return np.array([np.array([box.x, box.y]) + a * ahead + b * left for a, b in signs])


def test_separation_is_a_lower_bound_of_the_distance_and_zero_only_on_overlap():
    rng = np.random.default_rng(4)
    tight = apart = 0
    for _ in range(500):
        a, b = rectangle(rng), rectangle(rng)
        true, found = box_distance(corners(a), corners(b)), separation(a, b)
        assert found <= true + 1e-9
        assert (found <= 0.0) == (true == 0.0)
        apart += true > 0.0
        tight += true > 0.0 and found > 0.999 * true
    assert 30 < tight < apart


def test_may_touch_is_true_for_every_pair_that_touches_within_the_time():
    rng = np.random.default_rng(9)
    within, announced, touching = 0.1, 0, 0
    for _ in range(300):
        pair, rates = [], rng.uniform(-0.5, 0.5, 2).tolist()
        for spread, rate in zip((12.0, 24.0), rates, strict=True):
            box = rectangle(rng, spread=spread, speed=30.0)
            spin = abs(rate) * math.hypot(box.half_length, box.half_width)
            pair.append(dataclasses.replace(box, spin=spin))
        if separation(*pair) <= 0.0:
            continue
        said, met = may_touch(*pair, within), False
        for t in np.linspace(0.0, within, 21).tolist():
            moved = []
            for box, rate in zip(pair, rates, strict=True):
                yaw = math.atan2(box.ahead_y, box.ahead_x) + rate * t
                moved.append(
                    dataclasses.replace(
                        box,
                        x=box.x + t * box.velocity_x,
                        y=box.y + t * box.velocity_y,
                        ahead_x=math.cos(yaw),
                        ahead_y=math.sin(yaw),
                    )
                )
            met = met or separation(*moved) <= 0.0
        assert said or not met
        announced += said
        touching += met
    assert touching > 10
    assert announced < 200


def test_a_full_pool_in_the_other_lanes_cannot_touch_the_truck(driven):
    route, mirror, truck = driven
    mirror.bind(truck.model)
    ego = truck.reset(station=200.0, offset=0.0, speed=15.0)
    kinds = [kind for kind, count in DEFAULT_POOL.items() for _ in range(count)]
    beside = [
        vehicle(f"v{i:02}", route, 150.0 + 18.0 * (i % 6), 3.5 * (i // 6 + 1), kind, speed=17.0)
        for i, kind in enumerate(kinds)
    ]
    assert mirror.update(truck.data, beside, (ego.x, ego.y)) == 27
    mujoco.mj_forward(truck.model, truck.data)
    assert not mirror.may_touch(truck.data, 0.1)
    assert truck.data.ncon == 0
    # Oncoming at 30 m/s, 2 m before the bumper: within the next 0.1 s.
    ahead = vehicle("x", route, 200.0 + 1.4 + 2.0 + 2.35, yaw=math.pi, speed=15.0)
    mirror.update(truck.data, [*beside, ahead], (ego.x, ego.y))
    assert mirror.may_touch(truck.data, 0.1)


def test_a_contact_names_the_unit_of_an_a_double():
    route, mirror = Route.straight(length=1000.0), Mirror({"car": 4}, visuals=False)
    parameters = TruckParameters.load("a_double")
    truck = Truck.load(parameters=parameters, route=route, visuals=False, edit_spec=mirror.add_to)
    mirror.bind(truck.model)
    truck.reset(station=200.0, offset=0.0)
    ego, boxes = truck.observe(), truck_boxes(truck.observe(), parameters)
    for unit, box in zip(parameters.units, boxes, strict=True):
        x, y = box.mean(axis=0).tolist()
        mirror.update(truck.data, [vehicle("a", route, x, y)], (ego.x, ego.y))
        mujoco.mj_forward(truck.model, truck.data)
        assert ("a", unit.name) in mirror.contacts(truck.data)


@pytest.mark.parametrize("lasting", [0.01, 0.04])
def test_a_short_overlap_at_30_m_per_s_is_detected_between_two_traffic_steps(driven, lasting):
    route, mirror, truck = driven
    mirror.bind(truck.model)
    truck.reset(station=200.0, offset=0.0, speed=20.0)
    tractor = truck.parameters.lead
    # A car crosses from the right, and its rear corner touches the left end of the bumper: the
    # corners overlap from 0.14 s on, at a relative speed of 30 m/s.
    begin, speed = 0.14, 22.0
    front = 200.0 + tractor.front_overhang + 20.0 * begin

    def crossing(time):
        y = 0.5 * tractor.width + 2.35 + speed * (time - begin - lasting)
        return vehicle("x", route, front + 0.925, y, yaw=0.5 * math.pi, speed=speed)

    at_steps, between = [], []
    for k in range(4):
        ego = truck.observe()
        mirror.update(truck.data, [crossing(0.1 * k)], (ego.x, ego.y))
        mujoco.mj_forward(truck.model, truck.data)
        at_steps += mirror.contacts(truck.data)
        stride = 1 if mirror.may_touch(truck.data, 0.1) else 50
        for j in range(0, 50, stride):
            mirror.update(truck.data, None, (ego.x, ego.y), elapsed=0.002 * j)
            truck.step(stride)
            between += [(0.1 * k + 0.002 * j, *pair) for pair in mirror.contacts(truck.data)]
    assert at_steps == []
    assert {pair[1:] for pair in between} == {("x", "tractor")}
    assert between[0][0] == pytest.approx(begin, abs=0.006)
    assert len(between) == pytest.approx(lasting / 0.002, abs=3)


class _Crossing(Mode):
    """Traffic of one car that crosses before the truck at a right angle."""

    def __init__(self, route, at, offset, when, speed=20.0):
        self.route, self._time = route, 0.0
        self._at, self._offset, self._when, self._speed = at, offset, when, speed

    @property
    def time(self):
        return self._time

    def reset(self, ego=None):
        self._time = 0.0
        return self._car()

    def step(self, ego=None):
        self._time = ego.time
        return self._car()

    def _car(self):
        p = self.route.evaluate(self._at, self._offset)
        yaw = float(p.heading) + 0.5 * math.pi
        way = self._speed * (self._time - self._when)
        car = TrackedVehicle(
            "crossing",
            x=float(p.x) + way * math.cos(yaw),
            y=float(p.y) + way * math.sin(yaw),
            z=float(p.z),
            yaw=yaw,
            speed=self._speed,
            station=self._at,
            length=4.7,
            width=1.85,
            height=1.5,
        )
        return VehicleFrame.of([car])


class _Blind(Stack):
    """Plans without other vehicles, so that it does not brake for the crossing car."""

    def plan(self, scene):
        return super().plan(dataclasses.replace(scene, vehicles=()))


def test_a_drive_ends_at_a_short_overlap_between_two_traffic_steps():
    config = DriveConfig(
        duration=2.5, traffic_mode="none", speed=16.0, start_speed=16.0, decision="keep"
    )
    with Simulation(config, driver=lambda route, truck: _Blind(route), visuals=False) as simulation:
        while simulation.time < 2.0:
            ego = simulation.cycle().ego
        # The car's flank passes before the bumper; its last 0.4 m are caught 0.04 s after a step.
        overhang = simulation.truck.footprint.front_overhang
        at = ego.station + overhang + ego.speed * 0.04 + 0.5 * 1.85
        clear = 0.5 * (simulation.truck.parameters.lead.width + 4.7) / 20.0
        simulation.traffic = _Crossing(simulation.route, at, ego.offset, 2.06 - clear)
        simulation.reset()
        while not simulation.ended:
            simulation.cycle()
        simulation.traffic = None
    assert simulation.collision
    assert simulation.failed
    ended = re.fullmatch(
        r"collision with crossing at the tractor at t = (\d+\.\d+) s", simulation.ended
    )
    assert ended is not None
    assert float(ended[1]) == pytest.approx(2.045, abs=0.015)
    assert simulation.time == pytest.approx(2.1)
