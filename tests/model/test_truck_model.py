"""The files of `mjcf/` and the builder: loads, names, inertias, equilibrium, reset, warnings."""

import re

import mujoco
import numpy as np
import pytest
from export_model import model_files, readme_text

import iits_mj
from iits_mj.core.assets import mjcf_dir
from iits_mj.core.errors import InputError
from iits_mj.core.messages import VehicleCommand
from iits_mj.model.builder import truck_spec
from iits_mj.parameters import TruckParameters
from iits_mj.parameters.mass_state import laden_units, static_axle_loads

PARAMETERS = TruckParameters.load()
AXLE_LOADS_KN = {
    0.0: [50.6, 34.6, 34.6, 22.2, 22.2, 22.2],
    36_000.0: [60.7, 94.9, 94.9, 96.4, 96.4, 96.4],
}


def build(payload):
    iits_mj.plugin.register()
    return truck_spec(PARAMETERS, payload).compile()


@pytest.fixture(scope="module")
def laden():
    return build(36_000.0)


def axle_loads(model, data):
    return [
        sum(
            data.sensor(f"{axle.name}_{side}_tire_force").data[2] / 1e3
            for side in ("left", "right")
        )
        for axle in PARAMETERS.axles
    ]


def test_shipped_files_equal_the_output_of_the_builder():
    for name, text in model_files().items():
        shipped = (mjcf_dir() / name).read_text(encoding="utf-8")
        assert shipped == text, f"{name} is stale: run `python tools/export_model.py`"


def test_meshes_have_no_signed_zeros():
    meshes = [text for name, text in model_files().items() if name.endswith(".obj")]
    assert meshes
    assert not any("-0.0000" in text for text in meshes)


def test_provenance_table_of_the_readme_is_current():
    text = (mjcf_dir() / "README.md").read_text(encoding="utf-8")
    assert text == readme_text(text), "run `python tools/export_model.py`"
    assert "| engine.idle_speed | 62.83 | rad/s | R |" in text


@pytest.mark.parametrize("payload", sorted(AXLE_LOADS_KN))
def test_axle_loads_at_rest_are_the_published_ones_and_stay_constant(payload):
    model = build(payload)
    data = mujoco.MjData(model)
    for _ in range(1000):
        mujoco.mj_step(model, data)
    loads = axle_loads(model, data)
    np.testing.assert_allclose(loads, AXLE_LOADS_KN[payload], rtol=0.005)
    assert sum(loads) == pytest.approx((19_000 + payload) * 9.81e-3, rel=1e-6)
    assert np.abs(data.qvel).max() < 1e-6


@pytest.mark.parametrize("payload", [0.0, 12_345.0, 36_000.0])
def test_truck_at_qpos0_is_in_equilibrium_for_any_payload(payload):
    model = build(payload)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    assert np.abs(data.qacc).max() < 1e-6
    assert model.body_subtreemass[1] == pytest.approx(19_000 + payload)


def test_payload_moves_the_static_loads_to_the_tri_axle():
    share = [sum(static_axle_loads(PARAMETERS, p)[3:]) / p for p in (18_000.0, 36_000.0)]
    assert share[0] > share[1]  # the tare's share falls


@pytest.mark.parametrize("payload", [-1.0, 36_001.0, float("nan"), float("inf")])
def test_payload_out_of_range_is_refused(payload):
    with pytest.raises(InputError, match=r"payload = .* kg: allowed is 0 to 36000 kg"):
        truck_spec(PARAMETERS, payload)


def all_names(model):
    """(kind, name) of every element of every kind that MuJoCo can name."""
    counts = {
        "body": model.nbody,
        "jnt": model.njnt,
        "geom": model.ngeom,
        "site": model.nsite,
        "cam": model.ncam,
        "light": model.nlight,
        "mesh": model.nmesh,
        "mat": model.nmat,
        "tex": model.ntex,
        "tendon": model.ntendon,
        "actuator": model.nactuator,
        "sensor": model.nsensor,
        "numeric": model.nnumeric,
        "key": model.nkey,
        "plugin": model.nplugin,
        "eq": model.neq,
        "pair": model.npair,
        "exclude": model.nexclude,
        "tuple": model.ntuple,
    }
    for kind, count in counts.items():
        for address in getattr(model, f"name_{kind}adr")[:count]:
            yield kind, model.names[address:].split(b"\0", 1)[0].decode()


@pytest.mark.parametrize("scene", ["truck.xml", "scene.xml"])
def test_every_element_has_a_unique_name_in_snake_case(scene):
    model = mujoco.MjModel.from_xml_path(str(iits_mj.mjcf_path(scene)))
    found = list(all_names(model))
    assert len(found) > 200
    assert len(set(found)) == len(found)
    for kind, name in found:
        assert re.fullmatch(r"[a-z][a-z0-9_]*", name), f"a {kind} is named {name!r}"


@pytest.mark.parametrize("payload", [0.0, 1.0, 36_000.0])
def test_masses_and_inertias_are_physically_possible(payload):
    model = build(payload)
    for i in range(1, model.nbody):
        body = model.body(i)
        if body.mass == 0.0:  # massless: pressure centers, and the payload of an empty truck
            assert model.body_dofnum[i] == 0, body.name
            continue
        least, middle, most = sorted(body.inertia)
        assert least > 0.0, body.name
        assert least + middle >= most, body.name


