"""The fast world in NumPy: the reference of iits_mj/kernels/fast_world.cc.

`HighwayTraffic` and `HighwayEnv` draw from a generator what the compiled world draws from its own
state, in the same order, so that a seed means the same trip.
"""

import math
from dataclasses import dataclass

import numpy as np

from controllers.decision.base import DecisionContext
from controllers.decision.fast_world.config import (
    KINDS,
    LANE_WIDTH,
    NUMBERS,
    SHARES,
    WAVES,
    HighwayConfig,
    HighwayRoad,
    Obstacle,
)
from controllers.decision.observation import ObservationHistory, observe_frame
from controllers.decision.rules import HARDEST_BRAKING as TRUCK_BRAKING
from controllers.decision.trip import TripConfig, TripLog
from controllers.planning.config import FollowingConfig, LaneChangeConfig, SafetyConfig
from controllers.planning.following import follow_acceleration
from controllers.planning.safety import front_gap_needed, rear_gap_needed
from iits_mj.core.messages import Decision, EgoState, Scene, TrackedVehicle
from iits_mj.core.units import GRAVITY
from iits_mj.parameters import TruckParameters
from iits_mj.parameters.mass_state import rolling_resistance

MARGIN = 2.0  # [m] that must be free ahead and behind after a change
CRITICAL_SPEED = 60.0 / 3.6  # [m/s]: below it lanes may pass on the right
MEAN_DESIRED_SPEED = 0.92  # share of the limit with which the road is filled
HARDEST_BRAKING = 8.0  # [m/s2], dry road
RAMP_LENGTH = 250.0  # [m]
TRUCK_KIND = len(KINDS) - 1
COLUMNS = {
    **dict.fromkeys(("serial", "lane", "kind"), np.int64),
    **dict.fromkeys(("front", "speed", "acceleration", "length", "desired"), np.float64),
    **dict.fromkeys(("change_time", "change_from"), np.float64),
}
FOLLOWING, SAFETY = FollowingConfig(), SafetyConfig()
_TABLE = {name: np.array([getattr(kind, name) for kind in KINDS]) for name in NUMBERS}


class Drivers:
    """Parameters of n drivers: an array of shape (n,) for each number of `Kind`."""

    def __init__(self, kinds):
        self._kinds = kinds

    def __getattr__(self, name):
        return _TABLE[name][self._kinds]

    def of(self, index):
        return Drivers(self._kinds[index])


def idm_acceleration(speed, desired, gap, leader_speed, drivers):
    """IDM, Treiber et al. (2000) eq. 3; the free term is bounded at -b above the desired speed."""
    a, b = drivers.acceleration, drivers.deceleration
    free = a * np.maximum(1.0 - (speed / desired) ** 4, -b / a)
    dynamic = speed * (speed - leader_speed) / (2.0 * np.sqrt(a * b))
    wanted = drivers.minimum_gap + np.maximum(0.0, speed * drivers.time_headway + dynamic)
    return free - a * (wanted / np.maximum(gap, 0.1)) ** 2


@dataclass(frozen=True)
class Vehicles:
    """Vehicles and obstacles of a road, arrays of shape (n,); stations of front bumpers."""

    front: np.ndarray
    length: np.ndarray
    speed: np.ndarray
    desired: np.ndarray
    lane: np.ndarray
    drivers: Drivers

    def around(self, deciders, lanes):
        """Indices of leader and follower of deciders in lanes, -1 for none."""
        found = np.full((2, deciders.size), -1)
        for lane in np.unique(lanes):
            asks = np.flatnonzero(lanes == lane)
            there = np.flatnonzero(self.lane == lane)
            there = there[np.argsort(self.front[there], kind="stable")]
            fronts = self.front[deciders[asks]]
            last = np.searchsorted(self.front[there], fronts, side="right")
            # The decider is among the vehicles of its own lane.
            own = self.lane[deciders[asks]] == lane
            padded = np.concatenate([[-1], there, [-1]])
            found[0, asks], found[1, asks] = padded[last + 1], padded[last - own]
        return found

    def gap(self, behind, leader):
        """Gap to and speed of leaders; inf and the own speed where the index is -1."""
        has = leader >= 0
        gap = (self.front - self.length)[leader] - self.front[behind]
        speed = np.where(has, self.speed[leader], self.speed[behind])
        return np.where(has, gap, np.inf), speed


