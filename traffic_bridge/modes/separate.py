"""One traffic simulation in a process of its own, for programs that have several at once.

A script that makes one does so under `if __name__ == "__main__":`, see `TrafficWorlds`.
"""

from __future__ import annotations

from iits_mj.closing import Closing
from iits_mj.errors import InputError, TrafficError
from iits_mj.messages import EgoState
from iits_mj.road import Route
from traffic_bridge.config import TrafficConfig
from traffic_bridge.frame import VehicleFrame
from traffic_bridge.modes.parallel import TrafficWorlds, WorldSpec


class SeparateTraffic(Closing):
    """`InterSim` or `PureSim` elsewhere: bit for bit the same vehicles.

    Lights and signs stay in the other process, so it is for roads without lights and for traffic
    without events.

    Args:
      route: the ego's road.
      config: settings.
      seed: of everything random.
      mode: "InterSim" or "PureSim".

    Raises:
      InputError: as of `WorldSpec`; the traffic has events or, at the reset, the road has lights.
    """

    def __init__(
        self, route: Route, config: TrafficConfig, seed: int = 0, mode: str = "InterSim"
    ) -> None:
        self._spec = WorldSpec(route, config, seed, mode)
        if config.events:
            raise InputError("traffic in a process of its own can have no events")
        self.route = route
        self._worlds: TrafficWorlds | None = None

    @property
    def time(self) -> float:
        """Traffic time since the reset [s].

        Raises:
          TrafficError: it was not begun.
        """
        return float(self._running.call("time")[0])

    def reset(self, ego: EgoState | None = None) -> VehicleFrame:
        """Begins anew; see the mode's `reset`."""
        if self._worlds is None:
            self._worlds = TrafficWorlds([self._spec])
        vehicles = self._worlds.reset([ego])[0]
        if lights := self._worlds.call("signals.lights")[0]:
            self.close()
            raise InputError(
                f"traffic in a process of its own cannot tell of lights, and {lights[0]!r} is one"
            )
        return vehicles

    def step(self, ego: EgoState | None = None) -> VehicleFrame:
        """Advances one step; see the mode's `step`."""
        return self._running.step([ego])[0]

    def close(self) -> None:
        """Ends SUMO and its process; may be called again."""
        if self._worlds is not None:
            self._worlds.close()
            self._worlds = None

    @property
    def _running(self) -> TrafficWorlds:
        if self._worlds is None:
            raise TrafficError("the traffic has not been started: call reset() first")
        return self._worlds
