"""Pictures in every weather: light, lamps, air, and instruments that leave the truck free."""

from __future__ import annotations

import math

import mujoco
import numpy as np
import pytest

from iits_mj.core.errors import InputError
from iits_mj.model.visuals.shapes import VISUAL_GROUP
from iits_mj.parameters import shipped_trucks
from iits_mj.render.cameras import FollowCamera, camera_pose
from iits_mj.render.lamps import BLINK, Lamps, Signals
from iits_mj.render.offscreen import Offscreen
from iits_mj.render.overlay import Overlay
from iits_mj.render.video import Pictures
from iits_mj.render.weather import WEATHERS
from iits_mj.simulation import DriveConfig
from iits_mj.simulation.drive_log import stored_options
from iits_mj.truck import Truck
from tests.render.scenes import road, standing, vehicle

pytestmark = pytest.mark.usefixtures("opengl")

SIZE = (480, 270)
TUNNEL = 1300.0  # [m], station inside the tunnel of the built-in highway
OPEN = 700.0


def shown(drive, weather="day", camera="chase", times=(0.0,), size=SIZE):
    """Pictures without instruments and plan, as floats of 0 to 255."""
    with Pictures(drive.truck, size, camera, weather, overlay=False, plan=False) as pictures:
        return [pictures.draw(drive.data, drive.at(time)).astype(float) for time in times]


def pixels(points, camera, size=SIZE):
    """Column and row of points in a picture; of points ahead of the camera."""
    eye, forward = camera_pose(camera)
    azimuth = math.radians(camera.azimuth)
    right = np.array([math.sin(azimuth), -math.cos(azimuth), 0.0])
    seen = (points - eye) @ np.stack([right, np.cross(forward, right), forward]).T
    scale = 0.5 * size[1] / math.tan(math.radians(22.5))
    assert (seen[:, 2] > 0.0).all()
    return 0.5 * np.array(size) + scale * seen[:, :2] / seen[:, 2:]


def corners(drive, body):
    """Corners of the box around a body's visual geoms, in the map."""
    model, data = drive.truck.model, drive.data
    found = []
    for geom in np.flatnonzero((model.geom_bodyid == body) & (model.geom_group == VISUAL_GROUP)):
        middle, half = model.geom_aabb[geom, :3], model.geom_aabb[geom, 3:]
        for signs in np.ndindex(2, 2, 2):
            local = middle + half * (2.0 * np.array(signs) - 1.0)
            found.append(data.geom_xpos[geom] + data.geom_xmat[geom].reshape(3, 3) @ local)
    return np.array(found)


def rear_box(drive, camera="chase", size=SIZE):
    """Left, top, right and bottom of the last unit in a picture."""
    view = FollowCamera(camera, road().tunnels, drive.truck.parameters)
    frame = drive.at(0.0)
    place = view.follow(drive.data, frame.ego.station)
    body = drive.truck.model.body(f"{drive.truck.parameters.last.name}_visuals").id
    at = pixels(corners(drive, body), place, size)
    return (*at.min(axis=0), *at.max(axis=0))


def red(picture):
    """How much more red than green there is."""
    return np.clip(picture[..., 0] - 1.6 * picture[..., 1] - 20.0, 0.0, None).sum()


@pytest.fixture(scope="module")
def open_road():
    return standing(OPEN, vehicles=[vehicle(OPEN + 60.0, 1, speed=15.0)])


@pytest.fixture(scope="module")
def in_tunnel():
    return standing(TUNNEL)


def test_unknown_weather_is_refused_with_the_list():
    model = mujoco.MjModel.from_xml_string("<mujoco/>")
    with pytest.raises(InputError, match=r"'hail'.*day.*night"):
        Offscreen(model, SIZE, "hail")


