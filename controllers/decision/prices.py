"""Prices of lane changes in meters of way, and the flags that set them."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from iits_mj.core import options
from iits_mj.core.errors import InputError
from iits_mj.core.options import option


@dataclass(frozen=True)
class Prices:
    """Prices as distances; the bounds are those of the training.

    Attributes:
      lane_change: distance that a lane change must gain [m].
      imposed_braking: distance that spares a new follower a braking of 1 m/s2 [m/(m/s2)].
      left_lane: distance that is worth a second in the right lane [m/s].

    Raises:
      InputError: a price is out of its bounds; the message names it.
    """

    lane_change: float = option(
        100.0, help="distance that a lane change must gain", unit="m", low=10.0, high=400.0
    )
    imposed_braking: float = option(
        0.0,
        help="distance that spares a new follower a braking of 1 m/s2",
        unit="m/(m/s2)",
        low=0.0,
        high=60.0,
    )
    left_lane: float = option(
        0.0, help="distance that is worth a second in the right lane", unit="m/s", low=0.0, high=4.0
    )

    def __post_init__(self) -> None:
        options.check(self)

    @property
    def numbers(self) -> NDArray[np.float64]:
        """The prices in the order of the fields, shape (3,)."""
        return np.array(dataclasses.astuple(self), dtype=float)


def _price(name: str) -> Any:
    """Returns the field of a flag: a price that is not given, with the help of `Prices`."""
    found = {field.name: options.of(field) for field in dataclasses.fields(Prices)}[name]
    assert found is not None
    use = ": the method ddqn then uses its policy for every price" if name == "lane_change" else ""
    return option(
        None,
        help=found.help + use,
        unit=found.unit,
        low=found.low,
        high=found.high,
        metavar="PRICE",
        group="decision",
    )


@dataclass(frozen=True, kw_only=True)
class PriceOptions:
    """Flags of the prices of the decision maker ddqn."""

    lane_change_price: float | None = _price("lane_change")
    imposed_braking_price: float | None = _price("imposed_braking")
    left_lane_price: float | None = _price("left_lane")

    def prices(self) -> Prices | None:
        """Returns the prices; None without a price of a lane change.

        Raises:
          InputError: another price is given alone, or a price is out of its bounds.
        """
        others = {
            "imposed_braking": self.imposed_braking_price,
            "left_lane": self.left_lane_price,
        }
        given = {name: value for name, value in others.items() if value is not None}
        if self.lane_change_price is None:
            for name in given:
                flag = f"{name.replace('_', '-')}-price"
                raise InputError(f"{flag} needs lane-change-price: give both, or none")
            return None
        return Prices(self.lane_change_price, **given)
