import subprocess
import sys

import mujoco
import numpy as np
import pytest
from dm_control import composer, mjcf

from iits_mj.core.errors import InputError
from iits_mj.suite.entity import TruckEntity, truck_mjcf, use_options
from iits_mj.truck import COMMAND_FIELDS, Truck


class Drive(composer.Task):
    """Two trucks in one arena."""

    def __init__(self, visuals=False):
        self._arena = composer.Arena()
        self.trucks = tuple(
            TruckEntity(payload, visuals=visuals, name=name)
            for name, payload in (("laden", 36_000.0), ("empty", 0.0))
        )
        for number, truck in enumerate(self.trucks):
            self._arena.add_free_entity(truck).pos = (40.0 * number, 4.0 * number, 0.0)
            truck.observables.enable_all()
        use_options(self._arena.mjcf_model)
        self.control_timestep, self.physics_timestep = 0.1, 0.002

    @property
    def root_entity(self):
        return self._arena

    def get_reward(self, physics):
        return float(physics.bind(self.trucks[0].tractor).xpos[0])


@pytest.fixture(scope="module")
def drive():
    task = Drive()
    environment = composer.Environment(task, time_limit=10.0, legacy_step=False)
    yield environment
    environment.close()


def test_two_trucks_drive_in_one_arena(drive):
    drive.reset()
    action = np.zeros(drive.action_spec().shape)
    action[COMMAND_FIELDS.index("accelerator_pedal")] = 0.8
    for _ in range(40):
        step = drive.step(action)
    laden, empty = (drive.physics.bind(truck.tractor).xpos for truck in drive.task.trucks)
    assert laden[0] > 2.0
    assert empty[0] == pytest.approx(40.0, abs=0.01)
    assert step.observation["laden/velocity"][0, 0] > 1.0
    assert step.observation["empty/velocity"][0, 0] == pytest.approx(0.0, abs=0.01)


def test_an_attached_truck_drives_as_the_plain_one_does(drive):
    drive.reset()
    physics = drive.physics
    model, data = physics.model.ptr, physics.data.ptr
    mujoco.mj_resetData(model, data)
    plain = Truck.load(36_000.0, visuals=False)
    mujoco.mj_resetData(plain.model, plain.data)
    pedal = physics.bind(drive.task.trucks[0].actuators[0])
    pedal.ctrl = 0.6
    plain.data.ctrl[0] = 0.6
    mujoco.mj_step(model, data, 1_500)
    mujoco.mj_step(plain.model, plain.data, 1_500)
    mujoco.mj_forward(model, data)
    mujoco.mj_forward(plain.model, plain.data)
    attached = physics.bind(drive.task.trucks[0].tractor).xpos[0]
    assert attached > 1.0
    assert attached == pytest.approx(plain.data.body("tractor").xpos[0], abs=1e-6)


def test_visual_geoms_change_no_mass():
    bare, dressed = (
        mjcf.Physics.from_mjcf_model(truck_mjcf(20_000.0, visuals=seen)).model
        for seen in (False, True)
    )
    assert dressed.ngeom > bare.ngeom + 50
    # Bodies that only show something come last.
    np.testing.assert_array_equal(dressed.body_mass[: bare.nbody], bare.body_mass)
    np.testing.assert_array_equal(dressed.body_inertia[: bare.nbody], bare.body_inertia)
    assert dressed.body_mass.sum() == bare.body_mass.sum()


def test_a_wrong_payload_is_refused():
    with pytest.raises(InputError, match="payload"):
        TruckEntity(-1.0)


def test_dm_controls_viewer_runs_a_task():
    # In a separate process, because the viewer loads OpenGL for a display once per process.
    program = (
        "import numpy as np\n"
        "from dm_control.viewer import runtime\n"
        "from iits_mj import suite\n"
        "environment = suite.load('truck', 'cruise', {'random': 0, 'visuals': False})\n"
        "run = runtime.Runtime(environment, lambda _: np.array([0.5]))\n"
        "for _ in range(30):\n"
        "    run.tick(0.1, paused=False)\n"
        "assert environment.physics.time() > 1.0\n"
        "assert environment.physics.speed() > 0.0\n"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


def test_error_of_pictures_after_the_viewer_names_the_wrong_opengl(monkeypatch):
    program = (
        "import OpenGL.platform\n"
        "from iits_mj.render.context import make_context\n"
        "make_context(64, 64)\n"
    )
    monkeypatch.delenv("MUJOCO_GL", raising=False)
    monkeypatch.setenv("PYOPENGL_PLATFORM", "glx")
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    if done.returncode:
        assert "set MUJOCO_GL=egl before Python starts" in done.stderr