def test_edges_are_smooth():
    """Along a slanted edge, pixels lie between both colors."""
    model = mujoco.MjModel.from_xml_string(
        """<mujoco><visual><headlight ambient="0.8 0.8 0.8" diffuse="0 0 0" specular="0 0 0"/>
        </visual><worldbody><light type="directional" dir="0 0 -1" diffuse="0 0 0"/>
        <geom type="box" size="0.01 3 3" pos="5 -3 -3" euler="17 0 0" rgba="1 1 1 1"/>
        </worldbody></mujoco>"""
    )
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    camera = mujoco.MjvCamera()
    camera.distance, camera.azimuth, camera.elevation = 1.0, 0.0, 0.0
    share = {}
    for weather in (None, "day"):
        with Offscreen(model, SIZE, weather) as view:
            view.update(data, camera)
            light = view.draw()[..., 1].astype(float)
        low, high = light.min(), light.max()
        assert high - low > 30.0
        between = (light > low + 0.15 * (high - low)) & (light < high - 0.15 * (high - low))
        share[weather] = np.count_nonzero(between)
    assert share[None] < 0.1 * share["day"]
    assert share["day"] > 0.5 * SIZE[1]


def test_weather_is_no_option_of_the_drive():
    assert not {"weather", "camera"} & set(stored_options(DriveConfig()))


@pytest.mark.parametrize("weather", WEATHERS)
def test_tunnel_is_lit_and_the_truck_stands_out_in_it(in_tunnel, weather):
    (picture,) = shown(in_tunnel, weather)
    light = picture.mean(axis=-1)
    assert light.mean() > 70.0
    assert np.mean(light < 30.0) < 0.1
    left, top, right, bottom = (round(v) for v in rear_box(in_tunnel))
    rear = light[top + 8 : bottom - 40, left + 8 : right - 8]
    around = light[top + 8 : bottom - 40, max(left - 60, 0) : left - 8]
    assert abs(np.median(rear) - np.median(around)) > 8.0
    assert np.median(rear) > 80.0


def test_white_roof_is_not_clipped(open_road):
    (picture,) = shown(open_road, camera="top")
    bright = picture.min(axis=-1)
    assert bright.max() > 200.0
    assert bright.max() < 252.0


def test_night_is_dark_but_for_the_road_in_the_head_lamps(open_road):
    day, night = (shown(open_road, weather, "cab")[0].mean(axis=-1) for weather in ("day", "night"))
    assert night.mean() < 0.5 * day.mean()
    height, width = night.shape
    ahead = night[int(0.6 * height) :, int(0.35 * width) : int(0.65 * width)].mean()
    beside = night[int(0.6 * height) :, : int(0.1 * width)].mean()
    assert ahead > 2.0 * beside
    assert ahead > 60.0


def test_low_sun_casts_longer_shadows():
    height = {name: math.sin(math.radians(weather.sun[0])) for name, weather in WEATHERS.items()}
    assert height["low-sun"] < 0.25 < height["day"]
    np.testing.assert_allclose(WEATHERS["low-sun"].to_sun[2], height["low-sun"])


def test_rain_and_fog_take_contrast_in_the_distance(open_road):
    band = slice(int(0.20 * SIZE[1]), int(0.30 * SIZE[1]))
    contrast = {
        weather: shown(open_road, weather, "aerial")[0][band].std()
        for weather in ("day", "rain", "fog")
    }
    assert contrast["rain"] < 0.8 * contrast["day"]
    assert contrast["fog"] < 0.5 * contrast["rain"]


def test_visibility_is_where_five_percent_of_the_contrast_remain():
    weather = WEATHERS["fog"]
    assert math.exp(-weather.mist * weather.visibility) == pytest.approx(0.05)
    assert WEATHERS["day"].mist == 0.0


@pytest.fixture(scope="module")
def braking():
    """A drive of 4 s that brakes from 2 s on."""
    return standing(OPEN, brake_pressures=lambda time: (0.0 if time < 2.0 else 200e3,) * 5)


