"""Ratio of steering wheel to road wheels, where the log has both angles."""

from __future__ import annotations

import dataclasses

import numpy as np

from iits_mj.core.arrays import FloatArray
from iits_mj.identification.estimate import Estimate, Free, fit
from iits_mj.identification.log import Log
from iits_mj.parameters import TruckParameters

_GRID = 0.02
_WINDOW = 10.0
# The linkage's compliance counts as ratio [1]: on top of the interval.
_MODEL_ERROR = 0.005
# Least spread of the steering wheel beyond its play that shows a ratio [rad].
_SPREAD_MIN = 0.02


def identify_ratio(log: Log, parameters: TruckParameters) -> Estimate | None:
    """The steering's ratio; None where the log lacks the road wheels' angle.

    The play of the gear is taken out of the steering wheel's angle; the wheel's offset and the
    linkage's lag, in proportion to the steering's rate, are solved for. Side forces bend the
    linkage, which counts as ratio: half a per cent of it in ordinary driving.
    """
    steering = parameters.steering
    if log.missing("steering_wheel_angle", "road_wheel_angle"):
        return None
    free = Free("steering_ratio", "1", steering.ratio, 5.0, 60.0)
    clock = log.series("road_wheel_angle").time
    time = np.arange(clock[0], clock[-1], max(_GRID, float(np.median(np.diff(clock)))))
    pitman = pitman_angle(log.at("steering_wheel_angle", time), steering.dead_band)
    road = log.at("road_wheel_angle", time)
    nuisance = np.column_stack([np.ones_like(road), np.gradient(pitman, time)])
    if np.ptp(pitman) < _SPREAD_MIN:
        return Estimate.unseen(free.name, free.unit, free.prior, "the steering was not used")
    length = max(round(_WINDOW / (time[1] - time[0])), 2)
    cuts = list(range(length, len(time), length))

    def residual(values: FloatArray) -> list[FloatArray]:
        rest = road - pitman / values[0]
        levels, *_ = np.linalg.lstsq(nuisance, rest, rcond=None)
        # In radians at the steering wheel, so that the fit's tolerances bite.
        return list(np.split(free.prior * (nuisance @ levels - rest), cuts))

    found = fit([free], residual)[0][0]
    wider = float(np.hypot(found.half_width, _MODEL_ERROR * found.value))
    return dataclasses.replace(found, half_width=wider)


def pitman_angle(wheel: FloatArray, dead_band: float) -> FloatArray:
    """Steering wheel's angle behind the play of the gear [rad], shape (n,).

    The gear is taken to lie in the middle of its play at first.
    """
    found = np.empty_like(wheel)
    angle = float(wheel[0])
    for index, value in enumerate(wheel):
        angle = min(max(angle, value - 0.5 * dead_band), value + 0.5 * dead_band)
        found[index] = angle
    return found