def gains(vehicles, deciders, side, keeps_right):
    """MOBIL's gain above the threshold of a change by `side` lanes [m/s2]; -inf if unsafe.

    safety      a~_n >= -b_safe, a~_c >= -b_safe, and room for the vehicle
    for itself  a~_c - a_c > a_th (the symmetric rule with p = 0)
    keep right  to the right   a~_c^eur - a_c + p (a~_o - a_o) > a_th - a_bias
                to the left    a~_c - a_c^eur + p (a~_n - a_n) > a_th + a_bias

    c decides, n is its follower after the change, o before it; `a~` are accelerations after it.
    Kesting, Treiber and Helbing, Transportation Research Record 1999 (2007), 86-94.
    """
    leader, follower = vehicles.around(deciders, vehicles.lane[deciders])
    new_leader, new_follower = vehicles.around(deciders, vehicles.lane[deciders] + side)
    kinds, own_speed = vehicles.drivers.of(deciders), vehicles.speed[deciders]
    rear = (vehicles.front - vehicles.length)[deciders]

    def driven(index, gap, speed):
        own, desired = vehicles.speed[index], vehicles.desired[index]
        value = idm_acceleration(own, desired, gap, speed, vehicles.drivers.of(index))
        return np.where(index >= 0, value, 0.0)

    gap, speed = vehicles.gap(deciders, leader)
    new_gap, new_speed = vehicles.gap(deciders, new_leader)
    gap_behind = np.where(follower >= 0, rear - vehicles.front[follower], np.inf)
    new_gap_behind = np.where(new_follower >= 0, rear - vehicles.front[new_follower], np.inf)
    before, after = driven(deciders, gap, speed), driven(deciders, new_gap, new_speed)
    braking = driven(new_follower, new_gap_behind, own_speed)
    gain = after - before
    if keeps_right:
        left_gap, left_speed = (gap, speed) if side < 0 else (new_gap, new_speed)
        bound = (left_gap < np.inf) & (own_speed > left_speed) & (left_speed > CRITICAL_SPEED)
        lesser = np.where(bound, np.minimum(before, after), after if side < 0 else before)
        if side < 0:
            freed = driven(follower, *vehicles.gap(follower, leader))
            others = freed - driven(follower, gap_behind, own_speed)
            gain = lesser - before
        else:
            others = braking - driven(new_follower, *vehicles.gap(new_follower, new_leader))
            gain = after - lesser
        gain = gain - side * kinds.keep_right_bias + kinds.politeness * others
    safe = (new_gap >= MARGIN) & (new_gap_behind >= MARGIN)
    safe &= (after >= -kinds.safe_braking) & (braking >= -kinds.safe_braking)
    return np.where(safe, gain - kinds.change_threshold, -np.inf)


def blended(phase, duration):
    """The share of a lane change at a phase of 0 to 1, by a quintic, and its rate [1/s]."""
    blend = phase**3 * (10.0 - 15.0 * phase + 6.0 * phase**2)
    return blend, 30.0 * phase**2 * (1.0 - phase) ** 2 / duration


