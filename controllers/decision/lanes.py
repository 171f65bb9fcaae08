"""What drives in which lane around the truck, for the rules: bumper gaps along the route."""

from __future__ import annotations

from controllers.decision.base import DecisionContext
from controllers.surroundings import INTRUSION, Neighbor
from iits_mj.messages import TrackedVehicle


class LaneView:
    """Leaders and followers by lane index.

    A vehicle belongs to a lane while its body reaches 0.3 m or more into it; vehicles that are on
    no lane of the route (lane -1) are left out. Reach is 250 m ahead and behind.
    """

    REACH = 250.0

    def __init__(self, context: DecisionContext) -> None:
        self.context = context
        scene = context.scene
        self.front = scene.ego.station + scene.footprint.front_overhang
        self.rear = self.front - scene.footprint.length
        self._by_lane: dict[int, list[Neighbor]] = {}

    def vehicles(self, lane: int) -> list[Neighbor]:
        """All vehicles of a lane with their gaps, negative beside the truck."""
        if lane not in self._by_lane:
            self._by_lane[lane] = [
                Neighbor(vehicle, self._gap(vehicle))
                for vehicle in self.context.scene.vehicles
                if vehicle.lane >= 0 and self._in_lane(vehicle, lane)
            ]
        return self._by_lane[lane]

    def leader(self, lane: int) -> Neighbor | None:
        """Nearest vehicle whose middle is ahead of the truck's front bumper."""
        ahead = [n for n in self.vehicles(lane) if n.vehicle.station > self.front]
        return min(ahead, key=lambda n: n.gap, default=None)

    def follower(self, lane: int) -> Neighbor | None:
        """Nearest vehicle whose middle is behind the truck's front, those beside included."""
        behind = [n for n in self.vehicles(lane) if n.vehicle.station <= self.front]
        return min(behind, key=lambda n: n.gap, default=None)

    def is_free(self, lane: int, distance: float) -> bool:
        """True when nothing in the lane is nearer than a bumper gap, ahead, beside or behind."""
        return all(neighbor.gap >= distance for neighbor in self.vehicles(lane))

    def _gap(self, vehicle: TrackedVehicle) -> float:
        ahead = vehicle.station - 0.5 * vehicle.length - self.front
        behind = self.rear - vehicle.station - 0.5 * vehicle.length
        return max(ahead, behind)

    def _in_lane(self, vehicle: TrackedVehicle, lane: int) -> bool:
        if abs(vehicle.station - self.front) > self.REACH:
            return False
        route = self.context.route
        middle = float(route.lane_offset(lane, vehicle.station))
        half = 0.5 * float(route.lane_width(lane, vehicle.station))
        return abs(vehicle.offset - middle) < half + 0.5 * vehicle.width - INTRUSION
