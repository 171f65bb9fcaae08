"""The published truck scenario of Hoel, Wolff and Laine (2020) as a world of SUMO alone.

"Tactical Decision-Making in Autonomous Driving by Reinforcement Learning with Uncertainty
Estimation", IEEE Intelligent Vehicles Symposium 2020 (arXiv 2004.10439). A truck of 16 m drives at
up to 25 m/s on three lanes among 24 cars; those ahead are slower, those behind faster. It acts once
a second. All figures here are those of the authors' published program (MIT licence); SUMO's version
differs.
"""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from iits_mj.core.arrays import BoolArray, FloatArray, IntArray
from iits_mj.core.errors import InputError
from iits_mj.core.messages import EgoFootprint, EgoState, Scene, TrackedVehicle
from iits_mj.road import Route
from traffic_bridge.network.nets import build_network
from traffic_bridge.session import Session

STEPS = 100
STEP = 1.0  # [s]
LANES, LANE_WIDTH = 3, 3.2
VEHICLES = 25  # with the truck
SPEED_MAX = 25.0  # of the truck [m/s]
TRUCK = EgoFootprint(length=16.0, width=2.55)
# Acceleration [m/s2] and lane change (1: to the left) of each action.
ACTIONS = (
    *((0.0, 0), (1.0, 0), (-1.0, 0), (-4.0, 0)),
    *((0.0, 1), (1.0, 1), (-1.0, 1)),
    *((0.0, -1), (1.0, -1), (-1.0, -1)),
)
OBSERVATION_SIZE = 4 + 4 * VEHICLES
COLLISION, NEAR_COLLISION, HARD_BRAKING, LANE_CHANGE = 10.0, 10.0, 10.0, 1.0  # penalties

_SPEEDS = (15.0, 35.0)  # of the cars [m/s]
_CAR_LENGTH, _CAR_WIDTH = 4.8, 1.8
_ROAD_LENGTH = 6_500.0  # no car reaches its end
_START_LENGTH = 1_000.0  # of the road on which the vehicles are placed; the truck is in its middle
_SEPARATION_MIN = 30.0
_SETTLING = 4  # steps before an episode begins
_CHANGE_STEPS = 4
_SENSOR_RANGE = 200.0
_HARD = -4.6  # a car that decelerates more was forced to [m/s2]
_HARD_RANGE = 25.0  # behind the truck's front [m]
_BESIDE = 15.0  # [m]
_ON_LANE = 1e-5  # [m]
_TYPES = f"""
<vType id="truck" vClass="trailer" length="{TRUCK.length}" width="{TRUCK.width}"
 maxSpeed="{SPEED_MAX}" accel="1.1" decel="4.0" {{common}}/>
<vType id="car" vClass="passenger" length="{_CAR_LENGTH}" width="{_CAR_WIDTH}" maxSpeed="100"
 accel="2.6" decel="4.5" {{common}}/>
<route id="road" edges="{{edge}}"/>
"""
_VEHICLE = """
<vehicle id="{}" type="{}" route="road" depart="0" departPos="{!r}" departLane="{}"
 departSpeed="{!r}" insertionChecks="none"/>
"""
_DRIVER = (
    'carFollowModel="Krauss" minGap="2.5" collisionMinGapFactor="1" emergencyDecel="9.0" sigma="0" '
    'tau="1.0" speedFactor="1" speedDev="0" laneChangeModel="LC2013" lcStrategic="0" '
    'lcCooperative="0" lcSpeedGain="1" lcKeepRight="0" lcSpeedGainRight="1" lcAssertive="1" '
    'lcSigma="0"'
)
# SUMO keeps the gap to the leader, but the acceleration is free.
_SAFE_SPEED = 1
_NAMES = tuple(f"veh{number:02d}" for number in range(VEHICLES))
TRUCK_NAME = _NAMES[0]


