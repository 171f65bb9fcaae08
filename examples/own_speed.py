"""A reference speed that is lower on climbs."""

import numpy as np

from iits_mj.core.messages import SpeedProfile


class Hills:
    def __init__(self, route, speed, slower=0.85):
        station = np.arange(0.0, route.length, 50.0)
        climbs = route.smoothed_grade(station) > 0.02
        self.profile = SpeedProfile(station, np.where(climbs, slower * speed, speed))

    def reset(self):
        pass

    def update(self, scene, find_leader):
        return self.profile
