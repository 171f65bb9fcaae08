"""Keeps the truck's speed and lateral position over a CAN bus, as an independent controller.

It uses python-can, cantools and the DBC file, and no code of the package that serves the truck:

    iits-mj serve --bus udp_multicast --start-speed 16.67 --on-silence release
    python examples/keep_speed.py --duration 60

It receives the speed in CCVS1, the yaw rate in VDC2 and the distance from the road's reference line
in IITS_ROUTE. It sends pedal (EEC2), brake (XBR) and steering wheel (IITS_COMMAND).
"""

from __future__ import annotations

import argparse
import logging
import math
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, NoReturn

import can
import cantools
import cantools.database.can

DBC = Path(__file__).resolve().parents[1] / "iits_mj" / "j1939" / "iits_mj.dbc"
# Our source address: the one that J1939 prefers for a headway controller.
ADDRESS = 0x2A
# Selects the PGN: without priority and source address.
PGN_MASK = 0x03FFFF00
STEP = 0.02
# Required messages and signals, and how long each may be silent or not available [s].
NEEDED = {
    "CCVS1": ("wheel_based_speed_kph", 0.5),
    "VDC2": ("yaw_rate", 0.5),
    "IITS_ROUTE": ("route_offset", 0.5),
    "CVW": ("gross_combination_weight_kg", 5.0),
}
# Data of the truck: steering ratio, wheelbase to the middle of the drive axles, understeer and
# sideslip of the drive axles (both per speed squared), and engine power.
RATIO = 21.0
WHEELBASE = 3.9
UNDERSTEER = 0.004  # s2/m
SLIP = 0.010  # s2/m
POWER = 330e3  # W


class SpeedKeeper:
    """Converts the speed error [m/s] to a pedal position and a braking demand."""

    GAIN = 1.0  # 1/s
    INTEGRAL = 0.3  # 1/s2
    COAST = 0.02  # m/s2: smaller decelerations do not use the brakes
    FULL = 0.94  # share of the pedal's travel; beyond it a kick-down causes slow shifts

    def __init__(self) -> None:
        self.grade = 0.0

    def step(self, error: float, speed: float, mass: float, elapsed: float) -> tuple[float, float]:
        """Pedal, 0 to 1, and acceleration demand [m/s2], zero or negative."""
        # The acceleration at full pedal, and the share for rolling and air on a level road.
        full = POWER / (mass * max(speed, 3.0))
        level = 0.05 + 3.6 * speed**2 / mass
        wanted = level + self.GAIN * error + self.grade
        # The integral estimates the grade; it stops at the pedal's limit.
        if wanted < self.FULL * full or error < 0.0:
            self.grade = min(max(self.grade + self.INTEGRAL * error * elapsed, -1.0), 1.0)
        demand = max(wanted + self.COAST, -3.0)
        return min(max(wanted / full, 0.0), self.FULL), min(demand, 0.0)


class LaneKeeper:
    """Steering-wheel angle from the offset to the left of the desired line, and the yaw rate.

    An observer estimates the heading relative to the road and the road's curvature, which no sensor
    measures. The offset is that of the steer axle, which yaw moves too. At low speed the truck
    needs the same distance to return to the line, not the same time, so the bandwidth is
    proportional to the speed, up to a limit.
    """

    OBSERVER = 3.0, 0.25  # bandwidth: maximum [rad/s], per distance [rad/m]
    PATH = 0.8, 1.0 / 15.0  # the same for the path control
    TRIM = 0.3  # share of the path bandwidth

    def __init__(self) -> None:
        self.offset: float | None = None
        self.heading = self.curvature = self.trim = 0.0

    def step(self, offset: float, yaw_rate: float, speed: float, elapsed: float) -> float:
        """The angle [rad], positive to the left."""
        v = max(speed, 1.0)
        w, path = (min(limit, v * per_metre) for limit, per_metre in (self.OBSERVER, self.PATH))
        if self.offset is None:
            self.offset = offset
        surprise = offset - self.offset
        # Distance from the steer axle back to the point that moves along the truck's heading.
        arm = WHEELBASE - SLIP * v**2
        sideways = v * self.heading + arm * yaw_rate
        self.offset += elapsed * (sideways + 3.0 * w * surprise)
        self.heading += elapsed * (yaw_rate - v * self.curvature + 3.0 * w**2 / v * surprise)
        self.curvature -= elapsed * w**3 / v**2 * surprise
        # In a steady bend the steer axle follows the line, and the heading differs from it.
        heading = self.heading + arm * self.curvature
        back = (path / v) ** 2 * self.offset + 1.8 * path / v * heading
        wanted = self.curvature - back
        wheel = RATIO * (WHEELBASE + UNDERSTEER * v**2)
        if speed > 1.0:
            self.trim += elapsed * self.TRIM * path * wheel * (wanted - yaw_rate / v)
        return wheel * wanted + self.trim