class HighwayTraffic:
    """The vehicles around the truck; arrays of shape (n,), changed in place by `step`."""

    CHANGE_DURATION = 3.5
    CHANGE_INTERVAL = 6.0

    def __init__(self, config, generator):
        self.config = config
        self._random = generator
        self._serial = 0
        self.clock = 0.0
        self._round_due = 0.0
        for name, kind in COLUMNS.items():
            setattr(self, name, np.zeros(0, dtype=kind))
        # Beyond each edge of the window one vehicle per lane waits: its distance from the edge.
        self._wait_ahead = [0.5 * self._headway() for _ in range(config.lanes)]
        self._wait_behind = [0.5 * self._headway() for _ in range(config.lanes)]
        self._most_ahead = list(self._wait_ahead)
        self._most_behind = list(self._wait_behind)

    def fill(self, truck):
        for lane in range(self.config.lanes):
            front = truck.front - self.config.window_behind
            while True:
                front += self._headway()
                if front > truck.front + self.config.window_ahead:
                    break
                near = truck.front - truck.length - 40.0 < front < truck.front + 40.0
                if not (near and lane == truck.lane):
                    self.spawn(lane, front)

    def step(self, obstacles):
        dt = self.config.timestep
        self.clock += dt
        truck = obstacles[0]
        if self.clock >= self._round_due:
            self._round_due += 1.0
            self._arrive(truck)
            self._change_lanes(obstacles)
        vehicles = self._vehicles(obstacles)
        everyone = np.arange(vehicles.front.size)
        leader, _ = vehicles.around(everyone, vehicles.lane)
        gap, leader_speed = vehicles.gap(everyone, leader)
        wanted = idm_acceleration(
            vehicles.speed, vehicles.desired, gap, leader_speed, vehicles.drivers
        )
        wanted = np.maximum(wanted[: self.front.size], -HARDEST_BRAKING)
        new_speed = np.maximum(0.0, self.speed + wanted * dt)
        self.front += 0.5 * (self.speed + new_speed) * dt
        self.acceleration = (new_speed - self.speed) / dt
        self.speed = new_speed
        self._exchange(truck)

    def tracked(self, front):
        """The vehicles in sight of the truck as messages."""
        distance = self.front - front
        low, high = -self.config.sight_behind, self.config.sight_ahead
        found = []
        for k in np.flatnonzero((distance > low) & (distance < high)):
            kind, start = KINDS[self.kind[k]], float(self.change_from[k])
            phase = float(np.clip((self.clock - self.change_time[k]) / self.CHANGE_DURATION, 0, 1))
            blend, rate = blended(phase, self.CHANGE_DURATION)
            step = float(self.lane[k]) * LANE_WIDTH - start
            place, offset = float(self.front[k] - 0.5 * self.length[k]), start + step * blend
            found.append(
                TrackedVehicle(
                    id=f"v{self.serial[k]}",
                    kind=kind.kind,
                    x=place,
                    y=offset,
                    speed=float(self.speed[k]),
                    acceleration=float(self.acceleration[k]),
                    lateral_speed=step * rate,
                    station=place,
                    offset=offset,
                    lane=math.floor(offset / LANE_WIDTH + 0.5),
                    length=kind.length,
                    width=kind.width,
                    height=kind.height,
                )
            )
        return tuple(found)

    def neighbors(self, front, lane):
        """Indices of the vehicles ahead of and behind a front in a lane; -1 for none."""
        mine = np.flatnonzero(self.lane == lane)
        ahead = mine[self.front[mine] > front]
        behind = mine[self.front[mine] <= front]
        return (
            int(ahead[np.argmin(self.front[ahead])]) if ahead.size else -1,
            int(behind[np.argmax(self.front[behind])]) if behind.size else -1,
        )

    def spawn(self, lane, front):
        """Adds a random vehicle with its front bumper at a station [m], if there is room."""
        random, config = self._random, self.config
        index = int(random.choice(len(KINDS), p=SHARES))
        kind = KINDS[index]
        factor = float(random.normal(kind.desired_speed_mean, kind.desired_speed_deviation))
        limit = config.traffic_speed
        if config.truck_speed_limit is not None and kind.kind in ("truck", "articulated"):
            limit = min(limit, config.truck_speed_limit)
        speed = desired = limit * min(1.0, max(kind.desired_speed_low, factor))
        leader, follower = self.neighbors(front, lane)
        if leader >= 0 and self.front[leader] - self.length[leader] - front < 2.0 * speed:
            speed = min(speed, float(self.speed[leader]))
        if follower >= 0 and front - kind.length - self.front[follower] < kind.minimum_gap:
            return  # The vehicle is too long for the gap.
        self._serial += 1
        row = (self._serial, lane, index, front, speed, 0.0, kind.length, desired)
        for name, value in zip(COLUMNS, (*row, -math.inf, lane * LANE_WIDTH), strict=True):
            array = getattr(self, name)
            setattr(self, name, np.append(array, np.asarray(value, dtype=array.dtype)))

    def _headway(self):
        """Draws a distance between fronts [m]: Poisson arrivals, enough to drive at the limit."""
        if self.config.spawn_probability == 0.0:
            return math.inf
        speed = self.config.traffic_speed
        mean = MEAN_DESIRED_SPEED * speed / self.config.spawn_probability
        least = KINDS[0].length + KINDS[0].minimum_gap + 1.5 * speed
        return max(least, float(self._random.exponential(mean)))

    def _ramps(self, low, high):
        if self.config.ramp_probability == 0.0:
            return []
        interval = self.config.ramp_interval
        return [k * interval for k in range(1, int(high / interval) + 1) if k * interval > low]

    def _arrive(self, truck):
        low, high = truck.front - self.config.window_behind, truck.front + self.config.window_ahead
        for start in self._ramps(low, high):
            if self._random.random() < self.config.ramp_probability and self._free(-1, start):
                self.spawn(-1, start)

    def _exchange(self, truck):
        """Removes vehicles that leave the window and adds those that its edges reach."""
        low = truck.front - self.config.window_behind
        high = truck.front + self.config.window_ahead
        keep = (self.front > low - 1.0) & (self.front < high + 1.0)
        for name in COLUMNS:
            setattr(self, name, getattr(self, name)[keep])
        closing = (truck.speed - 0.9 * self.config.traffic_speed) * self.config.timestep
        for lane in range(self.config.lanes):
            self._wait_ahead[lane] = min(self._wait_ahead[lane] - closing, self._most_ahead[lane])
            if self._wait_ahead[lane] <= 0.0 and self._free(lane, high):
                self.spawn(lane, high)
                self._wait_ahead[lane] = self._most_ahead[lane] = self._headway()
            wait = min(self._wait_behind[lane] + closing, self._most_behind[lane])
            self._wait_behind[lane] = wait
            if wait <= 0.0 and self._free(lane, low):
                self.spawn(lane, low)
                self._wait_behind[lane] = self._most_behind[lane] = self._headway()

    def _free(self, lane, front):
        return not bool((np.abs(self.front[self.lane == lane] - front) < 30.0).any())

    def _vehicles(self, obstacles):
        """The vehicles, the truck once for each lane that it occupies, the ends of the ramps."""
        front = obstacles[0].front
        low, high = front - self.config.window_behind, front + self.config.window_ahead
        walls = [
            Obstacle(start + RAMP_LENGTH, 0.0, 0.0, -1)
            for start in self._ramps(low - RAMP_LENGTH, high)
        ]
        others = [*obstacles, *walls]
        return Vehicles(
            front=np.append(self.front, [o.front for o in others]),
            length=np.append(self.length, [o.length for o in others]),
            speed=np.append(self.speed, [o.speed for o in others]),
            # The truck keeps its speed.
            desired=np.append(self.desired, [max(o.speed, 1.0) for o in others]),
            lane=np.append(self.lane, [o.lane for o in others]),
            drivers=Drivers(np.append(self.kind, [TRUCK_KIND] * len(others))),
        )

    def _change_lanes(self, obstacles):
        """Runs a MOBIL round, vehicle by vehicle; each sees the changes of those before it."""
        rested = np.flatnonzero(self.clock - self.change_time > self.CHANGE_INTERVAL)
        keeps_right = self.config.keeps_right
        while rested.size:
            vehicles = self._vehicles(obstacles)
            gain = np.array([gains(vehicles, rested, side, keeps_right) for side in (-1, 1)])
            gain[0, self.lane[rested] < 1] = -np.inf
            gain[1, self.lane[rested] == self.config.lanes - 1] = -np.inf
            wanting = np.flatnonzero(gain.max(axis=0) > 0.0)
            if wanting.size == 0:
                return
            first = int(rested[wanting[0]])
            self.change_from[first] = self.lane[first] * LANE_WIDTH
            self.change_time[first] = self.clock
            self.lane[first] += (-1, 1)[int(gain[:, wanting[0]].argmax())]
            rested = rested[wanting[0] + 1 :]


