"""The truck's model works in a model of the user's own, with any prefix or suffix."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from iits_mj.model.builder import truck_spec
from iits_mj.parameters import TruckParameters
from iits_mj.plugin import register
from iits_mj.truck import Truck

SECONDS = 3.0


def drive(model: mujoco.MjModel, before: str = "", after: str = "") -> np.ndarray:
    """Pulls away, shifts, steers and brakes; position and all sensors of the truck at the end."""
    data = mujoco.MjData(model)
    steps = round(SECONDS / model.opt.timestep)
    for step in range(steps):
        braking = step > 2 * steps // 3
        controls = {"accelerator_pedal": not braking, "xbr_demand": -3.0 * braking}
        controls |= {"xbr_mode": 2 * braking, "steering_wheel_angle": 1.0}
        for name, value in controls.items():
            data.actuator(f"{before}{name}{after}").ctrl[:] = value
        mujoco.mj_step(model, data)
    sensors = [data.sensor(i) for i in range(model.nsensor)]
    chosen = [s.data for s in sensors if s.name.startswith(before) and s.name.endswith(after)]
    return np.concatenate([data.body(f"{before}tractor{after}").xpos, *chosen])


@pytest.fixture(scope="module")
def plain() -> np.ndarray:
    return drive(Truck.load(0.0, visuals=False).model)


@pytest.mark.parametrize(("before", "after"), [("t1_", ""), ("t1/", ""), ("", "_a"), ("a.", "-b")])
def test_an_attached_truck_drives_as_the_plain_one(
    plain: np.ndarray, before: str, after: str
) -> None:
    register()
    parent = mujoco.MjSpec()
    child = truck_spec(TruckParameters.load(), 0.0)
    parent.option = child.option
    parent.option.timestep = 0.002
    ground = parent.worldbody.add_frame()
    parent.attach(child, prefix=before, suffix=after, frame=ground)
    found = drive(parent.compile(), before, after)
    np.testing.assert_allclose(found, plain, rtol=1e-6, atol=1e-6)
    assert plain[0] > 1.0
