"""The observed state is what the sensors, the pose and the road say, in every copy of a truck."""

from __future__ import annotations

import copy
import dataclasses
import math
import pickle
from typing import Any

import mujoco
import pytest

from iits_mj import Truck
from iits_mj.core.errors import InputError
from iits_mj.core.messages import EgoState
from iits_mj.road import RoadMap
from iits_mj.truck.state import BRAKE_PRESSURES

PLACES = ("station", "offset", "trailer_offset")
SUMS = ("acceleration", "lateral_acceleration")


def assert_same(state: EgoState, expected: EgoState) -> None:
    """Both are equal; searched places to a nanometer, sums with gravity to the last digits."""
    for name in PLACES + SUMS:
        assert getattr(state, name) == pytest.approx(getattr(expected, name), abs=1e-9)
    known = {name: getattr(expected, name) for name in PLACES + SUMS}
    assert dataclasses.replace(state, **known) == expected


def by_names(truck: Truck) -> EgoState:
    """The state by the names of bodies and sensors."""
    data = truck.data

    def of(name: str, index: int = 0) -> float:
        return float(truck.sensor(name)[index])

    x, y, z = data.body("tractor").xpos.tolist()
    axes = data.body("tractor").xmat.reshape(3, 3)
    felt = truck.sensor("tractor_acceleration") + axes.T @ truck.model.opt.gravity
    station, offset = truck.route.locate(x, y)
    rear = data.site("trailer_axle_center").xpos.tolist()
    pressures: Any = tuple(of(name) for name in BRAKE_PRESSURES)
    return EgoState(
        time=data.time,
        x=x,
        y=y,
        z=z,
        yaw=math.atan2(axes[1, 0], axes[0, 0]),
        pitch=-math.asin(axes[2, 0]),
        roll=math.atan2(axes[2, 1], axes[2, 2]),
        speed=of("tractor_velocity"),
        lateral_speed=of("tractor_velocity", 1),
        acceleration=float(felt[0]),
        lateral_acceleration=float(felt[1]),
        yaw_rate=of("tractor_gyro", 2),
        trailer_yaw_rate=of("trailer_gyro", 2),
        articulation=-of("articulation_yaw"),
        articulation_rate=-of("articulation_rate"),
        steering_wheel_angle=of("steering_wheel_position"),
        road_wheel_angle=0.5 * (of("steer_angle_left") + of("steer_angle_right")),
        mass=truck.parameters.gross_mass(truck.payload),
        station=station,
        offset=offset,
        trailer_offset=truck.route.locate(rear[0], rear[1])[1],
        gear=round(of("gear")),
        shift_in_process=of("shift_in_process") > 0.5,
        engine_speed=of("engine_speed"),
        engine_torque=of("engine_torque"),
        fuel_rate=of("fuel_rate"),
        fuel_used=of("fuel_used"),
        brake_pressures=pressures,
    )


@pytest.fixture
def truck() -> Truck:
    """A truck that brakes in a turn of the highway."""
    made = Truck.load(20_000.0, route=RoadMap.builtin().route(), visuals=False)
    made.reset(station=900.0, offset=-2.0, speed=20.0)
    made.command(brake_pedal=0.2, steering_wheel_angle=0.5)
    made.step(100)
    return made


def test_the_state_is_that_of_the_named_sensors(truck: Truck) -> None:
    for _ in range(3):
        assert_same(truck.observe(), by_names(truck))
        truck.step(40)


def test_accelerations_are_without_gravity_in_any_direction(truck: Truck) -> None:
    truck.model.opt.gravity[:] = 1.0, -0.7, -9.6
    assert_same(truck.observe(), by_names(truck))


def test_a_truck_far_from_its_last_place_is_found_on_the_whole_route(truck: Truck) -> None:
    there = truck.route.evaluate(5_000.0)
    truck.data.qpos[:3] = there.x, there.y, there.z + 1.0
    assert truck.observe().station == pytest.approx(5_000.0, abs=1.0)


def test_a_position_that_is_not_finite_is_refused(truck: Truck) -> None:
    truck.observe()
    truck.data.xpos[truck.data.body("tractor").id, 0] = math.nan
    with pytest.raises(InputError, match="must be finite"):
        truck.state()


@pytest.mark.parametrize("twin", [copy.deepcopy, lambda truck: pickle.loads(pickle.dumps(truck))])
def test_a_copy_observes_its_own_data(twin: Any, truck: Truck) -> None:
    before = truck.observe()
    other = twin(truck)
    other.step(50)
    assert_same(truck.observe(), before)
    moved = other.observe()
    assert moved.station > before.station + 1.0
    truck.step(50)
    assert_same(truck.observe(), moved)


def test_a_truck_with_other_data_observes_these(truck: Truck) -> None:
    before = truck.observe()
    old, truck.data = truck.data, mujoco.MjData(truck.model)
    truck.reset(station=3_000.0)
    assert truck.observe().station == pytest.approx(3_000.0, abs=0.1)
    truck.data = old
    assert_same(truck.observe(), before)
