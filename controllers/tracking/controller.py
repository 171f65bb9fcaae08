"""The tracking controller: J1939 command from a trajectory and the truck's state."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from controllers.tracking.lateral import USED, LateralConfig, LateralController, check_finite
from controllers.tracking.longitudinal import LongitudinalConfig, LongitudinalController
from iits_mj.core.messages import EgoState, Trajectory, VehicleCommand
from iits_mj.parameters import TruckParameters

if TYPE_CHECKING:
    from iits_mj.road import Route

_USED = (*USED, "engine_speed", "engine_torque")


@dataclass(frozen=True)
class TrackingConfig:
    """Settings of both controllers, see `LateralConfig` and `LongitudinalConfig`."""

    lateral: LateralConfig = field(default_factory=LateralConfig)
    longitudinal: LongitudinalConfig = field(default_factory=LongitudinalConfig)


class Tracker:
    """Follows trajectories at 50 Hz.

    Args:
      route: the road, for the grade under the combination.
      parameters: of the truck; default: the shipped one.
      config: gains.
    """

    def __init__(
        self,
        route: Route,
        parameters: TruckParameters | None = None,
        config: TrackingConfig | None = None,
    ) -> None:
        self.route = route
        self.parameters = parameters or TruckParameters.load()
        self.config = config or TrackingConfig()
        tractor, trailer = self.parameters.lead, self.parameters.units[1]
        behind = self.parameters.couplings[0].position + trailer.cg_position
        # Mass of the tractor [kg], and way from its steer axle back to both centers of gravity [m].
        self._units = tractor.mass, tractor.cg_position, behind
        self.lateral = LateralController(self.parameters, self.config.lateral)
        self.longitudinal = LongitudinalController(self.parameters, self.config.longitudinal)

    def reset(self) -> None:
        """Clears everything but the gains."""
        self.lateral.reset()
        self.longitudinal.reset()

    def command(self, ego: EgoState, trajectory: Trajectory) -> VehicleCommand:
        """The command for the coming 20 ms.

        Raises:
          InputError: a value of the state that the controllers use is not finite.
        """
        check_finite(ego, _USED)
        angle = self.lateral.steer(ego, trajectory)
        return self.longitudinal.command(ego, trajectory, self.grade(ego), angle)

    def grade(self, ego: EgoState) -> float:
        """Grade under the combination, rise over run, tractor and trailer weighted by mass."""
        mass, ahead, behind = self._units
        share = mass / max(ego.mass, mass)
        front = float(self.route.smoothed_grade(ego.station - ahead))
        rear = float(self.route.smoothed_grade(ego.station - behind))
        return share * front + (1.0 - share) * rear
