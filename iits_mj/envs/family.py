"""The trucks of an environment: one, or a family from which each episode draws one."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TypeAlias

import numpy as np

from iits_mj.core.errors import InputError
from iits_mj.parameters import AnyTruck, TruckParameters

# One truck, or several for domain randomization; None for the default one.
Trucks: TypeAlias = AnyTruck | Sequence[AnyTruck] | None


class Family:
    """Trucks that may drive an episode.

    Args:
      truck: one, or a sequence of them.
      payload: of each [kg]; None: the greatest of each.
      payload_height: of the loads' centers of gravity above the road [m]; None: the trucks' own.

    Attributes:
      members: their parameters.

    Raises:
      InputError: there is no truck, one does not exist, or one may not carry the payload.
    """

    def __init__(
        self, truck: Trucks, payload: float | None = None, payload_height: float | None = None
    ) -> None:
        if isinstance(truck, str) or not isinstance(truck, Sequence):
            truck = [TruckParameters.load(truck)]
        self.members = tuple(TruckParameters.load(one) for one in truck)
        if not self.members:
            raise InputError("a family of trucks is empty: name at least one")
        for one in self.members:
            one.check_payload(payload)
            one.with_payload_height(payload_height)

    def draw(self, generator: np.random.Generator) -> int:
        """Returns the number of the next episode's truck; a single truck needs no draw."""
        return int(generator.integers(len(self.members))) if len(self.members) > 1 else 0

    def info(self, number: int) -> dict[str, str]:
        """Returns the entry `truck` of an episode's info: its name; none for a single truck."""
        return {"truck": self.members[number].name} if len(self.members) > 1 else {}
