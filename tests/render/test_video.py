"""Videos, cameras and pictures; tests that need OpenGL are skipped without it."""

import math
import sys
from types import SimpleNamespace

import mujoco
import numpy as np
import pytest

from iits_mj.core.errors import InputError, RenderError
from iits_mj.core.messages import EgoState, PlanMode, Scene, Trajectory
from iits_mj.model.scenery.structures import TUNNEL_ROOF, WALL_GAP
from iits_mj.parameters import TruckParameters, check_truck, shipped_trucks
from iits_mj.render.cameras import CAMERAS, FollowCamera, camera_pose, cameras_of, tiles
from iits_mj.render.context import make_context
from iits_mj.render.lane_sketch import trajectory_boxes
from iits_mj.render.offscreen import Offscreen, check_size
from iits_mj.render.video import Mp4Encoder, VideoObserver
from iits_mj.road import RoadMap
from iits_mj.simulation import DriveConfig
from iits_mj.truck import Truck

SIZE = (160, 120)
XML = """
<mujoco>
  <visual><map zfar="300"/></visual>
  <worldbody>
    <light pos="0 0 20" dir="0 0 -1"/>
    <geom name="ground" type="plane" size="0 0 1" rgba="0.2 0.3 0.2 1" contype="0" conaffinity="0"/>
    <geom name="near" type="box" size="1 1 1" pos="20 6 1" rgba="1 0 0 1"/>
    <geom name="behind" type="box" size="1 1 1" pos="-300 0 1"/>
    <geom name="road_trunk_0" type="box" size="1 1 1" pos="2000 0 1"/>
    <body name="tractor"><freejoint/>
      <geom name="cab" type="box" size="1 1.2 1.5" pos="0 0 2" rgba="0.1 0.3 1 1"/>
      <body name="trailer" pos="-3.6 0 1.1">
        <joint name="yaw" axis="0 0 1"/><geom type="box" size="6 1.2 1.2" pos="-5 0 1.2"/>
      </body>
    </body>
  </worldbody>
</mujoco>
"""


@pytest.fixture
def scene():
    model = mujoco.MjModel.from_xml_string(XML)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    return model, data


@pytest.fixture(scope="module")
def truck():
    return Truck.load(route=RoadMap.builtin().route(), visuals=False)


def plan(mode=PlanMode.LANE_CHANGE, n=40):
    t = np.arange(n) * 0.1
    zero = np.zeros(n)
    return Trajectory(t, 15 * t, zero, 15 * t, zero, zero, zero, zero, zero + 15, zero, mode=mode)


@pytest.mark.parametrize("size", [(10, 10), (5000, 200), ("wide", 100), (float("nan"), 100), 7])
def test_bad_sizes_are_refused(size):
    with pytest.raises(InputError, match="size"):
        check_size(size)


def test_odd_sizes_are_made_even():
    assert check_size((161, 121)) == (160, 120)


def test_unknown_camera_is_refused_with_the_list():
    with pytest.raises(InputError, match=r"'drone'.*chase.*aerial"):
        FollowCamera("drone")
    with pytest.raises(InputError, match=r"'drone'.*chase.*aerial"):
        cameras_of("chase,drone")
    with pytest.raises(InputError, match="use 4 at most"):
        cameras_of("chase,chase,chase,chase,top")


@pytest.mark.parametrize("count", [1, 2, 3, 4])
def test_parts_of_a_shared_picture_are_equal_and_apart(count):
    covered = np.zeros((540, 960), int)
    parts = tiles((960, 540), count)
    for left, top, width, height in parts:
        covered[top : top + height, left : left + width] += 1
        assert (width, height) == parts[0][2:]
        assert width % 2 == 0 == height % 2
    assert covered.max() == 1
    assert covered.mean() >= 0.74


@pytest.mark.parametrize("name", CAMERAS)
def test_every_camera_turns_with_the_truck(scene, name):
    model, data = scene
    eye, forward = camera_pose(FollowCamera(name).follow(data))
    data.qpos[:3] = [100.0, -50.0, 8.0]
    data.qpos[3:7] = [math.cos(0.5), 0.0, 0.0, math.sin(0.5)]
    mujoco.mj_forward(model, data)
    moved, turned = camera_pose(FollowCamera(name).follow(data))
    rotation = data.body("tractor").xmat.reshape(3, 3)
    np.testing.assert_allclose(rotation @ eye + data.qpos[:3], moved, atol=1e-6)
    np.testing.assert_allclose(rotation @ forward, turned, atol=1e-6)


