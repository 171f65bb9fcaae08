"""Pictures of a model without a window (EGL), and checks for the viewer's window."""

from __future__ import annotations

import dataclasses
import math
import os
import platform
import sys
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from iits_mj.core.checks import one_of
from iits_mj.core.context import Closing
from iits_mj.core.errors import InputError, RenderError
from iits_mj.render.geometry import CELLS, Geometry, plane_repeat, turn_of
from iits_mj.render.lamps import Lamps, Signals, beams, glints, glow
from iits_mj.render.shade import Shades
from iits_mj.render.shaders import BEAMS_MAX, GLINTS_MAX
from iits_mj.render.spots import COLUMNS, rain
from iits_mj.render.weather import WEATHERS, Weather


def check_display() -> None:
    """Checks that a window can be shown.

    Raises:
      RenderError: there is no display.
    """
    shown = os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")
    if platform.system() == "Linux" and not shown:
        raise RenderError(
            "there is no display for the viewer (DISPLAY and WAYLAND_DISPLAY are not set); "
            "watch in a browser with 'iits-mj view --web', or make a video with 'iits-mj drive'"
        )


def follow(window: Any, model: mujoco.MjModel, prefix: str = "") -> None:
    """Makes a viewer's camera follow the center of mass of the truck with this prefix."""
    window.cam.type = mujoco.mjtCamera.mjCAMERA_TRACKING
    window.cam.trackbodyid = model.body(f"{prefix}tractor").id
    window.cam.distance, window.cam.elevation = 28.0, -18.0
    window.cam.azimuth = 180.0


Boxes = tuple[NDArray[np.float64], NDArray[np.float32]]
"""Half-sizes times axes as columns, and center, (n, 3, 4); color with alpha, emission, specular and
shininess from 0 to 128, (n, 7)."""
Vectors = tuple[NDArray[np.float64], ...]
VERSION = (4, 3)  # of OpenGL
PACKAGES = "libegl1 libgl1-mesa-dri libopengl0"
SIZE_MIN, SIZE_MAX = 64, 4096
# Static geoms beyond these distances [m] are not drawn.
DRAW_DISTANCE = {"fine": 900.0, "coarse": 4000.0}
_DEFAULT_COLOR = (0.5, 0.5, 0.5, 1.0)
_FINE = ("steel", "post", "reflector", "trunk", "conifer", "leaves", "gravel", "marking")
# The sky is this share of the largest distance away, as in MuJoCo, and hides what is beyond.
SKY = 0.7
_LAST_GROUP = 2
# Geoms with a smaller alpha are blended.
_OPAQUE = 0.995
# A coarser form is drawn where its cubes are smaller than a pixel by this factor.
_CELL_PIXELS = 0.7
# Light of a tunnel's lamps from above, and from the road; distances from the lamps within which a
# body is in it [m].
_TUNNEL_ABOVE, _TUNNEL_BELOW = (0.80, 0.77, 0.68), (0.44, 0.42, 0.38)
_TUNNEL_NEAR, _TUNNEL_FAR = 11.0, 24.0
_TUNNEL, _TUNNEL_LIGHT = "tunnel", 1.25
# Answer to head lamps by a part of the geom's name: paint and reflectors return much of the light.
_ANSWER = {"marking": 2.2, "reflector": 9.0, "post": 2.5, "sign": 4.0, "steel": 1.6}
_MEADOW = math.pi  # patches of grass over the texture's coordinates
_KNEE = 0.68
_ROD = 0.03  # [m], half the thickness of what casts no shadow


def check_size(size: tuple[int, int]) -> tuple[int, int]:
    """Returns width and height rounded down to even numbers, as the video format requires.

    Raises:
      InputError: not two whole numbers between 64 and 4096.
    """
    try:
        width, height = (int(value) for value in size)
    except (TypeError, ValueError):
        raise InputError(f"size {size!r} is not allowed: use two numbers, as (960, 540)") from None
    for value in (width, height):
        if not SIZE_MIN <= value <= SIZE_MAX:
            raise InputError(
                f"size {width}x{height} is not allowed: use {SIZE_MIN} to {SIZE_MAX} for each side"
            )
    return width - width % 2, height - height % 2


