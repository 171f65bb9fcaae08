"""The roads of the tasks: flat, uphill, a straight over hills, and a winding one."""

from __future__ import annotations

from iits_mj.road import RoadMap, Route
from iits_mj.road.design import Design
from iits_mj.road.design_build import build

LANE_WIDTH = 4.0
_SPEED_LIMIT = 22.22


def flat() -> Route:
    """5 km, straight and level."""
    return Route.straight(length=5_000.0, lanes=2)


def uphill(grade: float) -> Route:
    """2 km straight on a constant grade (dz/ds)."""
    return Route.straight(length=2_000.0, lanes=2, grade=grade)


def hills() -> Route:
    """8 km straight over hills of 400 m, grades within +/-4 %."""
    grades = []
    size = (0.02, -0.03, 0.04, -0.02, 0.03, -0.04, 0.01, -0.01)
    for index in range(19):
        grades.append((400.0 * (index + 1), size[index % len(size)], 250.0))
    return _route("suite_hills", ((8_000.0, 0.0, 0.0, 0.0, 0.0),), tuple(grades))


def winding() -> Route:
    """5 km of clothoid, arc, clothoid, to the left and right in turn, radii of 500 to 900 m."""
    alignment = [(200.0, 0.0, 0.0, 0.0, 0.0)]
    radii = (900.0, -700.0, 600.0, -500.0, 800.0, -600.0, 500.0, -900.0)
    for radius in radii:
        curvature = 1.0 / radius
        alignment += [
            (120.0, 0.0, curvature, 0.0, 0.0),
            (300.0, curvature, curvature, 0.0, 0.0),
            (120.0, curvature, 0.0, 0.0, 0.0),
        ]
    alignment.append((480.0, 0.0, 0.0, 0.0, 0.0))
    return _route("suite_winding", tuple(alignment), ())


def _route(
    name: str,
    alignment: tuple[tuple[float, float, float, float, float], ...],
    grades: tuple[tuple[float, float, float], ...],
) -> Route:
    length = sum(element[0] for element in alignment)
    design = Design(
        name=name,
        start=(0.0, 0.0, 0.0, 0.0),
        lane_width=LANE_WIDTH,
        lanes=2,
        left_shoulder=1.0,
        right_shoulder=2.5,
        speed_limit=_SPEED_LIMIT,
        initial_grade=0.0,
        road_ends=(),
        alignment=alignment,
        grades=grades,
        extra_lanes=(),
        limits=((0.0, length, _SPEED_LIMIT),),
        structures=(),
    )
    return RoadMap(build(design), name).route()
