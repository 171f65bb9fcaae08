"""What the truck says of its engine and retarders, EC1 and RC, and what a listener learns of it.

The percent torques of the bus are shares of the reference torques in these messages (SPN 544, 556).
"""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Callable

import numpy as np

from iits_mj.core.errors import BusError
from iits_mj.core.units import RPM
from iits_mj.j1939.addresses import DRIVELINE_RETARDER, ENGINE, ENGINE_RETARDER
from iits_mj.j1939.broadcasts import BroadcastSender
from iits_mj.j1939.database import cycle_time, pack, pgn_of
from iits_mj.j1939.frame import GLOBAL_ADDRESS, Frame
from iits_mj.j1939.group import Group, Status
from iits_mj.j1939.groups import EC1, RC
from iits_mj.j1939.long_groups import read_group
from iits_mj.j1939.quantities import ReferenceTorques
from iits_mj.j1939.transport import Reassembler
from iits_mj.parameters import TruckParameters

# SPN 901 and 902 (the DBC's value tables), and SPN 557 for torque without steps.
_HYDRAULIC, _COMPRESSION_RELEASE = 1.0, 3.0
_ON_ENGINE, _ON_DRIVELINE = 0.0, 4.0
_CONTINUOUS = 0.0
# Locations that turn with the engine, and with the propeller shaft.
_ENGINE_LOCATIONS, _DRIVELINE_LOCATIONS = (0.0, 1.0, 2.0), (3.0, 4.0)


def engine_configuration(parameters: TruckParameters) -> EC1:
    """EC1 of a truck: indicated full-load torque over speed, as percent of the reference.

    Point 1 is idle, 2 where the governor begins to act, 3 to 5 those corners between them that
    follow the curve best, 6 where the governor has taken all torque away.
    """
    engine = parameters.engine

    def percent(speed: float) -> float:
        drag = np.interp(speed, engine.drag_speed, engine.drag_torque)
        net = np.interp(speed, engine.full_load_speed, engine.full_load_torque)
        return float(100.0 * (net + drag) / engine.reference_torque)

    begin = engine.governed_speed * (1.0 - engine.governor_droop)
    inner = [float(s) for s in engine.full_load_speed if engine.idle_speed < s < begin]
    corners = _corners(percent, engine.idle_speed, inner, begin)
    points = {}
    for number, speed in zip((1, 3, 4, 5, 2), corners, strict=True):
        points[f"engine_speed_point_{number}_rpm"] = speed / RPM
        points[f"engine_torque_point_{number}_percent"] = percent(speed)
    return EC1(
        **points,
        engine_speed_point_6_rpm=engine.governed_speed / RPM,
        governor_gain_percent_per_rpm=percent(begin) / (engine.governed_speed - begin) * RPM,
        reference_engine_torque_nm=engine.reference_torque,
        engine_moment_of_inertia_kg_m2=engine.inertia,
    )


def retarder_configurations(parameters: TruckParameters) -> dict[int, RC]:
    """RC of the engine brake and of the retarder, cold, by the address that sends it."""
    engine, retarder = parameters.engine, parameters.retarder
    found = {}
    if engine.engine_brake_power > 0.0:
        rated = engine.engine_brake_speed
        speeds = np.linspace(engine.idle_speed, rated, 4)
        found[ENGINE_RETARDER] = _retarder(
            (_COMPRESSION_RELEASE, _ON_ENGINE),
            (speeds[0], rated, speeds[1], speeds[2], rated),
            engine.engine_brake_power / rated,
            lambda speed: _engine_brake_share(parameters, speed),
        )
    if retarder.torque_max > 0.0:
        full, plateau = retarder.full_torque_speed, retarder.power_max / retarder.torque_max
        greatest = engine.governed_speed / min(parameters.gearbox.ratios)
        found[DRIVELINE_RETARDER] = _retarder(
            (_HYDRAULIC, _ON_DRIVELINE),
            (0.0, greatest, 0.5 * full, plateau, full),
            retarder.torque_max,
            lambda speed: min(min(1.0, speed / full) ** 2, plateau / max(speed, full)),
        )
    return found