def make_context(width: int, height: int) -> Any:
    """Returns a new OpenGL context, by EGL unless the variable MUJOCO_GL names another backend.

    Raises:
      RenderError: OpenGL is too old, or missing; the message has the Debian packages with it.
    """
    wanted = os.environ.get("MUJOCO_GL", "").lower().strip()
    if wanted in ("disable", "disabled", "off", "false", "0"):
        raise RenderError(f"MUJOCO_GL={wanted} switches pictures off; set MUJOCO_GL=egl")
    try:
        if wanted == "osmesa":
            from mujoco.osmesa import GLContext
        else:
            from mujoco.egl import GLContext
        context = GLContext(width, height)
        context.make_current()
        # PyOpenGL must not be loaded before the context has chosen its platform.
        from OpenGL import GL

        version = tuple(
            int(GL.glGetIntegerv(n)) for n in (GL.GL_MAJOR_VERSION, GL.GL_MINOR_VERSION)
        )
    # PyOpenGL raises errors of many types: AttributeError on None, ImportError, GLError.
    except Exception as error:
        remedy = f"on Debian or Ubuntu: apt-get install {PACKAGES}"
        if wanted != "osmesa" and _for_a_display():
            remedy = (
                "another module has loaded OpenGL for a display in this process; set "
                "MUJOCO_GL=egl before Python starts"
            )
        raise RenderError(
            f"no offscreen OpenGL ({type(error).__name__}: {error}); {remedy}"
        ) from error
    if version < VERSION:
        context.free()
        raise RenderError(f"OpenGL {version[0]}.{version[1]} is too old: 4.3 is needed")
    return context


def _for_a_display() -> bool:
    """Returns whether PyOpenGL was loaded for another platform than EGL."""
    platform = sys.modules.get("OpenGL.platform")
    chosen = getattr(platform, "PLATFORM", None)
    return chosen is not None and "egl" not in type(chosen).__name__.lower()


