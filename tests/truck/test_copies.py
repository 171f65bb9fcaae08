"""Copies of trucks, environments and suite physics continue to the bit, also in new processes."""

from __future__ import annotations

import copy
import multiprocessing
import pickle
from collections.abc import Callable
from typing import Any

import gymnasium
import mujoco
import numpy as np
import pytest

import iits_mj
from iits_mj import suite
from iits_mj.core.errors import InputError, TrafficError
from iits_mj.envs import ENVIRONMENTS


def drive(truck: iits_mj.Truck) -> bytes:
    """Half a second in a curve; the bits of the state and of the last reading of all sensors."""
    truck.command(accelerator_pedal=0.6, steering_wheel_angle=0.4)
    truck.step(250)
    return (
        truck.data.qpos.tobytes()
        + truck.data.plugin_state.tobytes()
        + (truck.data.sensordata.tobytes())
    )


def act(environment: Any) -> bytes:
    """Three steps with the middle action; the bits of what they return."""
    space = environment.action_space
    action = 1 if isinstance(space, gymnasium.spaces.Discrete) else np.zeros(space.shape)
    results = [environment.step(action)[:2] for _ in range(3)]
    return b"".join(np.append(np.ravel(seen), reward).tobytes() for seen, reward in results)


def load_and(action: Callable[[Any], bytes], stored: bytes) -> bytes:
    """Runs an action on an object that arrives as a pickle."""
    return action(pickle.loads(stored))


@pytest.fixture(scope="module")
def pool() -> Any:
    with multiprocessing.get_context("spawn").Pool(1) as one:
        yield one


def test_a_truck_in_motion_continues_as_copy_pickle_and_in_a_new_process(pool: Any) -> None:
    truck = iits_mj.Truck.load(12_000.0, visuals=False)
    truck.reset(speed=18.0)
    truck.command(brake_pedal=0.3)
    truck.step(300)
    before = truck.data.sensordata.copy()
    twins = [copy.deepcopy(truck), pickle.loads(pickle.dumps(truck))]
    for twin in twins:
        np.testing.assert_array_equal(twin.data.sensordata, before)
    elsewhere = pool.apply_async(load_and, (drive, pickle.dumps(truck)))
    expected = drive(truck)
    assert [drive(twin) for twin in twins] == [expected] * 2
    assert elsewhere.get(60) == expected


IN_SUMO = ("iits_mj/Highway-v0", "iits_mj/Hoel2020-v0")


@pytest.mark.parametrize("name", [n for n in ENVIRONMENTS if n not in IN_SUMO])
def test_an_environment_continues_as_copy_pickle_and_in_a_new_process(name: str, pool: Any) -> None:
    environment = gymnasium.make(name)
    environment.reset(seed=1)
    twins = [copy.deepcopy(environment), pickle.loads(pickle.dumps(environment))]
    elsewhere = pool.apply_async(load_and, (act, pickle.dumps(environment)))
    expected = act(environment)
    assert [act(twin) for twin in twins] == [expected] * 2
    assert elsewhere.get(120) == expected


@pytest.mark.parametrize("name", IN_SUMO)
def test_sumo_traffic_is_copied_before_it_runs_and_refused_afterwards(name: str) -> None:
    environment = gymnasium.make(name)
    for twin in (copy.deepcopy(environment), pickle.loads(pickle.dumps(environment))):
        twin.close()
    environment.reset(seed=1)
    for action in (copy.deepcopy, pickle.dumps):
        with pytest.raises(TrafficError, match="SUMO simulation cannot be copied"):
            action(environment)
    environment.close()


def test_physics_of_the_suite_continue_as_copies() -> None:
    physics = suite.load("truck", "lane_change").physics
    physics.truck.reset(speed=20.0)
    physics.step(50)
    twins = [physics.copy(), copy.deepcopy(physics), pickle.loads(pickle.dumps(physics))]
    for each in (physics, *twins):
        each.truck.command(steering_wheel_angle=0.3)
        each.step(100)
        assert each.data.qpos.tobytes() == physics.data.qpos.tobytes()


def test_models_without_plugins_pickle_as_before() -> None:
    model = mujoco.MjModel.from_xml_string(
        "<mujoco><worldbody><body><freejoint/><geom size='.1'/></body></worldbody></mujoco>"
    )
    data = mujoco.MjData(model)
    mujoco.mj_step(model, data, 10)
    assert pickle.loads(pickle.dumps(data)).qpos.tobytes() == data.qpos.tobytes()


def test_data_of_another_model_are_refused() -> None:
    truck = iits_mj.Truck.load(0.0, visuals=False)

    def add_body(spec: mujoco.MjSpec) -> None:
        spec.worldbody.add_body(name="box", pos=[0, 50, 0]).add_geom(size=[1, 1, 1])

    other = iits_mj.Truck.load(0.0, visuals=False, edit_spec=add_body)
    with pytest.raises(InputError, match="data were made for another model"):
        iits_mj.Truck(truck.model, truck.parameters, 0.0, truck.route, data=other.data)
    with pytest.raises(mujoco.FatalError, match="mjData was made for another mjModel"):
        mujoco.mj_forward(truck.model, other.data)
