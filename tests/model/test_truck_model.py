"""What a maintainer of a model collection would check of `mjcf/` and the builder."""

import re

import mujoco
import numpy as np
import pytest

import iits_mj
from iits_mj.assets import mjcf_dir
from iits_mj.errors import InputError
from iits_mj.mass_state import static_axle_loads
from iits_mj.messages import VehicleCommand
from iits_mj.model.builder import truck_spec
from iits_mj.model.export import model_files, readme_text
from iits_mj.parameters import TruckParameters

PARAMETERS = TruckParameters.load()
AXLE_LOADS_KN = {
    0.0: [50.6, 34.6, 34.6, 22.2, 22.2, 22.2],
    36_000.0: [60.7, 94.9, 94.9, 96.4, 96.4, 96.4],
}


def build(payload):
    iits_mj.plugin_library.register()
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


def test_shipped_files_are_what_the_builder_makes():
    for name, text in model_files().items():
        shipped = (mjcf_dir() / name).read_text(encoding="utf-8")
        assert shipped == text, f"{name} is stale: run `python -m iits_mj.model`"


def test_provenance_table_of_the_readme_is_current():
    text = (mjcf_dir() / "README.md").read_text(encoding="utf-8")
    assert text == readme_text(text), "run `python -m iits_mj.model`"
    assert "| engine.idle_speed | 62.83 | rad/s | R |" in text


@pytest.mark.parametrize("payload", sorted(AXLE_LOADS_KN))
def test_axle_loads_are_those_of_the_truck_and_stay_so(payload):
    model = build(payload)
    data = mujoco.MjData(model)
    for _ in range(1000):
        mujoco.mj_step(model, data)
    np.testing.assert_allclose(axle_loads(model, data), AXLE_LOADS_KN[payload], rtol=0.005)
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
    assert share[0] > share[1]  # the tare counts for less


@pytest.mark.parametrize("payload", [-1.0, 36_001.0, float("nan"), float("inf")])
def test_payload_out_of_range_is_refused(payload):
    with pytest.raises(InputError, match=r"payload .* use 0 to 36000 kg"):
        truck_spec(PARAMETERS, payload)


def test_every_element_is_named_in_snake_case(laden):
    kinds = {
        "body": laden.nbody,
        "joint": laden.njnt,
        "geom": laden.ngeom,
        "site": laden.nsite,
        "actuator": laden.nactuator,
        "sensor": laden.nsensor,
        "tendon": laden.ntendon,
    }
    for kind, count in kinds.items():
        for i in range(count):
            name = getattr(laden, kind)(i).name
            assert re.fullmatch(r"[a-z][a-z0-9_]*", name), f"{kind} {i} is named {name!r}"


def test_left_and_right_are_mirror_images(laden):
    counts = {"body": laden.nbody, "joint": laden.njnt, "geom": laden.ngeom, "site": laden.nsite}
    for kind in counts:
        names = [getattr(laden, kind)(i).name for i in range(counts[kind])]
        for name in names:
            if "left" in name.split("_"):
                twin = "_".join("right" if part == "left" else part for part in name.split("_"))
                assert twin in names, f"{kind} {name} has no twin {twin}"
                left, right = getattr(laden, kind)(name), getattr(laden, kind)(twin)
                if kind == "body":
                    np.testing.assert_allclose(left.pos * [1, -1, 1], right.pos, atol=1e-12)
                    np.testing.assert_allclose(left.mass, right.mass)


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


def test_energy_of_the_unpowered_truck_never_grows(laden):
    laden.opt.enableflags |= mujoco.mjtEnableBit.mjENBL_ENERGY
    data = mujoco.MjData(laden)
    data.ctrl[list(VehicleCommand.__dataclass_fields__).index("transmission_mode")] = 1
    data.qvel[0] = 15.0
    data.qvel[5] = 0.05
    energy = []
    for _ in range(2000):
        mujoco.mj_step(laden, data)
        energy.append(data.energy.sum())
    # Tires, springs of the linkage and bristles store a little; over 20 ms it must go down.
    coarse = np.array(energy)[::100]
    assert (np.diff(coarse[1:]) < 0).all()
