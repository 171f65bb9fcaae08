"""The truck as a `dm_control.composer.Entity`, of which an arena may have several.

    arena = composer.Arena()
    truck = TruckEntity(payload=20_000.0)
    frame = arena.add_free_entity(truck)
    use_options(arena.mjcf_model)

The tires roll on the plane z = 0, independent of the arena's floor, unless the model has a road
(`iits_mj.model.road_table`). `truck.actuators` are the ten commands. Physics and environments of
dm_control step in two halves by default: use `legacy_step=False`.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from typing import Any

from dm_control import composer, mjcf
from dm_control.composer.observation import observable

from iits_mj.core.timing import TIMESTEP
from iits_mj.core.units import GRAVITY
from iits_mj.model.builder import truck_spec, truck_xml
from iits_mj.parameters import AnyTruck, TruckParameters
from iits_mj.plugin import register
from iits_mj.truck import COMMAND_FIELDS


def truck_mjcf(
    payload: float | None = None, truck: AnyTruck | None = None, *, visuals: bool = True
) -> mjcf.RootElement:
    """Returns the truck without its free joint, for `add_free_entity`.

    Args:
      payload: of all units together [kg]; default: the greatest.
      truck: see `Truck.load`.
      visuals: adds the visual geoms.

    Raises:
      InputError: there is no such truck, or it may not carry the payload.
      PluginError: the engine plugin is missing.
    """
    register()
    parameters = TruckParameters.load(truck)
    payload = parameters.check_payload(payload)
    root = ET.fromstring(truck_xml(parameters, payload))
    if visuals:
        _add_visuals(root, parameters, payload)
    keyframe = root.find("keyframe")
    if keyframe is not None:
        root.remove(keyframe)
    model = mjcf.from_xml_string(ET.tostring(root, encoding="unicode"))
    model.find("body", "tractor").freejoint.remove()
    return model


def use_options(model: mjcf.RootElement, timestep: float = TIMESTEP) -> None:
    """Gives an arena the integrator, solver, gravity and time step [s] of the truck's model.

    Those of `composer.Arena` suit manipulation.
    """
    model.option.integrator = "implicitfast"
    model.option.cone = "pyramidal"
    model.option.noslip_iterations = 0
    model.option.gravity = (0.0, 0.0, -GRAVITY)
    model.option.timestep = timestep


class TruckEntity(composer.Entity):
    """An articulated truck to attach with `Arena.add_free_entity`."""

    def _build(
        self,
        payload: float | None = None,
        truck: AnyTruck | None = None,
        *,
        visuals: bool = True,
        name: str = "truck",
    ) -> None:
        self._model = truck_mjcf(payload, truck, visuals=visuals)
        self._model.model = name

    def _build_observables(self) -> composer.Observables:
        return TruckObservables(self)

    @property
    def mjcf_model(self) -> mjcf.RootElement:
        """The model."""
        return self._model

    @property
    def actuators(self) -> tuple[Any, ...]:
        """The commands, in the order of the fields of `VehicleCommand`."""
        return tuple(self._model.find("actuator", name) for name in COMMAND_FIELDS)

    @property
    def tractor(self) -> Any:
        """Body of the motor vehicle; its origin is the middle of the steer axle on the ground."""
        return self._model.find("body", "tractor")

    @property
    def trailer(self) -> Any:
        """Body of the trailer; its origin is its coupling. None without one of this name."""
        return self._model.find("body", "trailer")


class TruckObservables(composer.Observables):
    """Readings of the truck's sensors, in SI units."""

    @composer.observable
    def velocity(self) -> observable.MJCFFeature:
        """Velocity of the steer axle's middle in the tractor's frame [m/s], shape (3,)."""
        return self._sensor("tractor_velocity")

    @composer.observable
    def angular_velocity(self) -> observable.MJCFFeature:
        """Angular velocity of the tractor [rad/s], shape (3,)."""
        return self._sensor("tractor_gyro")

    @composer.observable
    def hitch_angle(self) -> observable.MJCFFeature:
        """Trailer's yaw less the tractor's [rad], shape (1,)."""
        return self._sensor("articulation_yaw")

    @composer.observable
    def engine_speed(self) -> observable.MJCFFeature:
        """Engine speed [rad/s], shape (1,)."""
        return self._sensor("engine_speed")

    @composer.observable
    def gear(self) -> observable.MJCFFeature:
        """Gear: -1 in reverse, 0 in neutral, else 1 to 12; shape (1,)."""
        return self._sensor("gear")

    def _sensor(self, name: str) -> observable.MJCFFeature:
        return observable.MJCFFeature("sensordata", self._entity.mjcf_model.find("sensor", name))


def _add_visuals(root: ET.Element, parameters: TruckParameters, payload: float) -> None:
    """Adds visual geoms and their assets; copies no mechanics, which `to_xml` rounds."""
    spec = truck_spec(parameters, payload)
    spec.compile()
    seen = ET.fromstring(spec.to_xml())
    known = {geom.get("name") for geom in root.iter("geom")}
    assets = seen.find("asset")
    if assets is not None:
        root.append(assets)
    bodies = {body.get("name"): body for body in root.iter("body")}
    for body in seen.iter("body"):
        for child in body.findall("body"):
            # A body that only shows something.
            if child.get("name") not in bodies:
                at = ET.SubElement(bodies[body.get("name")], "body", name=child.get("name", ""))
                bodies[child.get("name")] = at
        for geom in body.findall("geom"):
            if geom.get("name") not in known:
                geom.attrib.pop("class", None)
                bodies[body.get("name")].append(geom)
