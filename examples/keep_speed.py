"""Somebody's own controller: keeps a speed and its place in the lane over a CAN bus.

It knows python-can, cantools and the DBC file, and nothing of the package that serves the truck:

    iits-mj serve --bus udp_multicast --start-speed 16.67
    python examples/keep_speed.py --duration 60

Speed comes from CCVS1, the yaw rate from VDC2, the distance from the road's reference line from
IITS_ROUTE; pedal (EEC2), brake (XBR) and steering wheel (IITS_COMMAND) go out.
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
# Priority and source address are no part of a message's name.
PGN_MASK = 0x03FFFF00
STEP = 0.02
# What must be heard, from whom the DBC says, and how long each may be silent or not available [s].
NEEDED = {
    "CCVS1": ("wheel_based_speed_kph", 0.5),
    "VDC2": ("yaw_rate", 0.5),
    "IITS_ROUTE": ("route_offset", 0.5),
    "CVW": ("gross_combination_weight_kg", 5.0),
}
# Of the truck's maker: steering ratio, wheelbase to the middle of the drive axles, how much more
# it must be steered as it gets faster, how far its drive axles slip sideways then, and its power.
RATIO = 21.0
WHEELBASE = 3.9
UNDERSTEER = 0.004  # s2/m
SLIP = 0.010  # s2/m
POWER = 330e3  # W


class SpeedKeeper:
    """Pedal and braking demand from the speed error [m/s]: an acceleration, shared out by mass."""

    GAIN = 1.0  # 1/s
    INTEGRAL = 0.3  # 1/s2
    COAST = 0.02  # m/s2 of holding back that is not worth a brake
    FULL = 0.94  # of the pedal's travel: beyond is kick-down, which costs time for its shifts

    def __init__(self) -> None:
        self.grade = 0.0

    def step(self, error: float, speed: float, mass: float, elapsed: float) -> tuple[float, float]:
        """Pedal, 0 to 1, and acceleration demand [m/s2], zero or negative."""
        # The pedal gives so much, and a level road takes so much of it: rolling and air.
        full = POWER / (mass * max(speed, 3.0))
        level = 0.05 + 3.6 * speed**2 / mass
        wanted = level + self.GAIN * error + self.grade
        # What no road asks for is no grade: the integral stands still at the pedal's stop.
        if wanted < self.FULL * full or error < 0.0:
            self.grade = min(max(self.grade + self.INTEGRAL * error * elapsed, -1.0), 1.0)
        demand = max(wanted + self.COAST, -3.0)
        return min(max(wanted / full, 0.0), self.FULL), min(demand, 0.0)


class LaneKeeper:
    """Steering-wheel angle from the distance to the left of the wanted line, and the yaw rate.

    An observer finds the heading against the road and the road's curvature, which no sensor tells.
    The distance is that of the steer axle, which yawing moves, too. Slowly driven the truck needs
    the same way, not the same time, to come back: all is quick as its speed allows, up to a limit.
    """

    OBSERVER = 3.0, 0.25  # rad/s at most, rad/m
    PATH = 0.8, 1.0 / 15.0  # rad/s at most, rad/m
    TRIM = 0.3  # of the path's quickness

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
        # The point of the truck that runs along its heading is so far behind the steer axle.
        arm = WHEELBASE - SLIP * v**2
        sideways = v * self.heading + arm * yaw_rate
        self.offset += elapsed * (sideways + 3.0 * w * surprise)
        self.heading += elapsed * (yaw_rate - v * self.curvature + 3.0 * w**2 / v * surprise)
        self.curvature -= elapsed * w**3 / v**2 * surprise
        # In a steady bend the steer axle runs along the line and the truck's heading does not.
        heading = self.heading + arm * self.curvature
        back = (path / v) ** 2 * self.offset + 1.8 * path / v * heading
        wanted = self.curvature - back
        wheel = RATIO * (WHEELBASE + UNDERSTEER * v**2)
        if speed > 1.0:
            self.trim += elapsed * self.TRIM * path * wheel * (wanted - yaw_rate / v)
        return wheel * wanted + self.trim


class Controller:
    """Reads the truck's frames, sends commands, keeps account."""

    def __init__(self, bus: can.BusABC, speed: float) -> None:
        self.bus, self.speed = bus, speed
        # Of J1939 the DBC's identifiers are matched without priority and source.
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
        """Takes what comes until a time of the monotonic clock."""
        while (left := until - time.monotonic()) > 0.0:
            message = self.bus.recv(timeout=left)
            if message is not None:
                self.take(message)

    def take(self, message: can.Message) -> None:
        """Keeps what we need of a message, if it is a number and from the unit that measures it."""
        if not message.is_extended_id or message.is_error_frame or message.is_remote_frame:
            return
        try:
            layout = self.dbc.get_message_by_frame_id(message.arbitration_id)
            # The priority is free, the sender is not: the DBC's identifier ends with its address.
            if layout.name not in NEEDED or (layout.frame_id ^ message.arbitration_id) & 0xFF:
                return
            raw = layout.decode(message.data, decode_choices=False, scaling=False)
        except (KeyError, cantools.database.DecodeError):
            return
        name, _ = NEEDED[layout.name]
        signal = layout.get_signal_by_name(name)
        # J1939: above 0xFA in the highest byte stand "error" and "not available".
        if raw[name] >> signal.length - 8 <= 0xFA:
            self.heard[name] = raw[name] * signal.scale + signal.offset
            self.heard_at[name] = time.monotonic()

    def missing(self) -> list[str]:
        """What is not known or too old, as "message signal"."""
        now = time.monotonic()
        return [
            f"{message} {name}"
            for message, (name, patience) in NEEDED.items()
            if now - self.heard_at.get(name, -math.inf) > patience
        ]

    def control(self, step: int) -> None:
        """One 20 ms cycle: commands from what was heard."""
        speed = self.heard["wheel_based_speed_kph"] / 3.6
        offset = self.heard["route_offset"]
        if self.line is None:
            # Wherever the truck is when we come is where it is to stay.
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
        """Sends a message; signals left out are all ones, which is "not available"."""
        layout = self.dbc.get_message_by_name(name)
        frame_id = layout.frame_id & ~0xFF | ADDRESS
        raw = {s.name: (1 << s.length) - 1 for s in layout.signals}
        for signal in layout.signals:
            if signal.name in signals:
                raw[signal.name] = round((signals[signal.name] - signal.offset) / signal.scale)
        data = bytearray(layout.encode(raw, scaling=False, padding=True, strict=False))
        if name != "EEC2":
            # The checksum: bytes 1 to 7, the counter and the identifier's bytes.
            total = sum(data[:7]) + (data[7] & 0x0F) + sum(frame_id.to_bytes(4, "little"))
            data[7] = ((total >> 4) + total & 0x0F) << 4 | data[7] & 0x0F
        self.bus.send(can.Message(arbitration_id=frame_id, data=data, is_extended_id=True))

    def result(self, settled: float) -> tuple[str, bool]:
        """The result in words, and whether speed and line were kept once it had settled."""
        skip = round(settled / STEP)
        speed = [3.6 * error for error in self.speed_errors[skip:]]
        line = self.line_errors[skip:]
        if not speed:
            return "stopped before anything could be said", False
        rms = math.sqrt(sum(error**2 for error in speed) / len(speed))
        worst, off = max(map(abs, speed)), max(map(abs, line))
        text = (
            f"{3.6 * self.speed:.1f} km/h for {STEP * len(speed):.1f} s after {settled:g} s: speed "
            f"error rms {rms:.2f} km/h, worst {worst:.2f} km/h; off the line at most {off:.2f} m"
        )
        return text, worst < 3.0 and off < 0.5


