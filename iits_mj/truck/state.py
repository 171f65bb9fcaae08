"""Reads the state that the truck reports from MuJoCo's data."""

from __future__ import annotations

import ctypes
from typing import Any

import mujoco
import numpy as np

from iits_mj import kernels
from iits_mj.core.messages import EgoState, positional
from iits_mj.kernels import Address, Integer, Real
from iits_mj.model.connections import articulation_names
from iits_mj.parameters import TruckParameters
from iits_mj.road import Route
from iits_mj.truck.report import sensor_addresses

BRAKE_PRESSURES = tuple(
    f"brake_pressure_{place}"
    for place in ("front_left", "front_right", "rear_left", "rear_right", "trailer")
)
# Sensors that are read, and which of their numbers, in the order of `StateReader.read`. The yaw
# rate of the last unit and the articulations depend on the truck.
_BEGIN = (
    ("tractor_velocity", 0),
    ("tractor_velocity", 1),
    ("tractor_acceleration", 0),
    ("tractor_acceleration", 1),
    ("tractor_gyro", 2),
)
_READINGS = (
    ("steering_wheel_position", 0),
    ("steer_angle_left", 0),
    ("steer_angle_right", 0),
    ("gear", 0),
    ("shift_in_process", 0),
    ("engine_speed", 0),
    ("engine_torque", 0),
    ("fuel_rate", 0),
    ("fuel_used", 0),
    *((name, 0) for name in BRAKE_PRESSURES),
)


class _Sources(ctypes.Structure):
    """Addresses of what the compiled function reads; see iits_mj/kernels/truck_state.cc."""

    _fields_ = (
        ("position", Address),
        ("axes", Address),
        ("trailer", Address),
        ("gravity", Address),
        ("line", Address),
        ("sensors", Address),
        ("readings", Address),
        ("count", ctypes.c_int64),
    )


# Sources, a station near the truck and one near its trailer, and the row of results.
_read = kernels.function("iits_truck_state", Integer, Address, Real, Real, Address)
_ego_state = positional(EgoState)


class StateReader:
    """Reads `EgoState` from a model's data.

    Args:
      model: a compiled scene.
      parameters: of the truck.
      payload: of the truck [kg].
      route: its road.
      prefix: of the truck's names in the model.
    """

    def __init__(
        self,
        model: mujoco.MjModel,
        parameters: TruckParameters,
        payload: float,
        route: Route,
        prefix: str = "",
    ) -> None:
        address = sensor_addresses(model, prefix)
        last, couplings = parameters.last.name, articulation_names(parameters)
        self._couplings = len(couplings)
        read = (
            *_BEGIN,
            (f"{last}_gyro", 2),
            *_READINGS,
            *((f"{name}_{part}", 0) for part in ("yaw", "rate") for name in couplings),
        )
        self._readings = np.array([address[name] + i for name, i in read], dtype=np.int64)
        self._tractor = model.body(f"{prefix}tractor").id
        self._trailer = model.site(f"{prefix}{last}_axle_center").id
        self._mass = parameters.gross_mass(payload)
        self._route = route
        self._model: mujoco.MjModel | None = None
        self._data: mujoco.MjData | None = None
        self._sources: _Sources | None = None
        self._row: Any = None  # type of the array of results, which pickle does not find by name

    def __getstate__(self) -> dict[str, Any]:
        # A copy takes the addresses of its own model and data when it first reads them.
        return vars(self) | dict.fromkeys(("_model", "_data", "_sources", "_row"))

    def read(
        self, model: mujoco.MjModel, data: mujoco.MjData, near: float, trailer_near: float
    ) -> tuple[EgoState, float]:
        """Returns the state, and the station of the middle of the last unit's axle group [m].

        Args:
          model: of the truck.
          data: its data; the sensors are up to date.
          near: a station near the steer axle [m]; the whole route is searched if it is far away or
            not a number.
          trailer_near: likewise for the last unit's axle group.

        Raises:
          InputError: the truck's position is not finite.
        """
        if data is not self._data or model is not self._model:
            self._bind(model, data)
        row = self._row()
        found = _read(self._address, near, trailer_near, row)
        (
            x,
            y,
            z,
            yaw,
            pitch,
            roll,
            gravity_x,
            gravity_y,
            station,
            offset,
            trailer_station,
            trailer_offset,
            speed,
            lateral_speed,
            felt_x,
            felt_y,
            yaw_rate,
            trailer_yaw_rate,
            steering_wheel_angle,
            steer_left,
            steer_right,
            gear,
            shift_in_process,
            engine_speed,
            engine_torque,
            fuel_rate,
            fuel_used,
            *more,
        ) = row[:]
        air, bent = tuple(more[: len(BRAKE_PRESSURES)]), more[len(BRAKE_PRESSURES) :]
        number = self._couplings
        fold, turning = (-bent[0], -bent[number]) if number else (0.0, 0.0)
        if not found:
            station, offset = self._route.locate(x, y, near)
            rear_x, rear_y, _ = data.site_xpos[self._trailer].tolist()
            trailer_station, trailer_offset = self._route.locate(rear_x, rear_y, trailer_near)
        state = _ego_state(
            data.time,
            x,
            y,
            z,
            yaw,
            pitch,
            roll,
            speed,
            lateral_speed,
            felt_x + gravity_x,
            felt_y + gravity_y,
            yaw_rate,
            trailer_yaw_rate,
            fold,
            turning,
            steering_wheel_angle,
            0.5 * (steer_left + steer_right),
            self._mass,
            station,
            offset,
            trailer_offset,
            round(gear),
            shift_in_process > 0.5,
            engine_speed,
            engine_torque,
            fuel_rate,
            fuel_used,
            air,
            tuple(-angle for angle in bent[1:number]),
            tuple(-rate for rate in bent[number + 1 :]),
        )
        return state, trailer_station

    def _bind(self, model: mujoco.MjModel, data: mujoco.MjData) -> None:
        """Takes the addresses of arrays of a model and its data, which last as long as these."""
        address = kernels.address
        self._model, self._data = model, data
        self._row = Real * (12 + self._readings.size)
        self._sources = _Sources(
            position=address(data.xpos[self._tractor]),
            axes=address(data.xmat[self._tractor]),
            trailer=address(data.site_xpos[self._trailer]),
            gravity=address(model.opt.gravity),
            line=self._route.line.table.address,
            sensors=address(data.sensordata),
            readings=address(self._readings),
            count=self._readings.size,
        )
        self._address = ctypes.addressof(self._sources)
