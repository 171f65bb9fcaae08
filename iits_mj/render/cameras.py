"""Cameras that follow the truck smoothly, the user's own, and the pose of a camera."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any, Protocol, runtime_checkable

import mujoco
import numpy as np

from iits_mj.core.angles import wrap_angle
from iits_mj.core.arrays import FloatArray
from iits_mj.core.checks import shown
from iits_mj.core.errors import InputError
from iits_mj.core.own_parts import Guard, Kind, is_own
from iits_mj.parameters import TruckParameters


@dataclass(frozen=True)
class View:
    """Position of a camera relative to the smoothed heading of the unit that it follows.

    Distance and `ahead` are those for a combination of `_LENGTH` and a last unit with its rear
    `_REAR` behind its origin.

    Attributes:
      distance: from the point looked at [m]; azimuth, elevation: viewing direction [deg].
      ahead, left, up: point looked at, in the frame of the unit [m].
      time_constant: of the smoothing of the heading [s].
      follows: "lead", the motor vehicle, or "last", the last unit.
      tunnel: view inside a tunnel, whose roof and walls would hide the truck: "behind" or
        "ahead"; "" to keep the view.
      slopes: whether the elevation follows the grade of the road.
      scales: whether the view depends on the truck's size: of the combination, distance and `ahead`
        grow with its length; the rear of the last unit is seen from the same place.
    """

    distance: float
    azimuth: float
    elevation: float
    ahead: float
    left: float
    up: float
    time_constant: float
    follows: str = "lead"
    tunnel: str = "behind"
    slopes: bool = True
    scales: bool = True


VIEWS = {
    "chase": View(31.0, -7.0, -14.0, 3.0, 0.0, 1.2, 0.7),
    "side": View(21.0, -76.0, -9.0, -6.5, 0.0, 1.7, 0.5),
    "front": View(17.0, 157.0, -7.0, -2.0, 0.0, 1.8, 0.5, tunnel="ahead"),
    "top": View(62.0, 0.0, -89.0, 2.0, 0.0, 0.0, 0.9, slopes=False),
    "cab": View(1.0, 0.0, -3.0, 1.72, 0.45, 2.42, 0.0, tunnel="", scales=False),
    "trailer": View(13.0, 24.0, -9.0, -6.5, 0.0, 1.2, 0.3, follows="last"),
    "aerial": View(115.0, -28.0, -27.0, 25.0, 0.0, 0.0, 1.2, slopes=False, scales=False),
}
CAMERAS = tuple(VIEWS)
CAMERAS_MAX = 4  # in one picture
# Length of the combination, and distance of its rear from the last unit's origin, for which the
# views are defined [m].
_LENGTH, _REAR = 16.5, 11.5
_SCALE_MIN = 0.65  # a short truck does not hide the road ahead
_LAST_DISTANCE = 0.55  # of the views along the truck when they follow its last unit
# These views are nearly along the truck, which may drive close to either wall.
_TUNNEL_VIEWS = {
    "behind": View(27.0, -0.5, -5.5, 2.0, 0.2, 2.9, 0.7),
    "ahead": View(16.0, 178.5, -6.0, -1.0, 0.2, 1.9, 0.5),
}
_TUNNEL_NEAR, _TUNNEL_TIME = 75.0, 1.2


@runtime_checkable
class Camera(Protocol):
    """Gives the view of each picture.

    A class needs this method and no base class. Its constructor may ask for `parameters`
    (`TruckParameters`) and `tunnels`, first and last station of each [m]. A `FollowCamera` with a
    `View` of your own is one, too.
    """

    def follow(self, data: mujoco.MjData, station: float | None, /) -> mujoco.MjvCamera:
        """Returns a free camera for the state of this instant.

        Args:
          data: bodies in the map frame [m]: the truck's units by name ("tractor", "trailer"), x
            forward, y left, z up, and `data.time` [s], which rises but may skip.
          station: of the truck on its route [m]; None where it is not known.
        """


CAMERA = Kind("camera", Camera, CAMERAS)


class CameraGuard(Guard):
    """Guard of a user's camera."""

    kind = CAMERA

    def follow(self, data: mujoco.MjData, station: float | None = None) -> mujoco.MjvCamera:
        """Returns the camera; raises InputError if it is not usable."""
        camera = self.call("follow", data, station)
        if not isinstance(camera, mujoco.MjvCamera):
            raise self.unusable("follow", f"returned {shown(camera)}, must be a mujoco.MjvCamera")
        numbers = (*camera.lookat, camera.distance, camera.azimuth, camera.elevation)
        if not np.isfinite(numbers).all() or camera.distance <= 0.0:
            raise self.unusable(
                "follow",
                f"returned lookat {camera.lookat.tolist()}, distance {camera.distance}, azimuth "
                f"{camera.azimuth}, elevation {camera.elevation}: must be finite, the distance "
                "above 0",
            )
        return camera