def test_model_files_give_the_same_truck_as_python(laden):
    shipped = mujoco.MjModel.from_xml_path(str(iits_mj.mjcf_path("truck.xml")))
    state = []
    for model in (laden, shipped):
        data = mujoco.MjData(model)
        data.qvel[0] = 10.0
        data.ctrl[:4] = 0.5, 0.0, 0.0, 0.5
        for _ in range(500):
            mujoco.mj_step(model, data)
        state.append(np.concatenate([data.qpos, data.qvel]))
    np.testing.assert_allclose(state[1], state[0], atol=1e-4)


def test_reset_and_keyframe_restore_the_initial_state_bit_for_bit(laden):
    full = mujoco.mjtState.mjSTATE_INTEGRATION
    fresh, reset, keyed = (mujoco.MjData(laden) for _ in range(3))
    for data in (reset, keyed):
        data.ctrl[:4] = 0.8, 0.0, 0.0, 2.0
        for _ in range(500):
            mujoco.mj_step(laden, data)
    mujoco.mj_resetData(laden, reset)
    mujoco.mj_resetDataKeyframe(laden, keyed, laden.key("home").id)
    for _ in range(300):
        states = []
        for data in (fresh, reset, keyed):
            state = np.empty(mujoco.mj_stateSize(laden, full))
            mujoco.mj_getState(laden, data, state, full)
            states.append(state)
            data.ctrl[:4] = 0.5, 0.0, 0.0, -1.0
            mujoco.mj_step(laden, data)
        np.testing.assert_array_equal(states[1], states[0])
        np.testing.assert_array_equal(states[2], states[0])


def test_controls_are_the_fields_of_the_vehicle_command(laden):
    names = [laden.actuator(i).name for i in range(laden.nactuator)]
    assert names == list(VehicleCommand.__dataclass_fields__)


@pytest.mark.parametrize("scene", ["truck.xml", "scene.xml"])
def test_scenes_step_with_noise_on_the_controls_without_a_warning(scene):
    model = mujoco.MjModel.from_xml_path(str(iits_mj.mjcf_path(scene)))
    data = mujoco.MjData(model)
    rng = np.random.default_rng(1)
    low, high = model.actuator_ctrlrange.T
    for _ in range(1500):
        data.ctrl[:] = rng.uniform(low, high)
        mujoco.mj_step(model, data)
    assert not data.warning.number.any()
    assert np.isfinite(data.qpos).all()


@pytest.mark.parametrize("timestep", [0.001, 0.002, 0.005])
def test_start_shift_steer_and_brake_leave_no_warning(timestep):
    truck = iits_mj.Truck.load(timestep=timestep, visuals=False)
    gears, speeds = set(), []

    def drive(seconds, **command):
        truck.command(**command)
        for _ in range(round(seconds / 0.5)):
            truck.step(round(0.5 / timestep))
            ego = truck.observe()
            gears.add(ego.gear)
            speeds.append(ego.speed)

    drive(12.0, accelerator_pedal=0.8)
    drive(3.0, steering_wheel_angle=1.5)
    drive(3.0, steering_wheel_angle=-1.5)
    drive(2.0, accelerator_pedal=0.0, steering_wheel_angle=0.0, engine_brake=1.0)
    drive(5.0, xbr_demand=-4.0, xbr_mode=2.0)
    drive(2.0, parking_brake=1.0)
    drive(
        5.0,
        parking_brake=0.0,
        xbr_demand=0.0,
        xbr_mode=0.0,
        transmission_mode=2.0,
        accelerator_pedal=0.4,
        engine_brake=0.0,
    )
    assert len(gears) > 3
    assert max(speeds) > 5.0
    assert speeds[-1] < -0.5
    assert not truck.data.warning.number.any()


@pytest.mark.parametrize("height", [1.3, 3.0])
def test_payload_lies_at_the_requested_height(height):
    truck = iits_mj.Truck.load(payload_height=height, visuals=False)
    model, data = truck.model, truck.data
    body, site = model.body("payload"), data.site("payload_cg")
    assert data.xipos[body.id][2] == pytest.approx(height, abs=1e-6)
    np.testing.assert_allclose(site.xpos, data.xipos[body.id], atol=1e-9)
    assert truck.parameters.last.payload.cg_height == height
    # On a level road the height does not matter: same loads, still in equilibrium.
    for _ in range(500):
        mujoco.mj_step(model, data)
    np.testing.assert_allclose(axle_loads(model, data), AXLE_LOADS_KN[36_000.0], rtol=0.005)
    assert np.abs(data.qvel).max() < 1e-6


def test_trailer_has_the_mass_center_and_inertia_of_the_mass_state():
    payload, height = 20_000.0, 2.6
    truck = iits_mj.Truck.load(payload, payload_height=height, visuals=False)
    model, data = truck.model, truck.data
    expected = laden_units(PARAMETERS, payload, height)[1]
    root = model.body("trailer").id
    parts = [i for i in range(model.nbody) if root in ancestors(model, i)]
    mass = model.body_mass[parts]
    center = mass @ data.xipos[parts] / mass.sum()
    kingpin = data.xpos[root]
    assert mass.sum() == pytest.approx(expected.mass)
    assert kingpin[0] - center[0] == pytest.approx(expected.cg_position, abs=1e-6)
    assert center[2] == pytest.approx(expected.cg_height, abs=1e-6)
    inertia = np.zeros((3, 3))
    for i in parts:
        axes = data.ximat[i].reshape(3, 3)
        arm = data.xipos[i] - center
        inertia += axes @ np.diag(model.body_inertia[i]) @ axes.T
        inertia += model.body_mass[i] * (arm @ arm * np.eye(3) - np.outer(arm, arm))
    np.testing.assert_allclose(np.diag(inertia), expected.inertia, rtol=1e-6)


def ancestors(model, body):
    found = {body}
    while body:
        body = int(model.body_parentid[body])
        found.add(body)
    return found
