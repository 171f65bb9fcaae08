"""Begins and ends the events of a configuration in a running traffic."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

from iits_mj.core.errors import InputError
from traffic_bridge.overrides import Undo
from traffic_bridge.signals.events import (
    Event,
    LaneClosure,
    LightOverride,
    LightProgramRun,
    SlowConvoy,
    SpeedLimit,
    StoppedVehicle,
    VehicleChange,
)
from traffic_bridge.signals.lights import LightPhase
from traffic_bridge.vehicles.scripted import Manner, ScriptedVehicle

if TYPE_CHECKING:
    from traffic_bridge.signals.controller import TrafficController

ROUNDING = 1e-9  # [s]: times of steps are sums of tenths


class EventRunner:
    """The events of one run: which are to come, which hold, which are over.

    Args:
      events: of the configuration.
      controller: what carries them out.
    """

    def __init__(self, events: Sequence[Event], controller: TrafficController) -> None:
        self._controller = controller
        self._to_come = list(events)
        # Changes of vehicles that are not there: the event and its end [s].
        self._waiting: list[tuple[VehicleChange, float]] = []
        self._holding: list[tuple[float, Undo]] = []

    def check(self) -> None:
        """Holds every event against the net and the route, before the drive begins.

        Raises:
          InputError: a lane, light, program or type is not there; the message names the event.
        """
        for event in self._to_come:
            try:
                _check(event, self._controller)
            except InputError as error:
                raise InputError(f"event {event.name}: {error}") from error

    def step(self, time: float, ego_station: float | None) -> None:
        """Ends what is over and begins what is due.

        Args:
          time: of the traffic [s].
          ego_station: of the truck's steer axle [m]; None without a truck.
        """
        if self._holding:
            over = [undo for until, undo in self._holding if until <= time + ROUNDING]
            self._holding = [entry for entry in self._holding if entry[0] > time + ROUNDING]
            for undo in over:
                undo()
        if self._waiting:
            self._waiting = [entry for entry in self._waiting if entry[1] > time + ROUNDING]
            there = [e for e in self._waiting if self._controller.has_vehicles(e[0].target)]
            self._waiting = [entry for entry in self._waiting if entry not in there]
            for change, last in there:
                self._begin(change, time, last)
        if not self._to_come:
            return
        due = [event for event in self._to_come if _is_due(event, time, ego_station)]
        if not due and not any(event.until is not None for event in self._to_come):
            return
        self._to_come = [
            event for event in self._to_come if event not in due and not _is_past(event, time)
        ]
        for event in due:
            if _is_past(event, time):
                continue
            end = event.until
            if end is None:
                end = math.inf if event.duration is None else time + event.duration
            if isinstance(event, VehicleChange) and not self._controller.has_vehicles(event.target):
                self._waiting.append((event, end))
            else:
                self._begin(event, time, end)

    def _begin(self, event: Event, time: float, end: float) -> None:
        try:
            undo = _begin(event, self._controller)
        except InputError as error:
            raise InputError(f"event {event.name} at {time:.1f} s: {error}") from error
        if end < math.inf:
            self._holding.append((end, undo))


def _is_due(event: Event, time: float, ego_station: float | None) -> bool:
    if event.at_station is not None:
        return ego_station is not None and ego_station >= event.at_station
    return (event.at_time or 0.0) <= time + ROUNDING


def _is_past(event: Event, time: float) -> bool:
    return event.until is not None and event.until <= time + ROUNDING


def _check(event: Event, controller: TrafficController) -> None:
    parts = controller.obstructions
    match event:
        case LightOverride():
            links = len(controller.state(event.light))
            if len(event.state) not in (1, links):
                raise InputError(
                    f"state {event.state!r} of traffic light {event.light!r}: 1 or {links} letters"
                )
        case LightProgramRun(phases=()):
            controller.phases(event.light, event.program)
        case LightProgramRun():
            phases = [LightPhase(*phase) for phase in event.phases]
            controller.define_program(event.light, event.program, phases)
        case SpeedLimit():
            controller.limits.check(event)
        case LaneClosure():
            parts.check_closure(event)
        case StoppedVehicle():
            parts.check(
                ScriptedVehicle("", event.type, event.lane, event.station, 0.0, Manner.STANDING)
            )
        case SlowConvoy():
            for vehicle in parts.convoy_group(0, event):
                parts.check(vehicle)
        case VehicleChange():
            controller.check_target(event.target)


def _begin(event: Event, controller: TrafficController) -> Undo:
    """Does what an event says; what is returned undoes it."""
    match event:
        case LightOverride():
            return controller.traffic_lights.hold_state(event.light, event.state)
        case LightProgramRun():
            return controller.traffic_lights.hold_program(event.light, event.program)
        case SpeedLimit():
            limit = controller.set_speed_limit(event.limit, event.start, event.end, event.lane)
            return lambda: controller.lift_speed_limit(limit)
        case LaneClosure():
            closure = controller.close_lane(event.lane, event.start, event.end, event.notice)
            return lambda: controller.open_lane(closure)
        case StoppedVehicle():
            notice = event.notice if event.hazard else None
            standing = controller.stop_vehicle(event.station, event.lane, event.type, notice)
            return lambda: controller.release(standing)
        case SlowConvoy():
            convoy = controller.convoy(
                event.station, event.speed, event.lane, event.count, event.type
            )
            return lambda: controller.release(convoy)
        case VehicleChange():
            return controller.change_vehicles(event.target, dict(event.parameters))
    raise InputError(f"event {event!r}: nothing knows how to begin it")
