"""Fits the truck's parameters to a recorded drive, and says what the drive cannot show."""

from iits_mj.identification.command import IdentifyConfig, run
from iits_mj.identification.estimate import Estimate
from iits_mj.identification.identify import DEFAULT, LONGITUDINAL, Identification, identify
from iits_mj.identification.log import NEEDED, OPTIONAL, Log

__all__ = [
    "DEFAULT",
    "LONGITUDINAL",
    "NEEDED",
    "OPTIONAL",
    "Estimate",
    "Identification",
    "IdentifyConfig",
    "Log",
    "identify",
    "run",
]
