"""A decision maker that passes slow vehicles and returns to the right."""

from iits_mj.core.messages import Decision


class Impatient:
    def __init__(self, room=40.0):
        self.room = room  # free length of the other lane [m]

    def reset(self):
        pass

    def decide(self, context):
        traffic, route = context.scene.neighbors, context.route
        leader = traffic.leader_in_lane(route, context.lane)
        slow = leader is not None and leader.speed < 0.95 * context.reference_speed
        for side, lane in context.sides():
            wanted = slow if side is Decision.LEFT else not slow
            if wanted and traffic.least_gap(route, lane) > self.room:
                return side
        return Decision.KEEP