class Controller:
    """Reads the truck's frames, sends commands, and records the errors."""

    def __init__(self, bus: can.BusABC, speed: float) -> None:
        self.bus, self.speed = bus, speed
        # The DBC's identifiers are matched without priority and source address.
        self.dbc = cantools.database.can.Database(frame_id_mask=PGN_MASK)
        self.dbc.add_dbc_file(str(DBC))
        self.heard: dict[str, float] = {}
        self.heard_at: dict[str, float] = {}
        self.counter = 0
        self.line: float | None = None
        self.speed_keeper, self.lane_keeper = SpeedKeeper(), LaneKeeper()
        self.speed_errors: list[float] = []
        self.line_errors: list[float] = []

    def listen(self, until: float) -> None:
        """Receives messages until a time of the monotonic clock."""
        while (left := until - time.monotonic()) > 0.0:
            message = self.bus.recv(timeout=left)
            if message is not None:
                self.take(message)

    def take(self, message: can.Message) -> None:
        """Stores a required signal if it is valid and from the unit that measures it."""
        if not message.is_extended_id or message.is_error_frame or message.is_remote_frame:
            return
        try:
            layout = self.dbc.get_message_by_frame_id(message.arbitration_id)
            # Any priority is accepted, but only the sender in the DBC's identifier (its last byte).
            if layout.name not in NEEDED or (layout.frame_id ^ message.arbitration_id) & 0xFF:
                return
            raw = layout.decode(message.data, decode_choices=False, scaling=False)
        except (KeyError, cantools.database.DecodeError):
            return
        name, _ = NEEDED[layout.name]
        signal = layout.get_signal_by_name(name)
        # J1939: values above 0xFA in the highest byte mean "error" or "not available".
        if raw[name] >> signal.length - 8 <= 0xFA:
            self.heard[name] = raw[name] * signal.scale + signal.offset
            self.heard_at[name] = time.monotonic()

    def missing(self) -> list[str]:
        """Signals that are missing or too old, as "message signal"."""
        now = time.monotonic()
        return [
            f"{message} {name}"
            for message, (name, patience) in NEEDED.items()
            if now - self.heard_at.get(name, -math.inf) > patience
        ]

    def control(self, step: int) -> None:
        """One 20 ms cycle: computes and sends the commands."""
        speed = self.heard["wheel_based_speed_kph"] / 3.6
        offset = self.heard["route_offset"]
        if self.line is None:
            # The desired line is the truck's offset at the start.
            self.line = offset
        error = self.speed - speed
        mass = self.heard["gross_combination_weight_kg"]
        pedal, demand = self.speed_keeper.step(error, speed, mass, STEP)
        angle = self.lane_keeper.step(offset - self.line, self.heard["yaw_rate"], speed, STEP)
        self.speed_errors.append(error)
        self.line_errors.append(offset - self.line)
        if step % 5 in (0, 2):
            # Twice in 100 ms: every 40 or 60 ms, 50 ms on average.
            self.send("EEC2", accelerator_pedal_position_percent=100.0 * pedal)
        self.send(
            "XBR",
            external_acceleration_demand=demand,
            xbr_ebi_mode=2,
            xbr_priority=1,
            xbr_control_mode=2 if demand < 0.0 else 0,
            xbr_message_counter=self.counter % 16,
        )
        self.send(
            "IITS_COMMAND",
            steering_wheel_angle_request=min(max(angle, -12.0), 12.0),
            steering_control_mode=1,
            parking_brake_request=0,
            transmission_mode_request=0,
            driver_brake_pedal_percent=0.0,
            command_message_counter=self.counter % 16,
        )
        self.counter += 1

    def send(self, name: str, **signals: float) -> None:
        """Sends a message; omitted signals are all ones, which means "not available"."""
        layout = self.dbc.get_message_by_name(name)
        frame_id = layout.frame_id & ~0xFF | ADDRESS
        raw = {s.name: (1 << s.length) - 1 for s in layout.signals}
        for signal in layout.signals:
            if signal.name in signals:
                raw[signal.name] = round((signals[signal.name] - signal.offset) / signal.scale)
        data = bytearray(layout.encode(raw, scaling=False, padding=True, strict=False))
        if name != "EEC2":
            # The checksum covers bytes 1 to 7, the counter and the identifier's bytes.
            total = sum(data[:7]) + (data[7] & 0x0F) + sum(frame_id.to_bytes(4, "little"))
            data[7] = ((total >> 4) + total & 0x0F) << 4 | data[7] & 0x0F
        self.bus.send(can.Message(arbitration_id=frame_id, data=data, is_extended_id=True))

    def result(self, settled: float) -> tuple[str, bool]:
        """The result as text, and whether speed and line were kept after the settling time [s]."""
        skip = round(settled / STEP)
        speed = [3.6 * error for error in self.speed_errors[skip:]]
        line = self.line_errors[skip:]
        if not speed:
            return "stopped before the end of the settling time", False
        rms = math.sqrt(sum(error**2 for error in speed) / len(speed))
        worst, off = max(map(abs, speed)), max(map(abs, line))
        text = (
            f"{3.6 * self.speed:.1f} km/h for {STEP * len(speed):.1f} s after {settled:g} s: speed "
            f"error rms {rms:.2f} km/h, worst {worst:.2f} km/h; off the line at most {off:.2f} m"
        )
        return text, worst < 3.0 and off < 0.5


