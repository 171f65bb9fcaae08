"""A plan between its nodes: what its constant forces do on a road that is known more finely.

A plan states one force for each interval. Drawn as straight lines of v^2 over a road that is rough
within the intervals it would ask for forces that swing with every bump, up into the brakes: on the
paper's road a 50 m plan followed so burns 0.8 % more than planned. With the force held, kinetic and
potential energy change places there, and it burns what was planned.
"""

from __future__ import annotations

import numpy as np

from controllers.pcc.profile import RoadProfile
from controllers.pcc.vehicle import PointMass
from iits_mj.core.arrays import FloatArray
from iits_mj.errors import InputError
from iits_mj.units import GRAVITY


def on_finer_road(
    vehicle: PointMass,
    road: RoadProfile,
    speed: FloatArray,
    fine: RoadProfile,
    v_max: float = np.inf,
) -> FloatArray:
    """Speeds at the nodes of a finer profile of the same road, shape of its stations [m/s].

    With force, rolling resistance and drag as at the mean of the interval, `m_e v^2 / 2 + m g z`
    is linear in the station between two nodes of the plan. The fine road's limits and
    the band are kept as well as between the plan's nodes.

    Args:
      vehicle: that the plan was made for.
      road: on whose grid the plan stands.
      speed: of the plan at its nodes, shape (n + 1,) [m/s].
      fine: the same road with closer nodes, within the stations of `road`.
      v_max: of the band [m/s].

    Raises:
      InputError: the fine profile leaves the road, or speeds are not those of its nodes.
    """
    if speed.shape != road.station.shape or not np.isfinite(speed).all():
        raise InputError(f"a plan over {road.name!r} wants {road.station.size} finite speeds")
    first, last = road.station[[0, -1]]
    if fine.station[0] < first - 1e-6 or fine.station[-1] > last + 1e-6:
        raise InputError(
            f"fine profile {fine.name!r} from {fine.station[0]:.0f} to {fine.station[-1]:.0f} m "
            f"leaves the plan's {first:.0f} to {last:.0f} m"
        )
    line = np.interp(fine.station, road.station, speed**2)
    above = fine.height - np.interp(fine.station, road.station, road.height)
    b = line - 2.0 * GRAVITY * vehicle.mass / vehicle.inertial_mass * above
    # A dip deeper than the kinetic energy is no road; half the planned energy is kept.
    b = np.maximum(b, 0.5 * line)
    cap = np.maximum(np.minimum(fine.v_limit, v_max), np.sqrt(line))
    return np.asarray(np.minimum(np.sqrt(b), cap))