class Offscreen(Closing):
    """Draws a model's data into arrays of pixels.

    Without a weather it looks as MuJoCo's renderer with the shadows of one directional light, fog
    and a sky, without reflections and antialiasing. A weather has its own light, sky and air, and
    lamps, a lit tunnel and smooth edges. Geoms of the groups 0 to 2 are drawn; height fields,
    flexes, skins and sites are not.

    Args:
      model: to draw.
      size: width and height in pixels, rounded down to even numbers.
      weather: one of `iits_mj.render.weather.WEATHERS`.

    Raises:
      InputError: the size is out of range, or the weather unknown. RenderError: OpenGL is missing.
    """

    def __init__(
        self, model: mujoco.MjModel, size: tuple[int, int], weather: str | None = None
    ) -> None:
        self.width, self.height = check_size(size)
        self._weather: Weather | None = None
        if weather is not None:
            self._weather = WEATHERS[one_of("weather", weather, tuple(WEATHERS))]
        self._model = model
        self._gl: Any = make_context(self.width, self.height)
        try:
            from iits_mj.render.painter import Painter

            self._geometry = Geometry.of(model)
            self._prepare()
            self._painter = Painter(
                model,
                self._geometry,
                (self.width, self.height),
                _lighting(model, self._sun, self._weather),
            )
        except BaseException:
            self.close()
            raise

    def _prepare(self) -> None:
        model, geometry = self._model, self._geometry
        suns = model.light_active & model.light_castshadow
        suns &= model.light_type == mujoco.mjtLightType.mjLIGHT_DIRECTIONAL
        self._sun = int(np.flatnonzero(suns)[0]) if suns.any() else None
        self._looks = _looks(model)
        part = geometry.geom[:-1]
        self._box = len(part)
        self._texture = _textures(model)[part]
        self._part = part
        alpha = self._looks[part, 3]
        drawn = (model.geom_group[part] <= _LAST_GROUP) & (alpha > 0.0)
        self._opaque = drawn & (alpha >= _OPAQUE)
        self._transparent = drawn & ~self._opaque
        # What has a texture is ground; rods and hoses are thinner than a pixel of the shadow map.
        thick = np.sort(model.geom_aabb[part, 3:], axis=1)[:, 1] > _ROD
        self._casting = drawn & (self._texture < 0) & thick
        names = [model.geom(i).name for i in range(model.ngeom)]
        self._time = 0.0
        self._signals: dict[int, Signals] = {}
        # Time and place of the eye in the last picture of each camera.
        self._eyes: dict[int, tuple[float, NDArray[np.float64]]] = {}
        self._velocity = np.zeros(3)
        self._covered = False  # whether the eye is in a tunnel
        if self._weather is not None:
            self._lamps, self._shades = Lamps(model), Shades(model)
            self._prepare_answers(names)
        static = model.geom_bodyid == 0
        fine = np.array([any(word in name for word in _FINE) for name in names], bool)
        reach = np.where(fine, DRAW_DISTANCE["fine"], DRAW_DISTANCE["coarse"])
        self._reach = np.where(static, reach + model.geom_rbound, np.inf)
        # An infinite plane moves with the camera by whole tiles of its texture.
        self._planes = [
            (int(i), 2.0 / plane_repeat(model, int(i)))
            for i in np.flatnonzero(model.geom_type == mujoco.mjtGeom.mjGEOM_PLANE)
            if (model.geom_size[i, :2] <= 0.0).all()
        ]

    def _prepare_answers(self, names: list[str]) -> None:
        """Sets which geoms are in tunnels, and how geoms answer to head lamps."""
        model = self._model
        for geom, name in enumerate(names):
            if _TUNNEL in name and "concrete" not in name:
                self._looks[geom, 4], self._looks[geom, 7] = _TUNNEL_LIGHT, 2.0
            for part, answer in _ANSWER.items():
                if name.startswith("road_") and part in name:
                    self._looks[geom, 8] = answer
        self._moving = np.flatnonzero(model.body_weldid[model.geom_bodyid] != 0)
        mocap = model.body_mocapid[model.body_rootid[model.geom_bodyid]] >= 0
        self._moving = np.union1d(self._moving, np.flatnonzero(mocap))
        lamps = [i for i, name in enumerate(names) if name.startswith("road_tunnel_light")]
        places = [np.empty((0, 3))]
        for geom in lamps:
            mesh = model.geom_dataid[geom]
            first, count = model.mesh_vertadr[mesh], model.mesh_vertnum[mesh]
            points = model.mesh_vert[first : first + count] @ turn_of(model, geom).T
            places.append(points[::2] + model.geom_pos[geom])
        self._tunnel_lamps = np.concatenate(places)

    def signal(self, signals: dict[int, Signals]) -> None:
        """Sets what vehicles show from now on, by the root of their bodies."""
        self._signals = signals

    @property
    def lamps(self) -> Lamps | None:
        """The lamps of the model; None without a weather."""
        return None if self._weather is None else self._lamps

    def update(self, data: mujoco.MjData, camera: mujoco.MjvCamera) -> None:
        """Takes the state of `data`, seen by the free camera `camera`; removes added boxes."""
        model, geometry = self._model, self._geometry
        eye, forward = camera_pose(camera)
        azimuth = math.radians(camera.azimuth)
        right = np.array([math.sin(azimuth), -math.cos(azimuth), 0.0])
        self._eye, self._axes = eye, np.stack([right, np.cross(right, forward), forward])
        places = self._places = np.empty((model.ngeom, 3, 4))
        places[:, :, :3] = data.geom_xmat.reshape(-1, 3, 3)
        places[:, :, 3] = data.geom_xpos - eye
        for geom, tile in self._planes:
            across = -places[geom, :, 3] @ places[geom, :, :2]
            places[geom, :, 3] += places[geom, :, :2] @ (np.round(across / tile) * tile)
        part = self._part
        self._center = places[part, :, 3] + np.einsum(
            "ijk,ik->ij", places[part, :, :3], geometry.center[:-1]
        )
        self._light, self._to_sun = np.eye(4), np.zeros(3)
        if self._sun is not None:
            self._to_sun, center = -data.light_xdir[self._sun], data.light_xpos[self._sun]
            if self._weather is not None:
                self._to_sun = self._weather.to_sun
                center = data.xpos[model.light_bodyid[self._sun]]
            self._light = self._sun_view(center, eye)
        self._time = float(data.time)
        if self._weather is not None:
            self._update_weather(data, id(camera))
        self._boxes: Boxes = (np.empty((0, 3, 4)), np.empty((0, 9), np.float32))

    def _update_weather(self, data: mujoco.MjData, camera: int) -> None:
        eye = self._eye
        last = self._eyes.get(camera)
        self._eyes[camera] = (self._time, eye)
        if last is not None and 0.0 < self._time - last[0] < 0.5:
            self._velocity = (eye - last[1]) / (self._time - last[0])
        at = data.geom_xpos[self._moving]
        self._looks[self._moving, 7] = 0.0
        near = self._tunnel_lamps
        if len(near):
            near = near[np.abs(near - eye).max(axis=1) < 400.0]
        self._covered = bool((np.linalg.norm(near - eye, axis=1) < _TUNNEL_NEAR).any())
        if len(near):
            apart = np.full(len(at), np.inf)
            close = np.abs(at - eye).max(axis=1) < 450.0
            reach = np.linalg.norm(at[close, None] - near[None, ::2], axis=2)
            apart[close] = reach.min(axis=1)
            share = (_TUNNEL_FAR - apart) / (_TUNNEL_FAR - _TUNNEL_NEAR)
            self._looks[self._moving, 7] = np.clip(share, 0.0, 1.0)
        self._shades.update(data)

    def add_boxes(self, boxes: Boxes) -> None:
        """Adds boxes without shadows to the next picture."""
        places, own = boxes
        looks = np.concatenate([own, np.zeros((len(own), 2), np.float32)], axis=1)
        relative = places.copy()
        relative[:, :, 3] -= self._eye
        self._boxes = (relative, looks)

    def draw(self) -> NDArray[np.uint8]:
        """Returns a new array of pixels (height, width, 3), top row first."""
        from iits_mj.render.painter import Shot

        self._gl.make_current()
        model, radius = self._model, self._geometry.radius[:-1]
        distance = np.sqrt(np.einsum("ij,ij->i", self._center, self._center))
        near, far = self._range()
        slope = math.tan(math.radians(0.5 * model.vis.global_.fovy))
        half = np.array([slope * self.width / self.height, slope])
        seen = self._center @ self._axes.T
        # A part is outside when its sphere is beyond one of the five nearest sides of the view.
        beyond = np.abs(seen[:, :2]) - seen[:, 2:] * half
        visible = (beyond <= radius[:, None] * np.sqrt(1.0 + half**2)).all(axis=1)
        away = np.linalg.norm(self._places[:, :, 3], axis=1)
        visible &= (
            (seen[:, 2] > near - radius)
            & (seen[:, 2] < far + radius)
            & (away <= self._reach)[self._part]
        )
        pixel = 2.0 * slope / self.height * np.maximum(distance - radius, near)
        level = np.searchsorted(_CELL_PIXELS * np.array(CELLS), pixel)
        if self._weather is None:
            level[level == 1] = 0
        # From front to back, so that what is hidden is not colored.
        shown = np.flatnonzero(visible & self._opaque)
        shown = shown[np.argsort((distance - radius)[shown])]
        texture = self._texture[shown]
        behind = np.flatnonzero(visible & self._transparent)
        behind = behind[np.argsort((distance - radius)[behind])]
        count = len(self._boxes[0])
        front = np.concatenate([self._part[behind], model.ngeom + np.arange(count)])
        parts = np.concatenate([behind, np.full(count, self._box)])
        in_light = self._center @ self._light[:3, :3].T + self._light[:3, 3]
        wide = radius[:, None] * np.linalg.norm(self._light[:2, :3], axis=1)
        casting = self._casting & (np.abs(in_light[:, :2]) < 1.0 + wide).all(1)
        view = np.zeros((4, 4))
        view[0, :3] = self._axes[0] / half[0]
        # Upside down: the first row of the picture is its top.
        view[1, :3] = -self._axes[1] / half[1]
        view[2, :3] = -near / (far - near) * self._axes[2]
        view[2, 3] = near * far / (far - near)
        view[3, :3] = self._axes[2]
        axes = self._axes.T * [half[0], -half[1], 1.0]
        added, head, mirrored = self._lit_lamps()
        shot = Shot(
            places=np.concatenate([self._places, self._boxes[0]]).astype(np.float32),
            looks=np.concatenate([self._looks, self._boxes[1]]),
            opaque={int(t): shown[texture == t] for t in np.unique(texture)},
            casters=np.flatnonzero(casting),
            # As MuJoCo draws them: from front to back, and from back to front.
            transparent=np.concatenate([parts, parts[::-1]]),
            instances=np.concatenate([front, front[::-1]]),
            level=np.append(level, 0),
            view=view,
            light=self._light,
            forward=self._axes[2],
            to_sun=self._to_sun,
            axes=axes[[0, 2, 1]] * np.array([1.0, 1.0, -1.0])[:, None],
            spots=added,
            beams=head,
            glints=mirrored,
        )
        return self._painter.paint(shot)

    def _lit_lamps(self) -> tuple[NDArray[np.float64], Vectors, Vectors]:
        """Sets the brightness of lamps; returns spots, head lamps and lamps that a road mirrors."""
        weather, none = self._weather, np.empty((0, 3))
        if weather is None:
            return np.empty((0, COLUMNS)), (none, none, none), (none, none)
        # Lamps are on in a tunnel, too.
        on = weather.lamps or bool(self._looks[self._lamps.geom, 7].max(initial=0.0) > 0.3)
        brightness = self._lamps.brightness(self._signals, self._time, on=on)
        self._looks[self._lamps.geom, 4] = brightness
        lights = self._lamps.lights(self._places, brightness)
        added = [
            self._shades.spots(self._eye, self._looks[:, 7]),
            glow(lights, self._axes, weather.glow),
        ]
        if weather.wet > 0.0:
            fog = np.array(weather.fog)
            by = self._signals, self._time, weather
            added.append(self._shades.spray(self._eye, self._axes, *by))
            if weather.drops and not self._covered:
                light = fog if not weather.beams else fog + 0.10
                added.append(rain(weather.drops, self._time, self._eye, self._velocity, light))
        return (
            np.concatenate(added),
            beams(lights, BEAMS_MAX),
            glints(lights, self._axes, 0.3 + 0.5 * weather.glow, GLINTS_MAX),
        )

    def close(self) -> None:
        """Frees the context; may be called again."""
        if self._gl is not None:
            self._gl.free()
            self._gl = None

    def _range(self) -> tuple[float, float]:
        """Returns the nearest and the largest distance that is drawn [m]."""
        model = self._model
        extent = model.stat.extent
        return model.vis.map.znear * extent, SKY * model.vis.map.zfar * extent

    def _sun_view(
        self, center: NDArray[np.float64], eye: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Returns the matrix from places relative to the eye to the shadow map, (4, 4)."""
        clip = self._model.stat.extent * self._model.vis.map.shadowclip
        near, far = -2.0 * clip, 3.0 * clip
        forward = -self._to_sun
        axis = np.array([0.0, 1.0, 0.0]) if abs(forward[1]) < 0.9 else np.array([0.0, 0.0, 1.0])
        up = np.cross(forward, axis)
        up /= np.linalg.norm(up)
        right = np.cross(forward, up)
        found = np.eye(4)
        found[0, :3], found[1, :3] = right / clip, up / clip
        found[2, :3] = -forward / (far - near)
        place = found[:3, :3] @ center
        if self._weather is not None:
            # The map moves by whole pixels, so that the edges of shadows do not flicker.
            pixel = 2.0 / max(self._model.vis.quality.shadowsize, 1)
            place[:2] = np.round(place[:2] / pixel) * pixel
        found[:3, 3] = found[:3, :3] @ eye - place
        found[2, 3] += far / (far - near)
        return found


def _looks(model: mujoco.MjModel) -> NDArray[np.float32]:
    """Returns color with alpha, emission, specular and shininess of each geom, (n, 9).

    The last columns, light of a tunnel and answer to head lamps, are 0 and 1.
    """
    looks = np.zeros((model.ngeom, 9), np.float32)
    looks[:, :4] = model.geom_rgba
    looks[:, 5:7] = 0.5
    looks[:, 8] = 1.0
    material = model.geom_matid
    made = material >= 0
    which = material[made]
    looks[made, 4] = model.mat_emission[which]
    looks[made, 5] = model.mat_specular[which]
    looks[made, 6] = model.mat_shininess[which]
    # A geom's own color counts where it is not MuJoCo's default.
    plain = made & (model.geom_rgba == _DEFAULT_COLOR).all(axis=1)
    looks[plain, :4] = model.mat_rgba[material[plain]]
    looks[:, 6] *= 128.0
    return looks


def _textures(model: mujoco.MjModel) -> NDArray[np.int64]:
    """Returns the number of the 2D texture on each geom, -1 without one."""
    found = np.full(model.ngeom, -1)
    made = np.flatnonzero(model.geom_matid >= 0)
    role = int(mujoco.mjtTextureRole.mjTEXROLE_RGB)
    found[made] = model.mat_texid[model.geom_matid[made], role]
    for geom in np.flatnonzero(found >= 0):
        mesh, kind = model.geom_dataid[geom], model.geom_type[geom]
        mapped = kind == mujoco.mjtGeom.mjGEOM_PLANE
        if kind == mujoco.mjtGeom.mjGEOM_MESH:
            mapped = model.mesh_texcoordadr[mesh] >= 0
        if not mapped or model.tex_type[found[geom]] != mujoco.mjtTexture.mjTEXTURE_2D:
            found[geom] = -1
    return found


def _lighting(model: mujoco.MjModel, sun: int | None, weather: Weather | None) -> Any:
    from iits_mj.render.painter import Lighting

    black = np.zeros(3, np.float32)
    head = model.vis.headlight
    extent = model.stat.extent
    ambient = head.ambient + (black if sun is None else model.light_ambient[sun])
    found = Lighting(
        ambient=ambient,
        ground=ambient,
        head_diffuse=head.diffuse,
        head_specular=head.specular,
        sun_diffuse=black if sun is None else model.light_diffuse[sun],
        sun_specular=black if sun is None else model.light_specular[sun],
        shadow_size=0 if sun is None else model.vis.quality.shadowsize,
        fog=model.vis.rgba.fog[:3],
        fog_range=(extent * model.vis.map.fogstart, extent * model.vis.map.fogend),
        sky_radius=SKY * extent * model.vis.map.zfar,
        tunnel_above=np.array(_TUNNEL_ABOVE, np.float32),
        tunnel_below=np.array(_TUNNEL_BELOW, np.float32),
    )
    if weather is None:
        return found
    sunlight = np.array(weather.sunlight, np.float32)
    return dataclasses.replace(
        found,
        ambient=np.array(weather.above, np.float32),
        ground=np.array(weather.below, np.float32),
        head_diffuse=0.15 * np.array(weather.above, np.float32),
        head_specular=0.06 * np.array(weather.above, np.float32),
        sun_diffuse=sunlight,
        sun_specular=0.5 * sunlight,
        fog=np.array(weather.fog, np.float32),
        knee=_KNEE,
        mist=weather.mist,
        beams=weather.beams,
        wet=weather.wet,
        meadow=_MEADOW,
        smooth=True,
        sky=np.round(255.0 * weather.faces()).astype(np.uint8),
    )


def camera_pose(camera: mujoco.MjvCamera) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Returns position and viewing direction of a free camera."""
    azimuth, elevation = math.radians(camera.azimuth), math.radians(camera.elevation)
    forward = np.array(
        [
            math.cos(elevation) * math.cos(azimuth),
            math.cos(elevation) * math.sin(azimuth),
            math.sin(elevation),
        ]
    )
    return np.asarray(camera.lookat) - camera.distance * forward, forward