def wait_for_truck(controller: Controller, patience: float) -> list[str]:
    """Receives until all required signals arrive; returns those missing after a time [s]."""
    end = time.monotonic() + patience
    while (missing := controller.missing()) and time.monotonic() < end:
        controller.listen(time.monotonic() + STEP)
    return missing


def drive(controller: Controller, duration: float) -> list[str]:
    """Drives for a time [s]; returns the signals whose loss ended the drive, usually none."""
    start = time.monotonic()
    for step in range(round(duration / STEP)):
        controller.control(step)
        controller.listen(start + (step + 1) * STEP)
        if missing := controller.missing():
            return missing
    return []


class Parser(argparse.ArgumentParser):
    """Reports wrong use in one line on stderr, with exit code 2."""

    def error(self, message: str) -> NoReturn:
        """Ends the program."""
        self.exit(2, f"{self.prog}: {message}\n")


def number(low: float, high: float, kind: Callable[[str], float] = float) -> Callable[[str], float]:
    """Type of an argument: a number within a range."""

    def parse(text: str) -> float:
        try:
            value = kind(text)
        except ValueError:
            value = math.nan
        # NaN fails this comparison.
        if not low <= value <= high:
            raise argparse.ArgumentTypeError(f"{text!r}: use a number, {low:g} to {high:g}")
        return value

    return parse


def arguments() -> argparse.Namespace:
    """The command line."""
    parser = Parser(description=__doc__.splitlines()[0])
    parser.add_argument("--interface", default="udp_multicast", help="python-can interface")
    parser.add_argument("--channel", default="239.74.163.2", help="group or CAN interface")
    parser.add_argument(
        "--port", type=number(1, 65535, int), default=43113, help="of udp_multicast"
    )
    parser.add_argument("--speed", type=number(5.0, 90.0), default=60.0, help="km/h")
    parser.add_argument("--duration", type=number(STEP, 86400.0), default=60.0, help="s")
    parser.add_argument(
        "--settle", type=number(0.0, 86400.0), default=5.0, help="s before errors count"
    )
    given = parser.parse_args()
    if given.settle >= given.duration:
        parser.error(f"--settle {given.settle:g}: use less than --duration {given.duration:g}")
    return given


def main() -> int:
    """Runs the command line; returns exit code 0 if speed and line were kept."""
    given = arguments()
    # Silences python-can: errors in opening the bus are reported below.
    logging.getLogger("can").addHandler(logging.NullHandler())
    settings: dict[str, Any] = {"interface": given.interface, "channel": given.channel}
    if given.interface == "udp_multicast":
        settings["port"] = given.port
    try:
        with can.Bus(**settings) as bus:
            controller = Controller(bus, given.speed / 3.6)
            if missing := wait_for_truck(controller, patience=20.0):
                return fail(f"no truck on this bus: no valid {', '.join(missing)}")
            if missing := drive(controller, given.duration):
                return fail(f"the truck stopped sending: no valid {', '.join(missing)}")
    except (can.CanError, OSError, ValueError, ImportError, NotImplementedError) as error:
        reason = " ".join(str(error).split()) or type(error).__name__
        return fail(f"CAN bus {given.interface}:{given.channel}: {reason}")
    text, kept = controller.result(given.settle)
    print(text)
    return 0 if kept else 1


def fail(reason: str) -> int:
    """Prints the reason of a failure in one line; returns the exit code."""
    print(f"keep_speed: {reason}", file=sys.stderr)
    return 2


if __name__ == "__main__":
    sys.exit(main())
