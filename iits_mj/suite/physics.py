"""`Physics` of the domain with named getters, its cameras, and observations that tasks share.

Names of bodies and sensors of the model occur only here.
"""

from __future__ import annotations

import contextlib
import copy
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import mujoco
import numpy as np
from dm_control.mujoco import Physics as BasePhysics
from dm_control.mujoco import wrapper

from iits_mj.core.arrays import FloatArray
from iits_mj.core.messages import EgoState, VehicleCommand
from iits_mj.road import RoadPoint, Route
from iits_mj.simulation.gaps import truck_boxes
from iits_mj.truck import Truck
from iits_mj.truck.fleet import TruckFleet


@dataclass(frozen=True)
class Observed:
    """Description of a task's observation.

    Attributes:
      scale: usual size in `unit`; a learner sees the observation divided by it.
      unit: SI unit, "1" for pure numbers.
      meaning: in words.
      source: sensor, body or site of the model, or the road.
      size: number of its values.
    """

    scale: float
    unit: str
    meaning: str
    source: str
    size: int = 1


INSTRUMENTS = {
    "speed": Observed(
        25.0, "m/s", "of the steer axle along the tractor", "sensor `tractor_velocity`"
    ),
    "acceleration": Observed(
        2.0, "m/s2", "along the tractor, without gravity", "sensor `tractor_acceleration`"
    ),
    "gear": Observed(12.0, "1", "1 to 12, -1 in reverse, 0 in neutral", "sensor `gear`"),
    "engine_speed": Observed(220.0, "rad/s", "of the crankshaft", "sensor `engine_speed`"),
    "engine_torque": Observed(2700.0, "N m", "at the crankshaft", "sensor `engine_torque`"),
    "brake_pressure": Observed(
        8e5, "Pa", "mean of the five circuits", "sensors `brake_pressure_*`"
    ),
}
# For tasks at a nearly constant speed, in which the gear has no information.
WITHOUT_GEAR = {name: entry for name, entry in INSTRUMENTS.items() if name != "gear"}

BENDING = {
    "articulation": Observed(
        0.1, "rad", "tractor's yaw less the trailer's", "sensor `articulation_yaw`, negative"
    ),
    "yaw_rate": Observed(0.1, "rad/s", "of the tractor", "sensor `tractor_gyro`"),
    "steering_wheel_angle": Observed(
        1.0, "rad", "actual, left positive", "sensor `steering_wheel_position`"
    ),
}


def wide(bending: dict[str, Observed]) -> dict[str, Observed]:
    """Returns the observations with the scales of maneuvers at walking pace."""
    sizes = {"articulation": 0.5, "yaw_rate": 0.2, "steering_wheel_angle": 10.0}
    return {name: replace(entry, scale=sizes[name]) for name, entry in bending.items()}


# Cameras fixed to the tractor: position, and the picture's x and y axes, in its frame. "chase" is
# that far behind the tractor with its semitrailer, whose rear is at `_REAR` [m].
_REAR = -15.1
CAMERAS = {
    "chase": ((-27.0, 0.0, 8.0), (0.0, -1.0, 0.0), (0.22, 0.0, 0.98)),
    "side": ((-5.0, -24.0, 4.0), (1.0, 0.0, 0.0), (0.0, 0.09, 0.99)),
    "cab": ((0.9, 0.0, 2.6), (0.0, -1.0, 0.0), (0.05, 0.0, 1.0)),
}


def add_cameras(spec: mujoco.MjSpec, prefix: str = "") -> None:
    """Adds the suite's cameras to the tractor with this prefix."""
    tractor = spec.body(f"{prefix}tractor")
    longer = round(_rear(tractor) - _REAR, 3)
    for name, (position, right, up) in CAMERAS.items():
        if name == "chase":
            position = (position[0] + longer, *position[1:])
        axes = np.column_stack([right, up, np.cross(right, up)])
        axes /= np.linalg.norm(axes, axis=0)
        quaternion = np.zeros(4)
        mujoco.mju_mat2Quat(quaternion, axes.ravel())
        tractor.add_camera(name=prefix + name, pos=position, quat=quaternion)