@pytest.mark.parametrize("weather", WEATHERS)
def test_brake_lamps_are_red_only_while_braking(braking, weather):
    with Pictures(braking.truck, SIZE, "chase", weather, overlay=False, plan=False) as pictures:

        def picture(time):
            frame = braking.at(time)
            braking.data.time = 0.0  # the rain falls as at that time
            return pictures.draw(braking.data, frame).astype(float)

        dark, lit = picture(1.0), picture(3.0)
    left, _, right, bottom = (round(v) for v in rear_box(braking))
    low = slice(bottom - 20, min(bottom + 12, SIZE[1]))
    parts = [red(p[low, left - 4 : right + 4]) for p in (dark, lit)]
    assert parts[1] > 1.12 * parts[0]
    elsewhere = np.abs(lit - dark)[: int(0.3 * SIZE[1])].max()
    assert elsewhere < 3.0


@pytest.mark.parametrize(("to", "side"), [(1, "left"), (0, "right")])
def test_indicator_blinks_at_its_frequency_on_the_side_of_the_change(to, side):
    # In the tunnel the camera is straight behind.
    drive = standing(TUNNEL, 1 - to, to=to)
    times = np.arange(0.0, 2.0, 0.05)
    pictures = np.array(shown(drive, times=times))
    left, _, right, bottom = (round(v) for v in rear_box(drive))
    low = slice(bottom - 20, min(bottom + 12, SIZE[1]))
    middle = (left + right) // 2
    sides = {"left": slice(left - 4, middle), "right": slice(middle, right + 4)}
    bright = {name: pictures[:, low, part].sum(axis=(1, 2, 3)) for name, part in sides.items()}
    other = "right" if side == "left" else "left"
    assert np.ptp(bright[side]) > 4.0 * np.ptp(bright[other])
    on = bright[side] > 0.5 * (bright[side].max() + bright[side].min())
    assert np.count_nonzero(np.diff(on.astype(int)) == 1) + on[0] == round(2.0 * BLINK)


def test_traffic_shows_braking_and_lane_changes():
    def signals(**values):
        drive = standing(OPEN, vehicles=[vehicle(OPEN + 40.0, 1, speed=15.0, **values)])
        frame = drive.at(0.0)
        lamps = Lamps(drive.truck.model)
        body = [
            body
            for body in np.unique(lamps.owner)
            if drive.truck.model.body(body).name.startswith("traffic")
            and np.linalg.norm(drive.data.xpos[body] - drive.data.body("tractor").xpos) < 60.0
        ]
        assert len(body) == 1
        return lamps.signals(drive.data, frame)[int(body[0])]

    assert signals() == Signals(speed=15.0)
    assert signals(acceleration=-2.0).brake
    assert signals(lateral_speed=0.6).left
    assert signals(lateral_speed=-0.6).right


