"""Whether somebody crosses the truck's way behind a stop line, for a start at a green arrow.

Vehicles are taken to go on straight at constant speed. Who follows the truck's own lane is not
crossing: car following has them.
"""

from __future__ import annotations

import numpy as np

from controllers.road_preview import RoadPreview
from iits_mj.messages import Scene

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