def test_camera_heading_follows_smoothly(scene):
    model, data = scene
    follower = FollowCamera("chase")
    before = follower.follow(data).azimuth
    data.time = 0.05
    data.qpos[3:7] = [math.cos(0.1), 0.0, 0.0, math.sin(0.1)]
    mujoco.mj_forward(model, data)
    after = follower.follow(data).azimuth
    expected = math.degrees(0.2) * (1.0 - math.exp(-0.05 / follower.view.time_constant))
    assert after - before == pytest.approx(expected, rel=1e-6)


@pytest.mark.parametrize("name", CAMERAS)
def test_every_camera_stays_below_a_tunnel_roof(scene, name):
    _, data = scene
    eye, _ = camera_pose(FollowCamera(name, ((0.0, 500.0),)).follow(data, 250.0))
    assert 0.5 < eye[2] < 6.8


LONG = TruckParameters.load(
    overlay={
        "units": {
            "rear": {"like": "trailer", "coupling": {"position": 11.0}},
            "last": {"like": "trailer", "coupling": {"position": 11.0}},
        }
    }
)
ALONE = TruckParameters.load(overlay={"remove": ["units.trailer"]})


@pytest.fixture
def long_scene():
    model = mujoco.MjModel.from_xml_string(
        XML.replace("trailer", "last").replace("-3.6 0 1.1", "-25.6 0 1.1")
    )
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    return data


def test_views_of_a_longer_truck_are_from_farther_away(scene, long_scene):
    _, data = scene
    for name in ("chase", "side", "front", "top"):
        near = FollowCamera(name).follow(data).distance
        far = FollowCamera(name, truck=LONG).follow(long_scene).distance
        assert far == pytest.approx(near * LONG.length / 16.5)
    assert FollowCamera("cab", truck=LONG).follow(long_scene).distance == 1.0


def test_camera_behind_a_long_truck_is_behind_its_rear(long_scene):
    eye, _ = camera_pose(FollowCamera("chase", truck=LONG).follow(long_scene))
    assert eye[0] < -LONG.rear - 5.0


def test_camera_of_the_trailer_shows_the_last_unit(long_scene):
    shown = FollowCamera("trailer", truck=LONG).follow(long_scene).lookat
    assert shown[0] == pytest.approx(-25.6 - 6.5)


def test_cameras_are_closer_to_a_truck_without_trailer(scene):
    _, data = scene
    shown = FollowCamera("chase", truck=ALONE).follow(data)
    assert 0.6 < shown.distance / FollowCamera("chase").follow(data).distance < 0.7


@pytest.mark.parametrize("name", shipped_trucks())
def test_camera_of_the_trailer_sees_the_rear_of_every_truck_from_the_same_place(scene, name):
    truck = check_truck(DriveConfig(truck=name))
    assert truck.last.name in ("tractor", "trailer")
    _, data = scene
    eye, _ = camera_pose(FollowCamera("trailer", truck=truck).follow(data))
    rear = truck.last.length - truck.last.front_overhang
    assert data.body(truck.last.name).xpos[0] - rear - eye[0] == pytest.approx(6.73, abs=0.01)


@pytest.mark.parametrize("name", CAMERAS)
def test_camera_of_a_long_truck_stays_below_a_tunnel_roof(long_scene, name):
    follower = FollowCamera(name, ((0.0, 500.0),), LONG)
    eye, _ = camera_pose(follower.follow(long_scene, 250.0))
    assert 0.5 < eye[2] < 6.8


@pytest.mark.parametrize("name", ["chase", "side", "front", "trailer"])
@pytest.mark.parametrize("lane", [0, 1])
def test_camera_in_the_tunnel_is_inside_the_tube(truck, name, lane):
    route = truck.route
    (start, end), *_ = route.tunnels
    for station in np.linspace(start + 40, end - 40, 5):
        truck.reset(station=station, offset=route.lane_offset(lane, station), speed=16.0)
        camera = FollowCamera(name, route.tunnels).follow(truck.data, station)
        position, _ = camera_pose(camera)
        along, offset = route.locate(position[0], position[1], station)
        right, left = route.surface_edges(along)
        assert right - WALL_GAP < offset < left + WALL_GAP
        height = position[2] - float(route.evaluate(along, offset).z)
        assert 0.5 < height < TUNNEL_ROOF


