"""A proportional speed controller with the grade fed forward."""

import numpy as np

from iits_mj.core.messages import VehicleCommand, XbrMode


class Proportional:
    def __init__(self, parameters, gain=0.4):
        self.power, self.gain = parameters.engine.full_load_power, gain

    def reset(self):
        pass

    def command(self, ego, trajectory, grade):
        speed = np.interp(ego.time + 0.5, trajectory.time, trajectory.speed)
        if speed < 0.2 and ego.speed < 0.5:
            return VehicleCommand(xbr_demand=-1.0, xbr_mode=XbrMode.MAXIMUM)
        demand = self.gain * (speed - ego.speed)  # [m/s2]
        force = ego.mass * (demand + 9.81 * grade + 0.08)  # with rolling and air [N]
        if force > 0.0:
            pedal = force * max(ego.speed, 2.0) / self.power
            return VehicleCommand(accelerator_pedal=min(pedal, 1.0))
        return VehicleCommand(xbr_demand=min(max(demand, -8.0), 0.0), xbr_mode=XbrMode.MAXIMUM)
