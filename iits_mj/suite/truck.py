"""The domain `truck`: one factory per task, as in `dm_control.suite`."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import mujoco
from dm_control.rl import control
from dm_control.utils import containers

from controllers.decision.trip import SPAWN_PROBABILITY, TripConfig
from iits_mj.core.errors import InputError
from iits_mj.road import Route
from iits_mj.simulation.truck_world import TruckWorld
from iits_mj.suite import scene
from iits_mj.suite.physics import Physics, add_cameras
from iits_mj.suite.tasks import (
    Cruise,
    Dock,
    DrivingTask,
    Highway,
    HillStart,
    LaneChange,
    LaneKeep,
    Stop,
    TightTurn,
)
from iits_mj.suite.tasks.highway import HighwayEnvironment, HighwayPhysics
from iits_mj.truck import Truck

CONTROL_TIMESTEP = 0.1
TIMESTEP = 0.002
DECISION_TIMESTEP = 1.0

SUITE = containers.TaggedTasks()


@SUITE.add("benchmarking")
def cruise(**settings: Any) -> control.Environment:
    """Hold 20 m/s over hills; 60 s."""
    return _environment(Cruise, scene.hills(), 60.0, **settings)


@SUITE.add("benchmarking", "easy")
def stop(**settings: Any) -> control.Environment:
    """Stop at a line; 40 s."""
    return _environment(Stop, scene.flat(), 40.0, **settings)


@SUITE.add("benchmarking", "easy")
def hill_start(**settings: Any) -> control.Environment:
    """Start on a grade of 4 to 9 %; 20 s."""
    return _environment(HillStart, scene.uphill(), 20.0, **settings)


@SUITE.add("benchmarking", "hard")
def lane_keep(**settings: Any) -> control.Environment:
    """Keep the lane of a winding road; 60 s."""
    return _environment(LaneKeep, scene.winding(), 60.0, **settings)


@SUITE.add("benchmarking", "hard")
def lane_change(**settings: Any) -> control.Environment:
    """Double lane change at 60 km/h, laden; 30 s."""
    return _environment(LaneChange, scene.flat(), 30.0, **settings)


@SUITE.add("benchmarking", "hard")
def tight_turn(**settings: Any) -> control.Environment:
    """90 degree turn of 12.5 m within the swept path that the rules allow; 30 s."""
    return _environment(TightTurn, scene.turn(), 30.0, **settings)


@SUITE.add("benchmarking", "hard")
def dock(**settings: Any) -> control.Environment:
    """Reverse the semitrailer into a loading bay; 60 s."""
    return _environment(Dock, scene.yard(), 60.0, **settings)


@SUITE.add("hard")
def highway(
    *,
    time_limit: float = 180.0,
    random: Any = None,
    density: str = "dense",
    traffic_speed: float = 12.5,
    payload: float = 12_000.0,
    payload_height: float | None = None,
    visuals: bool = True,
    environment_kwargs: Mapping[str, Any] | None = None,
) -> control.Environment:
    """Choose lanes in SUMO traffic; 180 s.

    Args:
      time_limit: end of an episode [s].
      random: seed or `numpy.random.RandomState` of the task.
      density: of the traffic, "dense", "medium" or "sparse".
      traffic_speed: its speed limit [m/s].
      payload: on the semitrailer [kg].
      payload_height: of the load's centre of gravity above the road [m], 1.3 to 3.
      visuals: adds what is only seen.
      environment_kwargs: further arguments of `control.Environment`.

    Raises:
      InputError: an argument is not allowed. TrafficError: SUMO is not usable.
    """
    if density not in SPAWN_PROBABILITY:
        raise InputError(f"density {density!r} is unknown; allowed: {', '.join(SPAWN_PROBABILITY)}")
    trip = TripConfig(
        spawn_probability=SPAWN_PROBABILITY[density],
        traffic_speed=traffic_speed,
        duration=time_limit + 10.0,
        payload=payload,
    )
    world = TruckWorld(payload_height=payload_height, visuals=visuals, edit_spec=_add_common)
    options = {"control_timestep": DECISION_TIMESTEP, "legacy_step": False}
    return HighwayEnvironment(
        HighwayPhysics.from_world(world, trip),
        Highway(random=random),
        time_limit=time_limit,
        **{**options, **(environment_kwargs or {})},
    )


def _environment(
    kind: type[DrivingTask],
    route: Route,
    default_time_limit: float,
    *,
    time_limit: float | None = None,
    random: Any = None,
    payload: float = 36_000.0,
    payload_height: float | None = None,
    visuals: bool = True,
    environment_kwargs: Mapping[str, Any] | None = None,
) -> control.Environment:
    """One task.

    Args:
      kind: the task's class.
      route: its road.
      default_time_limit: end of an episode [s].
      time_limit: instead of the default [s].
      random: seed or `numpy.random.RandomState` of the task.
      payload: on the semitrailer [kg].
      payload_height: of the load's centre of gravity above the road [m], 1.3 to 3.
      visuals: adds road and landscape for pictures; the physics is the same without.
      environment_kwargs: further arguments of `control.Environment`.
    """

    def edit_spec(spec: mujoco.MjSpec) -> None:
        _add_common(spec)
        kind.edit_spec(spec)

    truck = Truck.load(
        payload,
        payload_height=payload_height,
        route=route,
        timestep=TIMESTEP,
        visuals=visuals,
        edit_spec=edit_spec,
    )
    options = {"control_timestep": CONTROL_TIMESTEP, "legacy_step": False}
    return control.Environment(
        Physics.from_truck(truck),
        kind(random=random),
        time_limit=default_time_limit if time_limit is None else time_limit,
        **{**options, **(environment_kwargs or {})},
    )


def _add_common(spec: mujoco.MjSpec) -> None:
    """Colors and cameras of every task."""
    scene.add_reward_colors(spec)
    add_cameras(spec)
