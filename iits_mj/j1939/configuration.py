"""Configurations of engine and retarders (EC1, RC): broadcast by the truck, read by a listener.

The percent torques on the bus refer to the reference torques in these messages (SPN 544, 556).
"""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Callable

import numpy as np

from iits_mj.core.errors import BusError
from iits_mj.core.units import RPM
from iits_mj.j1939.database import cycle_time, make_group, pack, pgn_of
from iits_mj.j1939.diagnostics import read_group
from iits_mj.j1939.frame import GLOBAL_ADDRESS, Frame
from iits_mj.j1939.groups import Group, Status, Value
from iits_mj.j1939.network import DRIVELINE_RETARDER, ENGINE, ENGINE_RETARDER
from iits_mj.j1939.quantities import ReferenceTorques
from iits_mj.j1939.schedule import Schedule
from iits_mj.j1939.transport import BroadcastSender, Reassembler
from iits_mj.parameters import TruckParameters

# SPN 901 and 902 (the DBC's value tables), and SPN 557 for torque without steps.
_HYDRAULIC, _COMPRESSION_RELEASE = 1.0, 3.0
_ON_ENGINE, _ON_DRIVELINE = 0.0, 4.0
_CONTINUOUS = 0.0
# Field of `ReferenceTorques` by location: on the engine, or on the driveline.
_LOCATIONS: dict[Value, str] = {
    **dict.fromkeys((0.0, 1.0, 2.0), "engine_brake"),
    **dict.fromkeys((3.0, 4.0), "retarder"),
}
# Signal of the reference torque in each message.
_TORQUES = {"EC1": "reference_engine_torque_nm", "RC": "reference_retarder_torque_nm"}


def engine_configuration(parameters: TruckParameters) -> Group:
    """EC1 of a truck: indicated full-load torque over speed, as percent of the reference.

    Point 1 is idle, point 2 the start of the governor's range and point 6 its end, with no torque.
    Points 3 to 5 are the corners between 1 and 2 that approximate the curve best.
    """
    engine = parameters.engine

    def percent(speed: float) -> float:
        drag = np.interp(speed, engine.drag_speed, engine.drag_torque)
        net = np.interp(speed, engine.full_load_speed, engine.full_load_torque)
        return float(100.0 * (net + drag) / engine.reference_torque)

    begin = engine.governed_speed * (1.0 - engine.governor_droop)
    inner = [float(s) for s in engine.full_load_speed if engine.idle_speed < s < begin]
    corners = _corners(percent, engine.idle_speed, inner, begin)
    values = {}
    for number, speed in zip((1, 3, 4, 5, 2), corners, strict=True):
        values[f"engine_speed_point_{number}_rpm"] = speed / RPM
        values[f"engine_torque_point_{number}_percent"] = percent(speed)
    values["engine_speed_point_6_rpm"] = engine.governed_speed / RPM
    gain = percent(begin) / (engine.governed_speed - begin) * RPM
    values["governor_gain_percent_per_rpm"] = gain
    values["reference_engine_torque_nm"] = engine.reference_torque
    values["engine_moment_of_inertia_kg_m2"] = engine.inertia
    return make_group("EC1", values)


def retarder_configurations(parameters: TruckParameters) -> dict[int, Group]:
    """RC of the engine brake and of the cold retarder, by the address of the sender."""
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
    """Broadcasts a truck's configurations at the rate of the DBC, each from its control unit.

    Args:
      parameters: of the truck.
    """

    def __init__(self, parameters: TruckParameters) -> None:
        groups = {ENGINE: engine_configuration(parameters), **retarder_configurations(parameters)}
        self._contents = [
            (BroadcastSender(source), pgn_of(group.MESSAGE), pack(group, saturate=True))
            for source, group in groups.items()
        ]
        self._schedule = Schedule([cycle_time("EC1")])

    def frames(self, time: float) -> list[Frame]:
        """The frames that are due at a time [s], at most one per unit.

        To be called at least every 50 ms. Raises InputError if the time is not finite.
        """
        if self._schedule.due(time):
            for sender, pgn, data in self._contents:
                sender.put(pgn, data)
        return [frame for sender, _, _ in self._contents for frame in sender.due(time)]

    def repeat(self, pgn: int, address: int) -> bool:
        """Broadcasts a group again on request; returns whether a unit at the address sends it.

        Args:
          pgn: of the group.
          address: of the requested unit; 255 for all.
        """
        found = [
            (sender, data)
            for sender, own, data in self._contents
            if own == pgn and address in (sender.source, GLOBAL_ADDRESS)
        ]
        for sender, data in found:
            sender.put(pgn, data)
        return bool(found)


class ConfigurationReceiver:
    """Reads the reference torques from EC1 and RC.

    Attributes:
      references: the latest ones; before their reception, those given.
    """

    def __init__(self, references: ReferenceTorques) -> None:
        self.references = references
        self._reassembler = Reassembler()

    def receive(self, frame: Frame) -> bool:
        """Receives any frame; returns whether it completes a reference torque. Never raises."""
        message = self._reassembler.receive(frame)
        if message is None:
            return False
        try:
            group = read_group(message.pgn, message.data)
        except BusError:
            return False
        if not isinstance(group, Group) or group.MESSAGE not in _TORQUES:
            return False
        values = dict(group.items())
        torque = values[_TORQUES[group.MESSAGE]]
        engine = group.MESSAGE == "EC1"
        field = "engine" if engine else _LOCATIONS.get(values["retarder_location"])
        if field is None or isinstance(torque, Status) or torque <= 0.0:
            return False
        self.references = dataclasses.replace(self.references, **{field: torque})
        return True


def _corners(
    curve: Callable[[float], float], low: float, inner: list[float], high: float
) -> tuple[float, ...]:
    """Both ends and the three speeds between them whose polyline is closest to the curve."""
    checked = np.array([low, *inner, high])
    values = np.array([curve(speed) for speed in checked])

    def error(chosen: tuple[float, ...]) -> float:
        speeds = (low, *chosen, high)
        lines = np.interp(checked, speeds, [curve(speed) for speed in speeds])
        return float(np.abs(lines - values).max())

    three = itertools.combinations(inner, 3)
    return low, *min(three, key=error, default=tuple(np.linspace(low, high, 5)[1:-1])), high


def _engine_brake_share(parameters: TruckParameters, speed: float) -> float:
    """Share of the rated torque: P = P0 (w / w0)^exponent, with the plugin's fade near idle."""
    engine = parameters.engine
    fade = (speed - engine.engine_brake_speed_min) / engine.engine_brake_fade
    law = (speed / engine.engine_brake_speed) ** (engine.engine_brake_exponent - 1.0)
    return float(min(max(fade, 0.0), 1.0) * law)


def _retarder(
    kind: tuple[float, float],
    speeds: tuple[float, ...],
    reference: float,
    share: Callable[[float], float],
) -> Group:
    """RC from type and location, speeds of points 1 to 5, and torque as share of the reference."""
    values = {}
    for number, speed in enumerate(speeds, start=1):
        values[f"retarder_speed_point_{number}_rpm"] = float(speed) / RPM
        values[f"retarder_torque_point_{number}_percent"] = -100.0 * share(float(speed))
    values["retarder_type"], values["retarder_location"] = kind
    values["retarder_control_steps"] = _CONTINUOUS
    values["reference_retarder_torque_nm"] = reference
    return make_group("RC", values)
