"""The Stanley controller: steers by the errors of heading and offset at the steer axle."""

import math

import numpy as np


class Stanley:
    def __init__(self, parameters, gain=0.3, damping=0.3):
        self.steering, self.gain, self.damping = parameters.steering, gain, damping

    def reset(self):
        pass

    def steer(self, ego, trajectory):
        yaw, offset, bend = (
            np.interp(ego.station, trajectory.station, column)
            for column in (trajectory.yaw, trajectory.offset, trajectory.curvature)
        )
        heading = math.remainder(yaw - ego.yaw, math.tau)
        turning = bend * ego.speed - ego.yaw_rate
        angle = heading + math.atan2(self.gain * (offset - ego.offset), max(ego.speed, 1.0))
        return self.steering.ratio * (angle + self.damping * turning)
