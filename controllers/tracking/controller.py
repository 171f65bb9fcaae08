"""The tracking controller: J1939 command from a trajectory and the truck's state."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from controllers.own_parts import (
    AnyLateral,
    AnyLongitudinal,
    guarded_lateral,
    guarded_longitudinal,
)
from controllers.protocols import LateralControl, LongitudinalControl
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
      config: gains of the shipped controllers.
      lateral, longitudinal: the user's own controllers; default: the shipped ones.

    Attributes:
      lateral, longitudinal: the controllers in use.

    Raises:
      InputError: a controller lacks a method.
    """

    def __init__(
        self,
        route: Route,
        parameters: TruckParameters | None = None,
        config: TrackingConfig | None = None,
        lateral: LateralControl | None = None,
        longitudinal: LongitudinalControl | None = None,
    ) -> None:
        self.route = route
        self.parameters = parameters or TruckParameters.load()
        self.config = config or TrackingConfig()
        p, places, origin = self.parameters, [], 0.0
        for unit in p.units:
            origin += unit.coupling.position if unit.coupling else 0.0
            places.append(origin + unit.cg_position)
        # Way from the steer axle back to the centers of gravity [m], mass of the empty units [kg],
        # and share of the payload of all but the last unit.
        self._places, self._empty = tuple(places), p.gross_mass(0.0)
        most = p.payload_max or 1.0
        self._masses = tuple(
            (unit.mass, unit.payload.mass_max / most if unit.payload else 0.0)
            for unit in p.units[:-1]
        )
        self.lateral: AnyLateral
        self.longitudinal: AnyLongitudinal
        if lateral is None:
            self.lateral = LateralController(self.parameters, self.config.lateral)
        else:
            self.lateral = guarded_lateral(lateral)
        if longitudinal is None:
            self.longitudinal = LongitudinalController(self.parameters, self.config.longitudinal)
        else:
            self.longitudinal = guarded_longitudinal(longitudinal)

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
        """Grade under the combination, rise over run, its units weighted by mass."""
        total = max(ego.mass, self._empty)
        payload = total - self._empty
        shares = [(mass + load * payload) / total for mass, load in self._masses]
        shares.append(1.0 - sum(shares))
        grades = [float(self.route.smoothed_grade(ego.station - place)) for place in self._places]
        return sum(share * grade for share, grade in zip(shares, grades, strict=True))
