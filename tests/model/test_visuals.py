"""Visual geoms do not affect the physics and fit the truck's size."""

import itertools

import mujoco
import numpy as np
import pytest

import iits_mj
from iits_mj.core.errors import InputError
from iits_mj.model.builder import truck_spec, truck_xml
from iits_mj.model.visuals import decorate
from iits_mj.model.visuals.shapes import VISUAL_GROUP, beam, boxes, lathe, merge, prism, surface
from iits_mj.parameters import TruckParameters
from iits_mj.parameters.units import MOTOR_VEHICLES
from iits_mj.road import RoadMap
from tests.model.combinations import REAR, combinations

PARAMETERS = TruckParameters.load()
TRUCKS = combinations()
PLATES = ("fifth_wheel", "turntable")


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


class Drawn:
    """A truck's visual geoms by name: points in the frame of their unit, heights above the road."""

    def __init__(self, name, payload):
        iits_mj.plugin.register()
        self.parameters = TRUCKS[name]
        self.model = truck_spec(self.parameters, payload).compile()
        self.data = mujoco.MjData(self.model)
        mujoco.mj_forward(self.model, self.data)
        self.names = [self.model.geom(int(geom)).name for geom in visual(self.model)]

    def points(self, geom, unit=None):
        """Points (n, 3) of a geom, in the world or in a unit's frame with z above the road."""
        model, index = self.model, self.model.geom(geom).id
        if model.geom_type[index] == mujoco.mjtGeom.mjGEOM_MESH:
            mesh = model.geom_dataid[index]
            first = model.mesh_vertadr[mesh]
            local = model.mesh_vert[first : first + model.mesh_vertnum[mesh]]
        else:
            size = model.geom_size[index]
            if model.geom_type[index] != mujoco.mjtGeom.mjGEOM_BOX:
                size = np.array([size[0], size[0], size[1]])
            local = size * np.array(
                [[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], dtype=float
            )
        world = local @ self.data.geom_xmat[index].reshape(3, 3).T + self.data.geom_xpos[index]
        if unit is None:
            return world
        frame = self.data.body(unit.name)
        height = unit.coupling.height if unit.coupling else 0.0
        return (world - frame.xpos) @ frame.xmat.reshape(3, 3) + [0.0, 0.0, height]

    def of(self, unit):
        """Names of the geoms of a unit's body, without axles and wheels."""
        geoms = visual(self.model)
        body = f"{unit.name}_visuals"
        return [
            self.model.geom(int(geom)).name
            for geom in geoms
            if self.model.body(self.model.geom_bodyid[geom]).name == body
        ]

    def load_body(self, unit):
        """Name of the frame of a unit's load body; None for a tractor or dolly."""
        name = f"{unit.name}_body_frame" if unit.kind == "rigid_truck" else f"{unit.name}_frame"
        return name if name in self.names else None


@pytest.fixture(scope="module", params=TRUCKS)
def laden(request):
    return Drawn(request.param, TRUCKS[request.param].payload_max)


@pytest.fixture(scope="module", params=TRUCKS)
def empty(request):
    return Drawn(request.param, 0.0)


def pairs(drawn):
    return list(itertools.pairwise(drawn.parameters.units))


def test_visual_geoms_of_every_truck_are_named_and_weightless(laden):
    model, p = laden.model, laden.parameters
    assert all(laden.names)
    assert len(set(laden.names)) == len(laden.names)
    geoms = visual(model)
    assert not model.geom_contype[geoms].any()
    assert not model.geom_conaffinity[geoms].any()
    bare = mujoco.MjModel.from_xml_string(truck_xml(p, p.payload_max))
    for body in range(bare.nbody):
        dressed = model.body(bare.body(body).name).id
        assert model.body_mass[dressed] == bare.body_mass[body]
        np.testing.assert_array_equal(model.body_inertia[dressed], bare.body_inertia[body])
    assert model.body_mass.sum() == bare.body_mass.sum()


def test_every_unit_is_drawn_inside_its_length_width_and_height(laden):
    for unit in laden.parameters.units:
        points = {name: laden.points(name, unit) for name in laden.of(unit)}
        assert points
        mirrors = [name for name in points if "mirror" in name]
        assert len(mirrors) == (2 if unit.kind in MOTOR_VEHICLES else 0)
        # The seat of a dolly may be higher than its frame.
        top = unit.height if unit.kind != "dolly" else 1.3
        last = unit.axles[-1]
        rear = last.position + laden.parameters.tires[last.tire].free_radius + 0.15
        for name, part in points.items():
            low, high = part.min(axis=0), part.max(axis=0)
            allowed = 0.5 * unit.width + (0.40 if name in mirrors else 0.03)
            assert high[1] < allowed, name
            assert low[1] > -allowed, name
            assert high[2] < top + 0.02, name
            assert low[2] > 0.15, name
            # A drawbar reaches to its eye, a jaw to the eye of the unit behind, a frame behind its
            # last tire; the rear lamps stand out a little.
            front = max(unit.front_overhang, 0.09) if "drawbar" in name else unit.front_overhang
            assert high[0] < front + 0.03, name
            if not name.endswith("hitch"):
                assert low[0] > min(unit.front_overhang - unit.length, -rear) - 0.10, name


def test_load_bodies_have_the_size_of_their_unit(laden):
    for unit, behind in itertools.pairwise((*laden.parameters.units, None)):
        frame = laden.load_body(unit)
        assert (frame is None) is (unit.kind in ("tractor", "dolly"))
        if frame is None:
            continue
        low, high = (f(laden.points(frame, unit), axis=0) for f in (np.min, np.max))
        assert high[1] == pytest.approx(0.5 * unit.width, abs=1e-3)
        assert high[2] == pytest.approx(unit.height, abs=1e-3)
        if unit.kind != "rigid_truck":
            assert high[0] == pytest.approx(unit.front_overhang, abs=1e-3)
        if behind is None or behind.coupling.kind not in PLATES:
            assert low[0] == pytest.approx(unit.front_overhang - unit.length, abs=1e-3)
        else:
            assert low[0] > -behind.coupling.position


def test_tires_are_below_fenders_and_load_bodies(empty):
    p = empty.parameters
    floors = [
        (empty.points(frame), unit)
        for unit in p.units
        if (frame := empty.load_body(unit)) is not None
    ]
    for unit in p.units:
        covers = np.concatenate(
            [empty.points(name) for name in empty.of(unit) if name.endswith("fenders")]
        )
        for axle in unit.axles:
            tires = empty.points(f"{axle.name}_left_wheel_tire")
            center = tires.mean(axis=0)
            top = tires[:, 2].max()
            cover = covers[
                (np.abs(covers[:, 0] - center[0]) < 0.1) & (np.abs(covers[:, 1] - center[1]) < 0.3)
            ]
            assert top < cover[:, 2].min() < top + 0.15, axle.name
            for points, _ in floors:
                if points[:, 0].min() < center[0] < points[:, 0].max():
                    assert points[:, 2].min() > top + 0.03, axle.name


def test_lifted_tires_hang_above_the_road(empty):
    for axle in empty.parameters.axles:
        lowest = empty.points(f"{axle.name}_left_wheel_tire")[:, 2].min()
        if axle.lifted(0.0):
            assert lowest == pytest.approx(0.10, abs=0.02)
        else:
            assert -0.05 < lowest < 0.01


def test_tires_of_every_truck_have_their_number_and_radius(laden):
    for axle in laden.parameters.axles:
        tire = laden.parameters.tires[axle.tire]
        tires = laden.points(f"{axle.name}_left_wheel_tire")
        size = np.ptp(tires, axis=0)
        assert size[2] == pytest.approx(2.0 * tire.free_radius, abs=3e-3)
        assert 0.5 < size[1] < 0.65 if tire.count == 2 else 0.3 < size[1] < 0.4
        assert tires[:, 1].mean() == pytest.approx(0.5 * axle.track, abs=1e-3)


def test_units_rest_on_the_plate_ahead_of_them(laden):
    for ahead, unit in pairs(laden):
        drawn = {kind for kind in PLATES if f"{ahead.name}_{kind}" in laden.names}
        kind = unit.coupling.kind
        assert drawn == {kind} & set(PLATES)
        if not drawn:
            continue
        plate = laden.points(f"{ahead.name}_{kind}")
        kingpin = laden.points(f"{unit.name}_kingpin_plate")
        assert 0.0 < kingpin[:, 2].min() - plate[:, 2].max() < 0.03
        assert plate[:, 0].mean() == pytest.approx(laden.data.body(unit.name).xpos[0])
        # From its foot on, the plate stands on the frame.
        foot = laden.points(f"{ahead.name}_{kind}_foot", ahead)
        frame = next(n for n in ("rails", "plate_frame") if f"{ahead.name}_{n}" in laden.names)
        rails = laden.points(f"{ahead.name}_{frame}", ahead)
        assert foot[:, 2].min() <= rails[:, 2].max() + 1e-3
        assert rails[:, 0].min() < -unit.coupling.position < rails[:, 0].max()
    assert f"{laden.parameters.last.name}_fifth_wheel" not in laden.names


def test_drawbars_reach_the_jaw_ahead_of_them(laden):
    for ahead, unit in pairs(laden):
        towed = unit.coupling.kind not in PLATES
        assert (f"{ahead.name}_hitch" in laden.names) is towed
        assert (f"{unit.name}_drawbar" in laden.names) is towed
        if not towed:
            continue
        jaw = laden.points(f"{ahead.name}_hitch", ahead)
        eye = np.array([-unit.coupling.position, 0.0, unit.coupling.height])
        assert np.all(jaw.min(axis=0) <= eye + 1e-6)
        assert np.all(jaw.max(axis=0) >= eye - 1e-6)
        bar = laden.points(f"{unit.name}_drawbar", unit)
        assert bar[:, 0].max() == pytest.approx(0.0, abs=0.05)
        frame = f"{unit.name}_{'rails' if unit.kind == 'dolly' else 'beams'}"
        assert bar[:, 0].min() < laden.points(frame, unit)[:, 0].max()


def test_units_on_a_plate_turn_clear_of_what_is_ahead(laden):
    for (ahead, unit), name in zip(pairs(laden), laden.parameters.coupling_names, strict=True):
        if unit.coupling.kind not in PLATES:
            continue
        solid = ("cab", "cab_back", "extenders", "frame", "doors", "body_frame", "body_doors")
        shown = [f"{ahead.name}_{part}" for part in solid if f"{ahead.name}_{part}" in laden.names]
        for angle in np.linspace(0.0, min(unit.coupling.yaw_limit, 1.5), 7):
            laden.data.joint(f"{name}_yaw").qpos = angle
            mujoco.mj_kinematics(laden.model, laden.data)
            front = laden.points(laden.load_body(unit), ahead)[:, 0].max()
            assert front < min(
                (laden.points(part, ahead)[:, 0].min() for part in shown), default=np.inf
            )
        laden.data.joint(f"{name}_yaw").qpos = 0.0
        mujoco.mj_kinematics(laden.model, laden.data)


def test_a_truck_without_trailer_has_no_parts_of_one():
    alone = Drawn("tractor alone", 0.0)
    spec = truck_spec(alone.parameters, 0.0)
    names = [*alone.names, *(mesh.name for mesh in spec.meshes)]
    assert not [name for name in names if "trailer" in name or "fifth" in name or "line" in name]


@pytest.mark.parametrize("position", [2.0, 4.0])
def test_a_unit_that_is_too_short_for_a_load_body_has_none(position):
    short = TruckParameters.load(
        overlay={
            "units": {
                "trailer": {
                    "length": 5.0,
                    "axles": {
                        "axle1": {"position": 3.0},
                        "axle2": {"position": 4.2},
                        "axle3": {"position": 5.4},
                    },
                },
                "rear": {**REAR, "coupling": {"position": position}},
            }
        }
    )
    names = {mesh.name for mesh in truck_spec(short, 0.0).meshes}
    assert ("trailer_doors" in names) is (position > 3.0)
    assert "rear_doors" in names
    assert "trailer_beams" in names


def test_a_small_wheel_has_its_rim_inside_its_tire():
    small = TruckParameters.load(
        overlay={"tires": {"trailer": {"free_radius": 0.38, "rolling_radius": 0.37}}}
    )
    spec = truck_spec(small, 0.0)
    reach = []
    for part in ("tire", "rim"):
        points = np.array(spec.mesh(f"wheel_trailer_{part}").uservert).reshape(-1, 3)
        reach.append(np.hypot(points[:, 0], points[:, 2]).max())
    assert reach[0] == pytest.approx(0.38, abs=1e-3)
    assert reach[1] < reach[0] - 0.1


def test_a_low_unit_has_a_flat_deck():
    low = TruckParameters.load(overlay={"units": {"trailer": {"height": 1.5}}})
    spec = truck_spec(low, 0.0)
    names = {mesh.name for mesh in spec.meshes}
    assert "trailer_frame" in names
    assert not names & {"trailer_doors", "trailer_straps", "trailer_name"}


def signed_volume(shape):
    a, b, c = (shape.vertices[shape.faces[:, i]] for i in range(3))
    return np.einsum("ij,ij->i", a, np.cross(b, c)).sum() / 6.0


def test_boxes_and_prisms_face_outwards():
    assert signed_volume(boxes([((1.0, 2.0, 3.0), (2.0, 3.0, 4.0))])) == pytest.approx(24.0)
    square = [(0.0, 0.0), (1.0, 0.0), (1.0, 2.0), (0.0, 2.0)]
    assert signed_volume(prism(square, 0.0, 0.5)) == pytest.approx(1.0)
    assert signed_volume(prism(square[::-1], 0.0, 0.5)) == pytest.approx(1.0)
    assert signed_volume(prism(square, 0.0, 0.5).mirrored()) == pytest.approx(1.0)


def test_a_beam_runs_from_its_start_to_its_end():
    shape = beam((0.0, 0.0, 0.5), (-3.0, 4.0, 0.5), 0.2, 0.1)
    assert signed_volume(shape) == pytest.approx(5.0 * 0.2 * 0.1)
    np.testing.assert_allclose(shape.vertices.mean(axis=0), [-1.5, 2.0, 0.5])
    assert np.ptp(shape.vertices[:, 2]) == pytest.approx(0.1)
    along = shape.vertices @ [-0.6, 0.8, 0.0]
    assert (along.min(), along.max()) == pytest.approx((0.0, 5.0))


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