def test_split_screen_shows_both_cameras(open_road):
    (both,) = shown(open_road, camera="chase,top")
    half = (SIZE[0] // 2, SIZE[1] // 2 * 2)
    for i, camera in enumerate(("chase", "top")):
        (alone,) = shown(open_road, camera=camera, size=half)
        part = both[: half[1] - 1, i * half[0] : (i + 1) * half[0] - 1]
        np.testing.assert_allclose(part, alone[:-1, :-1], atol=2.0)


@pytest.mark.parametrize("name", [n for n in shipped_trucks() if n != "vecto_tractor"])
@pytest.mark.parametrize(
    ("station", "camera"),
    [(OPEN, "chase"), (OPEN, "side"), (OPEN, "front"), (TUNNEL, "chase"), (TUNNEL, "front")],
)
def test_instruments_do_not_cover_the_trailer(name, station, camera):
    drive = standing(station, truck=name)
    size = (960, 540)
    left, top, right, bottom = rear_box(drive, camera, size)
    for x, y, width, height in Overlay(size, road()).boxes:
        apart = x + width <= left or x >= right or y + height <= top or y >= bottom
        assert apart, (x, y, width, height)


@pytest.mark.parametrize("name", shipped_trucks())
def test_lamps_sit_on_the_bodies_of_every_truck(name):
    truck = Truck.load(truck=name)
    lamps, data = Lamps(truck.model), truck.data
    places = np.empty((truck.model.ngeom, 3, 4))
    places[:, :, :3] = data.geom_xmat.reshape(-1, 3, 3)
    places[:, :, 3] = data.geom_xpos
    lights = lamps.lights(places, np.ones(len(lamps.geom)))
    p = truck.parameters
    rear = data.body("tractor").xpos[0] - p.length + p.lead.front_overhang
    # Head lamps ahead of the steer axle, tail lamps at the ends of units, all left and right.
    assert {0, 1, 3, 4} <= set(lights.kind.tolist())
    forward = lights.at[lights.kind == 0]
    assert (forward[:, 0] > data.body("tractor").xpos[0]).all()
    assert lights.at[lights.kind == 1][:, 0].min() == pytest.approx(rear, abs=0.35)
    assert (lights.at[lights.kind == 3][:, 1] > 0.3).all()
    assert (lights.at[lights.kind == 4][:, 1] < -0.3).all()
    assert (np.abs(lights.at[:, 1]) < 1.35).all()
    assert ((lights.at[:, 2] > 0.3) & (lights.at[:, 2] < 4.3)).all()
    np.testing.assert_allclose(lights.forward[:, 0], 1.0, atol=0.01)


def test_head_lamps_burn_in_a_tunnel_by_day(in_tunnel, open_road):
    for drive, on in ((in_tunnel, True), (open_road, False)):
        with Offscreen(drive.truck.model, SIZE, "day") as view:
            frame = drive.at(0.0)
            camera = FollowCamera("front", road().tunnels, drive.truck.parameters)
            view.update(drive.data, camera.follow(drive.data, frame.ego.station))
            view.draw()
            lamps = view.lamps
            geoms = lamps.geom[(lamps.function == 0) & (lamps.owner == lamps.owner[0])]
            assert (view._looks[geoms, 4] > 1.0).all() == on


def test_rain_falls(open_road):
    first, second = shown(open_road, "rain", times=(0.0, 0.1))
    assert np.mean(np.abs(first - second).max(axis=-1) > 6.0) > 0.002


def test_wet_road_is_darker_than_a_dry_one(open_road):
    share = {}
    for weather in ("day", "rain"):
        (picture,) = shown(open_road, weather, "top")
        ahead = picture[: SIZE[1] // 4].mean(axis=-1)
        middle, side = SIZE[0] // 2, SIZE[0] // 6
        share[weather] = np.median(ahead[:, middle : middle + 20]) / np.median(ahead[:, :side])
    assert share["rain"] < 0.9 * share["day"]


def test_wet_road_mirrors_brake_lamps():
    def vehicles(time):
        return [vehicle(OPEN + 40.0, 1, speed=15.0, acceleration=-3.0 if time < 2.0 else 0.0)]

    drive = standing(OPEN, vehicles=vehicles)
    frame = drive.at(0.0)
    leader = frame.scene.vehicles[0]
    camera = FollowCamera("chase", road().tunnels, drive.truck.parameters)
    place = camera.follow(drive.data, frame.ego.station)
    point = road().evaluate(OPEN + np.array([30.0, 36.0]), np.full(2, leader.offset))
    at = pixels(np.stack([np.asarray(v) for v in (point.x, point.y, point.z)], -1), place)
    (left, right), (top, bottom) = (np.sort(at[:, i]).astype(int) for i in (0, 1))

    def gain(weather):
        lit, dark = shown(drive, weather, times=(1.0, 3.0))
        return (lit - dark)[top : bottom + 1, left - 6 : right + 7, 0].sum()

    assert gain("rain") > 2.0 * max(gain("day"), 1.0)
