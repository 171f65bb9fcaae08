"""Visual geoms do not affect the physics and fit the truck's size."""

import mujoco
import numpy as np
import pytest

import iits_mj
from iits_mj.core.errors import InputError
from iits_mj.model.builder import truck_spec, truck_xml
from iits_mj.model.visuals import decorate
from iits_mj.model.visuals.shapes import VISUAL_GROUP, boxes, lathe, merge, prism, surface
from iits_mj.parameters import TruckParameters
from iits_mj.road import RoadMap

PARAMETERS = TruckParameters.load()


@pytest.fixture(scope="module")
def model():
    iits_mj.plugin.register()
    return truck_spec(PARAMETERS, 36_000.0).compile()


@pytest.fixture(scope="module")
def bare():
    iits_mj.plugin.register()
    return mujoco.MjModel.from_xml_string(truck_xml(PARAMETERS, 36_000.0))


def visual(model):
    return np.flatnonzero(model.geom_group == VISUAL_GROUP)


def extent(model, body):
    """Lowest and highest corner of a body's visual meshes and boxes in the body's frame."""
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    frame = data.body(body)
    corners = []
    for geom in visual(model):
        shown = model.body(model.geom_bodyid[geom]).name
        if shown not in (body, f"{body}_visuals"):
            continue
        if model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_MESH:
            mesh = model.geom_dataid[geom]
            first = model.mesh_vertadr[mesh]
            local = model.mesh_vert[first : first + model.mesh_vertnum[mesh]]
        else:
            size = model.geom_size[geom]
            local = np.array([-size, size])
            if model.geom_type[geom] != mujoco.mjtGeom.mjGEOM_BOX:
                continue
        world = local @ data.geom_xmat[geom].reshape(3, 3).T + data.geom_xpos[geom]
        corners.append((world - frame.xpos) @ frame.xmat.reshape(3, 3))
    points = np.concatenate(corners)
    return points.min(axis=0), points.max(axis=0)


def test_visual_geoms_touch_nothing_and_are_named(model):
    geoms = visual(model)
    assert 80 < len(geoms) < 150
    assert not model.geom_contype[geoms].any()
    assert not model.geom_conaffinity[geoms].any()
    names = [model.geom(int(geom)).name for geom in geoms]
    assert all(names)
    assert len(set(names)) == len(names)


def test_visuals_change_no_mass_and_no_inertia(model, bare):
    for quantity in ("body_mass", "body_subtreemass", "body_inertia", "body_ipos"):
        dressed, plain = getattr(model, quantity), getattr(bare, quantity)
        np.testing.assert_array_equal(dressed[: bare.nbody], plain)
    assert model.body_mass.sum() == bare.body_mass.sum()


def test_the_truck_drives_the_same_with_and_without_visuals_bit_for_bit():
    road = RoadMap.builtin().route()
    states = []
    for seen in (False, True):
        truck = iits_mj.Truck.load(route=road, visuals=seen)
        truck.reset(station=100.0, speed=15.0)
        truck.command(accelerator_pedal=0.6, steering_wheel_angle=0.3)
        truck.step(400)
        truck.command(accelerator_pedal=0.0, xbr_demand=-3.0, xbr_mode=2.0)
        truck.step(400)
        states.append((truck.observe(), truck.data.qpos.copy(), truck.data.sensordata.copy()))
    (bare_ego, *bare), (seen_ego, *seen) = states
    assert bare_ego == seen_ego
    for one, other in zip(bare, seen, strict=True):
        np.testing.assert_array_equal(one, other)


def test_bodies_with_a_hull_have_no_other_geom(model):
    hulls = np.flatnonzero(model.geom_contype)
    for body in set(model.geom_bodyid[hulls]):
        assert model.body_geomnum[body] == np.sum(model.geom_bodyid[hulls] == body)


def test_cab_is_as_long_wide_and_high_as_the_parameters_say(model):
    low, high = extent(model, "tractor")
    tractor = PARAMETERS.lead
    assert high[0] == pytest.approx(tractor.front_overhang, abs=0.03)
    assert high[2] == pytest.approx(tractor.height, abs=0.01)
    # Mirrors stand out by a third of a meter.
    assert 0.5 * tractor.width < high[1] < 0.5 * tractor.width + 0.40
    assert 0.15 < low[2] < 0.35


