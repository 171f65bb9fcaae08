"""A camera that flies around the truck."""

import mujoco


class Orbit:
    def __init__(self, distance=25.0, period=20.0):
        self.distance, self.period = distance, period

    def follow(self, data, station):
        camera = mujoco.MjvCamera()
        camera.lookat[:] = data.body("tractor").xpos
        camera.distance, camera.elevation = self.distance, -20.0
        camera.azimuth = 360.0 * data.time / self.period
        return camera
