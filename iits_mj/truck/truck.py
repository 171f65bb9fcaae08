"""The truck in MuJoCo: `Truck` loads, places, commands, steps and observes it."""

from __future__ import annotations

import contextlib
import dataclasses
import math
from collections.abc import Callable, Iterator, Mapping
from operator import attrgetter, le
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from iits_mj.core.checks import in_range, is_whole, one_of, shown
from iits_mj.core.errors import Error, InputError
from iits_mj.core.messages import (
    EgoState,
    TransmissionMode,
    TruckReport,
    VehicleCommand,
    XbrEbiMode,
    XbrMode,
)
from iits_mj.core.timing import PLANTS, TIMESTEP
from iits_mj.model.builder import truck_spec
from iits_mj.model.road_table import add_road_table
from iits_mj.model.scenery.road_scene import add_road
from iits_mj.parameters import AnyTruck, TruckParameters
from iits_mj.plugin import register
from iits_mj.road import Route
from iits_mj.truck.faults import Faults
from iits_mj.truck.placement import Poser, TruckPlacement
from iits_mj.truck.plant import Plant, reserve_state
from iits_mj.truck.report import Reporter, sensor_addresses
from iits_mj.truck.state import StateReader

COMMAND_FIELDS = tuple(field.name for field in dataclasses.fields(VehicleCommand))
_COMMAND_INDEX = {name: index for index, name in enumerate(COMMAND_FIELDS)}
_MODES = ("xbr_mode", "transmission_mode", "xbr_ebi_mode")
_MODE_INDEX = tuple(_COMMAND_INDEX[name] for name in _MODES)
_command_values = attrgetter(*COMMAND_FIELDS)
# Warnings after which MuJoCo resets the state.
_FATAL_WARNINGS = (
    mujoco.mjtWarning.mjWARN_BADQPOS,
    mujoco.mjtWarning.mjWARN_BADQVEL,
    mujoco.mjtWarning.mjWARN_BADQACC,
    mujoco.mjtWarning.mjWARN_BADCTRL,
)
_NO_SENSORS = int(mujoco.mjtDisableBit.mjDSBL_SENSOR)
_NO_CONTACTS = int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
# Callbacks that may read sensors during a step.
_CALLBACKS = (
    mujoco.get_mjcb_control,
    mujoco.get_mjcb_passive,
    mujoco.get_mjcb_sensor,
    mujoco.get_mjcb_act_dyn,
    mujoco.get_mjcb_act_gain,
    mujoco.get_mjcb_act_bias,
)
_NO_CALLBACK = [None] * len(_CALLBACKS)


def compile_scene(
    spec: mujoco.MjSpec,
    route: Route,
    timestep: float,
    *,
    visuals: bool,
    flat: bool = False,
    edit_spec: Callable[[mujoco.MjSpec], None] | None = None,
) -> mujoco.MjModel:
    """Adds the road to a specification with trucks, and compiles it.

    Args:
      spec: with the trucks.
      route: the road.
      timestep: of the physics [s], 0.0005 to 0.005.
      visuals: adds the visual geoms of the road.
      flat: leaves the road's surface out: the ground is the plane z = 0.
      edit_spec: called with the specification before it is compiled.

    Raises:
      InputError: the time step is not allowed, or MuJoCo refuses the scene.
    """
    if not flat:
        add_road_table(spec, route)
    if visuals:
        add_road(spec, route)
    if edit_spec is not None:
        edit_spec(spec)
    spec.option.timestep = in_range("timestep", timestep, 0.0005, 0.005, "s")
    try:
        return spec.compile()
    except ValueError as error:
        reason = " ".join(str(error).split())
        raise InputError(f"the truck's model does not compile: {reason}") from error


def _unread_sensors(model: mujoco.MjModel) -> int:
    """Flag that disables the sensors of a model, 0 if something may read them between the steps."""
    if model.nhistory or [get() for get in _CALLBACKS] != _NO_CALLBACK:
        return 0
    return _NO_SENSORS


@contextlib.contextmanager
def without_sensors(model: mujoco.MjModel) -> Iterator[None]:
    """Within this context, steps of the model do not compute sensors, an eighth of their time.

    It changes nothing where something may read sensors between the steps: a callback of MuJoCo, or
    a sensor or actuator with a history.
    """
    flags = model.opt.disableflags
    model.opt.disableflags = flags | _unread_sensors(model)
    try:
        yield
    finally:
        model.opt.disableflags = flags