class HighwayTruck:
    """Longitudinal motion of the truck; `front` is the front bumper's station [m]."""

    def __init__(self, parameters, payload):
        engine, gearbox, air = parameters.engine, parameters.gearbox, parameters.aerodynamics
        self.mass = parameters.gross_mass(payload)
        efficiency = gearbox.efficiency * gearbox.driveline_efficiency
        self._power = float((engine.full_load_speed * engine.full_load_torque).max()) * efficiency
        self._drag = 0.5 * air.density * air.mean_drag_area()
        self._rolling = rolling_resistance(parameters, parameters.check_payload(payload))
        self.front = self.speed = self.acceleration = 0.0

    def step(self, dt, reference, leaders, grade):
        slope = GRAVITY * (math.sin(math.atan(grade)) + self._rolling)
        force = self._power / max(self.speed, 4.0) - self._drag * self.speed**2
        wanted = force / self.mass - slope
        for leader in ((math.inf, 0.0, 0.0), *leaders):
            wanted = min(wanted, follow_acceleration(self.speed, reference, *leader, FOLLOWING))
        wanted = max(wanted, -TRUCK_BRAKING)
        speed = max(0.0, self.speed + wanted * dt)
        self.front += 0.5 * (self.speed + speed) * dt
        self.acceleration = (speed - self.speed) / dt
        self.speed = speed


