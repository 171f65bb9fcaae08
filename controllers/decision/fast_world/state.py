"""The state of fast worlds as one NumPy array, and the compiled functions that advance it.

A world is one entry of the array, without pointers: it is copied and pickled as numbers.
"""

from __future__ import annotations

import math
from dataclasses import astuple
from typing import Any

import numpy as np
from numpy.typing import NDArray

from controllers.decision.fast_world.config import (
    KINDS,
    MEAN_DESIRED_SPEED,
    NUMBERS,
    SHARES,
    HighwayConfig,
)
from controllers.decision.observation import FRAME_AGES, FRAME_SHAPE, SCALE
from controllers.decision.rules import MODEL
from controllers.planning.config import FollowingConfig, LaneChangeConfig
from iits_mj import kernels
from iits_mj.core.arrays import IntArray
from iits_mj.core.errors import InputError
from iits_mj.kernels import Address, Integer, Table

States = NDArray[np.void]

LANES_MOST = 3


def _numbers(names: str, kind: type = np.float64) -> list[tuple[Any, ...]]:
    return [(name, kind) for name in names.split()]


# A vehicle: number in the order of arrival; lane, -1 on a ramp; index into `KINDS`; station of the
# front bumper [m]; [m/s]; [m/s2]; [m]; desired speed [m/s]; beginning [s] and offset [m] of its
# last lane change.
VEHICLE = np.dtype(
    _numbers("serial lane kind", np.int64)
    + _numbers("front speed acceleration length desired change_time change_from")
)
# The truck as the traffic sees it, in one lane.
OBSTACLE = np.dtype([*_numbers("front length speed"), ("lane", np.int64)])
# Fields of `World` in iits_mj/kernels/fast_world.h, which explains them.
_WORLD = [
    *_numbers("traffic_speed spawn_probability truck_speed_limit ramp_probability ramp_interval"),
    *_numbers("keeps_right lanes truck_keeps_right", np.int64),
    *_numbers("window_behind window_ahead sight_behind sight_ahead timestep"),
    *_numbers("reference_speed end duration"),
    *(("grade_amplitude", np.float64, (2,)), ("grade_phase", np.float64, (2,))),
    *_numbers("charge_change charge_danger charge_speed charge_collision discount"),
    *_numbers("mass power drag rolling truck_length front_overhang"),
    *(("random", np.uint64, (6,)),),
    *_numbers("capacity count spawned", np.int64),
    *_numbers("clock round_due"),
    *(
        (f"{kind}_{end}", np.float64, (LANES_MOST,))
        for kind in ("wait", "most")
        for end in ("ahead", "behind")
    ),
    *_numbers("time front speed acceleration offset lateral_speed"),
    *_numbers("change_left change_lasts changed_at speed_max"),
    *_numbers("lane source", np.int64),
    *_numbers("distance driven_time time_gap_min loss_integral"),
    *_numbers("decisions changes refused dangerous collisions", np.int64),
    *_numbers("right_time beside_time"),
    *_numbers("imposed_brakings", np.int64),
    *_numbers("imposed_deceleration collision_time_front collision_time_rear"),
    *_numbers("change_time_gap_front change_time_gap_rear"),
    *_numbers("watched", np.int64),
    *_numbers("watched_until watched_braking"),
    *(("total", np.float64, (4,)), ("reward", np.float64, (4,))),
    *_numbers("seconds"),
    *_numbers("terminated truncated", np.int64),
    ("frames", np.float32, (len(FRAME_AGES), *FRAME_SHAPE)),
]
WORLD_SIZE = np.dtype(_WORLD).itemsize

_SLOW = ("truck", "articulated")
# Numbers that all worlds share: `Laws` of iits_mj/kernels/fast_world.h.
LAWS = Table(
    [
        *MODEL.numbers.tolist(),
        *astuple(FollowingConfig()),
        *(LaneChangeConfig.pause, LaneChangeConfig.keep_right_time),
        *(getattr(kind, name) for kind in KINDS for name in NUMBERS),
        *(np.cumsum(SHARES) / np.cumsum(SHARES)[-1]).tolist(),
        *(float(kind.kind in _SLOW) for kind in KINDS),
        *SCALE.tolist(),
    ]
)
_copy = kernels.function(
    "iits_worlds_copy", None, Address, Integer, Address, Integer, Address, Integer
)


def capacity_of(config: HighwayConfig) -> int:
    """Returns the number of vehicles for which a world needs places.

    It is 1.5 times the number at the start and 16 more in each lane, or with ramps, whose vehicles
    may fill the road, that of a jam. No vehicle enters a full world.
    """
    window = config.window_behind + config.window_ahead
    speed, rate = config.traffic_speed, config.spawn_probability
    closest = KINDS[0].length + KINDS[0].minimum_gap
    if config.ramp_probability > 0.0:
        return math.ceil((config.lanes + 1) * window / closest)
    a_lane = window * min(rate / (MEAN_DESIRED_SPEED * speed), 1.0 / (closest + 1.5 * speed))
    return math.ceil(config.lanes * (1.5 * a_lane + 16.0))


def new_states(count: int, capacity: int) -> States:
    """Returns worlds, shape (count,), with places for a number of vehicles each."""
    dtype = np.dtype([*_WORLD, ("vehicles", VEHICLE, (capacity,))])
    states = np.zeros(count, dtype)
    states["capacity"] = capacity
    return states


def copied(states: States, indices: IntArray, capacity: int) -> States:
    """Returns copies of the worlds of some indices, with places for a number of vehicles each."""
    copies = np.empty(indices.size, np.dtype([*_WORLD, ("vehicles", VEHICLE, (capacity,))]))
    source = kernels.address(states), states.dtype.itemsize
    _copy(*source, kernels.address(indices), indices.size, kernels.address(copies), capacity)
    return copies


def set_traffic(state: Any, config: HighwayConfig, generator: np.random.Generator) -> None:
    """Sets the traffic of a world, and its random numbers; see `set_random`."""
    limit = config.truck_speed_limit
    values = vars(config) | {"truck_speed_limit": math.inf if limit is None else limit}
    for name, value in values.items():
        state[name] = value
    set_random(state, generator)


def set_random(state: Any, generator: np.random.Generator) -> None:
    """Sets the random numbers of a world to the generator's next 2^64 ones.

    Raises:
      InputError: the generator is not one of `numpy.random.default_rng`.
    """
    bits: Any = generator.bit_generator
    if not isinstance(bits, np.random.PCG64):
        raise InputError(
            f"generator uses {type(bits).__name__}; use numpy.random.default_rng(seed)"
        )
    stream = bits.state
    words = [stream["state"]["state"], stream["state"]["inc"]]
    state["random"] = [
        *(part for word in words for part in (word >> 64, word & (2**64 - 1))),
        *(stream["has_uint32"], stream["uinteger"]),
    ]
    bits.advance(2**64)


def function(name: str, result: Any, *arguments: Any) -> Any:
    """Returns a compiled function of one world, which takes its state, shape (1,), first."""
    found = kernels.function(name, result, Address, Address, *arguments)
    return lambda state, *rest: found(kernels.address(state), LAWS.address, *rest)


def batch_function(name: str, *arguments: Any) -> Any:
    """Returns a compiled function of several worlds, which takes their states first."""
    found = kernels.function(name, None, Address, Integer, Integer, Address, *arguments)

    def call(states: States, *rest: Any) -> None:
        found(kernels.address(states), states.dtype.itemsize, len(states), LAWS.address, *rest)

    return call


world_size = kernels.function("iits_world_size", Integer)
