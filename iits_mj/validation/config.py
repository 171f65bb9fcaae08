"""Options of `iits-mj validate`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from iits_mj import options
from iits_mj.options import option


@dataclass(frozen=True, kw_only=True)
class ValidateConfig:
    """How to validate the truck, the traffic and the planning."""

    payload: float | None = option(
        None,
        help="only this load on the semitrailer; without it laden and empty",
        unit="kg",
        low=0.0,
        high=36_000.0,
        metavar="KG",
    )
    timestep: float | None = option(
        None,
        help="time step of the physics; without it 0.001, in the quick form 0.002",
        unit="s",
        low=0.0005,
        high=0.005,
        metavar="S",
    )
    data: Path | None = option(
        None, help="recorded trajectories to hold the traffic against", metavar="FILE"
    )
    roads: Path | None = option(
        None,
        help="folder with the roads and cycles that fuel is measured on: jinan_altimap_pcc.csv, "
        "EPA_Ph2_urban_highway_55mph.csv, EPA_Ph2_rural_interstate_65mph.csv",
        metavar="DIR",
    )
    runs: Path | None = option(
        None,
        help="folder in which finished drives are kept, so that a validation that was stopped goes "
        "on; drives of another version of the code are not taken",
        metavar="DIR",
    )
    quick: bool = option(False, help="a shorter form that ends within a minute")

    def __post_init__(self) -> None:
        options.check(self)

    @property
    def step(self) -> float:
        """Time step to use [s]."""
        if self.timestep is not None:
            return self.timestep
        return 0.002 if self.quick else 0.001

    def payloads(self) -> tuple[float, ...]:
        """The loads to test [kg], the greatest first."""
        return (36_000.0, 0.0) if self.payload is None else (self.payload,)