class ConfigurationSender:
    """Broadcasts a truck's configurations at the DBC's rate, each from its own unit.

    Args:
      parameters: of the truck.
    """

    def __init__(self, parameters: TruckParameters) -> None:
        groups: dict[int, Group] = {ENGINE: engine_configuration(parameters)}
        groups |= retarder_configurations(parameters)
        self._contents = [
            (BroadcastSender(source), pgn_of(group.MESSAGE), pack(group, saturate=True))
            for source, group in groups.items()
        ]
        self._period = cycle_time(EC1.MESSAGE)
        self._next = self._last = -math.inf

    def frames(self, time: float) -> list[Frame]:
        """The frames that are due [s], at most one a unit; to be asked at least every 50 ms.

        Raises:
          BusError: the time is not finite.
        """
        # Time goes back where a drive begins anew.
        if time >= self._next or time < self._last:
            self._next = time + self._period
            for sender, pgn, data in self._contents:
                sender.put(pgn, data)
        self._last = time
        return [frame for sender, _, _ in self._contents for frame in sender.due(time)]

    def repeat(self, pgn: int, address: int) -> bool:
        """Broadcasts a group anew because somebody asked for it.

        Args:
          pgn: that is asked for.
          address: of the unit that is asked; 255 asks all.

        Returns:
          True when a unit at that address sends it; its frames are among those due next.
        """
        asked = [
            (sender, data)
            for (sender, own, data) in self._contents
            if own == pgn and address in (sender.source, GLOBAL_ADDRESS)
        ]
        for sender, data in asked:
            sender.put(pgn, data)
        return bool(asked)


class ConfigurationReceiver:
    """Learns the reference torques from the units that tell them.

    Args:
      references: until they are told.

    Attributes:
      references: as known now.
    """

    def __init__(self, references: ReferenceTorques) -> None:
        self.references = references
        self._reassembler = Reassembler()

    def receive(self, frame: Frame) -> bool:
        """Takes any frame; returns True when it told a reference torque. Never raises."""
        message = self._reassembler.receive(frame)
        if message is None:
            return False
        try:
            group = read_group(message.pgn, message.data)
        except BusError:
            return False
        field, torque = _reference(group)
        if field is None or isinstance(torque, Status) or torque <= 0.0:
            return False
        self.references = dataclasses.replace(self.references, **{field: torque})
        return True


def _reference(group: object) -> tuple[str | None, float | Status]:
    """Which of the reference torques a group tells, and its value."""
    if isinstance(group, EC1):
        return "engine", group.reference_engine_torque_nm
    if isinstance(group, RC):
        on_engine = group.retarder_location in _ENGINE_LOCATIONS
        on_driveline = group.retarder_location in _DRIVELINE_LOCATIONS
        field = "engine_brake" if on_engine else "retarder" if on_driveline else None
        return field, group.reference_retarder_torque_nm
    return None, Status.NOT_AVAILABLE


def _corners(
    curve: Callable[[float], float], low: float, inner: list[float], high: float
) -> tuple[float, ...]:
    """The ends and those three of the speeds between whose lines come closest to the curve."""
    checked = np.array([low, *inner, high])
    values = np.array([curve(speed) for speed in checked])

    def error(chosen: tuple[float, ...]) -> float:
        speeds = (low, *chosen, high)
        lines = np.interp(checked, speeds, [curve(speed) for speed in speeds])
        return float(np.abs(lines - values).max())

    three = itertools.combinations(inner, 3)
    return low, *min(three, key=error, default=tuple(np.linspace(low, high, 5)[1:-1])), high


def _engine_brake_share(parameters: TruckParameters, speed: float) -> float:
    """Of the rated torque: P = P0 (w / w0)^exponent, fading out near idle, as the plugin has it."""
    engine = parameters.engine
    fade = (speed - engine.engine_brake_speed_min) / engine.engine_brake_fade
    law = (speed / engine.engine_brake_speed) ** (engine.engine_brake_exponent - 1.0)
    return float(min(max(fade, 0.0), 1.0) * law)


def _retarder(
    kind: tuple[float, float],
    speeds: tuple[float, ...],
    reference: float,
    share: Callable[[float], float],
) -> RC:
    """RC from type and location, the speeds of points 1 to 5, and torque over the reference."""
    points = {}
    for number, speed in enumerate(speeds, start=1):
        points[f"retarder_speed_point_{number}_rpm"] = float(speed) / RPM
        points[f"retarder_torque_point_{number}_percent"] = -100.0 * share(float(speed))
    return RC(
        **points,
        retarder_type=kind[0],
        retarder_location=kind[1],
        retarder_control_steps=_CONTINUOUS,
        reference_retarder_torque_nm=reference,
    )
