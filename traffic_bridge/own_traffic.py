"""The user's own traffic: what it must offer, its guard, and vehicles placed on a route."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, Protocol, runtime_checkable

from iits_mj.core.errors import InputError
from iits_mj.core.messages import EgoState
from iits_mj.core.own_parts import Guard, Kind, part_name
from iits_mj.core.vehicles import TrackedVehicle, VehicleFrame
from iits_mj.road import Route
from traffic_bridge.modes.sumo_modes import Mode
from traffic_bridge.scenario.actors import on_road
from traffic_bridge.scenario.runner import Scenario
from traffic_bridge.signals.controller import TrafficController
from traffic_bridge.vehicles.types import ALL_KINDS

_STEP = 0.1  # [s]


@runtime_checkable
class TrafficSource(Protocol):
    """Moves the other vehicles, every 100 ms.

    A class needs these methods and no base class. Its constructor may ask for `route`, `config`
    (`TrafficConfig`), `seed`, and `footprint`, the truck's size. Units and axes are those of
    `TrackedVehicle`; `vehicle_on` makes one at a place on the route. The same calls after `reset`
    must give the same vehicles, or drives do not repeat.

    A part may also have `close()`, `signal_controller()` and `exact_vehicles(time)`, see
    `traffic_bridge.Traffic`. A subclass of `InterSim` or of another mode has all of them.
    """

    def reset(self, ego: EgoState, /) -> Iterable[TrackedVehicle]:
        """Starts again; returns the vehicles at time zero.

        Args:
          ego: the truck at its start.
        """

    def step(self, ego: EgoState, /) -> Iterable[TrackedVehicle]:
        """Advances 0.1 s; returns the vehicles then, each with the id that it had before.

        Args:
          ego: the truck at the end of the step.
        """


TRAFFIC = Kind("traffic", TrafficSource, ("inter", "pure", "none"))


class OwnTraffic(Guard, Mode):
    """A user's traffic behind its guard.

    Args:
      part: of the user.
      route: the truck's road.

    Attributes:
      mode: its name in recordings.
    """

    kind = TRAFFIC

    def __init__(self, part: Any, route: Route) -> None:
        super().__init__(part)
        self.route = route
        self.mode = part_name(part)
        self._steps = 0

    @property
    def time(self) -> float:
        """Traffic time since the reset [s]."""
        return self._steps * _STEP

    def reset(self, ego: EgoState | None = None) -> VehicleFrame:
        """Starts the traffic again; returns the vehicles at time zero, sorted by name."""
        self._steps = 0
        return self._frame("reset", ego)

    def step(self, ego: EgoState | None = None) -> VehicleFrame:
        """Advances one step; returns the vehicles at its end, sorted by name."""
        self._steps += 1
        return self._frame("step", ego)

    def close(self) -> None:
        """Ends the traffic; may be called again."""
        if hasattr(self.part, "close"):
            self.call("close")

    def signal_controller(self) -> TrafficController | None:
        """Returns the lights and changing limits; None if the traffic has none."""
        has = hasattr(self.part, "signal_controller")
        found: TrafficController | None = self.call("signal_controller") if has else None
        return found

    def running_scenario(self) -> Scenario | None:
        """Returns the running events; None if the traffic has none."""
        has = hasattr(self.part, "running_scenario")
        found: Scenario | None = self.call("running_scenario") if has else None
        return found

    def exact_vehicles(self, time: float) -> VehicleFrame | None:
        """Returns the vehicles with known places between two steps; None if there are none."""
        if not hasattr(self.part, "exact_vehicles"):
            return None
        found = self.call("exact_vehicles", time)
        return None if found is None else self._checked("exact_vehicles", found)

    def _frame(self, method: str, ego: EgoState | None) -> VehicleFrame:
        return self._checked(method, self.call(method, ego))

    def _checked(self, method: str, vehicles: Any) -> VehicleFrame:
        try:
            frame = VehicleFrame.of(vehicles)
        except InputError as error:
            raise self.unusable(method, f"returned unusable vehicles: {error}") from error
        for name, kind in zip(frame.ids, frame.kinds, strict=True):
            if kind not in ALL_KINDS:
                allowed = ", ".join(ALL_KINDS)
                raise self.unusable(
                    method, f"returned vehicle {name!r} of kind {kind!r}; use one of: {allowed}"
                )
        return frame


def vehicle_on(
    route: Route, id: str, station: float, lane: int = 0, shift: float = 0.0, **more: Any
) -> TrackedVehicle:
    """Returns a vehicle that drives along a lane of a route.

    Args:
      route: the truck's road.
      id: name of the vehicle.
      station: of its center [m].
      lane: index from the outside.
      shift: to the left of the lane's middle [m].
      **more: further fields of `TrackedVehicle`, such as `speed`, `kind` and `length`.

    Raises:
      InputError: the lane does not exist there.
    """
    if not route.lane_exists(lane, station):
        raise InputError(
            f"vehicle {id!r}: lane {lane} does not exist at station {station:g} m; there are "
            f"{route.lane_count(station)}"
        )
    offset = float(route.lane_offset(lane, station)) + shift
    return on_road(route, id, station, offset, **({"lane": lane} | more))
