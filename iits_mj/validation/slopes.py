"""Straight roads whose grade changes in parabolas: ramps for climbing and hills for the audit."""

from __future__ import annotations

from iits_mj.road import RoadMap, Route
from iits_mj.road.design import Design
from iits_mj.road.design_build import build

_LANE_WIDTH = 4.0
_SPEED_LIMIT = 25.0
# (station of the change [m], grade after it, length of the parabola [m]).
Grade = tuple[float, float, float]
_HILLS: tuple[Grade, ...] = (
    (250.0, 0.03, 200.0),
    (700.0, -0.02, 250.0),
    (1100.0, 0.04, 250.0),
    (1600.0, -0.045, 300.0),
    (2050.0, 0.02, 300.0),
    (2700.0, 0.0, 200.0),
)
HILLS_LENGTH = 3000.0


def sloping(length: float, initial: float, grades: tuple[Grade, ...]) -> Route:
    """A straight road along x that begins with grade `initial` (dz/ds).

    Raises:
      InputError: two changes of grade overlap.
    """
    design = Design(
        name="slopes",
        start=(0.0, 0.0, 0.0, 0.0),
        lane_width=_LANE_WIDTH,
        lanes=1,
        left_shoulder=1.0,
        right_shoulder=2.5,
        speed_limit=_SPEED_LIMIT,
        initial_grade=initial,
        road_ends=(),
        alignment=((length, 0.0, 0.0, 0.0, 0.0),),
        grades=grades,
        extra_lanes=(),
        limits=((0.0, length, _SPEED_LIMIT),),
        structures=(),
    )
    return RoadMap(build(design), design.name).route()


def hills() -> Route:
    """3 km of hills, grades from -4.5 to +4 %, which end 18 m above their start."""
    return sloping(HILLS_LENGTH, 0.0, _HILLS)
