"""The model in the browser: mjviser's scene with a landscape in chunks, sky, cameras, overlays.

Places are sent relative to the truck, because browsers draw in single precision.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import mujoco
import numpy as np
from mjviser import ViserMujocoScene
from mjviser.conversions import get_geom_texture_id, is_fixed_body, merge_geoms

from iits_mj.core.arrays import FloatArray
from iits_mj.core.messages import RoadSignals, Trajectory
from iits_mj.core.own_parts import part_name
from iits_mj.core.vehicles import VehicleFrame
from iits_mj.model.scenery.signs import LAMPS
from iits_mj.render.cameras import (
    CAMERAS,
    Camera,
    CameraGuard,
    FollowCamera,
    camera_pose,
    make_camera,
)
from iits_mj.render.lamps import RoadLights

if TYPE_CHECKING:
    import viser

    from iits_mj.parameters import TruckParameters

ORBIT = "orbit"
VIEWS = (ORBIT, *CAMERAS)
# Geoms of higher groups are for contacts, not for pictures.
_LAST_GROUP = 2
_CHUNK = 800.0  # [m] of landscape in one node, which the browser leaves out of sight
# Bodies farther away from the truck are not drawn [m].
_SIGHT = 2_000.0
_PARKED = (0.0, 0.0, -500.0)
_GRASS = (117, 140, 80)
_SKY, _HAZE = np.array([86.0, 142.0, 206.0]), np.array([214.0, 227.0, 238.0])
_PLAN, _LOAD, _FORCE = (20, 160, 60), (240, 150, 20), (210, 30, 60)
_PATH_POINTS = 24
_NEWTONS = 25_000.0  # load that an arrow of 1 m shows [N]
_SHEAR = 4.0  # forces in the road's plane are drawn longer
_ASIDE = 0.75  # [m]
_LABELS = 6
_LABEL_REACH = 120.0  # [m]
_ROOT = "/fixed_bodies"
# Lit lamps of traffic lights: radius [m] and colors.
_LAMP = 0.13
_LAMP_COLORS = dict(zip(LAMPS, ((255, 30, 20), (255, 190, 0), (40, 255, 120)), strict=True))


@dataclass(frozen=True)
class Poses:
    """Places of all bodies at one instant.

    Attributes:
      position: (nbody, 3) [m]; quaternion: (nbody, 4).
    """

    position: FloatArray
    quaternion: FloatArray

    @classmethod
    def of(cls, data: mujoco.MjData) -> Poses:
        """Returns a copy of the places in MuJoCo's data."""
        found = cls(data.xpos.copy(), data.xquat.copy())
        # The places of mocap bodies may be newer than the last step.
        model = data.model
        mocap = np.flatnonzero(model.body_mocapid >= 0)
        ids = model.body_mocapid[mocap]
        found.position[mocap], found.quaternion[mocap] = data.mocap_pos[ids], data.mocap_quat[ids]
        return found

    def toward(self, other: Poses, share: float) -> Poses:
        """Returns the poses at a share of the way to others; bodies that jump are already there."""
        step = other.position - self.position
        far = np.linalg.norm(step, axis=1) > 40.0
        sign = np.where((self.quaternion * other.quaternion).sum(axis=1) < 0.0, -1.0, 1.0)
        turn = sign[:, None] * other.quaternion - self.quaternion
        quaternion = self.quaternion + share * turn
        quaternion /= np.maximum(np.linalg.norm(quaternion, axis=1, keepdims=True), 1e-9)
        position = np.where(far[:, None], other.position, self.position + share * step)
        return Poses(position, np.where(far[:, None], other.quaternion, quaternion))