def make_camera(
    given: Any,
    tunnels: tuple[tuple[float, float], ...] = (),
    truck: TruckParameters | None = None,
) -> FollowCamera | CameraGuard:
    """Returns a camera: one of `CAMERAS` by its name, or the user's own.

    Args:
      given: name, or own part, see `iits_mj.core.own_parts`.
      tunnels: first and last station of each tunnel [m].
      truck: that the camera follows; None: a tractor with a semitrailer of 16.5 m.

    Raises:
      InputError: unknown name, or the part does not fit.
    """
    own = CAMERA.make(given, parameters=truck, tunnels=tunnels)
    if own is None:
        return FollowCamera(given, tunnels, truck)
    return own if isinstance(own, FollowCamera) and not is_own(own) else CameraGuard(own)


def cameras_of(given: Any) -> tuple[Any, ...]:
    """Returns the cameras of a picture.

    Args:
      given: names separated by commas, or one camera of the user's own.

    Raises:
      InputError: a name is unknown, a camera does not fit, or there are more than four.
    """
    names = tuple(map(str.strip, given.split(","))) if isinstance(given, str) else (given,)
    for name in names:
        CAMERA.check(name)
    if len(names) > CAMERAS_MAX:
        raise InputError(f"camera {given!r} has {len(names)} names: use {CAMERAS_MAX} at most")
    return names


