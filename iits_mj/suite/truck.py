"""The domain `truck`: one factory per task, as in `dm_control.suite`."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import mujoco
from dm_control.rl import control
from dm_control.utils import containers

from controllers.decision.trip import SPAWN_PROBABILITY, TripConfig, usual_payload
from iits_mj.core.checks import one_of
from iits_mj.core.timing import TIMESTEP
from iits_mj.parameters import AnyTruck, TruckParameters
from iits_mj.simulation.truck_world import TruckWorld
from iits_mj.suite import scene
from iits_mj.suite.physics import Physics, add_cameras
from iits_mj.suite.tasks import DRIVING_TASKS, DrivingTask, Highway
from iits_mj.suite.tasks.highway import HighwayEnvironment, HighwayPhysics
from iits_mj.truck import Truck

DECISION_TIMESTEP = 1.0

SUITE = containers.TaggedTasks()


def _factory(name: str, kind: type[DrivingTask]) -> Callable[..., control.Environment]:
    """Returns the function that builds a task's environment."""

    def build(
        *,
        time_limit: float | None = None,
        random: Any = None,
        truck: AnyTruck | None = None,
        payload: float | None = None,
        payload_height: float | None = None,
        plant: str = "full",
        visuals: bool = True,
        environment_kwargs: Mapping[str, Any] | None = None,
    ) -> control.Environment:
        def edit_spec(spec: mujoco.MjSpec) -> None:
            _add_common(spec)
            kind.edit_spec(spec)

        made = Truck.load(
            payload,
            truck=truck,
            payload_height=payload_height,
            route=kind.road(),
            timestep=TIMESTEP,
            plant=plant,
            visuals=visuals,
            edit_spec=edit_spec,
        )
        options = {"control_timestep": kind.period, "legacy_step": False}
        return control.Environment(
            Physics.from_truck(made),
            kind(random=random),
            time_limit=kind.time_limit if time_limit is None else time_limit,
            **{**options, **(environment_kwargs or {})},
        )

    build.__name__ = name
    build.__doc__ = f"""{(kind.__doc__ or "").splitlines()[0]}

    Args:
      time_limit: end of an episode [s]; default: {kind.time_limit:g} s.
      random: seed or `numpy.random.RandomState` of the task.
      truck: see `Truck.load`.
      payload: of all units together [kg]; default: the greatest.
      payload_height: of the loads' centers of gravity above the road [m].
      plant: model of the truck's motion; see `Truck.load`.
      visuals: adds road and landscape for pictures; the physics is the same without.
      environment_kwargs: further arguments of `control.Environment`.
    """
    return build


for _name, _kind in DRIVING_TASKS.items():
    SUITE.add("benchmarking", *_kind.tags)(_factory(_name, _kind))


@SUITE.add("hard")
def highway(
    *,
    time_limit: float = 180.0,
    random: Any = None,
    density: str = "dense",
    traffic_speed: float = 12.5,
    truck: AnyTruck | None = None,
    payload: float | None = None,
    payload_height: float | None = None,
    plant: str = "full",
    visuals: bool = True,
    environment_kwargs: Mapping[str, Any] | None = None,
) -> control.Environment:
    """Choose lanes in SUMO traffic for 180 s.

    Args:
      time_limit: end of an episode [s].
      random: seed or `numpy.random.RandomState` of the task.
      density: of the traffic, "dense", "medium" or "sparse".
      traffic_speed: speed limit of the traffic [m/s].
      truck: see `Truck.load`.
      payload: of all units together [kg]; default: 12 t, or the truck's greatest if that is less.
      payload_height: of the loads' centers of gravity above the road [m].
      plant: model of the truck's motion; see `Truck.load`.
      visuals: adds the visual geoms.
      environment_kwargs: further arguments of `control.Environment`.

    Raises:
      InputError: an argument is not allowed. TrafficError: SUMO is not usable.
    """
    one_of("density", density, SPAWN_PROBABILITY)
    parameters = TruckParameters.load(truck)
    trip = TripConfig(
        truck=parameters,
        spawn_probability=SPAWN_PROBABILITY[density],
        traffic_speed=traffic_speed,
        duration=time_limit + 10.0,
        payload=usual_payload(parameters) if payload is None else payload,
    )
    world = TruckWorld(
        payload_height=payload_height, plant=plant, visuals=visuals, edit_spec=_add_common
    )
    options = {"control_timestep": DECISION_TIMESTEP, "legacy_step": False}
    return HighwayEnvironment(
        HighwayPhysics.from_world(world, trip),
        Highway(random=random),
        time_limit=time_limit,
        **{**options, **(environment_kwargs or {})},
    )


def _add_common(spec: mujoco.MjSpec) -> None:
    """Adds the colors and cameras that all tasks share."""
    scene.add_reward_colors(spec)
    add_cameras(spec)
