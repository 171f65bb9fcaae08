import mujoco
import numpy as np
import pytest

from iits_mj.core.errors import InputError
from iits_mj.road import Route
from iits_mj.road.unevenness import ALONG, Unevenness
from iits_mj.truck import Truck

SIDES = ("left", "right")
UNEVEN = Unevenness("C", 20.0, 25.0, seed=2)


def numeric(route):
    return Truck.load(route=route, visuals=False).model.numeric_data


def test_smooth_road_keeps_its_bits():
    road = Route.straight(300.0)
    smooth = numeric(road)
    np.testing.assert_array_equal(numeric(road.with_unevenness(Unevenness(seed=5))), smooth)
    rough = numeric(road.with_unevenness(UNEVEN))
    assert rough[0] == 2.0
    np.testing.assert_array_equal(rough[8 : 4 + len(smooth)], smooth[4:])
    np.testing.assert_array_equal(rough[4 + len(smooth) :], UNEVEN.heights().ravel())


@pytest.mark.parametrize("place", [(101.25, -3.0), (2100.0, 2.5), (60.0, -17.0)])
def test_tires_meet_the_heights_of_the_grid(place):
    """In one pose on both roads, the heights below the tires change their deflections."""
    flat, uneven = Route.straight(3000.0), Unevenness("A", seed=2)
    forces, pose = [], None
    for route in (flat, flat.with_unevenness(uneven)):
        truck = Truck.load(route=route, visuals=False)
        truck.reset(station=place[0], offset=place[1])
        pose = truck.data.qpos.copy() if pose is None else pose
        truck.data.qpos[:], truck.data.qvel[:] = pose, 0.0
        mujoco.mj_forward(truck.model, truck.data)
        axle = [f"tractor_axle1_{side}" for side in SIDES]
        forces.append([truck.sensor(f"{name}_tire_force")[2] for name in axle])
        centers = [truck.data.body(f"{name}_wheel").xpos for name in axle]
        expected = [uneven.height(x, y) for x, y, _ in centers]
    stiffness = truck.parameters.tires["steer"].vertical_stiffness
    felt = np.subtract(forces[1], forces[0]) / stiffness
    # Between the rows, the plugin's heights are cubic and these linear.
    np.testing.assert_allclose(felt, expected, atol=2e-4)
    assert np.abs(expected).max() > 1e-3


def test_axle_loads_vary_in_proportion_to_the_roughness():
    spread = []
    for roughness in ("A", "B"):
        route = Route.straight(1000.0).with_unevenness(Unevenness(roughness))
        truck = Truck.load(route=route, visuals=False)
        truck.reset(speed=20.0)
        loads = []
        for _ in range(250):
            truck.step(10)
            loads.append([truck.read(f"trailer_axle2_{side}_tire_force", 2) for side in SIDES])
        loads = np.array(loads)[50:]
        spread.append(loads.std(axis=0) / loads.mean(axis=0))
        # The two wheel tracks differ.
        assert np.corrcoef(loads.T)[0, 1] < 0.9
    # The class's density is four times as great.
    np.testing.assert_allclose(spread[1] / spread[0], 2.0, rtol=0.15)
    assert 0.03 < spread[0].mean() < 0.2


def test_start_on_a_rough_road_is_on_its_surface():
    road = Route.straight(1000.0)
    rough = road.with_unevenness(Unevenness("D", seed=3))
    heights = []
    for route in (road, rough):
        truck = Truck.load(route=route, visuals=False)
        heights.append(truck.reset(station=300.0).z)
    tracks = [rough.unevenness.height(300.0, side) for side in (1.0, -1.0)]
    assert heights[1] - heights[0] == pytest.approx(np.mean(tracks), abs=1e-9)
    assert abs(np.mean(tracks)) > 2.0 * ALONG / 100.0


@pytest.mark.parametrize(
    "data", ["2 2 0 1", "2 2 0 1 4 1 1 1", "2 2 0 1 1e9 64 1 1", "2 -3 0 1 4 2 1 1"]
)
def test_malformed_uneven_road_is_refused(data):
    values = np.append(np.array(data.split(), dtype=float), np.zeros(22))

    def add(spec):
        numeric = spec.add_numeric()
        numeric.name, numeric.data, numeric.size = "iits_road", values, values.size

    with pytest.raises(InputError, match="not a road table"):
        Truck.load(visuals=False, edit_spec=add)
