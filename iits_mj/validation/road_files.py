"""Roads and cycles that are no part of this package: where they are looked for."""

from __future__ import annotations

from pathlib import Path

from iits_mj.errors import InputError
from iits_mj.validation.config import ValidateConfig

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