def test_video_has_the_size_and_number_of_its_pictures(tmp_path):
    import imageio_ffmpeg

    path = tmp_path / "film.mp4"
    with Mp4Encoder(path, SIZE, 20) as encoder:
        for i in range(6):
            encoder.add(np.full((120, 160, 3), 30 * i, dtype=np.uint8))
        assert not path.exists()
    reader = imageio_ffmpeg.read_frames(str(path))
    meta = next(reader)
    pictures = [np.frombuffer(p, dtype=np.uint8) for p in reader]
    assert meta["size"] == SIZE
    assert meta["codec"] == "h264"
    assert meta["pix_fmt"].startswith("yuv420p")
    assert len(pictures) == 6
    assert pictures[5].mean() == pytest.approx(150.0, abs=4.0)
    assert [p.name for p in tmp_path.iterdir()] == ["film.mp4"]


def test_failed_video_leaves_the_old_video_and_no_partial_file(tmp_path):
    path = tmp_path / "film.mp4"
    path.write_bytes(b"old")

    def fail():
        with Mp4Encoder(path, SIZE, 20) as encoder:
            encoder.add(np.zeros((120, 160, 3), dtype=np.uint8))
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        fail()
    assert path.read_bytes() == b"old"
    assert [p.name for p in tmp_path.iterdir()] == ["film.mp4"]


def test_missing_ffmpeg_is_named_and_leaves_nothing(tmp_path, monkeypatch):
    monkeypatch.setattr("imageio_ffmpeg._io.get_ffmpeg_exe", refuse)
    with pytest.raises(RenderError, match="ffmpeg does not start: No ffmpeg exe could be found"):
        Mp4Encoder(tmp_path / "film.mp4", SIZE, 20)
    assert list(tmp_path.iterdir()) == []


def refuse():
    raise RuntimeError("No ffmpeg exe could be found")


def test_wrong_picture_name_and_folder_are_refused(tmp_path):
    with pytest.raises(InputError, match=r"end in \.mp4"):
        Mp4Encoder(tmp_path / "film.avi", SIZE, 20)
    with pytest.raises(InputError, match="folder"):
        Mp4Encoder(tmp_path / "missing" / "film.mp4", SIZE, 20)
    with pytest.raises(InputError, match="fps"):
        Mp4Encoder(tmp_path / "film.mp4", SIZE, math.nan)
    with Mp4Encoder(tmp_path / "film.mp4", SIZE, 20) as encoder, pytest.raises(InputError):
        encoder.add(np.zeros((10, 10, 3), dtype=np.uint8))


def test_missing_opengl_is_named_with_its_packages(monkeypatch):
    monkeypatch.delenv("MUJOCO_GL", raising=False)
    monkeypatch.setitem(sys.modules, "mujoco.egl", None)
    with pytest.raises(RenderError, match="libegl1 libgl1-mesa-dri libopengl0"):
        make_context(16, 16)


def test_ribbon_begins_ahead_of_the_truck_and_takes_the_colour_of_the_mode():
    places, looks = trajectory_boxes(plan(PlanMode.EMERGENCY), 1.0)
    assert len(places) == len(looks) > 10
    assert places[0, 0, 3] == pytest.approx(15.0 + 2.2 + 1.0, abs=0.3)
    assert places[-1, 0, 3] == pytest.approx(15.0 * 3.9 - 1.0, abs=0.3)
    assert looks[0, 0] > 0.7 > 0.2 > looks[0, 1]
    # Boxes along x, 0.44 m wide, that become fainter with the distance.
    np.testing.assert_allclose(places[:, :, 1], np.tile([0.0, 0.22, 0.0], (len(places), 1)))
    assert (np.diff(looks[:, 3]) < 0.0).all()


def test_ribbon_of_a_short_trajectory_is_empty():
    places, looks = trajectory_boxes(plan(n=1), 0.0)
    assert places.shape == (0, 3, 4)
    assert looks.shape == (0, 7)


@pytest.mark.usefixtures("opengl")
def test_pictures_show_what_stands_beside_the_truck(scene):
    model, data = scene
    with Offscreen(model, SIZE) as view:
        view.update(data, FollowCamera("chase").follow(data))
        picture = view.draw()
    assert picture.shape == (120, 160, 3)
    red = (picture[..., 0] > 120) & (picture[..., 1] < 60)
    assert red.any()
    # The red box is to the left of the road.
    assert np.argwhere(red)[:, 1].mean() < 80