def wait_for_truck(controller: Controller, patience: float) -> list[str]:
    """Listens until all that is needed was heard; what is missing still after a time [s]."""
    end = time.monotonic() + patience
    while (missing := controller.missing()) and time.monotonic() < end:
        controller.listen(time.monotonic() + STEP)
    return missing


def drive(controller: Controller, duration: float) -> list[str]:
    """Drives for a time [s]; what was missing when it had to be given up, usually nothing."""
    start = time.monotonic()
    for step in range(round(duration / STEP)):
        controller.control(step)
        controller.listen(start + (step + 1) * STEP)
        if missing := controller.missing():
            return missing
    return []


class Parser(argparse.ArgumentParser):
    """Wrong use is one line on stderr and exit code 2."""

    def error(self, message: str) -> NoReturn:
        """Ends the program."""
        self.exit(2, f"{self.prog}: {message}\n")


def number(low: float, high: float, kind: Callable[[str], float] = float) -> Callable[[str], float]:
    """Type of an argument: a number of a range."""

    def parse(text: str) -> float:
        try:
            value = kind(text)
        except ValueError:
            value = math.nan
        # Not a number is in no range.
        if not low <= value <= high:
            raise argparse.ArgumentTypeError(f"{text!r}: use a number, {low:g} to {high:g}")
        return value

    return parse


def arguments() -> argparse.Namespace:
    """The command line."""
    parser = Parser(description=__doc__.splitlines()[0])
    parser.add_argument("--interface", default="udp_multicast", help="of python-can")
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
    """Command line; exit code 0 when speed and line were kept."""
    given = arguments()
    # What python-can has to say of a bus that could not be opened is said below.
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
                return fail(f"the truck fell silent: no valid {', '.join(missing)}")
    except (can.CanError, OSError, ValueError, ImportError, NotImplementedError) as error:
        reason = " ".join(str(error).split()) or type(error).__name__
        return fail(f"CAN bus {given.interface}:{given.channel}: {reason}")
    text, kept = controller.result(given.settle)
    print(text)
    return 0 if kept else 1


def fail(reason: str) -> int:
    """Tells on one line why nothing can be done; the exit code."""
    print(f"keep_speed: {reason}", file=sys.stderr)
    return 2


if __name__ == "__main__":
    sys.exit(main())
