"""Cameras of the user's own: made, checked, and refused where their views cannot be drawn."""

import math

import mujoco
import pytest

from iits_mj.core.errors import InputError
from iits_mj.render.cameras import FollowCamera, cameras_of, make_camera
from tests.paths import ROOT


class Still:
    """A camera that does not move."""

    def __init__(self, distance=20.0, tunnels=()):
        self.camera, self.tunnels = mujoco.MjvCamera(), tunnels
        self.camera.distance = distance

    def follow(self, data, station):
        return self.camera


def test_an_own_camera_gets_what_it_asks_for_and_shares_the_picture(monkeypatch, data):
    monkeypatch.chdir(ROOT)
    made = make_camera(Still, ((1.0, 2.0),))
    assert made.follow(data).distance == 20.0
    assert made.tunnels == ((1.0, 2.0),)
    text = "examples/own_camera.py:Orbit:distance=9"
    assert cameras_of(f"chase, {text}") == ("chase", text)
    assert make_camera(text).follow(data, None).distance == 9.0
    assert isinstance(make_camera(lambda tunnels: FollowCamera("top", tunnels)), FollowCamera)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        (object, r"camera builtins:object lacks follow\(data, station\)"),
        ("examples/own_camera.py:Orbits", r"has no 'Orbits' \(did you mean Orbit\?\)"),
        ("chase,chas", r"camera 'chas' is not known \(did you mean chase\?\)"),
    ],
)
def test_a_camera_that_does_not_fit_is_refused(monkeypatch, given, message):
    monkeypatch.chdir(ROOT)
    with pytest.raises(InputError, match=message):
        cameras_of(given)


@pytest.fixture
def data():
    xml = '<mujoco><worldbody><body name="tractor" pos="5 6 1"/></worldbody></mujoco>'
    model = mujoco.MjModel.from_xml_string(xml)
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    return data


@pytest.mark.parametrize("distance", [math.nan, 0.0, -1.0])
def test_a_view_that_is_not_finite_is_refused(data, distance):
    with pytest.raises(InputError, match=r"camera .*:Still: follow returned lookat .* be finite"):
        make_camera(Still(distance)).follow(data)
    broken = Still()
    broken.camera = None
    with pytest.raises(InputError, match=r"follow returned None, must be a mujoco.MjvCamera"):
        make_camera(broken).follow(data)
