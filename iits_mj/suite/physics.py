"""`Physics` of the domain: the one place of the tasks that knows the model's names."""

from __future__ import annotations

import copy

import mujoco
import numpy as np
from dm_control.mujoco import Physics as BasePhysics
from dm_control.mujoco import wrapper
from numpy.typing import NDArray

from iits_mj.messages import EgoState, VehicleCommand
from iits_mj.road import Route
from iits_mj.truck import Truck

FloatArray = NDArray[np.float64]

# Fixed to the tractor: name to position and the picture's x and y axes in its frame.
CAMERAS = {
    "chase": ((-27.0, 0.0, 8.0), (0.0, -1.0, 0.0), (0.22, 0.0, 0.98)),
    "side": ((-5.0, -24.0, 4.0), (1.0, 0.0, 0.0), (0.0, 0.09, 0.99)),
    "cab": ((0.9, 0.0, 2.6), (0.0, -1.0, 0.0), (0.05, 0.0, 1.0)),
}


def add_cameras(spec: mujoco.MjSpec) -> None:
    """Adds the suite's cameras to the tractor."""
    tractor = spec.body("tractor")
    for name, (position, right, up) in CAMERAS.items():
        axes = np.column_stack([right, up, np.cross(right, up)])
        axes /= np.linalg.norm(axes, axis=0)
        quaternion = np.zeros(4)
        mujoco.mju_mat2Quat(quaternion, axes.ravel())
        tractor.add_camera(name=name, pos=position, quat=quaternion)


class Physics(BasePhysics):
    """MuJoCo physics of a `Truck`, with getters in words; SI units, ISO 8855 axes.

    Made by `from_truck`. `truck` shares the model and data of this physics.
    """

    truck: Truck

    @classmethod
    def from_truck(cls, truck: Truck) -> Physics:
        """Takes over a truck: its `data` becomes that of the physics."""
        physics: Physics = cls.from_model(wrapper.MjModel(truck.model))
        physics._bind(truck)
        return physics

    def _bind(self, truck: Truck) -> None:
        self.truck = truck
        self.truck.data = self.data.ptr
        self._key: bytes = b""

    def copy(self, share_model: bool = False) -> Physics:
        """A copy with its own data (and model, unless shared)."""
        twin: Physics = super().copy(share_model=share_model)
        truck = copy.copy(self.truck)
        truck.model = twin.model.ptr
        twin._bind(truck)
        return twin

    @property
    def route(self) -> Route:
        """The road."""
        return self.truck.route

    def place(self, station: float, offset: float, speed: float) -> None:
        """Puts the truck on its road, rolling freely at a speed [m], [m], [m/s]."""
        self.truck.reset(station=station, offset=offset, speed=speed)
        self._key = b""

    def command(self, command: VehicleCommand) -> None:
        """Sets the truck's controls."""
        self.truck.command(command)

    def ego(self) -> EgoState:
        """The truck's state now."""
        key = self.data.time.hex().encode() + self.data.qpos.tobytes() + self.data.qvel.tobytes()
        if key != self._key:
            self._state = self.truck.observe()
            self._key = key
        return self._state

    def speed(self) -> float:
        """Forward speed of the tractor [m/s]."""
        return self.ego().speed

    def acceleration(self) -> float:
        """Forward acceleration of the tractor [m/s2]."""
        return self.ego().acceleration

    def lateral_acceleration(self) -> float:
        """Lateral acceleration of the tractor [m/s2]."""
        return self.ego().lateral_acceleration

    def station(self) -> float:
        """Steer axle along the road [m]."""
        return self.ego().station

    def lane_error(self, lane: int = 0) -> float:
        """Steer axle left of the lane's middle [m]."""
        ego = self.ego()
        return ego.offset - float(self.route.lane_offset(lane, ego.station))

    def trailer_error(self, lane: int = 0) -> float:
        """Centre of the trailer's axles left of the lane's middle [m]."""
        ego = self.ego()
        return ego.trailer_offset - float(self.route.lane_offset(lane, ego.station))

    def heading_error(self) -> float:
        """Tractor's heading less the road's [rad]."""
        ego = self.ego()
        heading = float(self.route.evaluate(ego.station, 0.0).heading)
        return float(np.arctan2(np.sin(ego.yaw - heading), np.cos(ego.yaw - heading)))

    def articulation(self) -> float:
        """Tractor's yaw less the trailer's [rad]."""
        return self.ego().articulation

    def yaw_rate(self) -> float:
        """Of the tractor [rad/s]."""
        return self.ego().yaw_rate

    def steering_wheel_angle(self) -> float:
        """Actual angle [rad]."""
        return self.ego().steering_wheel_angle

    def grade_ahead(self, distances: tuple[float, ...]) -> FloatArray:
        """Grade of the road at distances ahead of the steer axle [m], shape (n,)."""
        stations = np.minimum(self.station() + np.array(distances), self.route.length)
        return np.asarray(self.route.evaluate(stations).grade, dtype=float)

    def curvature_ahead(self, distances: tuple[float, ...]) -> FloatArray:
        """Curvature of the road at distances ahead [1/m], shape (n,), positive to the left."""
        stations = np.minimum(self.station() + np.array(distances), self.route.length)
        return np.asarray(self.route.evaluate(stations).curvature, dtype=float)

    def gear(self) -> int:
        """1 to 12; 0 in neutral."""
        return self.ego().gear

    def engine_speed(self) -> float:
        """[rad/s]."""
        return self.ego().engine_speed

    def engine_torque(self) -> float:
        """[N m]."""
        return self.ego().engine_torque

    def brake_pressure(self) -> float:
        """Mean of the five circuits [Pa]."""
        return float(np.mean(self.ego().brake_pressures))