def test_trailer_body_is_as_long_wide_and_high_as_the_parameters_say(model):
    low, high = extent(model, "trailer")
    trailer = PARAMETERS.units[1]
    assert high[0] == pytest.approx(trailer.front_overhang, abs=0.03)
    assert low[0] == pytest.approx(trailer.front_overhang - trailer.length, abs=0.07)
    assert high[1] == pytest.approx(0.5 * trailer.width, abs=0.02)
    assert high[2] == pytest.approx(trailer.height - PARAMETERS.couplings[0].height, abs=0.01)


def test_cab_and_trailer_clear_each_other_in_a_right_angle_turn(model):
    trailer = PARAMETERS.units[1]
    corner = np.hypot(trailer.front_overhang, 0.5 * trailer.width)
    rear_of_cab = PARAMETERS.couplings[0].position - corner
    low, _ = extent(model, "tractor")
    assert low[0] < -PARAMETERS.lead.axles[-1].position
    extenders = model.geom("tractor_extenders")
    mesh = int(extenders.dataid[0])
    first = model.mesh_vertadr[mesh]
    local = model.mesh_vert[first : first + model.mesh_vertnum[mesh]]
    rotation = np.empty(9)
    mujoco.mju_quat2Mat(rotation, extenders.quat)
    x = (local @ rotation.reshape(3, 3).T + extenders.pos)[:, 0]
    assert x.min() > -rear_of_cab + 0.1


def test_truck_looks_the_same_from_left_and_right(model):
    for body in ("tractor", "trailer"):
        low, high = extent(model, body)
        assert high[1] == pytest.approx(-low[1], abs=1e-4)


@pytest.mark.parametrize("axle", PARAMETERS.axles, ids=lambda axle: axle.name)
def test_tires_have_the_free_radius_and_stand_inside_the_width(model, axle):
    low, high = extent(model, f"{axle.name}_left_wheel")
    radius = PARAMETERS.tires[axle.tire].free_radius
    assert high[2] == pytest.approx(radius, abs=2e-3)
    assert low[2] == pytest.approx(-radius, abs=2e-3)
    assert 0.5 * axle.track + high[1] < 0.5 * PARAMETERS.units[1].width + 0.03


def test_static_xml_keeps_every_visual_geom(model):
    spec = truck_spec(PARAMETERS, 36_000.0)
    spec.compile()
    again = mujoco.MjModel.from_xml_string(spec.to_xml())
    assert again.ngeom == model.ngeom
    np.testing.assert_allclose(again.geom_pos, model.geom_pos, atol=1e-6)
    np.testing.assert_allclose(again.geom_rbound, model.geom_rbound, atol=1e-5)


def test_missing_body_is_named():
    spec = mujoco.MjSpec()
    spec.worldbody.add_body(name="tractor")
    with pytest.raises(InputError, match="trailer"):
        decorate(spec, PARAMETERS, 0.0)


def signed_volume(shape):
    a, b, c = (shape.vertices[shape.faces[:, i]] for i in range(3))
    return np.einsum("ij,ij->i", a, np.cross(b, c)).sum() / 6.0


def test_boxes_and_prisms_face_outwards():
    assert signed_volume(boxes([((1.0, 2.0, 3.0), (2.0, 3.0, 4.0))])) == pytest.approx(24.0)
    square = [(0.0, 0.0), (1.0, 0.0), (1.0, 2.0), (0.0, 2.0)]
    assert signed_volume(prism(square, 0.0, 0.5)) == pytest.approx(1.0)
    assert signed_volume(prism(square[::-1], 0.0, 0.5)) == pytest.approx(1.0)
    assert signed_volume(prism(square, 0.0, 0.5).mirrored()) == pytest.approx(1.0)


def test_a_lathed_cylinder_has_the_volume_of_its_polygon():
    cylinder = lathe([(0.0, 0.5), (2.0, 0.5), (2.0, -0.5), (0.0, -0.5)], 64)
    area = 0.5 * 64 * 4.0 * np.sin(2.0 * np.pi / 64)
    assert signed_volume(cylinder) == pytest.approx(area)


def test_a_sheet_drawn_left_to_right_and_forwards_faces_up():
    grid = np.array([[[0.0, 1, 0], [0.0, -1, 0]], [[5.0, 1, 0], [5.0, -1, 0]]])
    shape = surface(grid)
    a, b, c = (shape.vertices[shape.faces[:, i]] for i in range(3))
    assert np.all(np.cross(b - a, c - a)[:, 2] > 0)
    assert merge([shape, shape]).faces.max() == 7