def _rear(body: mujoco.MjsBody) -> float:
    """Returns the place of the rear of a body and those that it tows [m], along its x axis."""
    hulls = [geom for geom in body.geoms if geom.name.endswith("_hull")]
    own = [float(geom.pos[0] - geom.size[0]) for geom in hulls]
    return min([0.0, *own, *(float(towed.pos[0]) + _rear(towed) for towed in body.bodies)])


def _reading(name: str, doc: str) -> Callable[[Physics], float]:
    """Returns a getter of `Physics` for a field of the truck's state."""

    def get(physics: Physics) -> float:
        return float(getattr(physics.ego(), name))

    get.__name__, get.__doc__ = name, doc
    return get


class Physics(BasePhysics):
    """MuJoCo physics of a `Truck` with named getters; SI units, ISO 8855 axes.

    Made by `from_truck`. `truck` shares the model and data of this physics.
    """

    speed = _reading("speed", "Forward speed of the tractor [m/s].")
    acceleration = _reading("acceleration", "Forward acceleration of the tractor [m/s2].")
    lateral_acceleration = _reading(
        "lateral_acceleration", "Lateral acceleration of the tractor [m/s2]."
    )
    station = _reading("station", "Steer axle along the road [m].")
    offset = _reading("offset", "Steer axle left of the road's line [m].")
    trailer_offset = _reading(
        "trailer_offset", "Middle of the trailer's axle group left of the road's line [m]."
    )
    roll = _reading("roll", "Roll of the tractor [rad], right side down positive.")
    articulation = _reading("articulation", "Tractor's yaw less the trailer's [rad].")
    yaw_rate = _reading("yaw_rate", "Yaw rate of the tractor [rad/s].")
    steering_wheel_angle = _reading("steering_wheel_angle", "Actual steering-wheel angle [rad].")
    engine_speed = _reading("engine_speed", "Engine speed [rad/s].")
    engine_torque = _reading("engine_torque", "Engine torque [N m].")

    truck: Truck
    _state: EgoState

    @classmethod
    def from_truck(cls, truck: Truck) -> Physics:
        """Returns the physics of a truck, whose `data` becomes that of the physics."""
        physics: Physics = cls.from_model(wrapper.MjModel(truck.model))
        physics._bind(truck)
        return physics

    @classmethod
    def of_fleet(cls, fleet: TruckFleet) -> tuple[Physics, ...]:
        """Returns a physics for each truck of a fleet; all share the fleet's data."""
        members = tuple(cls(wrapper.MjData(fleet.data)) for _ in fleet.trucks)
        for physics, truck in zip(members, fleet.trucks, strict=True):
            physics._bind(truck)
        return members

    def _bind(self, truck: Truck) -> None:
        self.truck = truck
        self.truck.data = self.data.ptr
        # Moments of the state that `ego` returns, and of the sensors.
        self._key: tuple[float, bytes, bytes] | None = None
        self._sensors_key: tuple[float, bytes, bytes] | None = None
        self._held = False

    def __getstate__(self) -> tuple[wrapper.MjData, Truck]:
        return self.data, self.truck

    def __setstate__(self, state: tuple[wrapper.MjData, Truck]) -> None:
        data, truck = state
        # The base class computes the positions again, and with them the solver's first guess.
        warm_start, sensors = data.qacc_warmstart.copy(), data.sensordata.copy()
        super().__setstate__(data)
        data.qacc_warmstart[:], data.sensordata[:] = warm_start, sensors
        truck.model = self.model.ptr
        self._bind(truck)

    def copy(self, share_model: bool = False) -> Physics:
        """Returns a copy with its own data (and model, unless shared)."""
        twin: Physics = super().copy(share_model=share_model)
        truck = copy.copy(self.truck)
        truck.model = twin.model.ptr
        twin._bind(truck)
        return twin

    @property
    def route(self) -> Route:
        """The road."""
        return self.truck.route

    def place(self, station: float, offset: float, speed: float, **attitude: float) -> None:
        """Puts the truck on its road, coasting; see `Truck.reset`."""
        self.truck.reset(station=station, offset=offset, speed=speed, **attitude)
        self._key = self._sensors_key = None

    def command(self, command: VehicleCommand) -> None:
        """Sets the truck's controls."""
        self.truck.command(command)

    def step(self, nstep: int = 1) -> None:
        """Advances the physics by `nstep` time steps, with the truck's plant."""
        if self.truck.plant == "full":
            super().step(nstep)
            return
        with self.check_invalid_state():
            self.truck.step(nstep)

    def ego(self) -> EgoState:
        """Returns the truck's state now; the same object until the state changes."""
        if self._held:
            return self._state
        key = self._moment()
        if key != self._key:
            if key != self._sensors_key:
                self.update_sensors()
            self._state = self.truck.state()
            self._key = key
        return self._state

    @contextlib.contextmanager
    def held(self) -> Iterator[None]:
        """Within this context `ego` does not look whether the state has changed."""
        self.ego()
        self._held = True
        try:
            yield
        finally:
            self._held = False

    def update_sensors(self) -> None:
        """Computes the sensors now, as `ego` does unless they are; safe in a thread."""
        self.truck.update_sensors()
        self._sensors_key = self._moment()

    def _moment(self) -> tuple[float, bytes, bytes]:
        data = self.truck.data
        return data.time, data.qpos.tobytes(), data.qvel.tobytes()

    def trailer_station(self) -> float:
        """Returns the station of the middle of the trailer's axle group [m]."""
        self.ego()
        return self.truck.trailer_station

    def trailer_rear(self) -> tuple[float, float, float]:
        """Returns x, y of the middle of the last unit's rear end [m], and its yaw [rad]."""
        ego = self.ego()
        corners = truck_boxes(ego, self.truck.parameters)[-1]
        x, y = corners[2:].mean(axis=0).tolist()
        return x, y, ego.yaw - ego.articulation - sum(ego.rear_articulations)

    def outline_offsets(self) -> FloatArray:
        """Returns offsets of points around all units from the road's line [m], (n,)."""
        ego = self.ego()
        lead, *towed = truck_boxes(ego, self.truck.parameters)
        points = np.concatenate([_around(lead, 4), *(_around(unit, 16) for unit in towed)])
        near = self.station() - 0.5 * self.truck.behind
        return np.array([self.route.locate(x, y, near)[1] for x, y in points.tolist()])

    def heading_error(self) -> float:
        """Returns the tractor's heading minus the road's [rad]."""
        ego = self.ego()
        error = ego.yaw - float(self.route.evaluate(ego.station, 0.0).heading)
        return float(np.arctan2(math.sin(error), math.cos(error)))

    def grade_ahead(self, distances: tuple[float, ...]) -> list[float]:
        """Returns the road's grade at distances ahead of the steer axle [m]."""
        return [float(point.grade) for point in self._road_ahead(distances)]

    def curvature_ahead(self, distances: tuple[float, ...]) -> list[float]:
        """Returns the road's curvature at distances ahead [1/m], left positive."""
        return [float(point.curvature) for point in self._road_ahead(distances)]

    def _road_ahead(self, distances: tuple[float, ...]) -> list[RoadPoint]:
        route, station = self.route, self.station()
        return [route.evaluate(min(station + distance, route.length)) for distance in distances]

    def gear(self) -> int:
        """Returns the gear, 1 to 12; 0 in neutral, -1 in reverse."""
        return self.ego().gear

    def brake_pressure(self) -> float:
        """Returns the mean brake pressure of the five circuits [Pa]."""
        # Not `sum`, which rounds differently from Python 3.12 on.
        a, b, c, d, e = self.ego().brake_pressures
        return (a + b + c + d + e) / 5


def _around(corners: FloatArray, parts: int) -> FloatArray:
    """Returns points around a box, `parts` per side: (4, 2) to (4 * parts, 2)."""
    share = np.arange(parts)[:, None] / parts
    following = np.roll(corners, -1, axis=0)
    sides = [a + share * (b - a) for a, b in zip(corners, following, strict=True)]
    return np.concatenate(sides)
