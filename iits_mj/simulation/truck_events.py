"""Carries out the events of a scenario that change the truck's world or its parts."""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np

from iits_mj.core.errors import InputError
from iits_mj.model.road_table import friction_table
from iits_mj.truck import Truck
from traffic_bridge import (
    BrakeLeak,
    EventRecord,
    FrictionChange,
    Puncture,
    Scenario,
    StuckSpeedSensor,
    Wind,
)
from traffic_bridge.scenario.actions import Fault


class TruckEvents:
    """Wind, friction and faults of a running scenario, for one truck.

    Wind and friction are values of the model and change every 100 ms.

    Args:
      truck: whose model and faults change.
    """

    def __init__(self, truck: Truck) -> None:
        self._truck = truck
        self._friction, self._station = friction_table(truck.model)
        self._base = self._friction.copy(), truck.model.opt.wind.copy()
        # Headings of the truck at the beginnings of the winds [rad], and the faults that are there.
        self._headings: dict[int, float] = {}
        self._broken: set[int] = set()
        self._active: list[int] = []

    def restore(self) -> None:
        """Returns to the model's own wind and friction, for a new drive."""
        self._headings.clear()
        self._broken.clear()
        self._active.clear()
        self._friction[:], self._truck.model.opt.wind[:] = self._base

    def check(self, scenario: Scenario) -> None:
        """Checks the faults of a new drive; the truck is whole afterwards.

        Raises:
          InputError: the truck does not have a part that fails; the message names the event.
        """
        for event in scenario.faults:
            try:
                self._break(event)
            except InputError as error:
                raise InputError(f"event {event.title}: {error}") from error
            finally:
                self._truck.faults.clear()

    def apply(self, records: Iterable[EventRecord], time: float, heading: float) -> None:
        """Applies the events that last.

        Args:
          records: of the events that have begun and not ended.
          time: [s].
          heading: of the truck [rad].
        """
        present = list(records)
        names = [id(record) for record in present]
        winds = [record for record in present if isinstance(record.event, Wind)]
        if names == self._active and not winds:
            return
        if names != self._active:
            self._active = names
            self._friction[:] = self._base[0]
            for record in present:
                event = record.event
                if isinstance(event, FrictionChange):
                    self._change_friction(event)
                elif isinstance(event, Fault) and id(record) not in self._broken:
                    self._broken.add(id(record))
                    self._break(event)
        wind = self._base[1].copy()
        for record in winds:
            angle = self._headings.setdefault(id(record), heading)
            wind += _wind(record, time, angle)
        self._truck.model.opt.wind[:] = wind

    def _change_friction(self, event: FrictionChange) -> None:
        rows = (self._station >= event.start) & (self._station < event.end)
        right = event.friction if event.friction_right is None else event.friction_right
        self._friction[rows] = event.friction, right, event.split

    def _break(self, event: Fault) -> None:
        faults = self._truck.faults
        match event:
            case Puncture():
                faults.puncture(event.wheel, event.lost)
            case BrakeLeak():
                faults.leak(event.circuit, event.rate)
            case StuckSpeedSensor():
                faults.stick_speed_sensor(event.wheel, event.speed)


def _wind(record: EventRecord, time: float, heading: float) -> np.ndarray:
    """Velocity of the air [m/s], shape (3,)."""
    event = record.event
    assert isinstance(event, Wind)
    speed = event.speed
    if event.shape == "gust" and event.duration is not None:
        speed *= 0.5 - 0.5 * math.cos(math.tau * (time - record.begun) / event.duration)
    # It comes from this direction, so it blows to the opposite one.
    angle = heading + math.radians(event.direction) + math.pi
    return np.array([speed * math.cos(angle), speed * math.sin(angle), 0.0])
