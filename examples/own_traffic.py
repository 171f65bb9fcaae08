"""A vehicle ahead that speeds up and slows down, as in a jam."""

import math

from traffic_bridge import vehicle_on


class Wave:
    def __init__(self, route, speed=14.0, swing=4.0, period=30.0):
        self.route, self.mean, self.swing = route, speed, swing
        self.rate = math.tau / period

    def reset(self, ego):
        self.time, self.station = 0.0, ego.station + 50.0
        return self.vehicles()

    def step(self, ego):
        self.time += 0.1
        self.station += 0.1 * self.speed
        return self.vehicles()

    @property
    def speed(self):
        return self.mean - self.swing * math.sin(self.rate * self.time)

    def vehicles(self):
        return [vehicle_on(self.route, "wave", self.station, speed=self.speed)]
