"""What nobody can plan from is refused by name: states, places, masses, decisions."""

from __future__ import annotations

import math
from numbers import Integral

from iits_mj.errors import InputError
from iits_mj.messages import Decision, Scene
from iits_mj.parameters import TruckParameters

_USED = ("time", "station", "offset", "speed", "mass")
# An estimate of the mass may be wrong by this factor, no more.
_MASS_FACTOR = 2.0


class StateCheck:
    """Bounds of the truck's state for one truck on one road.

    Args:
      parameters: of the truck.
      length: of the road [m].
    """

    def __init__(self, parameters: TruckParameters, length: float) -> None:
        self.length = length
        self.mass_min = parameters.gross_mass(0.0) / _MASS_FACTOR
        self.mass_max = parameters.gross_mass(parameters.payload.mass_max) * _MASS_FACTOR

    def check(self, scene: Scene) -> None:
        """Refuses a truck whose state cannot be planned from.

        Raises:
          InputError: a value is not finite, the mass is no truck's, the station is off the road.
        """
        ego = scene.ego
        for name in _USED:
            value = getattr(ego, name)
            if not math.isfinite(value):
                raise InputError(f"state of the truck: {name} is {value}: not finite")
        if not self.mass_min <= ego.mass <= self.mass_max:
            raise InputError(
                f"state of the truck: mass is {ego.mass:g} kg: allowed is {self.mass_min:.0f} to "
                f"{self.mass_max:.0f} kg"
            )
        # A truck at an end of its road still has a part of itself on it.
        spare = scene.footprint.length
        if not -spare <= ego.station <= self.length + spare:
            raise InputError(
                f"state of the truck: station is {ego.station:g} m: the road has 0 to "
                f"{self.length:.0f} m"
            )


def named_decision(value: object) -> Decision:
    """The decision that a value stands for: a `Decision` or its number.

    Raises:
      InputError: it is none.
    """
    numbers = [int(decision) for decision in Decision]
    if isinstance(value, Integral) and not isinstance(value, bool) and int(value) in numbers:
        return Decision(int(value))
    allowed = ", ".join(f"Decision.{d.name} ({int(d)})" for d in Decision)
    raise InputError(f"decision is {value!r}: allowed is {allowed}")
