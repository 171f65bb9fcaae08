"""Everything that the truck says on its bus by itself: reports and configurations."""

from __future__ import annotations

from iits_mj.j1939.configuration import ConfigurationSender
from iits_mj.j1939.frame import Frame
from iits_mj.j1939.quantities import ReferenceTorques
from iits_mj.j1939.state import StateSender
from iits_mj.messages import EgoState, TruckReport
from iits_mj.parameters import TruckParameters


class TruckSender:
    """The frames of a truck, each message at its own rate.

    Args:
      parameters: of the truck, for its percent torques and configurations.
    """

    def __init__(self, parameters: TruckParameters) -> None:
        self._reports = StateSender(ReferenceTorques.of(parameters))
        self._configurations = ConfigurationSender(parameters)

    def frames(self, state: EgoState, report: TruckReport) -> list[Frame]:
        """The frames that are due at the state's time, none twice.

        Raises:
          BusError: a value is not finite.
          InputError: the state's time is not finite.
        """
        return self._reports.frames(state, report) + self._configurations.frames(state.time)

    def answer(
        self, pgn: int, address: int, state: EgoState, report: TruckReport
    ) -> list[Frame] | None:
        """What a unit (255: all of them) says now with a group; None when it never does.

        A configuration comes later, as a broadcast among `frames`.

        Raises:
          BusError: a value is not finite.
        """
        if self._configurations.repeat(pgn, address):
            return []
        return self._reports.answer(pgn, address, state, report) or None