class TruckScene(ViserMujocoScene):
    """A model of the truck and its road in a viser server.

    Args:
      server: of viser.
      model: to show.
      parameters: of the truck, for the cameras; None: a tractor with a semitrailer.
      tunnels: first and last station of each on the route [m].
      near: only the landscape near these places (n, 2) is sent [m]; None: all of it.
      overlays: whether path, gaps and forces can be drawn.
      camera: of new viewers: one of `VIEWS`, or your own.

    Attributes:
      show_path, show_forces, show_gaps: which overlays are drawn.
    """

    def __init__(
        self,
        server: viser.ViserServer,
        model: mujoco.MjModel,
        parameters: TruckParameters | None = None,
        tunnels: tuple[tuple[float, float], ...] = (),
        *,
        near: FloatArray | None = None,
        overlays: bool = True,
        camera: str | type[Camera] | Camera = "chase",
    ) -> None:
        self._near, self._first = near, camera
        self._chunks: list[tuple[Any, FloatArray]] = []
        server.scene.set_background_image(_sky(), format="png")
        server.scene.configure_fog(900.0, 4_500.0, color=tuple(_HAZE.astype(int)))
        super().__init__(server, model, 1)
        server.scene.configure_environment_map(environment_intensity=0.4)
        self._parameters, self._tunnels = parameters, tunnels
        self._tracked = model.body("tractor").id
        last = "trailer" if parameters is None else parameters.last.name
        self._units = {self._tracked, model.body(last).id}
        self._mocap = model.body_mocapid >= 0
        self._views: dict[int, tuple[str, FollowCamera | CameraGuard | None]] = {}
        self.show_path = self.show_forces = self.show_gaps = True
        self._fovy = math.radians(float(model.vis.global_.fovy))
        self._marks = (0.0, np.zeros((0, 3)), np.zeros((0, 3)))
        self._labels: list[Any] = []
        if overlays:
            self._add_overlays()

    # mjviser calls these four methods when it is made.
    def _compute_hull_body_meshes(self) -> None:
        """Hulls of bodies are not shown."""

    def _add_fixed_sites(self) -> None:
        """Sites are not shown."""

    def _create_site_handles_by_group(self) -> None:
        """Sites are not shown."""

    def _add_fixed_geometry(self) -> None:
        """Adds the landscape: geoms with one textured material together, others by place."""
        model = self.mj_model
        groups: dict[tuple[int, int, int], list[int]] = {}
        for geom in range(model.ngeom):
            body = int(model.geom_bodyid[geom])
            if not is_fixed_body(model, body) or model.geom_rgba[geom, 3] == 0.0:
                continue
            if model.geom_group[geom] > _LAST_GROUP:
                continue
            if model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_PLANE:
                self._add_plain(geom)
                continue
            place = self._place(geom)
            texture = get_geom_texture_id(model, geom)
            if self._far(place, float(model.geom_rbound[geom])):
                continue
            # Textured geoms have one material, others a place.
            cell = tuple(np.floor(place / _CHUNK).astype(int))
            if texture >= 0:
                cell = (int(model.geom_matid[geom]), 0)
            groups.setdefault((texture, *cell), []).append(geom)
        for number, ((texture, *_), geoms) in enumerate(sorted(groups.items())):
            handle = self.server.scene.add_mesh_trimesh(
                f"{_ROOT}/scenery{number}", merge_geoms(model, geoms), cast_shadow=False
            )
            if texture < 0:
                places = np.array([self._place(geom) for geom in geoms])
                reach = float(model.geom_rbound[geoms].max())
                self._chunks.append((handle, np.append(places.mean(axis=0), reach)))
        self._lights = RoadLights(model)
        self._lamps = {
            geom: self.server.scene.add_icosphere(
                f"{_ROOT}/lamp{geom}",
                radius=_LAMP,
                color=_LAMP_COLORS[one.material],
                position=tuple(self.mj_data.geom_xpos[geom]),
                cast_shadow=False,
                visible=False,
            )
            for geom, one in self._lights.lamps.items()
        }

    def show_lights(self, signals: RoadSignals, time: float) -> None:
        """Shows the lit lamps of traffic lights; `time` is that of the drive [s]."""
        lit = self._lights.lit(signals, time)
        for geom, lamp in self._lamps.items():
            if lamp.visible != (geom in lit):
                lamp.visible = geom in lit

    def _add_plain(self, geom: int) -> None:
        """Adds an infinite plane as a large square that moves with the truck, with a fine grid."""
        self.server.scene.add_grid(
            f"{_ROOT}/plain{geom}",
            infinite_grid=True,
            fade_distance=1_500.0,
            cell_size=10.0,
            section_size=100.0,
            cell_color=(104, 126, 70),
            section_color=(96, 118, 64),
            plane_color=_GRASS,
            plane_opacity=1.0,
            position=self.mj_model.geom_pos[geom] - np.array([0.0, 0.0, 0.03]),
            wxyz=self.mj_model.geom_quat[geom],
        )

    def _add_overlays(self) -> None:
        """Adds the handles of the overlays, hidden."""
        scene = self.server.scene
        self._path = scene.add_line_segments(
            f"{_ROOT}/plan", np.zeros((1, 2, 3)), _PLAN, thickness=0.25, visible=False
        )
        self._wheels = _wheels(self.mj_model)
        none = np.zeros((max(len(self._wheels), 1), 2, 3))
        self._loads = scene.add_arrows(
            "/loads",
            none,
            _LOAD,
            shaft_radius=0.05,
            head_radius=0.12,
            head_length=0.25,
            visible=False,
        )
        self._forces = scene.add_line_segments(
            "/forces", none, _FORCE, thickness=0.12, visible=False
        )
        self._labels = [
            scene.add_label(f"/gap{i}", "", anchor="bottom-center", visible=False)
            for i in range(_LABELS)
        ]

    def _place(self, geom: int) -> FloatArray:
        return np.asarray(self.mj_data.geom_xpos[geom, :2])

    def _far(self, place: FloatArray, reach: float) -> bool:
        if self._near is None:
            return False
        return bool(np.linalg.norm(self._near - place, axis=1).min() - reach > _SIGHT)

    def show(
        self,
        poses: Poses,
        station: float | None = None,
        time: float = 0.0,
        turned: float | None = None,
    ) -> None:
        """Moves all bodies and the viewers' cameras.

        Args:
          poses: of the bodies.
          station: of the truck [m], for the views in tunnels.
          time: of the simulation [s], for the smoothing of the cameras.
          turned: heading that is drawn along x [rad], for pages whose camera does not move; None:
            the map is drawn as it is.
        """
        offset = -poses.position[self._tracked]
        relative, quaternion = poses.position + offset, poses.quaternion
        far = self._mocap & (np.linalg.norm(relative, axis=1) > _SIGHT)
        relative[far] = _PARKED
        shift = offset
        if turned is not None:
            about = np.array([math.cos(0.5 * turned), 0.0, 0.0, -math.sin(0.5 * turned)])
            relative, shift = _rotated(about, relative), _rotated(about, offset[None])[0]
            quaternion = _multiplied(about, quaternion)
            self.fixed_bodies_frame.wxyz = tuple(about)
        with self.server.atomic():
            self._scene_offset = offset
            self.fixed_bodies_frame.position = tuple(shift)
            for group in self._mesh_groups:
                if group.group_id <= _LAST_GROUP:
                    group.handle.batched_positions = relative[group.body_ids]
                    group.handle.batched_wxyzs = quaternion[group.body_ids]
            for handle, (x, y, reach) in self._chunks:
                handle.visible = math.hypot(x + offset[0], y + offset[1]) - reach < _SIGHT
            self._move_labels(time)
        self._move_cameras(poses, station, time)
        self.server.flush()

    def use_view(self, client: int, view: str) -> None:
        """Gives a viewer one of `VIEWS` or the first camera; "orbit" leaves it to the mouse."""
        follow = None
        if view != ORBIT:
            given = self._first if view == part_name(self._first) else view
            follow = make_camera(given, self._tunnels, self._parameters)
        self._views[client] = view, follow

    def keep_views(self, before: TruckScene | None) -> None:
        """Gives the viewers the views that they had in another scene."""
        for client, (view, _) in before._views.items() if before is not None else ():
            self.use_view(client, view)

    def view_of(self, client: int) -> str:
        """Returns the view of a viewer."""
        return self._views.get(client, (part_name(self._first), None))[0]

    def _move_cameras(self, poses: Poses, station: float | None, time: float) -> None:
        clients = self.server.get_clients()
        for number in set(self._views) - set(clients):
            del self._views[number]
        for number, client in clients.items():
            if number not in self._views:
                self.use_view(number, part_name(self._first))
                client.camera.fov = self._fovy
                client.camera.near, client.camera.far = 0.3, 6_000.0
            follow = self._views[number][1]
            if follow is None:
                continue
            place, look_at = self._camera(follow, poses, station, time)
            with client.atomic():
                client.camera.position = place
                client.camera.look_at = look_at
            client.flush()

    def _camera(
        self, follow: FollowCamera | CameraGuard, poses: Poses, station: float | None, time: float
    ) -> tuple[FloatArray, FloatArray]:
        """Returns place and point looked at of a camera, relative to the truck."""
        data = self.mj_data
        data.time = time
        data.xpos[:] = poses.position
        matrix = np.empty(9)
        for body in self._units:
            mujoco.mju_quat2Mat(matrix, poses.quaternion[body])
            data.xmat[body] = matrix
        camera = follow.follow(data, station)
        eye, forward = camera_pose(camera)
        ahead = eye + max(float(camera.distance), 5.0) * forward
        return eye + self._scene_offset, ahead + self._scene_offset

    def initial_camera(
        self, poses: Poses, view: str | None = None, turned: float | None = None
    ) -> None:
        """Sets the camera with which pages and exported pages start; see `show`."""
        self._scene_offset = -poses.position[self._tracked]
        given = self._first if view is None else view
        follow = make_camera(given, self._tunnels, self._parameters)
        places = np.array(self._camera(follow, poses, None, 0.0))
        if turned is not None:
            about = np.array([math.cos(0.5 * turned), 0.0, 0.0, -math.sin(0.5 * turned)])
            places = _rotated(about, places)
        place, look_at = places
        camera = self.server.initial_camera
        camera.position, camera.look_at = tuple(place), tuple(look_at)
        camera.fov, camera.near, camera.far = self._fovy, 0.3, 6_000.0

    def show_plan(self, trajectory: Trajectory | None) -> None:
        """Draws the planned path; without one, or with an unknown one, nothing."""
        known = None
        if self.show_path and trajectory is not None and np.isfinite(trajectory.x).all():
            step = max(1, len(trajectory.x) // _PATH_POINTS)
            known = np.stack([trajectory.x, trajectory.y, trajectory.z + 0.25], axis=1)[::step]
        visible = known is not None and len(known) > 1
        if visible:
            assert known is not None
            self._path.points = np.stack([known[:-1], known[1:]], axis=1)
        self._path.visible = visible

    def show_tires(self, data: mujoco.MjData) -> None:
        """Draws the load of each wheel upward and its force in the road's plane."""
        self._loads.visible = self._forces.visible = self.show_forces and bool(self._wheels)
        if not self._loads.visible:
            return
        loads, forces = [], []
        for address, body, side in self._wheels:
            force = data.sensordata[address : address + 3] / _NEWTONS
            axis = data.xmat[body].reshape(3, 3)[:, 1]
            left = np.array([axis[0], axis[1], 0.0]) / max(math.hypot(axis[0], axis[1]), 1e-6)
            forward = np.array([left[1], -left[0], 0.0])
            # Beside the truck, where they are seen.
            foot = data.xpos[body] + self._scene_offset + side * _ASIDE * left
            loads.append((foot, foot + np.array([0.0, 0.0, max(force[2], 0.02)])))
            forces.append((foot, foot + _SHEAR * (force[0] * forward + force[1] * left)))
        self._loads.points, self._forces.points = np.array(loads), np.array(forces)

    def show_neighbors(self, time: float, vehicles: VehicleFrame, texts: Sequence[str]) -> None:
        """Writes above the nearest vehicles; the texts move with them until the next call.

        Args:
          time: of the vehicles [s].
          vehicles: now.
          texts: for each of them.
        """
        shown = vehicles if self.show_gaps else VehicleFrame.empty()
        x, y, z, yaw, speed = shown.columns("x", "y", "z", "yaw", "speed")
        places = np.stack([x, y, z], axis=1)
        distance = np.linalg.norm(places[:, :2] + self._scene_offset[:2], axis=1)
        rows = np.argsort(distance, kind="stable")[:_LABELS]
        rows = rows[distance[rows] < _LABEL_REACH]
        velocity = np.stack([speed * np.cos(yaw), speed * np.sin(yaw), 0.0 * speed], axis=1)
        places[:, 2] += 2.5
        self._marks = (time, places[rows], velocity[rows])
        for slot, label in enumerate(self._labels):
            label.visible = slot < len(rows)
            if slot < len(rows):
                label.text = texts[int(rows[slot])]

    def _move_labels(self, time: float) -> None:
        then, places, velocity = self._marks
        moved = places + (time - then) * velocity + self._scene_offset
        for label, place in zip(self._labels, moved, strict=False):
            label.position = tuple(place)

    def remove(self) -> None:
        """Takes everything out of the page."""
        self.server.scene.reset()


def _sky() -> Any:
    """Picture of a sky, (height, 4, 3)."""
    share = np.clip(np.linspace(0.0, 1.9, 128), 0.0, 1.0)[:, None, None]
    rows = (1.0 - share) * _SKY + share * _HAZE
    return np.broadcast_to(rows, (128, 4, 3)).astype(np.uint8)


def _rotated(quaternion: FloatArray, points: FloatArray) -> FloatArray:
    """Returns points (n, 3) rotated by a quaternion."""
    matrix = np.empty(9)
    mujoco.mju_quat2Mat(matrix, quaternion)
    return np.asarray(points @ matrix.reshape(3, 3).T)


def _multiplied(first: FloatArray, second: FloatArray) -> FloatArray:
    """Returns the products of a quaternion (4,) with others (n, 4)."""
    w, v = first[0], first[1:]
    scalar = w * second[:, :1] - second[:, 1:] @ v[:, None]
    vector = w * second[:, 1:] + second[:, :1] * v + np.cross(v, second[:, 1:])
    return np.concatenate([scalar, vector], axis=1)


def _wheels(model: mujoco.MjModel) -> list[tuple[int, int, float]]:
    """Returns address of the tire force, body, and side (left 1, right -1) of each wheel."""
    found = []
    for number in range(model.nsensor):
        name = model.sensor(number).name
        if name.endswith("_tire_force"):
            wheel = name.removesuffix("_tire_force")
            side = 1.0 if wheel.endswith("left") else -1.0
            body = int(model.body(f"{wheel}_wheel").id)
            found.append((int(model.sensor_adr[number]), body, side))
    return found