def tiles(size: tuple[int, int], count: int) -> list[tuple[int, int, int, int]]:
    """Returns left, top, width and height of each camera's part of a picture.

    Two are side by side, three and four in two rows; the sides are even numbers.
    """
    columns, rows = (1, 1) if count == 1 else (2, 1 + (count > 2))
    width, height = size[0] // columns // 2 * 2, size[1] // rows // 2 * 2
    return [(i % columns * width, i // columns * height, width, height) for i in range(count)]


class FollowCamera:
    """A camera that follows the truck, moved from frame to frame.

    Args:
      view: one of `CAMERAS`, or a view of your own.
      tunnels: first and last station of each tunnel [m].
      truck: that the camera follows; None: a tractor with a semitrailer of 16.5 m.

    Raises:
      InputError: unknown name.
    """

    def __init__(
        self,
        view: str | View,
        tunnels: tuple[tuple[float, float], ...] = (),
        truck: TruckParameters | None = None,
    ) -> None:
        if not isinstance(view, View):
            CAMERA.is_own(view)
            view = VIEWS[view]
        self.view = view
        self._body, scale, shift = _followed(self.view, truck)
        self._outside = _scaled(self.view, scale, shift)
        inside = _TUNNEL_VIEWS.get(self.view.tunnel, self.view)
        # A camera that is farther away in a tunnel is not higher.
        rise = math.sin(math.radians(inside.elevation)) / max(scale, 1.0)
        inside = replace(inside, elevation=math.degrees(math.asin(rise)))
        if self.view.follows == "last":
            inside = replace(inside, distance=_LAST_DISTANCE * inside.distance, ahead=-4.0)
        self._inside = _scaled(inside, scale, shift)
        self.camera = mujoco.MjvCamera()
        self.camera.type = mujoco.mjtCamera.mjCAMERA_FREE
        self._tunnels = tunnels
        self._time: float | None = None
        self._heading = self._slope = self._cover = 0.0

    def follow(self, data: mujoco.MjData, station: float | None = None) -> mujoco.MjvCamera:
        """Moves the camera to this instant and returns it.

        Args:
          data: of a model with the truck's units, with current positions.
          station: of the truck on its route [m], for the view in tunnels.
        """
        view = self.view
        body = data.body(self._body)
        forward = np.array(body.xmat).reshape(3, 3)[:, 0]
        heading = math.atan2(forward[1], forward[0])
        slope = math.asin(max(-1.0, min(1.0, float(forward[2])))) if view.slopes else 0.0
        cover = float(bool(view.tunnel) and self._covered(station))
        elapsed = 0.0 if self._time is None else float(data.time) - self._time
        if self._time is None or elapsed < 0.0:
            self._heading, self._slope, self._cover = heading, slope, cover
        else:
            turn = wrap_angle(heading - self._heading)
            self._heading += _share(elapsed, view.time_constant) * turn
            self._slope += _share(elapsed, max(view.time_constant, 0.05)) * (slope - self._slope)
            self._cover += _share(elapsed, _TUNNEL_TIME) * (cover - self._cover)
        self._time = float(data.time)
        self._place(np.array(body.xpos))
        return self.camera

    def _covered(self, station: float | None) -> bool:
        return station is not None and any(
            a - _TUNNEL_NEAR < station < b + 12.0 for a, b in self._tunnels
        )

    def _place(self, position: FloatArray) -> None:
        share = self._cover

        def blend(name: str) -> float:
            outside = float(getattr(self._outside, name))
            inside = float(getattr(self._inside, name))
            return outside + share * (inside - outside)

        c, s = math.cos(self._heading), math.sin(self._heading)
        slope = math.tan(self._slope)
        ahead, left = blend("ahead"), blend("left")
        camera = self.camera
        camera.lookat[0] = position[0] + c * ahead - s * left
        camera.lookat[1] = position[1] + s * ahead + c * left
        camera.lookat[2] = position[2] + blend("up") + slope * ahead
        camera.distance = blend("distance")
        azimuth = blend("azimuth")
        camera.azimuth = math.degrees(self._heading) + azimuth
        # A camera that looks along the road tilts with it.
        tilt = math.degrees(self._slope) * math.cos(math.radians(azimuth))
        camera.elevation = max(blend("elevation") + tilt, -89.0)


def _followed(view: View, truck: TruckParameters | None) -> tuple[str, float, float]:
    """Returns the body that a view follows, the scale of its distances and their shift [m]."""
    if truck is None:
        return {"lead": "tractor", "last": "trailer"}[view.follows], 1.0, 0.0
    if view.follows == "last":
        last = truck.last
        return last.name, 1.0, _REAR - (last.length - last.front_overhang)
    scale = max(truck.length / _LENGTH, _SCALE_MIN) if view.scales else 1.0
    return truck.lead.name, scale, 0.0


def _scaled(view: View, scale: float, shift: float) -> View:
    return replace(view, distance=scale * view.distance, ahead=scale * view.ahead + shift)


def _share(elapsed: float, time_constant: float) -> float:
    """Returns the share of a step that a first-order lag covers in a time."""
    return 1.0 if time_constant <= 0.0 else 1.0 - math.exp(-elapsed / time_constant)


def camera_pose(camera: mujoco.MjvCamera) -> tuple[FloatArray, FloatArray]:
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


def follow(window: Any, model: mujoco.MjModel, prefix: str = "") -> None:
    """Makes a viewer's camera follow the center of mass of the truck with this prefix."""
    window.cam.type = mujoco.mjtCamera.mjCAMERA_TRACKING
    window.cam.trackbodyid = model.body(f"{prefix}tractor").id
    window.cam.distance, window.cam.elevation = 28.0, -18.0
    window.cam.azimuth = 180.0
