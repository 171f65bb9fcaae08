"""Places of a unit's visible parts: what the axles, couplings and neighbors leave room for."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

from iits_mj.model.statics import LIFT
from iits_mj.parameters import Axle, Coupling, Tire, TruckParameters, Unit

CAB_LENGTH, CAB_HEIGHT, CAB_FLOOR = 2.38, 3.70, 1.16  # [m]
WHEEL_SPACE = 0.0975  # [m], from a tire to parts ahead of and behind it
PLATES = ("fifth_wheel", "turntable")
# From the highest point of a tire to the floor above it [m]: of the same unit, and of a unit that
# turns above it.
_OWN_GAP, _TURNING_GAP = 0.12, 0.075
_DECK_MIN = 1.5  # [m], shortest load body
_REAR_GAP = 0.15  # [m], least distance from a tire to the end of a frame behind it


@dataclass(frozen=True)
class Layout:
    """A unit between its neighbors; x is ahead of the unit's origin, z above the road [m].

    Attributes:
      unit, ahead, behind: the unit and its neighbors; None at the ends of the combination.
      tires: by kind.
      payload: of the combination [kg].
    """

    unit: Unit
    ahead: Unit | None
    behind: Unit | None
    tires: Mapping[str, Tire]
    payload: float

    @property
    def rear(self) -> float:
        """End of the chassis: that of the body, but a frame without a body holds the last axle."""
        unit = self.unit
        end = unit.front_overhang - unit.length
        if self.plate is None and unit.kind not in ("tractor", "dolly"):
            return end
        last = unit.axles[-1]
        return min(end, -last.position - self.radius(last) - _REAR_GAP)

    @property
    def cab_rear(self) -> float:
        """Back of the cab."""
        return self.unit.front_overhang - CAB_LENGTH

    @property
    def cab_height(self) -> float:
        """Highest point of the cab; a rigid truck's load body may be higher."""
        height = self.unit.height
        return height if self.unit.kind == "tractor" else min(height, CAB_HEIGHT)

    @property
    def deck_front(self) -> float:
        """Front of the load body."""
        return self.cab_rear - 0.12 if self.unit.coupling is None else self.unit.front_overhang

    @property
    def deck_rear(self) -> float:
        """Rear of the load body, which ends ahead of a unit that turns on this one.

        Its front if there is no room for a load body.
        """
        end = max(self.unit.front_overhang - self.unit.length, self.clear_of_towed + 0.05)
        return end if self.deck_front - end > _DECK_MIN else self.deck_front

    @property
    def has_deck(self) -> bool:
        """Whether there is room for a load body."""
        return self.deck_rear < self.deck_front

    @property
    def clear_of_towed(self) -> float:
        """Foremost point that the corners of a unit on a plate reach; minus infinity without."""
        coupling = self.plate
        if coupling is None or self.behind is None:
            return -math.inf
        return math.hypot(self.behind.front_overhang, 0.5 * self.behind.width) - coupling.position

    @property
    def plate(self) -> Coupling | None:
        """The fifth wheel or turntable on this unit."""
        coupling = self.behind.coupling if self.behind else None
        return coupling if coupling and coupling.kind in PLATES else None

    @property
    def hitch(self) -> Coupling | None:
        """The coupling of a drawbar on this unit."""
        return self.behind.coupling if self.behind and self.plate is None else None

    @property
    def floor(self) -> float:
        """Underside of the load body: above the coupling's plate and all tires below the body."""
        coupling = self.unit.coupling
        least = [1.0]
        if coupling and coupling.kind in PLATES:
            least.append(coupling.height + 0.06)
            if self.ahead is not None:
                behind_front = [
                    axle
                    for axle in self.ahead.axles
                    if axle.position > coupling.position - self.unit.front_overhang
                ]
                least += [self._highest(axle) + _TURNING_GAP for axle in behind_front]
        ends = self.deck_front, self.deck_rear
        least += [
            self._highest(axle) + _OWN_GAP
            for axle in self.unit.axles
            if ends[1] < self.radius(axle) - axle.position and -axle.position < ends[0]
        ]
        return round(max(least), 6)

    def radius(self, axle: Axle) -> float:
        """Returns the radius of an axle's tires [m]."""
        return self.tires[axle.tire].free_radius

    def center(self, axle: Axle) -> float:
        """Returns the height of an axle's wheel centers, without the tires' deflection [m]."""
        return self.radius(axle) + (LIFT if axle.lifted(self.payload) else 0.0)

    def half_width(self, axle: Axle) -> float:
        """Returns half the width of what covers an axle's wheels on one side [m]."""
        return 0.30 if self.tires[axle.tire].count > 1 else 0.22

    def _highest(self, axle: Axle) -> float:
        """Returns the top of an axle's tires, lifted if that is possible."""
        return 2.0 * self.radius(axle) + (LIFT if axle.lifted_below > 0.0 else 0.0)


def layouts(p: TruckParameters, payload: float) -> list[Layout]:
    """Returns the layout of every unit, front to rear."""
    ahead = (None, *p.units[:-1])
    behind = (*p.units[1:], None)
    return [
        Layout(unit, before, after, p.tires, payload)
        for unit, before, after in zip(p.units, ahead, behind, strict=True)
    ]
