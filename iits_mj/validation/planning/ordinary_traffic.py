"""Ordinary traffic in the fast world, planned through: false alarms, gaps, changes.

Vehicles follow by IDM and change lanes by MOBIL, also right before the truck. The truck obeys its
plans exactly and is asked once a second by the MOBIL decision maker.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np

from controllers.decision.base import DecisionContext
from controllers.decision.fast_world.config import LANE_WIDTH, HighwayConfig, Obstacle
from controllers.decision.fast_world.traffic import HighwayTraffic
from controllers.decision.rules import Mobil
from iits_mj.core.messages import Decision, EgoState, Scene, TrackedVehicle
from iits_mj.road import Route
from iits_mj.validation.planning.ideal_drive import STEP, IdealDrive


@dataclass(frozen=True)
class Ordinary:
    """What happened in an ordinary drive.

    Attributes:
      duration: [s]; emergencies: brakings of the last layer; changes: completed; aborted: changes.
      gap: least bumper gap to anybody in line with the truck [m].
      braking: strongest planned [m/s2]; cost: CPU time of a plan, median [s].
    """

    duration: float
    emergencies: int
    changes: int
    aborted: int
    gap: float
    braking: float
    cost: float


def ordinary_drive(probability: float, duration: float, seed: int = 0) -> Ordinary:
    """Drives among traffic at 12.5 m/s that fills both lanes.

    Args:
      probability: of a vehicle per second and lane; the paper's densest traffic has 0.05.
      duration: [s].
      seed: of the traffic.
    """
    route = Route.straight(length=30_000.0, lanes=2, lane_width=LANE_WIDTH)
    config = HighwayConfig(probability, traffic_speed=12.5, timestep=STEP)
    traffic = HighwayTraffic(config, np.random.default_rng(seed))
    drive = IdealDrive(route, 400.0, 0, 12.5)
    traffic.fill(_obstacles(drive.ego, route)[0])
    right = float(route.lane_offset(0, 0.0))
    # MOBIL looks at the scene, not at the network's observation.
    maker, unseen = Mobil(), np.zeros(216, dtype=np.float32)

    def vehicles(ego: EgoState) -> tuple[TrackedVehicle, ...]:
        traffic.step(_obstacles(ego, route))
        return tuple(dataclasses.replace(v, offset=v.offset + right) for v in traffic.tracked())

    def decide(scene: Scene) -> Decision:
        if round(scene.time / STEP) % 10 or drive.planner.changing:
            return Decision.KEEP
        lane = drive.planner.lane(scene)
        reference = drive.planner.config.speed.cruise_speed
        return maker.decide(DecisionContext(scene, route, lane, (0, 1), reference, unseen))

    drive.run(duration, vehicles, decide)
    return Ordinary(
        duration=duration,
        emergencies=drive.planner.emergencies,
        changes=drive.planner.lane_changes,
        aborted=drive.planner.aborted,
        gap=min(drive.gap(scene) for scene in drive.scenes),
        braking=-min(float(plan.acceleration[0]) for plan in drive.plans),
        cost=float(np.median(drive.cost)),
    )


def _obstacles(ego: EgoState, route: Route) -> list[Obstacle]:
    """The lanes that the truck's body is in, as the traffic sees it."""
    found = []
    for lane in range(2):
        if abs(ego.offset - float(route.lane_offset(lane, ego.station))) < 0.5 * LANE_WIDTH + 0.9:
            found.append(Obstacle(ego.station + 1.4, 16.5, ego.speed, lane))
    return found
