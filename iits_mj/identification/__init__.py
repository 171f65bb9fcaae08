"""Fits the truck's parameters to a recorded drive, with their uncertainty."""

from iits_mj.identification.command import IdentifyConfig, run
from iits_mj.identification.estimate import Estimate
from iits_mj.identification.identify import GROUPS, Identification, identify, overlay, write_toml
from iits_mj.identification.log import SIGNALS, Log, Series, from_frames, read, read_table

__all__ = [
    "GROUPS",
    "SIGNALS",
    "Estimate",
    "Identification",
    "IdentifyConfig",
    "Log",
    "Series",
    "from_frames",
    "identify",
    "overlay",
    "read",
    "read_table",
    "run",
    "write_toml",
]
