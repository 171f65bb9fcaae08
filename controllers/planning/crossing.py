"""Vehicles that cross the truck's path or drive towards it in its lane, as leads to brake for.

The ground that the truck's units will sweep is compared with the predicted boxes of the
others over the next seconds. A vehicle counts if it will meet the truck, at the truck's present
speed or while the truck speeds up, and would have to brake to let the truck pass. The truck stops
before it enters that vehicle's path. At a junction without a light it looks farther ahead, expects
no moving vehicle to yield, and stops before the line as long as it can.

`is_free` is the check at a green arrow: whether anything crosses behind the stop line.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from controllers.planning.following import Lead
from controllers.planning.predicted_boxes import Poses, bodies_along
from controllers.planning.road_preview import LanePath, RoadPreview
from controllers.planning.trajectory import Quintic
from iits_mj.core.angles import wrap_angle
from iits_mj.core.arrays import BoolArray, FloatArray
from iits_mj.core.messages import EgoState, Scene
from iits_mj.core.neighbors import ALONG, Neighbors
from iits_mj.parameters import TruckParameters
from iits_mj.parameters.mass_state import payload_of

# Times of the predictions [s].
_TIMES = np.linspace(0.0, 4.0, 17)
# The same at a junction without a light, and the distances before and behind its line at which it
# counts [m].
_LONG_TIMES = np.linspace(0.0, 8.0, 33)
_LINE_BEFORE, _LINE_BEHIND = 40.0, 25.0
# Before that line the front bumper stops at this distance [m]; the truck passes a line at which it
# would have to brake harder [m/s2].
_TO_LINE, _LATE = 0.5, 2.5
# Two ways to compute a heading differ by less than this [rad].
_ROUNDING = 1e-6
# Room beside the truck's bodies [m].
_ROOM = 0.4
# The truck expects a vehicle to yield if it can stop at this deceleration [m/s2].
_YIELDS = 1.5
# Pedestrians and cyclists do not yield, and the truck passes this long before or after them [s].
_WALKERS, _WALKER_TIME = ("pedestrian", "bicycle"), 1.5
_VEHICLE_TIME = 0.5  # the same for vehicles [s]
# Braking for a crossing vehicle, positive [m/s2].
_COMFORT = 1.3
# A slower vehicle is at rest [m/s]; a slower oncoming vehicle does not count [m/s].
_AT_REST, _ONCOMING = 0.3, 0.5
# Acceleration of the truck in the second prediction, as from standstill [m/s2].
_SPEEDING_UP = 0.7
# Spacing of the truck's predicted positions [m].
_STEP = 2.0
# At a green arrow: time to clear the crossing from standstill [s], length behind the line that
# counts [m], room beside the truck's body [m], and least speed of a vehicle that counts [m/s].
_ARROW_TIME, _ARROW_REACH, _ARROW_ROOM, _ARROW_SPEED = 8.0, 30.0, 1.0, 0.5


def crossing_leads(
    scene: Scene,
    preview: RoadPreview,
    parameters: TruckParameters,
    path: LanePath,
    residual: Quintic | None,
) -> list[tuple[Lead, str]]:
    """Leads at rest where the path of a crossing or oncoming vehicle begins, with its name.

    Args:
      scene: the truck and the traffic.
      preview: of the road.
      parameters: of the truck.
      path: of the lane kept or changed to.
      residual: offset from the path, None for none.
    """
    ego, neighbors = scene.ego, scene.neighbors
    line = _line(scene)
    times = _TIMES if line is None else _LONG_TIMES
    reach = max(max(ego.speed, 3.0) * times[-1], ego.speed**2 / (2.0 * _COMFORT)) + 10.0
    near = np.abs(neighbors.station - ego.station) < reach + 40.0
    # Where the route comes back to this place, a vehicle may have the station of the other part.
    back = ~near & neighbors.posed & (np.hypot(neighbors.x - ego.x, neighbors.y - ego.y) < reach)
    if not back.any():
        if neighbors.all_along(preview):
            return []
        others = near & neighbors.on_level(preview) & ~neighbors.surely_along(preview)
        if all(_is_along(neighbors, k, preview) for k in np.flatnonzero(others).tolist()):
            return []
    near = (near | back) & neighbors.on_level(preview)
    found = _placed_here(Poses.of(neighbors, near, preview), back[near], ego, preview)
    angle = np.abs(found.to_road)
    across = (angle > ALONG) & (angle < np.pi - ALONG)
    aside = np.abs(found.offset - path.driven_at(found.station)) - 0.5 * found.width
    wrong_way = (angle >= np.pi - ALONG) & (found.speed > _ONCOMING)
    half_width = 0.5 * max(unit.width for unit in parameters.units)
    wrong_way &= (aside < half_width) & (found.station > ego.station)
    matters = across | wrong_way
    if not matters.any():
        return []
    stations = ego.station + np.arange(0.0, reach, _STEP)
    units = bodies_along(
        parameters, preview, path, residual, stations, payload_of(parameters, ego.mass)
    )
    # Axes: positions of the truck, times, vehicles.
    touch = np.zeros((len(stations), len(times), len(angle)), dtype=bool)
    for chosen, boxes in (
        (across, lambda poses: poses.ahead(times)),
        (wrong_way, lambda poses: poses.along_road(times, preview)),
    ):
        if chosen.any():
            others = boxes(found.only(chosen))
            touch[:, :, chosen] = np.logical_or.reduce([u.touch(others, _ROOM) for u in units])
    leads, names = [], np.flatnonzero(near).tolist()
    for index in np.flatnonzero(matters & touch.any(axis=(0, 1))).tolist():
        walks = neighbors.kinds[names[index]] in _WALKERS
        if walks and found.speed[index] <= _AT_REST and aside[index] >= half_width:
            continue  # beside the lane: `TightBends` keeps the trailer off
        soon = touch[:, : len(_TIMES), index]
        if wrong_way[index]:
            # The longer prediction is for crossing vehicles only.
            lead = _meets_head_on(soon, found.one(index), ego)
        elif walks:
            lead = _crosses(soon, found.one(index), ego, _TIMES, None, walks)
        else:
            lead = _crosses(touch[:, :, index], found.one(index), ego, times, line, walks)
        if lead is not None:
            leads.append((lead, neighbors.ids[names[index]]))
    return leads


def _placed_here(found: Poses, back: BoolArray, ego: EgoState, preview: RoadPreview) -> Poses:
    """The poses, those of `back` with their places on the part of the route where the truck is."""
    if not back.any():
        return found
    station, offset, to_road = found.station.copy(), found.offset.copy(), found.to_road.copy()
    for k in np.flatnonzero(back).tolist():
        place = preview.route.locate(float(found.x[k]), float(found.y[k]), ego.station)
        station[k], offset[k] = place
        heading = preview.route.evaluate(place[0], 0.0).heading
        to_road[k] = wrap_angle(float(found.yaw[k] - heading))
    return replace(found, station=station, offset=offset, to_road=to_road)


def _line(scene: Scene) -> float | None:
    """Distance of the front bumper to the line of a near junction without a light [m], or None."""
    near = [
        line - scene.neighbors.front
        for line in scene.signals.lines
        if -_LINE_BEHIND < line - scene.neighbors.front < _LINE_BEFORE
    ]
    return near[0] if near else None


def _is_along(neighbors: Neighbors, index: int, preview: RoadPreview) -> bool:
    """Whether a vehicle drives along the road for certain, by the heading at its station."""
    if not neighbors.posed[index] or not neighbors.speed[index] >= 0.0:
        return False
    heading = preview.route.evaluate(float(neighbors.station[index]), 0.0).heading
    return abs(wrap_angle(float(neighbors.yaw[index] - heading))) < ALONG - _ROUNDING


def _meets_head_on(touch: BoolArray, one: Poses, ego: EgoState) -> Lead | None:
    """The lead where the truck would meet an oncoming vehicle if both continue."""
    now = touch[:, 0]
    if not touch.any() or now[0]:
        return None
    gap = float(now.argmax() if now.any() else len(now)) * _STEP
    return Lead(gap * ego.speed / max(ego.speed + float(one.speed[0]), 1e-3), 0.0)


def _crosses(
    touch: BoolArray,
    one: Poses,
    ego: EgoState,
    times: FloatArray,
    line: float | None,
    walks: bool = False,
) -> Lead | None:
    """The lead of a crossing vehicle, from the positions and times of contact.

    Args:
      touch: contacts, shape (positions of the truck, times).
      one: the vehicle.
      ego: the truck.
      times: of the prediction [s].
      line: distance to the line of a junction without a light [m], None for none.
      walks: it is a pedestrian or a cyclist.
    """
    places, moments = np.asarray(touch.any(axis=1)), np.asarray(touch.any(axis=0))
    # Braking does not help against a vehicle that is already at the truck.
    if not places.any() or places[0]:
        return None
    speed = float(one.speed[0])
    margin = _WALKER_TIME if walks else _VEHICLE_TIME
    if speed > _AT_REST and not _meets(touch, ego.speed, times, margin):
        return None
    first = int(moments.argmax())
    left = float(one.distance(times[first : first + 1])[0, 0])
    yields = 0.0 if speed > _AT_REST and (walks or line is not None) else _YIELDS
    if first > 0 and speed**2 < 2.0 * yields * left:
        return None
    last = float(times[len(moments) - 1 - int(moments[::-1].argmax())])
    until = math.inf if last >= times[-1] else last + 0.5
    gap = (float(places.argmax()) - 0.5) * _STEP
    if line is not None and ego.speed**2 < 2.0 * _LATE * (line - _TO_LINE):
        gap = min(gap, line - _TO_LINE)
    return Lead(gap, 0.0, 0.0, until)


def _meets(
    touch: BoolArray, speed: float, times: FloatArray, margin: float = _VEHICLE_TIME
) -> bool:
    """Whether truck and vehicle meet, within a margin of time [s]."""
    rows = len(touch) - 1
    for gain in (0.0, _SPEEDING_UP):
        for late in (-margin, 0.0, margin):
            time = np.maximum(times + late, 0.0)
            way = speed * time + 0.5 * gain * time**2
            row = np.minimum(np.rint(way / _STEP).astype(int), rows)
            if bool(touch[row, np.arange(len(times))].any()):
                return True
    return False


def is_free(scene: Scene, preview: RoadPreview, line: float) -> bool:
    """Whether no vehicle crosses the way behind a stop line within the next seconds.

    Vehicles are predicted straight ahead at constant speed. Vehicles along the truck's lane do not
    count: car following handles them.

    Args:
      scene: the truck and the traffic, with poses in the map frame.
      preview: of the truck's road.
      line: station of the stop line [m].
    """
    neighbors = scene.neighbors
    moving = np.flatnonzero(neighbors.speed > _ARROW_SPEED)
    if not moving.size:
        return True
    ends = np.minimum(np.linspace(line, line + _ARROW_REACH, 16), preview.route.length)
    way = preview.route.evaluate(ends, np.full(len(ends), scene.ego.offset))
    x, y, heading = np.asarray(way.x), np.asarray(way.y), np.asarray(way.heading)
    times = np.linspace(0.0, _ARROW_TIME, 33)
    for i in moving:
        yaw, ahead = neighbors.yaw[i], neighbors.speed[i] * times
        px = neighbors.x[i] + np.cos(yaw) * ahead
        py = neighbors.y[i] + np.sin(yaw) * ahead
        across = np.abs(np.angle(np.exp(1j * (yaw - heading)))) > ALONG
        clear = _ARROW_ROOM + 0.5 * (scene.footprint.width + neighbors.length[i])
        near = np.hypot(px[:, None] - x, py[:, None] - y) < clear
        if bool((near & across).any()):
            return False
    return True
