"""The manoeuvres of `path_tracking`: what disturbs a truck on its path, one function each."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from controllers.decision.base import DecisionContext
from iits_mj.core.messages import Decision, EgoState, VehicleCommand, XbrMode
from iits_mj.core.units import KMH
from iits_mj.parameters import TruckParameters
from iits_mj.road import RoadMap, Route
from iits_mj.road.design import Design, build
from iits_mj.truck import Truck
from iits_mj.validation.handling.side_wind import SideWind
from iits_mj.validation.planning.path_run import PERIOD, Override, PathRun, drive_path

# More than any surface gives, so that ABS works [m/s2].
FULL_BRAKING = -8.0
# Deviation of what the controller is told, white at 50 Hz, as after the sensors' own filters: 6 mm,
# 0.015 deg, 1 cm/s, 0.03 deg/s, 0.03 deg at the hitch and 0.006 deg at the road wheels.
NOISE = {
    "x": 0.006,
    "y": 0.006,
    "yaw": 2.6e-4,
    "lateral_speed": 0.01,
    "yaw_rate": 5.2e-4,
    "trailer_yaw_rate": 5.2e-4,
    "articulation": 5.2e-4,
    "road_wheel_angle": 1.0e-4,
}
_STRAIGHT_BEFORE, _STRAIGHT_AFTER = 60.0, 500.0


def turn_road(
    radius: float, angle: float, clothoid: float, cross_slope: float = 0.0, lane_width: float = 4.0
) -> Route:
    """A level one-lane road with one bend between two straights.

    Args:
      radius: positive to the left [m].
      angle: turned in all [rad], more than the clothoids take.
      clothoid: length of each [m].
      cross_slope: of the arc, falling to its inner side [rad].
      lane_width: [m].
    """
    bend = 1.0 / radius
    roll = -math.copysign(cross_slope, radius)
    arc = (angle - clothoid * abs(bend)) * abs(radius)
    alignment = (
        (_STRAIGHT_BEFORE, 0.0, 0.0, 0.0, 0.0),
        (clothoid, 0.0, bend, 0.0, roll),
        (arc, bend, bend, roll, roll),
        (clothoid, bend, 0.0, roll, 0.0),
        (_STRAIGHT_AFTER, 0.0, 0.0, 0.0, 0.0),
    )
    design = Design(
        name="bend",
        start=(0.0, 0.0, 0.0, 0.0),
        lane_width=lane_width,
        lanes=1,
        left_shoulder=2.0,
        right_shoulder=2.0,
        speed_limit=90.0 * KMH,
        initial_grade=0.0,
        road_ends=(),
        alignment=alignment,
        grades=(),
        extra_lanes=(),
        limits=(),
        structures=(),
    )
    return RoadMap(build(design), f"bend of {radius:g} m").route()


@dataclass
class _ChangeOnce:
    """Asks for the left lane once, after a time [s]."""

    at: float
    name: str = "once"

    def reset(self) -> None:
        """Nothing to forget."""

    def decide(self, context: DecisionContext) -> Decision:
        """Left in the second that begins at the time, else keep."""
        asked = self.at - 0.5 <= context.scene.time < self.at + 0.5
        return Decision.LEFT if asked else Decision.KEEP


def highway(
    payload: float, timestep: float, wind: SideWind | None, start: float, end: float
) -> PathRun:
    """The built-in highway at the speeds that it allows, 60 to 80 km/h, between two stations."""
    route = RoadMap.builtin().route()
    truck = Truck.load(payload, route=route, timestep=timestep, visuals=False)
    speed = min(80.0 * KMH, route.speed_limit(start))
    run = drive_path(
        truck,
        cruise=80.0 * KMH,
        duration=2.0 * (end - start) / speed,
        station=start,
        speed=speed,
        wind=wind,
        end=end,
    )
    # The truck is put on the road with its wheel straight and nothing known of the wind.
    return run.after(4.0)


def fast_bends(payload: float, timestep: float, wind: SideWind) -> PathRun:
    """A bend of 500 m at 90 km/h, with cross-slope and gusts."""
    route = turn_road(500.0, 1.0, 150.0, cross_slope=0.04)
    truck = Truck.load(payload, route=route, timestep=timestep, visuals=False)
    return drive_path(
        truck,
        cruise=90.0 * KMH,
        duration=60.0,
        station=25.0,
        speed=90.0 * KMH,
        wind=wind,
        end=route.length - 400.0,
    )


def pull_away(payload: float, timestep: float, wind: SideWind) -> PathRun:
    """From standstill towards 90 km/h on a straight road in wind, for a minute."""
    truck = Truck.load(payload, route=Route.straight(5000.0), timestep=timestep, visuals=False)
    return drive_path(truck, cruise=90.0 * KMH, duration=60.0, station=50.0, speed=0.0, wind=wind)


def junction(payload: float, timestep: float, radius: float, speed: float) -> PathRun:
    """From standstill through a right angle of a small radius."""
    route = turn_road(radius, 0.5 * np.pi, 8.0, lane_width=6.0)
    truck = Truck.load(payload, route=route, timestep=timestep, visuals=False)
    return drive_path(
        truck,
        cruise=speed,
        duration=200.0,
        station=25.0,
        speed=0.0,
        end=route.length - _STRAIGHT_AFTER + 40.0,
    )


def lane_change(payload: float, timestep: float, speed: float) -> PathRun:
    """One change to the left on a straight road."""
    truck = Truck.load(payload, route=Route.straight(2000.0), timestep=timestep, visuals=False)
    return drive_path(
        truck,
        cruise=speed,
        duration=16.0,
        station=50.0,
        speed=speed,
        maker=_ChangeOnce(2.0),
    )


def brake_in_bend(payload: float, timestep: float, friction: float, speed: float) -> PathRun:
    """Full braking to standstill in the middle of a bend of 400 m."""
    route = turn_road(400.0, 1.2, 120.0).with_friction(friction, friction)
    truck = Truck.load(payload, route=route, timestep=timestep, visuals=False)
    return drive_path(
        truck,
        cruise=speed,
        duration=40.0,
        station=120.0,
        speed=speed,
        override=_full_braking(after=5.0),
    )


def split_braking(payload: float, timestep: float, high: float, low: float) -> PathRun:
    """Full braking from 50 km/h with good grip on the left and little on the right (ISO 16234)."""
    route = Route.straight(2000.0).with_friction(high, low)
    truck = Truck.load(payload, route=route, timestep=timestep, visuals=False)
    return drive_path(
        truck,
        cruise=50.0 * KMH,
        duration=30.0,
        station=50.0,
        speed=50.0 * KMH,
        override=_full_braking(after=3.0),
    )


def _full_braking(after: float) -> Override:
    """An override that brakes fully from a time [s] on until the truck stands."""

    def override(state: EgoState, command: VehicleCommand) -> VehicleCommand:
        if state.time < after:
            return command
        return replace(
            command,
            accelerator_pedal=0.0,
            xbr_demand=FULL_BRAKING,
            xbr_mode=XbrMode.MAXIMUM,
        )

    return override


def side_impulse(
    payload: float, timestep: float, speed: float, force: float, *, steered: bool
) -> PathRun:
    """A push to the left on the trailer's centre of gravity for half a second, from 5 s on.

    Args:
      payload: [kg].
      timestep: [s].
      speed: [m/s].
      force: [N].
      steered: by the controller; else the wheel is held straight from the push on.
    """
    truck = Truck.load(payload, route=Route.straight(5000.0), timestep=timestep, visuals=False)
    body = truck.model.body("trailer").id

    def push(pushed: Truck, time: float) -> None:
        pushed.data.xfrc_applied[body, 1] = force if 5.0 <= time < 5.5 else 0.0

    def hold(state: EgoState, command: VehicleCommand) -> VehicleCommand:
        return (
            command if steered or state.time < 5.0 else replace(command, steering_wheel_angle=0.0)
        )

    return drive_path(
        truck,
        cruise=speed,
        duration=17.0,
        station=50.0,
        speed=speed,
        override=hold,
        disturb=push,
    )


def settling_time(run: PathRun, since: float, share: float) -> float:
    """Time from `since` [s] until the articulation rate stays below a share of its peak [s]."""
    after = run.time >= since
    rate = np.abs(run.articulation_rate[after])
    beyond = np.flatnonzero(rate > share * rate.max())
    return float((beyond[-1] + 1) * PERIOD)


def measured(ego: EgoState, noise: float, generator: np.random.Generator) -> EgoState:
    """A state as sensors of this noise would give it, white at 50 Hz."""
    errors = noise * generator.normal(size=len(NOISE)) * np.array(list(NOISE.values()))
    pairs = zip(NOISE, errors.tolist(), strict=True)
    return replace(ego, **{name: getattr(ego, name) + error for name, error in pairs})


def unlike_the_model(
    timestep: float,
    wind: SideWind | None,
    *,
    stiffness: float = 1.0,
    mass: float = 1.0,
    dead_band: float = 1.0,
    noise: float = 0.0,
) -> PathRun:
    """Laden, 30 s of the highway: the truck is not what its controller believes.

    Args:
      timestep: [s].
      wind: across the road.
      stiffness: cornering stiffness of all tires over that believed.
      mass: reported over that of the truck.
      dead_band: of the steering over that believed.
      noise: of what is measured, over `NOISE`.
    """
    route = RoadMap.builtin().route()
    plain, generator = TruckParameters.load(), np.random.default_rng(0)
    overlay = {
        "tires": {
            name: {"cornering_coefficient": stiffness * tire.cornering_coefficient}
            for name, tire in plain.tires.items()
        },
        "steering": {"dead_band": dead_band * plain.steering.dead_band},
    }
    truck = Truck.load(route=route, parameters=overlay, timestep=timestep, visuals=False)
    run = drive_path(
        truck,
        cruise=80.0 * KMH,
        duration=34.0,
        station=5200.0,
        speed=80.0 * KMH,
        wind=wind,
        reported=lambda ego: measured(replace(ego, mass=mass * ego.mass), noise, generator),
    )
    return run.after(4.0)
