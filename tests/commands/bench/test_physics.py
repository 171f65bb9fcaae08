"""What the figures of the physics compare; the times themselves are not tested."""

import mujoco
import numpy as np
import pytest

from iits_mj.commands.bench import clocks
from iits_mj.commands.bench import physics as bench_physics
from iits_mj.parameters import TruckParameters

PARAMETERS = TruckParameters.load()


@pytest.fixture(scope="module")
def truck():
    return bench_physics.highway_truck(20_000.0)


def test_the_tree_has_the_trucks_bodies_but_no_plugin(truck):
    tree = bench_physics.bare_model(PARAMETERS, 20_000.0, 0.002)
    assert tree.nplugin == tree.nactuator == 0
    assert tree.nsensor == np.sum(truck.model.sensor_type != mujoco.mjtSensor.mjSENS_PLUGIN)
    np.testing.assert_array_equal(tree.body_mass, truck.model.body_mass)
    frame = bench_physics.bare_model(PARAMETERS, 20_000.0, 0.002, sensors=False)
    assert (frame.nbody, frame.nv, frame.nsensor, frame.nsite) == (tree.nbody, tree.nv, 0, 0)


def test_one_kind_of_plugin_is_removed_with_its_sensors(truck):
    without = bench_physics.truck_model(truck, visuals=False, without={"iits.tire"})
    assert without.nplugin == truck.model.nplugin - 3
    assert without.nsensor == truck.model.nsensor - 25  # and the torque at the steering wheel
    assert without.nactuator == truck.model.nactuator


def test_the_smallest_time_of_functions_in_turns_counts():
    ticks = iter([0.0, 3.0, 10.0, 11.0, 20.0, 21.5, 30.0, 34.0])
    least = clocks.in_turns({"a": int, "b": int}, 2, lambda: next(ticks))
    assert least == {"a": 1.5, "b": 1.0}


def test_every_figure_is_finite():
    found = bench_physics.physics(bench_physics.highway_truck(0.0), rounds=1)
    values = [check.value for check in found.checks]
    assert len(values) > 15
    assert np.isfinite(values).all()