@dataclass(frozen=True)
class HoelStep:
    """What happened in a step.

    Attributes:
      reward: speed over 25 m/s, less the penalties.
      collision: the truck hit a car, or a car the truck.
      left_road: the truck left the outer lanes' side of the road.
      near_collision: less than 2.5 m to the car ahead.
      hard_braking: a car close behind the truck's front braked harder than 4.5 m/s2.
      lane_change: the action had one.
    """

    reward: float
    collision: bool
    left_road: bool
    near_collision: bool
    hard_braking: bool
    lane_change: bool

    @property
    def terminated(self) -> bool:
        """Whether the episode ends before its time."""
        return self.collision or self.left_road


@functools.cache
def _road() -> tuple[Route, Path, str]:
    """The road, its net's file and its only edge."""
    route = Route.straight(_ROAD_LENGTH, LANES, LANE_WIDTH, speed_limit=100.0)
    net = build_network(route)
    return route, net.path, next(iter(net.edges)).id


class HoelHighway:
    """One truck among 24 cars, advanced by actions. It holds the process's only SUMO simulation.

    Attributes:
      route: the road, whose reference line is the center of the right lane.
      step_number: steps since the beginning of the episode.
      front, offset: of all vehicles, the truck first, shape (25,): station of the front bumper and
        distance from the right lane's center [m].
      speed, lateral_speed, acceleration: likewise, [m/s] and [m/s2].
    """

    def __init__(self) -> None:
        self.route, self._net, self._edge = _road()
        self.step_number = 0
        self.front = np.zeros(VEHICLES)
        self.offset, self.speed = np.zeros(VEHICLES), np.zeros(VEHICLES)
        self.lateral_speed, self.acceleration = np.zeros(VEHICLES), np.zeros(VEHICLES)
        self._session: Session | None = None
        self._present = np.zeros(VEHICLES, bool)

    def close(self) -> None:
        """Ends the simulation; may be called again."""
        if self._session is not None:
            self._session.close()
            self._session = None

    def reset(self, generator: np.random.Generator) -> NDArray[np.float32]:
        """Places the vehicles, lets them settle for 4 s and returns the observation.

        Raises:
          TrafficError: SUMO is missing, or already runs in this process.
        """
        self.close()
        front, lane, speed = _start(generator)
        types = _TYPES.format(common=_DRIVER, edge=self._edge)
        kinds = "truck", *["car"] * (VEHICLES - 1)
        rows = zip(_NAMES, kinds, front.tolist(), lane.tolist(), speed.tolist(), strict=True)
        vehicles = "".join(_VEHICLE.format(*row) for row in rows)
        # SUMO draws nothing here; its seed is without effect.
        session = self._session = Session(
            self._net,
            types + vehicles,
            STEP,
            options=("--lanechange.duration", str(_CHANGE_STEPS * STEP)),
        )
        self.step_number = 0
        self._present[:] = True
        with session.guard("placing the vehicles"):
            api = session.api
            api.simulationStep()
            for name, desired in zip(_NAMES[1:], speed[1:], strict=True):
                api.vehicle.setSpeedMode(name, _SAFE_SPEED)
                api.vehicle.setSpeed(name, float(desired))
                api.vehicle.setMaxSpeed(name, float(desired))
            for _ in range(_SETTLING):
                api.simulationStep()
            for name in _NAMES[1:]:
                api.vehicle.setSpeed(name, -1.0)
            api.vehicle.setSpeedMode(TRUCK_NAME, 0)
            api.vehicle.setLaneChangeMode(TRUCK_NAME, 0)
            self._read()
        return self.observation()

    def step(self, action: int) -> HoelStep:
        """Carries out an action, by its place in `ACTIONS`, for one second.

        Raises:
          InputError: unknown action, or no episode has begun.
        """
        if not (isinstance(action, (int, np.integer)) and 0 <= action < len(ACTIONS)):
            raise InputError(f"action {action!r} is unknown; use 0 to {len(ACTIONS) - 1}")
        session = self._session
        if session is None:
            raise InputError("no episode has begun: call reset(generator) first")
        acceleration, side = ACTIONS[action]
        target = min(max(self.speed[0] + acceleration * STEP, 0.0), SPEED_MAX)
        offset = self.offset[0]
        edge = 0.0 if side < 0 else (LANES - 1) * LANE_WIDTH
        left_road = bool(side != 0 and abs(offset - edge) < _ON_LANE)
        with session.guard("stepping"):
            vehicle = session.api.vehicle
            vehicle.setSpeed(TRUCK_NAME, float(target))
            if not left_road:
                vehicle.changeLaneRelative(TRUCK_NAME, side, 1e15)
            session.api.simulationStep()
            self._read()
            self._remove_meeting(side)
            collision, near = self._contacts()
        self.step_number += 1
        hard = self._hard_braking()
        reward = float(self.speed[0]) / SPEED_MAX
        reward -= LANE_CHANGE * (side != 0) + COLLISION * (collision or left_road)
        reward -= NEAR_COLLISION * near + HARD_BRAKING * hard
        return HoelStep(reward, collision, left_road, near, hard, side != 0)

    @property
    def changing(self) -> bool:
        """Whether a lane change of the truck is under way."""
        return bool(self.lateral_speed[0] != 0.0)

    @property
    def lane(self) -> int:
        """The truck's lane; while it changes, the lane that it changes to."""
        place = self.offset[0] / LANE_WIDTH
        if not self.changing:
            return round(place)
        return math.ceil(place) if self.lateral_speed[0] > 0.0 else math.floor(place)

    def observation(self) -> NDArray[np.float32]:
        """Returns the published observation, shape (104,).

        Four numbers of the truck and four of each car within 200 m: distance ahead, to the left,
        relative speed along and across; without a car -1, 0, 0, 0.
        """
        width = (LANES - 1) * LANE_WIDTH
        rows = np.tile([-1.0, 0.0, 0.0, 0.0], (VEHICLES, 1))
        ahead = self.front - self.front[0]
        seen = np.flatnonzero(self._present[1:] & (np.abs(ahead[1:]) <= _SENSOR_RANGE)) + 1
        lateral = self.lateral_speed - self.lateral_speed[0]
        rows[: len(seen)] = np.column_stack(
            (
                ahead[seen] / _SENSOR_RANGE,
                (self.offset[seen] - self.offset[0]) / width,
                (self.speed[seen] - self.speed[0]) / (_SPEEDS[1] - _SPEEDS[0]),
                lateral[seen] / (LANE_WIDTH / (_CHANGE_STEPS * STEP)),
            )
        )
        truck = (
            2.0 * self.offset[0] / width - 1.0,
            2.0 * self.speed[0] / SPEED_MAX - 1.0,
            np.sign(self.lateral_speed[0]),
            0.0,
        )
        return np.concatenate([truck, rows.ravel()]).astype(np.float32)

    def scene(self) -> Scene:
        """Returns what the decision makers of the stack see, without the truck's dynamics."""
        station = float(self.front[0]) - TRUCK.front_overhang
        offset = float(self.offset[0])
        ego = EgoState(
            time=self.step_number * STEP,
            x=station,
            y=offset,
            speed=float(self.speed[0]),
            lateral_speed=float(self.lateral_speed[0]),
            acceleration=float(self.acceleration[0]),
            station=station,
            offset=offset,
            trailer_offset=offset,
        )
        cars = [
            TrackedVehicle(
                name,
                speed=float(self.speed[i]),
                acceleration=float(self.acceleration[i]),
                lateral_speed=float(self.lateral_speed[i]),
                station=float(self.front[i]) - _CAR_LENGTH / 2.0,
                offset=float(self.offset[i]),
                lane=math.floor(self.offset[i] / LANE_WIDTH + 0.5),
                length=_CAR_LENGTH,
                width=_CAR_WIDTH,
            )
            for i, name in enumerate(_NAMES)
            if i and self._present[i]
        ]
        return Scene(ego.time, ego, cars, TRUCK)

    def _read(self) -> None:
        """Reads the vehicles from SUMO."""
        assert self._session is not None
        vehicle = self._session.api.vehicle
        for i, name in enumerate(_NAMES):
            if not self._present[i]:
                continue
            self.front[i], y = vehicle.getPosition(name)
            self.offset[i] = y
            self.speed[i] = vehicle.getSpeed(name)
            self.acceleration[i] = vehicle.getAcceleration(name)
            # SUMO keeps the last lateral speed of a finished change.
            on_lane = abs(y / LANE_WIDTH - round(y / LANE_WIDTH)) * LANE_WIDTH < _ON_LANE
            self.lateral_speed[i] = 0.0 if on_lane else vehicle.getLateralSpeed(name)

    def _remove_meeting(self, side: int) -> None:
        """Removes cars that began to change to the middle lane in the same step as the truck.

        SUMO does not see such a meeting; the published program removes the car.
        """
        quarter = LANE_WIDTH / _CHANGE_STEPS
        begun = quarter if side > 0 else 2.0 * LANE_WIDTH - quarter
        if side == 0 or abs(self.offset[0] - begun) > _ON_LANE:
            return
        meeting: BoolArray = (
            self._present
            & (np.abs(self.offset - (2.0 * LANE_WIDTH - begun)) < _ON_LANE)
            & (np.abs(self.front - self.front[0]) < _BESIDE)
        )
        assert self._session is not None
        for number in np.flatnonzero(meeting):
            self._session.api.vehicle.remove(_NAMES[number])
            self._present[number] = False

    def _contacts(self) -> tuple[bool, bool]:
        """Whether the truck has a collision, or only less than the least gap to the car ahead."""
        assert self._session is not None
        near = False
        for found in self._session.api.simulation.getCollisions():
            if TRUCK_NAME not in (found.collider, found.victim):
                continue
            other = _NAMES.index(found.victim if found.collider == TRUCK_NAME else found.collider)
            if self.front[other] - _CAR_LENGTH <= self.front[0]:
                return True, False
            near = True
        return False, near

    def _hard_braking(self) -> bool:
        """Whether a car close behind the truck's front brakes hard.

        As in the published program, only the first car that brakes counts.
        """
        braking = np.flatnonzero(self._present & (self.acceleration < _HARD))
        if not braking.size:
            return False
        return bool(0.0 < self.front[0] - self.front[braking[0]] < _HARD_RANGE)


