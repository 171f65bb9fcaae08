"""Whether somebody crosses the truck's way behind a stop line, for a start at a green arrow.

Vehicles are taken to go on straight at constant speed. Who follows the truck's own lane is not
crossing: car following has them.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from controllers.planning.following import Lead
from controllers.planning.predicted_boxes import (
    Boxes,
    Poses,
    body_boxes,
    poses,
    swept_path,
    touching,
)
from controllers.planning.road_preview import LanePath, RoadPreview
from iits_mj.core.arrays import FloatArray
from iits_mj.core.messages import Scene

# --- Who crosses the truck's way, or comes towards it in its lane: leads to brake for ---
# The ground that tractor and semitrailer will sweep is held against the boxes of the others over
# the next seconds. Somebody counts who will be where the truck then is, at its present speed or
# speeding up, and who would have to brake to let it pass. The truck is to stop before it enters his
# way.

if TYPE_CHECKING:
    from controllers.planning.surroundings import Surroundings
    from controllers.planning.trajectory import Quintic
    from iits_mj.core.messages import EgoState
    from iits_mj.parameters import TruckParameters


# Seconds that are looked ahead.
_TIMES = np.linspace(0.0, 4.0, 17)
# Within this of the road's direction, either way, a vehicle goes along it [rad].
ALONG = 0.35
# The share of that within which rounding does not matter.
_PLAINLY = 0.99
# Kept beside the truck's bodies [m].
_crossing_ROOM = 0.4
# Who can still stop before the truck's way by this is expected to, positive [m/s2].
_YIELDS = 1.5
# Braking for who stands across the way, positive [m/s2].
_COMFORT = 1.3
# Slower than this a vehicle stands [m/s].
_STANDS = 0.3
# Acceleration of the truck in the second guess, as from standstill [m/s2].
_SPEEDING_UP = 0.7
# The trailer has found its way after so much [m].
_BEHIND = 30.0
_STEP = 2.0


def bodies_along(
    parameters: TruckParameters,
    preview: RoadPreview,
    path: LanePath,
    residual: Quintic | None,
    stations: FloatArray,
) -> tuple[Boxes, Boxes]:
    """Boxes of tractor and semitrailer with the steer axle at stations [m], shape (n,) each."""
    first = float(stations[0])
    run_up = np.arange(first - _BEHIND, first - 0.5, 2.0)
    every = np.concatenate([run_up, stations])
    offset = path.driven_at(every)
    if residual is not None:
        offset = offset + residual.evaluate(every)[0]
    point = preview.route.evaluate(every, offset)
    way = np.column_stack([point.x, point.y])
    swept = swept_path(parameters, way, float(np.asarray(point.heading)[0]))
    kept = slice(len(run_up), None)
    return (
        body_boxes(swept.tractor_corners[kept], swept.yaw[kept]),
        body_boxes(swept.trailer_corners[kept], swept.trailer_yaw[kept]),
    )


def crossing_leads(
    surroundings: Surroundings,
    preview: RoadPreview,
    parameters: TruckParameters,
    path: LanePath,
    residual: Quintic | None,
) -> list[tuple[Lead, str]]:
    """Leads that stand where a crossing or oncoming vehicle's way begins, with its name.

    Args:
      surroundings: the traffic, on the truck's level where that is known.
      preview: of the road.
      parameters: of the truck.
      path: of the lane kept or changed to.
      residual: offset from the path, None for none.
    """
    ego, others = surroundings.scene.ego, surroundings.scene.vehicles
    reach = max(max(ego.speed, 3.0) * _TIMES[-1], ego.speed**2 / (2.0 * _COMFORT)) + 10.0
    near = surroundings.here & (np.abs(surroundings.station - ego.station) < reach + 40.0)
    if not near.any():
        return []
    rows = surroundings.table[near]
    if _plainly_along(rows, preview):
        return []
    found = poses(rows, preview)
    angle = np.abs(found.to_road)
    across = (angle > ALONG) & (angle < np.pi - ALONG)
    aside = np.abs(found.offset - path.driven_at(found.station)) - 0.5 * found.width
    wrong_way = (angle >= np.pi - ALONG) & (found.speed > 0.5)
    wrong_way &= (aside < 0.5 * parameters.semitrailer.width) & (found.station > ego.station)
    matters = across | wrong_way
    if not matters.any():
        return []
    stations = ego.station + np.arange(0.0, reach, _STEP)
    units = bodies_along(parameters, preview, path, residual, stations)
    # All at once: rows along the truck's way, columns over time, then vehicles.
    touch = np.zeros((len(stations), len(_TIMES), len(angle)), dtype=bool)
    if across.any():
        touch[:, :, across] = _touched(units, found.only(across).ahead(_TIMES))
    if wrong_way.any():
        guess = found.only(wrong_way).along_road(_TIMES, preview)
        touch[:, :, wrong_way] = _touched(units, guess)
    leads = []
    for index in np.flatnonzero(matters & touch.any(axis=(0, 1))):
        one = found.only(np.arange(len(angle)) == index)
        judge = _head_on if wrong_way[index] else _crosses
        lead = judge(touch[:, :, index], one, ego)
        if lead is not None:
            leads.append((lead, others[int(np.flatnonzero(near)[index])].id))
    return leads


def _plainly_along(table: FloatArray, preview: RoadPreview) -> bool:
    """Whether all vehicles go along the road beyond doubt, which spares the look at their poses.

    Args:
      table: of them, see `table_of`.
      preview: of the road.
    """
    for station, _, speed, _, _, _, _, yaw, _, x, y, z in table.tolist():
        posed = x != 0.0 or y != 0.0 or z != 0.0
        if not posed or speed < 0.0:
            return False
        heading = float(preview.route.evaluate(station).heading)
        if abs(math.remainder(yaw - heading, 2.0 * math.pi)) > _PLAINLY * ALONG:
            return False
    return True


def _touched(units: tuple[Boxes, Boxes], others: Boxes) -> NDArray[np.bool_]:
    """Where and when tractor or trailer touches whom, shape (rows, times, vehicles)."""
    tractor, trailer = (touching(unit, others, _crossing_ROOM) for unit in units)
    return np.asarray(tractor | trailer)


def _head_on(touch: NDArray[np.bool_], one: Poses, ego: EgoState) -> Lead | None:
    """The lead at the place where the truck meets who comes towards it, if both go on."""
    now = touch[:, 0]
    if not touch.any() or now[0]:
        return None
    gap = float(now.argmax() if now.any() else len(now)) * _STEP
    return Lead(gap * ego.speed / max(ego.speed + float(one.speed[0]), 1e-3), 0.0)


def _crosses(touch: NDArray[np.bool_], one: Poses, ego: EgoState) -> Lead | None:
    """The lead that a vehicle makes, from where (rows) and when (columns) it would be touched."""
    places, moments = np.asarray(touch.any(axis=1)), np.asarray(touch.any(axis=0))
    # Who is in the truck's way at its very place is not let pass by braking.
    if not places.any() or places[0]:
        return None
    speed = float(one.speed[0])
    if speed > _STANDS and not _meets(touch, ego.speed):
        return None
    first = int(moments.argmax())
    left = float(one.ways(_TIMES[first : first + 1])[0, 0])
    if first > 0 and speed**2 < 2.0 * _YIELDS * left:
        return None
    last = float(_TIMES[len(moments) - 1 - int(moments[::-1].argmax())])
    until = np.inf if last >= _TIMES[-1] else last + 0.5
    return Lead((float(places.argmax()) - 0.5) * _STEP, 0.0, 0.0, until)


def _meets(touch: NDArray[np.bool_], speed: float) -> bool:
    """Whether truck and vehicle are at one place at one time, half a second more or less."""
    rows = len(touch) - 1
    for gain in (0.0, _SPEEDING_UP):
        for late in (-0.5, 0.0, 0.5):
            time = np.maximum(_TIMES + late, 0.0)
            way = speed * time + 0.5 * gain * time**2
            row = np.minimum(np.rint(way / _STEP).astype(int), rows)
            if bool(touch[row, np.arange(len(_TIMES))].any()):
                return True
    return False


# --- Whether somebody crosses the truck's way behind a stop line, for a start at a green arrow ---

# The truck needs this long from standstill to clear `_REACH` of the crossing [s].
_HORIZON = 8.0
# Behind the line this much of the way counts [m].
_REACH = 30.0
# Wanted beside the truck's body [m].
_ROOM = 1.0
# Within this of the truck's direction a vehicle goes along, not across [rad].
_ALONG = 0.35


def is_free(scene: Scene, preview: RoadPreview, line: float) -> bool:
    """Whether nobody crosses the way behind a line within the next seconds.

    Args:
      scene: the truck and the traffic, with poses in the map frame.
      preview: of the truck's road.
      line: station of the stop line [m].
    """
    moving = [v for v in scene.vehicles if v.speed > 0.5]
    if not moving:
        return True
    ends = np.minimum(np.linspace(line, line + _REACH, 16), preview.route.length)
    way = preview.route.evaluate(ends, np.full(len(ends), scene.ego.offset))
    x, y, heading = np.asarray(way.x), np.asarray(way.y), np.asarray(way.heading)
    times = np.linspace(0.0, _HORIZON, 33)
    for vehicle in moving:
        ahead = vehicle.speed * times
        px = vehicle.x + np.cos(vehicle.yaw) * ahead
        py = vehicle.y + np.sin(vehicle.yaw) * ahead
        across = np.abs(np.angle(np.exp(1j * (vehicle.yaw - heading)))) > _ALONG
        clear = _ROOM + 0.5 * (scene.footprint.width + vehicle.length)
        near = np.hypot(px[:, None] - x, py[:, None] - y) < clear
        if bool((near & across).any()):
            return False
    return True