def mujocos_picture(model, data, camera):
    """MuJoCo's own picture, with the settings of `Offscreen`."""
    model.vis.quality.offsamples = 0
    context = make_context(*SIZE)
    try:
        target = mujoco.MjrContext(model, mujoco.mjtFontScale.mjFONTSCALE_100.value)
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN.value, target)
        seen = mujoco.MjvScene(model, maxgeom=100)
        for flag, value in (("REFLECTION", 0), ("FOG", 1), ("HAZE", 0)):
            seen.flags[getattr(mujoco.mjtRndFlag, f"mjRND_{flag}")] = value
        everything = mujoco.mjtCatBit.mjCAT_ALL.value
        mujoco.mjv_updateScene(
            model, data, mujoco.MjvOption(), mujoco.MjvPerturb(), camera, everything, seen
        )
        pixels, part = np.empty((SIZE[1], SIZE[0], 3), np.uint8), mujoco.MjrRect(0, 0, *SIZE)
        mujoco.mjr_render(part, seen, target)
        mujoco.mjr_readPixels(pixels, None, part, target)
        target.free()
    finally:
        context.free()
    return pixels[::-1]


SHAPES = """
<mujoco>
  <statistic extent="8" center="0 0 1"/>
  <visual>
    <map zfar="40" fogstart="1" fogend="30" shadowclip="2"/><quality shadowsize="2048"/>
    <headlight ambient="0.4 0.4 0.4" diffuse="0.1 0.1 0.1"/>
    <rgba fog="0.7 0.8 0.9 1"/>
  </visual>
  <asset>
    <texture name="sky" type="skybox" builtin="gradient" rgb1="0.3 0.5 0.8" rgb2="0.9 0.9 1"
      width="64" height="64"/>
    <texture name="check" type="2d" builtin="checker" rgb1="0.2 0.3 0.2" rgb2="0.4 0.5 0.4"
      width="64" height="64"/>
    <material name="ground" texture="check" texrepeat="0.5 0.5" texuniform="true"/>
    <material name="shiny" rgba="0.8 0.3 0.1 1" specular="0.9" shininess="0.8"/>
    <mesh name="wedge" vertex="0 0 0  2 0 0  0 2 0  0 0 2"/>
  </asset>
  <worldbody>
    <light type="directional" pos="2 -3 9" dir="-0.3 0.4 -1" diffuse="0.6 0.6 0.5"/>
    <geom name="ground" type="plane" size="0 0 1" material="ground"/>
    <geom name="box" type="box" size="0.5 0.8 1" pos="0 -3 1" euler="0 0 20" rgba="0.2 0.4 0.9 1"/>
    <geom name="ball" type="sphere" size="0.8" pos="0 3 0.8" material="shiny"/>
    <geom name="egg" type="ellipsoid" size="0.4 0.6 1" pos="2 1.2 1" material="shiny"/>
    <geom name="can" type="cylinder" size="0.5 0.8" pos="3 -1 0.8" euler="0 30 0"/>
    <geom name="pill" type="capsule" size="0.3 0.7" pos="-1 -0.6 1" rgba="0.9 0.8 0.2 1"/>
    <geom name="wedge" type="mesh" mesh="wedge" pos="4 3 0" rgba="0.7 0.7 0.7 1"/>
    <geom name="pane" type="box" size="0.02 1 1" pos="-2 1.5 1" rgba="0.2 0.9 0.9 0.4"/>
  </worldbody>
</mujoco>
"""


@pytest.mark.usefixtures("opengl")
@pytest.mark.parametrize(("azimuth", "elevation"), [(0.0, -15.0), (130.0, -30.0), (250.0, 5.0)])
def test_pictures_look_like_mujocos(azimuth, elevation):
    model = mujoco.MjModel.from_xml_string(SHAPES)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    camera = mujoco.MjvCamera()
    camera.azimuth, camera.elevation, camera.distance = azimuth, elevation, 9.0
    camera.lookat[:] = [0.5, 0.0, 1.2]
    with Offscreen(model, SIZE) as view:
        view.update(data, camera)
        picture = view.draw()
    difference = np.abs(picture.astype(int) - mujocos_picture(model, data, camera)).max(axis=-1)
    # Only edges of bodies and shadows differ by more than rounding.
    assert np.mean(difference > 8) < 0.04
    assert np.median(difference) <= 2


@pytest.mark.usefixtures("opengl")
def test_video_shows_a_moving_model(scene, tmp_path):
    model, data = scene
    path = tmp_path / "film.mp4"
    route = SimpleNamespace(tunnels=())
    truck = SimpleNamespace(model=model, data=data, route=route, parameters=None)
    ego = EgoState()
    frame = SimpleNamespace(time=0.0, trajectory=plan(), ego=ego, scene=Scene(0.0, ego))
    with VideoObserver(path, truck, (161, 121), "side", 10, overlay=False) as video:
        for i in range(3):
            data.time = 0.1 * i
            data.qpos[0] = 2.0 * i
            mujoco.mj_forward(model, data)
            video.observe(None, frame)
        assert video.frames == 3
    assert path.stat().st_size > 500