def _start(generator: np.random.Generator) -> tuple[FloatArray, IntArray, FloatArray]:
    """Draws the fronts' stations, lanes and speeds of an episode's beginning."""
    front = generator.uniform(0.0, _START_LENGTH, VEHICLES)
    front[0] = _START_LENGTH / 2.0
    lane = generator.integers(0, LANES, VEHICLES)
    while (close := _too_close(front, lane)).size:
        front[close] = generator.uniform(0.0, _START_LENGTH, close.size)
        lane[close] = generator.integers(0, LANES, close.size)
    ahead = generator.uniform(_SPEEDS[0], SPEED_MAX, VEHICLES)
    behind = generator.uniform(SPEED_MAX, _SPEEDS[1], VEHICLES)
    speed = np.where(front > front[0], ahead, behind)
    speed[0] = SPEED_MAX
    return front, lane, speed


def _too_close(front: FloatArray, lane: IntArray) -> IntArray:
    """Of the closest two vehicles of each lane the later one, if they are too close."""
    found = []
    for number in range(LANES):
        inside = np.flatnonzero(lane == number)
        apart = np.abs(np.subtract.outer(front[inside], front[inside]))
        apart[np.tril_indices(len(inside))] = math.inf
        if apart.size and apart.min() < _SEPARATION_MIN:
            found.append(inside[np.unravel_index(apart.argmin(), apart.shape)[1]])
    return np.array(found, np.int64)
