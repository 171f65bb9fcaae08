"""Takes the whole state of the truck and puts it back: several tries from one instant."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np
from numpy.typing import NDArray

from iits_mj.core import options
from iits_mj.core.errors import InputError
from iits_mj.core.options import option
from iits_mj.parameters import MAX_PAYLOAD, payload_option
from iits_mj.truck import Truck

# --- Options of `iits-mj validate` ---


@dataclass(frozen=True, kw_only=True)
class ValidateConfig:
    """How to validate the truck, the traffic and the planning."""

    payload: float | None = payload_option(
        None, help="only this load on the semitrailer; without it laden and empty"
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
        return (MAX_PAYLOAD, 0.0) if self.payload is None else (self.payload,)


# --- Takes the whole state of the truck and puts it back: several tries from one instant ---

_EVERYTHING = mujoco.mjtState.mjSTATE_INTEGRATION


def state_of(truck: Truck) -> NDArray[np.float64]:
    """Everything that the next step depends on, plugin state and controls included, shape (n,)."""
    state = np.empty(mujoco.mj_stateSize(truck.model, _EVERYTHING))
    mujoco.mj_getState(truck.model, truck.data, state, _EVERYTHING)
    return state


def restore(truck: Truck, state: NDArray[np.float64]) -> None:
    """Puts a state of the same truck back."""
    mujoco.mj_setState(truck.model, truck.data, state, _EVERYTHING)
    mujoco.mj_forward(truck.model, truck.data)


# --- Roads and cycles that are no part of this package: where they are looked for ---

PAPER_ROAD = "jinan_altimap_pcc.csv"
PAPER_PLAN_VIEW = "jinan_trucksim_road_10m.csv"
CYCLE_55 = "EPA_Ph2_urban_highway_55mph.csv"
CYCLE_65 = "EPA_Ph2_rural_interstate_65mph.csv"
NAMES = (PAPER_ROAD, PAPER_PLAN_VIEW, CYCLE_55, CYCLE_65)
_SUBFOLDERS = ("", "road", "cycles")


def find_road(config: ValidateConfig, name: str) -> Path | None:
    """The file of this name in `config.roads` or its folders road/ and cycles/; None without it."""
    if config.roads is None:
        return None
    candidates = (config.roads / folder / name for folder in _SUBFOLDERS)
    return next((path for path in candidates if path.is_file()), None)


def check_folder(config: ValidateConfig) -> list[str]:
    """Names of the roads that are not there.

    Raises:
      InputError: a folder was named that does not exist, or that holds none of them.
    """
    missing = [name for name in NAMES if find_road(config, name) is None]
    if config.roads is not None and len(missing) == len(NAMES):
        raise InputError(
            f"roads: {str(config.roads)!r} is no folder that holds one of {', '.join(NAMES)}, "
            "itself or in road/ or cycles/"
        )
    return missing
