"""A planner that keeps the rightmost lane and a time gap to the vehicle ahead."""

import numpy as np

from controllers.planning.road_preview import RoadPreview
from controllers.planning.trajectory import on_road


class RightLane:
    def __init__(self, route, config, gap=2.0):
        self.preview, self.speed, self.gap = RoadPreview(route), config.speed.cruise_speed, gap

    def reset(self):
        pass

    def plan(self, scene, decision, profile):
        ego, time = scene.ego, 0.1 * np.arange(80)
        path = self.preview.follow(0, ego.station, ahead=400.0)
        target = min(self.speed, profile.at(ego.station), path.speed_limit.min())
        leader = scene.neighbors.leader_along_path(path)
        if leader is not None:
            spare = leader.gap - self.gap * ego.speed - 5.0
            target = max(min(target, leader.speed + 0.2 * spare), 0.0)
        speed = ego.speed + np.clip(target - ego.speed, -3.0 * time, 0.6 * time)
        station = ego.station + np.append(0.0, np.cumsum(0.1 * speed[:-1]))
        acceleration = np.gradient(speed, time)
        return on_road(self.preview, path, None, scene.time, station, speed, acceleration, 0.1)
