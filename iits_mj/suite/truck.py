"""The domain `truck`: one factory per task, as in `dm_control.suite`."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from dm_control.rl import control
from dm_control.utils import containers

from iits_mj.road import Route
from iits_mj.suite import roads
from iits_mj.suite.physics import Physics, add_cameras
from iits_mj.suite.tasks import Cruise, DrivingTask, HillStart, LaneKeep, Stop
from iits_mj.truck import Truck

CONTROL_TIMESTEP = 0.1
TIMESTEP = 0.002
HILL_GRADE = 0.08

SUITE = containers.TaggedTasks()


@SUITE.add("benchmarking")
def cruise(**settings: Any) -> control.Environment:
    """Hold 20 m/s over hills; 60 s."""
    return _environment(Cruise, roads.hills(), 60.0, **settings)


@SUITE.add("benchmarking", "easy")
def stop(**settings: Any) -> control.Environment:
    """Stop at a line; 40 s."""
    return _environment(Stop, roads.flat(), 40.0, **settings)


@SUITE.add("benchmarking", "easy")
def hill_start(**settings: Any) -> control.Environment:
    """Start on an 8 % grade; 20 s."""
    return _environment(HillStart, roads.uphill(HILL_GRADE), 20.0, **settings)


@SUITE.add("benchmarking", "hard")
def lane_keep(**settings: Any) -> control.Environment:
    """Keep the lane of a winding road; 60 s."""
    return _environment(LaneKeep, roads.winding(), 60.0, **settings)


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
    truck = Truck.load(
        payload,
        payload_height=payload_height,
        route=route,
        timestep=TIMESTEP,
        visuals=visuals,
        edit_spec=add_cameras,
    )
    options = {"control_timestep": CONTROL_TIMESTEP, "legacy_step": False}
    return control.Environment(
        Physics.from_truck(truck),
        kind(random=random),
        time_limit=default_time_limit if time_limit is None else time_limit,
        **{**options, **(environment_kwargs or {})},
    )
