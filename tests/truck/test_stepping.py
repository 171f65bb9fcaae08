"""`Truck.step` against MuJoCo's own stepping: sensors, callbacks, memory."""

import tracemalloc

import mujoco
import numpy as np
import pytest

import iits_mj
from iits_mj.core.messages import VehicleCommand


@pytest.fixture(scope="module")
def truck():
    return iits_mj.Truck.load(payload=20_000, visuals=False)


@pytest.mark.parametrize("steps", [0, 1, 2, 50])
def test_sensors_after_steps_are_those_of_plain_mujoco(truck, steps):
    truck.reset(speed=15.0)
    truck.command(accelerator_pedal=0.7, steering_wheel_angle=0.5)
    plain = mujoco.MjData(truck.model)
    mujoco.mj_copyData(plain, truck.model, truck.data)
    truck.step(steps)
    mujoco.mj_step(truck.model, plain, steps)
    np.testing.assert_array_equal(truck.data.sensordata, plain.sensordata)
    np.testing.assert_array_equal(truck.data.qpos, plain.qpos)
    np.testing.assert_array_equal(truck.data.plugin_state, plain.plugin_state)
    np.testing.assert_array_equal(truck.data.cacc, plain.cacc)
    assert truck.model.opt.disableflags == 0


def test_a_callback_reads_sensors_of_the_step_before(truck):
    truck.reset(speed=15.0)
    seen = []
    mujoco.set_mjcb_control(lambda model, data: seen.append(data.sensor("tractor_gyro").data[2]))
    try:
        truck.command(steering_wheel_angle=1.0)
        truck.step(20)
    finally:
        mujoco.set_mjcb_control(None)
    assert len(set(seen[1:])) == 19


def test_sensors_are_enabled_again_after_a_divergence():
    truck = iits_mj.Truck.load(payload=0, visuals=False)
    truck.data.qvel[0] = np.nan
    with pytest.raises(iits_mj.Error, match="diverged"):
        truck.step(10)
    assert truck.model.opt.disableflags == 0


def test_commands_and_steps_leave_no_memory_behind(truck):
    calls = 10_000
    command = VehicleCommand(accelerator_pedal=0.3)

    def drive(count):
        for _ in range(count):
            truck.command(command)
            truck.step(1)

    truck.reset()
    drive(500)
    tracemalloc.start()
    try:
        drive(500)
        before, _ = tracemalloc.get_traced_memory()
        drive(calls)
        after, _ = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert (after - before) // calls == 0
