"""OpenDRIVE maps of esmini, which are outside data."""

from iits_mj.road import RoadMap
from tests.paths import outside

MAPS = ("e6mini", "curves_elevation", "crest-curve", "velodrome", "fabriksgatan_traffic_lights")


def esmini(name: str) -> RoadMap:
    """A map by its name in esmini's repository; skips the calling test if the file is missing."""
    return RoadMap.from_opendrive(outside(f"xodr/esmini_{name}.xodr"))
