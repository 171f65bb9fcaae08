"""Options of `iits-mj validate`, and the files of roads and cycles outside of this package."""

from __future__ import annotations

import functools
from dataclasses import dataclass
from pathlib import Path

from iits_mj.core import options
from iits_mj.core.errors import InputError
from iits_mj.core.options import option, timestep_option
from iits_mj.core.timing import TIMESTEP
from iits_mj.parameters import (
    AnyTruck,
    TruckParameters,
    check_truck,
    payload_option,
    shipped_trucks,
    truck_option,
)

PAPER_ROAD = "jinan_altimap_pcc.csv"
CYCLE_55 = "EPA_Ph2_urban_highway_55mph.csv"
CYCLE_65 = "EPA_Ph2_rural_interstate_65mph.csv"
NAMES = (PAPER_ROAD, CYCLE_55, CYCLE_65)
_SUBFOLDERS = ("", "road", "cycles")
# Time step of the physics where none is chosen [s]; the quick form uses TIMESTEP.
FINE_TIMESTEP = 0.001


@functools.cache
def laden() -> float:
    """Greatest payload of the default truck [kg]."""
    return TruckParameters.load().payload_max


@dataclass(frozen=True, kw_only=True)
class ValidateConfig:
    """Settings for validating the truck, the traffic and the planning."""

    truck: AnyTruck | None = truck_option("truck to validate")
    payload: float | None = payload_option(
        None, help="only this load; default: greatest load and no load"
    )
    timestep: float | None = timestep_option(
        None, f"; default: {FINE_TIMESTEP:g}, with --quick {TIMESTEP:g}"
    )
    data: Path | None = option(
        None, help="recorded trajectories to compare the traffic with", metavar="FILE", group="data"
    )
    measured: Path | None = option(
        None,
        help="measured maneuver to drive: steering-wheel angle and speed, and what to compare",
        metavar="FILE.csv",
        group="data",
    )
    roads: Path | None = option(
        None,
        help=f"folder with roads and cycles for fuel measurements: {', '.join(NAMES)}",
        metavar="DIR",
        group="data",
    )
    runs: Path | None = option(
        None,
        help="folder that keeps finished drives, so that a stopped validation can continue; drives "
        "of another version of the code are not used",
        metavar="DIR",
        group="run",
    )
    quick: bool = option(False, help="a shorter form, of about a minute", group="run")

    def __post_init__(self) -> None:
        options.check(self)
        check_truck(self)

    @functools.cached_property
    def parameters(self) -> TruckParameters:
        """The truck to validate."""
        return TruckParameters.load(self.truck)

    @property
    def default_truck(self) -> bool:
        """Whether no other truck than the default one is validated."""
        return self.truck is None or self.truck == shipped_trucks()[0]

    @property
    def step(self) -> float:
        """Time step to use [s]."""
        if self.timestep is not None:
            return self.timestep
        return TIMESTEP if self.quick else FINE_TIMESTEP

    def payloads(self) -> tuple[float, ...]:
        """Payloads to test [kg], the greatest first; one for a truck without space for a load."""
        if self.payload is not None:
            return (self.payload,)
        return tuple(dict.fromkeys((self.parameters.payload_max, 0.0)))


def find_road(config: ValidateConfig, name: str) -> Path | None:
    """Path of a file in `config.roads` or its folders road/ and cycles/; None if it is missing."""
    if config.roads is None:
        return None
    candidates = (config.roads / folder / name for folder in _SUBFOLDERS)
    return next((path for path in candidates if path.is_file()), None)


def check_folder(config: ValidateConfig) -> list[str]:
    """Names of the roads and cycles that are missing.

    Raises:
      InputError: the given folder does not exist or has none of them.
    """
    missing = [name for name in NAMES if find_road(config, name) is None]
    if config.roads is not None and len(missing) == len(NAMES):
        raise InputError(
            f"roads: {str(config.roads)!r} is not a folder with one of {', '.join(NAMES)}, "
            "itself or in road/ or cycles/"
        )
    return missing