class HighwayEnv:
    """The fast world as a `World`."""

    def __init__(self, grade_max=0.045):
        self._grade_max = grade_max
        self._history = ObservationHistory()

    def reset(self, generator, trip=None):
        trip = trip or TripConfig()
        parameters = TruckParameters.load(trip.truck)
        self._footprint = parameters.footprint
        self.log = TripLog(trip)
        self.summary = self.log.summary
        self._end = trip.start_station + trip.length
        phase = tuple(generator.uniform(0.0, 2.0 * math.pi, 2).tolist())
        amplitude = tuple((self._grade_max * WAVES).tolist())
        self.road = HighwayRoad(self._end, trip.lanes, amplitude, phase)
        self.truck = HighwayTruck(parameters, trip.payload)
        self.truck.front = trip.start_station + self._footprint.front_overhang
        self.truck.speed = min(trip.traffic_speed, trip.reference_speed)
        self.lane, self._source = 0, 0
        self._change_left, self._change_lasts = 0.0, 1.0
        self._changed_at = -math.inf
        self._random = generator
        self.time = 0.0
        demand = (trip.spawn_probability, trip.traffic_speed, trip.keeps_right, trip.lanes)
        ramps = (trip.truck_speed_limit, trip.ramp_probability, trip.ramp_interval)
        self.traffic = HighwayTraffic(HighwayConfig(*demand, *ramps), generator)
        self.traffic.fill(self._obstacles()[0])
        self._history.reset()
        self._observe()
        return self._history.observation()

    def context(self):
        trip = self.log.trip
        return DecisionContext(
            scene=self._scene,
            route=self.road,
            lane=self.lane,
            lanes=tuple(range(trip.lanes)),
            reference_speed=trip.reference_speed,
            observation=self._history.observation(),
            may_pass=not (trip.truck_keeps_right and self._stays_free(self.lane)),
        )

    def _stays_free(self, lane):
        """Whether the leader in a lane is beyond 4 m + 1.5 s for 20 s at the reference speed."""
        leader = self._scene.neighbors.leader_in_lane(self.road, lane)
        speed = max(self.truck.speed, self.log.trip.reference_speed)
        if leader is None:
            return True
        gaps = (leader.gap - (speed - leader.speed) * time for time in range(21))
        return min(gaps) >= 4.0 + 1.5 * speed

    def _returns(self):
        rested = self.time - self._changed_at >= LaneChangeConfig.pause - 1e-6
        right = self.lane - 1
        keeps_right = self.log.trip.truck_keeps_right and right >= 0
        return keeps_right and rested and self.safe(right) and self._stays_free(right)

    def safe(self, target):
        """Whether the gaps in a lane are at least the planner's safety gaps."""
        truck, traffic = self.truck, self.traffic
        rear = truck.front - self._footprint.length
        lead, follow = traffic.neighbors(truck.front, target)
        if lead >= 0:
            gap = float(traffic.front[lead] - traffic.length[lead]) - truck.front
            if gap < front_gap_needed(truck.speed, float(traffic.speed[lead]), SAFETY):
                return False
        if follow < 0:
            return True
        gap = rear - float(traffic.front[follow])
        return gap >= rear_gap_needed(truck.speed, float(traffic.speed[follow]), SAFETY)

    def step(self, decision, speed_max=math.inf):
        self._speed_max = speed_max
        target = self.lane - int(decision)  # LEFT is -1, lanes count from the right
        rested = self.time - self._changed_at >= LaneChangeConfig.pause - 1e-6
        changes = decision is not Decision.KEEP
        possible = 0 <= target < self.log.trip.lanes and rested
        if decision is Decision.LEFT and not self.context().may_pass:
            possible = False
        dangerous = changes and possible and not self.safe(target)
        refused = changes and (dangerous or not possible)
        seconds = 1.0
        returns = not changes and self._returns()
        if returns:
            target = self.lane - 1
        changed = returns or (changes and not refused)
        if changed:
            self._source, self.lane = self.lane, target
            self.log.quality.begin_change(self._scene, self.road, target)
            seconds = float(self._random.integers(6, 9, endpoint=True))
            self._change_left = self._change_lasts = seconds
        log, collided = self.log, False
        log.begin()
        while log.elapsed < seconds - 1e-9 and not collided and not self._over():
            collided = self._second()
            log.charge_speed(self.truck.speed, 1.0)
        if self._source != self.lane:
            self._source, self._changed_at = self.lane, self.time
        self._change_left = 0.0
        return log.end(
            decision,
            self._history.observation(),
            changes=int(changed),
            refused=int(refused),
            dangerous=int(dangerous),
            collision_at=max(log.elapsed - 1.0, 0.0) if collided else None,
            over=self._over(),
        )

    def _over(self):
        station = self.truck.front - self._footprint.front_overhang
        return station >= self._end or self.time >= self.log.trip.duration

    def _second(self):
        """Advances one second and observes; returns whether there was a collision."""
        dt = self.traffic.config.timestep
        reference = min(self.log.trip.reference_speed, self._speed_max)
        collided = False
        for _ in range(round(1.0 / dt)):
            leaders = [self._leader(o.lane) for o in self._obstacles()]
            station = self.truck.front - self._footprint.front_overhang
            self.truck.step(dt, reference, leaders, self.road.smoothed_grade(station))
            self.traffic.step(self._obstacles())
            self.time += dt
            self._change_left = max(0.0, self._change_left - dt)
            self.log.drive(self.truck.speed, dt)
            self.summary.distance += self.truck.speed * dt
            self.log.quality.add(self._see(), self.lane, dt)
            collided = collided or self._collided()
        self._observe()
        return collided

    def _phase(self):
        """The progress of the change, 0 to 1."""
        if self._source == self.lane:
            return 1.0
        return 1.0 - self._change_left / self._change_lasts

    def _obstacles(self):
        """The truck in its own lane, and for 70 % of a change in the one that it leaves."""
        truck, length = self.truck, self._footprint.length
        lanes = [self.lane]
        if self._source != self.lane and self._phase() < 0.7:
            lanes.append(self._source)
        return [Obstacle(truck.front, length, truck.speed, lane) for lane in lanes]

    def _leader(self, lane):
        lead, _ = self.traffic.neighbors(self.truck.front, lane)
        if lead < 0:
            return math.inf, 0.0, 0.0
        traffic = self.traffic
        gap = float(traffic.front[lead] - traffic.length[lead]) - self.truck.front
        if lane == self.lane and self.truck.speed > 1.0 and gap >= 0.0:
            time_gap = gap / self.truck.speed
            self.summary.time_gap_min = min(self.summary.time_gap_min, time_gap)
        return gap, float(traffic.speed[lead]), float(traffic.acceleration[lead])

    def _collided(self):
        traffic, front = self.traffic, self.truck.front
        rear = front - self._footprint.length
        overlaps = (traffic.front > rear) & (traffic.front - traffic.length < front)
        return bool(np.isin(traffic.lane[overlaps], [o.lane for o in self._obstacles()]).any())

    def _observe(self):
        """Makes the scene and adds its frame to the history."""
        self._scene = self._see()
        self._history.add(
            self.time, observe_frame(self._scene, self.road, self.log.trip.reference_speed)
        )

    def _see(self):
        step = (self.lane - self._source) * LANE_WIDTH
        blend, rate = blended(self._phase(), self._change_lasts)
        offset = self._source * LANE_WIDTH + step * blend
        station = self.truck.front - self._footprint.front_overhang
        ego = EgoState(
            time=self.time,
            x=station,
            y=offset,
            speed=self.truck.speed,
            lateral_speed=step * rate,
            acceleration=self.truck.acceleration,
            mass=self.truck.mass,
            station=station,
            offset=offset,
            trailer_offset=offset,
        )
        return Scene(self.time, ego, self.traffic.tracked(self.truck.front), self._footprint)
