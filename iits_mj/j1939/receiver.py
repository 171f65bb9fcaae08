"""Frames to `VehicleCommand`: the truck's side of the bus, with its fail-safe."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass

from iits_mj.errors import BusError, InputError
from iits_mj.j1939.addresses import BRAKES, DRIVELINE_RETARDER, ENGINE_RETARDER
from iits_mj.j1939.checksum import counter_and_checksum, tsc1_checksum, xbr_checksum
from iits_mj.j1939.command import TORQUE_CONTROL, XBR_DEMAND_MIN
from iits_mj.j1939.database import Decoded, decode
from iits_mj.j1939.frame import GLOBAL_ADDRESS, Frame
from iits_mj.j1939.group import NOT_AVAILABLE
from iits_mj.j1939.groups import IitsCommand
from iits_mj.messages import TransmissionMode, VehicleCommand, XbrEbiMode, XbrMode


@dataclass(frozen=True, slots=True)
class TimeOuts:
    """Longest silence [s] before a message's command falls back to its safe value.

    Attributes:
      pedal: EEC2; xbr: XBR; body: IITS_COMMAND.
      engine_retarder, driveline_retarder: TSC1 to the one and to the other.
    """

    pedal: float = 0.25
    xbr: float = 0.1
    engine_retarder: float = 0.1
    driveline_retarder: float = 0.1
    body: float = 0.1


@dataclass(frozen=True, slots=True)
class _Listener:
    """A control unit that obeys a message: its name, address and reader of the message."""

    name: str
    message: str
    address: int
    read: Callable[[str, Frame, Decoded], dict[str, float]]


class CommandReceiver:
    """Frames in, a safe `VehicleCommand` out.

    Control units listen by message and address: TSC1 to the engine's retarder (15) and TSC1 to the
    driveline's (16) have their own counters, values and time-outs; a message to the global address
    reaches every unit that understands it. A frame with a wrong checksum, a repeated counter, an
    error or not-available code, or a number out of range is rejected and counted in `rejected`, and
    the last good command stays until its time-out. Safe values: pedal 0; XBR released; retarders 0;
    steering angle, brake pedal, parking brake and selector held as they are, with the accelerator
    at 0, since nobody steers. With `stop_deceleration` the truck also brakes smoothly, at that
    deceleration, while steering commands are missing.

    Attributes:
      rejected: reasons and how often; accepted: frames taken, by listener: `EEC2`, `XBR`,
        `TSC1 to 15`, `TSC1 to 16`, `IITS_COMMAND`.
    """

    def __init__(self, time_outs: TimeOuts | None = None, stop_deceleration: float = 0.0) -> None:
        if not 0.0 <= stop_deceleration <= -XBR_DEMAND_MIN:
            raise InputError(f"stop_deceleration {stop_deceleration!r} m/s2: use 0 to 10")
        self.time_outs = time_outs or TimeOuts()
        self.stop_deceleration = stop_deceleration
        self.rejected: Counter[str] = Counter()
        self.accepted: Counter[str] = Counter()
        self._values: dict[str, float] = {}
        self._times: dict[str, float] = {}
        self._counters: dict[str, int] = {}
        self._listeners = (
            _Listener("EEC2", "EEC2", GLOBAL_ADDRESS, _read_pedal),
            _Listener("XBR", "XBR", BRAKES, self._read_xbr),
            _Listener("TSC1 to 15", "TSC1", ENGINE_RETARDER, self._read_retarder),
            _Listener("TSC1 to 16", "TSC1", DRIVELINE_RETARDER, self._read_retarder),
            _Listener("IITS_COMMAND", "IITS_COMMAND", GLOBAL_ADDRESS, self._read_body),
        )
        self._messages = {listener.message for listener in self._listeners}

    def receive(self, frame: Frame) -> bool:
        """Takes one frame of the bus; returns True when it changed the command.

        Frames that are not commands to this truck pass untouched and uncounted.
        """
        try:
            decoded = decode(frame)
        except BusError as error:
            self.rejected[str(error)] += 1
            return False
        if decoded is None or decoded.name not in self._messages:
            return False
        taken = [self._take(u, frame, decoded) for u in self._listeners if _hears(u, decoded)]
        return any(taken)

    def _take(self, listener: _Listener, frame: Frame, decoded: Decoded) -> bool:
        try:
            values = listener.read(listener.name, frame, decoded)
        except BusError as error:
            self.rejected[str(error)] += 1
            return False
        self._values.update(values)
        self._times[listener.name] = frame.time
        self.accepted[listener.name] += 1
        return True

    def command(self, time: float) -> VehicleCommand:
        """The command in force at this time [s], with the safe value of every silent message."""
        limits, value = self.time_outs, self._values.get
        steered = self._alive("IITS_COMMAND", time, limits.body)
        pedal = self._alive("EEC2", time, limits.pedal) and steered
        braked = self._alive("XBR", time, limits.xbr)
        engine_brake = self._alive("TSC1 to 15", time, limits.engine_retarder)
        retarder = self._alive("TSC1 to 16", time, limits.driveline_retarder)
        demand = value("xbr_demand", 0.0) if braked else 0.0
        mode = XbrMode(int(value("xbr_mode", 0))) if braked else XbrMode.OFF
        ebi_mode = XbrEbiMode(int(value("xbr_ebi_mode", 0))) if braked else XbrEbiMode.FRICTION_ONLY
        if not steered and self.stop_deceleration > 0.0:
            wanted = demand if mode is not XbrMode.OFF else 0.0
            demand, mode = min(wanted, -self.stop_deceleration), XbrMode.MAXIMUM
            # The stop must not hang on endurance brakes alone.
            if ebi_mode is XbrEbiMode.ENDURANCE_ONLY:
                ebi_mode = XbrEbiMode.INTEGRATION
        return VehicleCommand(
            accelerator_pedal=value("accelerator_pedal", 0.0) if pedal else 0.0,
            xbr_demand=demand,
            xbr_mode=mode,
            steering_wheel_angle=value("steering_wheel_angle", 0.0),
            parking_brake=value("parking_brake", 0.0),
            engine_brake=value("TSC1 to 15", 0.0) if engine_brake else 0.0,
            transmission_mode=TransmissionMode(int(value("transmission_mode", 0))),
            retarder=value("TSC1 to 16", 0.0) if retarder else 0.0,
            brake_pedal=value("brake_pedal", 0.0),
            xbr_ebi_mode=ebi_mode,
        )

    def _alive(self, name: str, time: float, time_out: float) -> bool:
        last = self._times.get(name)
        # A hair of slack: 0.1 s after a frame is still in time whatever the rounding.
        return last is not None and time - last <= time_out + 1e-9

    def _read_xbr(self, name: str, frame: Frame, decoded: Decoded) -> dict[str, float]:
        self._check_sum(frame, name, xbr_checksum(frame))
        mode = int(decoded.group.number("xbr_control_mode"))
        if mode not in tuple(XbrMode):
            raise BusError(f"XBR.xbr_control_mode = {mode}: allowed is 0, 1 or 2")
        values = {"xbr_mode": float(mode), "xbr_demand": 0.0, "xbr_ebi_mode": 0.0}
        if mode != XbrMode.OFF:
            demand = decoded.group.number("external_acceleration_demand")
            # Zero lies 12 um/s2 off the grid of 1/2048.
            if not XBR_DEMAND_MIN <= demand <= 1e-3:
                raise BusError("XBR.external_acceleration_demand is outside -10 to 0 m/s2")
            ebi_mode = int(decoded.group.number("xbr_ebi_mode"))
            if ebi_mode not in tuple(XbrEbiMode):
                raise BusError(f"XBR.xbr_ebi_mode = {ebi_mode}: allowed is 0, 1 or 2")
            values |= {"xbr_demand": min(demand, 0.0), "xbr_ebi_mode": float(ebi_mode)}
        self._check_counter(frame, name)
        return values

    def _read_retarder(self, name: str, frame: Frame, decoded: Decoded) -> dict[str, float]:
        self._check_sum(frame, name, tsc1_checksum(frame))
        share = 0.0
        if int(decoded.group.number("override_control_mode")) == TORQUE_CONTROL:
            share = -0.01 * decoded.group.number("requested_torque_percent")
            if not 0.0 <= share <= 1.0:
                raise BusError(f"{name}: requested_torque_percent is outside -100 to 0 %")
        self._check_counter(frame, name)
        return {name: share}

    def _read_body(self, name: str, frame: Frame, decoded: Decoded) -> dict[str, float]:
        self._check_sum(frame, name, xbr_checksum(frame))
        group = decoded.group
        assert isinstance(group, IitsCommand)
        values = {"parking_brake": decoded.group.number("parking_brake_request")}
        # Without a driver's pedal on board the field is "not available".
        if group.driver_brake_pedal_percent is not NOT_AVAILABLE:
            pedal = decoded.group.number("driver_brake_pedal_percent")
            values["brake_pedal"] = min(0.01 * pedal, 1.0)
        selector = int(decoded.group.number("transmission_mode_request"))
        if selector not in tuple(TransmissionMode):
            raise BusError(f"IITS_COMMAND.transmission_mode_request = {selector}: use 0, 1 or 2")
        values["transmission_mode"] = float(selector)
        if int(decoded.group.number("steering_control_mode")) == 1:
            values["steering_wheel_angle"] = decoded.group.number("steering_wheel_angle_request")
        self._check_counter(frame, name)
        return values

    def _check_sum(self, frame: Frame, name: str, wanted: int) -> None:
        if counter_and_checksum(frame)[1] != wanted:
            raise BusError(f"{name}: wrong checksum")

    def _check_counter(self, frame: Frame, name: str) -> None:
        counter = counter_and_checksum(frame)[0]
        if self._counters.get(name) == counter:
            raise BusError(f"{name}: counter repeated")
        self._counters[name] = counter


def _read_pedal(_name: str, _frame: Frame, decoded: Decoded) -> dict[str, float]:
    pedal = decoded.group.number("accelerator_pedal_position_percent")
    return {"accelerator_pedal": min(0.01 * pedal, 1.0)}


def _hears(listener: _Listener, decoded: Decoded) -> bool:
    return decoded.name == listener.message and (
        decoded.destination in (listener.address, GLOBAL_ADDRESS)
    )