def bring_up_to_date(model: mujoco.MjModel, data: mujoco.MjData) -> None:
    """Computes the sensors of the current state; after a step they belong to the state before.

    The solver's first guess is restored, so that an observation does not change later bits.
    """
    warm_start = data.qacc_warmstart.copy()
    mujoco.mj_forward(model, data)
    data.qacc_warmstart[:] = warm_start


class Truck:
    """A truck in MuJoCo, with what it tows, on a route or on a flat plane.

    `model` and `data` are plain MuJoCo objects: `mujoco.mj_step`, `mujoco.rollout` and the viewer
    work on them. `data.ctrl` has the order of `VehicleCommand`'s fields, from `control_start` on.
    `planar` is the planar plant that steps it, None for the full one.
    `faults` makes parts of the truck fail. `detects_contacts`: False leaves MuJoCo's collision
    detection out of `step` and `observe`, a sixth of their time, where nothing can touch.

    Args:
      model: a compiled scene with the truck in it; use `load` to make one.
      parameters, payload, route: of the scene.
      prefix: of the truck's names in a model of several (`iits_mj.truck.fleet`).
      plant: of `PLANTS`; see `load`.
      data: of the scene; default: new data, with the truck at the beginning of its road.

    Raises:
      InputError: the model lacks the truck's controls, or `data` is of another model.
    """

    def __init__(
        self,
        model: mujoco.MjModel,
        parameters: TruckParameters,
        payload: float,
        route: Route,
        *,
        prefix: str = "",
        plant: str = "full",
        data: mujoco.MjData | None = None,
    ) -> None:
        if data is not None and data.signature != model.signature:
            raise InputError("data were made for another model: use mujoco.MjData(model)")
        self.model = model
        self.data = mujoco.MjData(model) if data is None else data
        self.parameters = parameters
        self.payload = payload
        self.route = route
        self.prefix = prefix
        self.plant = one_of("plant", plant, PLANTS)
        self.planar = None if plant == "full" else Plant(plant, prefix)
        self.footprint = parameters.footprint
        names = tuple(
            name.removeprefix(prefix)
            for name in (model.actuator(i).name for i in range(model.nactuator))
            if name.startswith(prefix)
        )
        if names[: len(COMMAND_FIELDS)] != COMMAND_FIELDS:
            raise InputError(f"the model's controls are {names}, needed are {COMMAND_FIELDS}")
        first = model.actuator(prefix + COMMAND_FIELDS[0]).id
        self.control_start = int(model.actuator_ctrladr[first])
        self._controls = slice(self.control_start, self.control_start + len(COMMAND_FIELDS))
        self._address = sensor_addresses(model, prefix)
        self._ranges = model.actuator_ctrlrange[first : first + len(COMMAND_FIELDS)].tolist()
        self._lowest, self._greatest = zip(*self._ranges, strict=True)
        self.faults = Faults(self)
        self.detects_contacts = True
        self._reporter = Reporter(model, parameters, payload, prefix)
        self._poser = Poser(model, parameters, route, prefix)
        self._reader = StateReader(model, parameters, payload, route, prefix)
        # Stations of the steer axle and of the last unit's axle group when last observed.
        self._station_hint = self._trailer_hint = math.nan
        if data is None:
            self.reset()

    @classmethod
    def load(
        cls,
        payload: float | None = None,
        *,
        truck: AnyTruck | None = None,
        payload_height: float | None = None,
        parameters: TruckParameters | Mapping[str, Any] | str | Path | None = None,
        route: Route | None = None,
        timestep: float = TIMESTEP,
        plant: str = "full",
        visuals: bool = True,
        edit_spec: Callable[[mujoco.MjSpec], None] | None = None,
    ) -> Truck:
        """Builds the truck on its road and compiles it.

        Args:
          payload: of all units together [kg]; default: the greatest.
          truck: name of a shipped truck, a `truck.toml`, a folder with one, or parameters;
            default: the 6x4 tractor with semitrailer, which weighs 55 t laden.
          payload_height: of the loads' centers of gravity above the road [m]; default: the
            parameters'.
          parameters: of the truck, or an overlay (TOML file or mapping) over the figures of
            `truck`.
          route: the road; default: a flat plane, driven along x.
          timestep: of the physics [s], 0.0005 to 0.005.
          plant: model of the motion: "full", MuJoCo's bodies; "yaw-sideslip", planar motion with
            quasi-static load transfer; "yaw-roll", planar motion and the roll of each unit;
            "kinematic", planar motion of axles that do not slip sideways. Planar plants have the
            same tires, powertrain, brakes and steering, and cost a sixth.
          visuals: adds what pictures show of truck, road and landscape; the physics is the same
            without, a step takes less time.
          edit_spec: called with the specification before it is compiled, to add cameras, traffic.

        Raises:
          InputError: payload, its height, time step, plant or parameters are not allowed.
          PluginError: the engine plugin is missing.
        """
        register()
        one_of("plant", plant, PLANTS)

        def edit(spec: mujoco.MjSpec) -> None:
            if edit_spec is not None:
                edit_spec(spec)
            if plant != "full":
                reserve_state(spec)

        if not isinstance(parameters, TruckParameters):
            parameters = TruckParameters.load(truck, parameters)
        elif truck is not None:
            raise InputError("truck and complete parameters cannot both be given")
        parameters = parameters.with_payload_height(payload_height)
        payload = parameters.check_payload(payload)
        shown = route if route is not None else Route.straight()
        model = compile_scene(
            truck_spec(parameters, payload, visuals=visuals),
            shown,
            timestep,
            visuals=visuals,
            flat=route is None,
            edit_spec=edit,
        )
        return cls(model, parameters, payload, shown, plant=plant)

    @property
    def time(self) -> float:
        """Simulation time [s]."""
        return float(self.data.time)

    @property
    def behind(self) -> float:
        """Distance of the last unit's rear axle group behind the steer axle [m]."""
        return self._poser.behind

    @property
    def trailer_station(self) -> float:
        """Station of the middle of the last unit's axle group at the last observation [m]."""
        assert self._trailer_hint is not None
        return self._trailer_hint

    def reset(
        self,
        *,
        station: float = 20.0,
        offset: float = 0.0,
        speed: float = 0.0,
        heading: float = 0.0,
        articulation: float | None = None,
    ) -> EgoState:
        """Resets the scene with the truck at a place on its route, rolling freely.

        Arguments and errors are those of `TruckPlacement`.
        """
        place = TruckPlacement(
            station=station, offset=offset, speed=speed, heading=heading, articulation=articulation
        )
        mujoco.mj_resetData(self.model, self.data)
        self.place(place)
        if self.planar is None:
            mujoco.mj_forward(self.model, self.data)
        return self.observe()

    def place(self, place: TruckPlacement) -> None:
        """Writes a pose into data that were reset, without `mj_forward`."""
        self._poser.pose(self.data, place)
        self._station_hint = place.station
        self._trailer_hint = place.station - self._poser.behind

    def command(self, command: VehicleCommand | None = None, **fields: float) -> None:
        """Sets the controls; fields that are not given keep their value.

        Raises:
          InputError: unknown field, or a value that is no finite number, outside the control's
            range, or not whole for a mode. No control is changed then.
        """
        if command is not None:
            if not fields and self._set_all(command):
                return
            fields = {name: getattr(command, name) for name in COMMAND_FIELDS} | fields
        controls = self.data.ctrl[self._controls].copy()
        for name, value in fields.items():
            index = _COMMAND_INDEX.get(name)
            if index is None:
                raise InputError(f"unknown command {name!r}; there are {COMMAND_FIELDS}")
            controls[index] = in_range(f"command {name}", value, *self._ranges[index])
            if name in _MODES and not controls[index].is_integer():
                raise InputError(f"command {name} = {shown(value)}: a whole number is needed")
        self.data.ctrl[self._controls] = controls

    def _set_all(self, command: VehicleCommand) -> bool:
        """Sets all controls at once; returns False and sets none if a value is not allowed."""
        try:
            values = tuple(map(float, _command_values(command)))
        except (TypeError, ValueError):
            return False
        if not (all(map(le, self._lowest, values)) and all(map(le, values, self._greatest))):
            return False
        for index in _MODE_INDEX:
            if not values[index].is_integer():
                return False
        self.data.ctrl[self._controls] = values
        return True

    def step(self, n: int = 1) -> None:
        """Advances the physics by `n` time steps.

        Only the last step computes the sensors, unless something may read them between the steps: a
        callback of MuJoCo, or a sensor or actuator with a history. Meanwhile `model` has its
        sensors, and without `detects_contacts` its contacts, disabled: trucks that share a model
        must not step in several threads.

        Raises:
          InputError: `n` is not a whole number of zero or more.
          Error: the simulation diverged (MuJoCo reports a state that is not finite).
        """
        if not is_whole(n) or n < 0:
            raise InputError(f"step: n = {shown(n)}: a whole number of zero or more is needed")
        if self.planar is not None:
            self._step_planar(self.planar, n)
            return
        model, data, options = self.model, self.data, self.model.opt
        end = data.time + n * options.timestep
        flags = options.disableflags
        last = flags if self.detects_contacts else flags | _NO_CONTACTS
        try:
            if n > 1:
                options.disableflags = last | _unread_sensors(model)
                mujoco.mj_step(model, data, n - 1)
                n = 1
            options.disableflags = last
            mujoco.mj_step(model, data, n)
        finally:
            options.disableflags = flags
        if not any(data.warning.number.tolist()):
            return
        for warning in _FATAL_WARNINGS:
            if self.data.warning[warning].number:
                # MuJoCo reset the data at that moment, and their time counts from there.
                raise Error(
                    f"the simulation diverged at t = {end - self.data.time:.3f} s "
                    f"({warning.name}, element {self.data.warning[warning].lastinfo}); "
                    "use a smaller time step, unless the truck has rolled over"
                )

    def _step_planar(self, plant: Plant, n: int) -> None:
        start = self.data.time
        with self._contacts():
            (finite,) = plant.step(self.model, (self.data,), n)
        if not finite:
            raise Error(
                f"the simulation diverged after t = {start:.3f} s (plant {plant.kind}); "
                "use a smaller time step, unless the truck has rolled over"
            )

    @contextlib.contextmanager
    def _contacts(self) -> Iterator[None]:
        """Within this context the model has its contacts disabled, unless `detects_contacts`."""
        options = self.model.opt
        flags = options.disableflags
        if not self.detects_contacts:
            options.disableflags = flags | _NO_CONTACTS
        try:
            yield
        finally:
            options.disableflags = flags

    @property
    def left_range(self) -> tuple[str, ...]:
        """Limits of the plant's validity that were exceeded since the reset, in words.

        A planar plant goes on beyond them, but what it shows then is not what a truck does. The
        full plant has no such limits: its is empty.
        """
        return () if self.planar is None else self.planar.left_range(self.data)

    def sensor(self, name: str) -> NDArray[np.float64]:
        """Returns a sensor's reading at the last step or observation."""
        return np.array(self.data.sensor(self.prefix + name).data)

    def read(self, name: str, index: int = 0) -> float:
        """Returns one number of a sensor at the last step or observation; faster than `sensor`."""
        return float(self.data.sensordata[self._address[name] + index])

    def observe(self) -> EgoState:
        """Returns the truck's current state."""
        with self._contacts():
            self.update_sensors()
        return self.state()

    def update_sensors(self) -> None:
        """Computes the sensors of the current state; after a step they may be older."""
        if self.planar is None:
            bring_up_to_date(self.model, self.data)
        else:
            self.planar.step(self.model, (self.data,), 0, observe=True)

    def state(self) -> EgoState:
        """Returns the truck's state from sensors that are up to date (`update_sensors`)."""
        state, self._trailer_hint = self._reader.read(
            self.model, self.data, self._station_hint, self._trailer_hint
        )
        self._station_hint = state.station
        return state

    def last_command(self) -> VehicleCommand:
        """Returns the current controls."""
        values = dict(zip(COMMAND_FIELDS, map(float, self.data.ctrl[self._controls]), strict=True))
        return VehicleCommand(
            **{
                **values,
                "xbr_mode": XbrMode(round(values["xbr_mode"])),
                "transmission_mode": TransmissionMode(round(values["transmission_mode"])),
                "xbr_ebi_mode": XbrEbiMode(round(values["xbr_ebi_mode"])),
            }  # type: ignore[arg-type]
        )

    def report(self) -> TruckReport:
        """Returns the reports of the control units at the last step or observation.

        A quantity without sensor or control in this model is None.
        """
        return self._reporter.read(self.data, self.faults.abs_operational)
