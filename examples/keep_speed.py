"""Somebody's own controller: keeps a speed and its place in the lane over a CAN bus.

It knows python-can, cantools and the DBC file, and nothing of the package that serves the truck:

    iits-mj serve --bus udp_multicast --start-speed 16.67
    python examples/keep_speed.py --duration 60

Speed comes from CCVS1, the yaw rate from VDC2, the distance from the road's reference line from
IITS_ROUTE; pedal (EEC2), brake (XBR) and steering wheel (IITS_COMMAND) go out.
"""

from __future__ import annotations

import argparse
import math
import sys
import time
from pathlib import Path

import can
import cantools
import cantools.database.can

DBC = Path(__file__).resolve().parents[1] / "iits_mj" / "j1939" / "iits_mj.dbc"
# Our source address: the one that J1939 prefers for a headway controller.
ADDRESS = 0x2A
# Priority and source address are no part of a message's name.
PGN_MASK = 0x03FFFF00
STEP = 0.02
# Of the truck's maker: steering ratio, wheelbase to the middle of the drive axles, and how much
# more it must be steered as it gets faster.
RATIO = 21.0
WHEELBASE = 3.9
UNDERSTEER = 0.004  # s2/m


class SpeedKeeper:
    """Pedal and braking demand from the speed error [m/s]."""

    def __init__(self) -> None:
        # About what a level road takes, so that it need not be found out first.
        self.integral = 0.3

    def step(self, error: float, elapsed: float) -> tuple[float, float]:
        """Pedal, 0 to 1, and acceleration demand [m/s2], zero or negative."""
        pedal = 0.5 * error + self.integral
        # The integral stands still while the pedal is at a stop.
        if 0.0 < pedal < 1.0 or (pedal <= 0.0) == (error > 0.0):
            self.integral = min(max(self.integral + 0.15 * error * elapsed, 0.0), 1.0)
        too_fast = -error - 0.3
        return min(max(pedal, 0.0), 1.0), -min(0.8 * too_fast, 3.0) if too_fast > 0.0 else 0.0


class LaneKeeper:
    """Steering-wheel angle from the distance to the left of the wanted line, and the yaw rate.

    An observer finds the heading against the road and the road's curvature, which no sensor tells.
    """

    OBSERVER = 3.0  # rad/s
    PATH = 0.8  # rad/s
    YAW = 2.0  # rad of steering wheel in a second for 1 rad/s

    def __init__(self) -> None:
        self.offset: float | None = None
        self.heading = self.curvature = self.trim = 0.0

    def step(self, offset: float, yaw_rate: float, speed: float, elapsed: float) -> float:
        """The angle [rad], positive to the left."""
        v, w = max(speed, 3.0), self.OBSERVER
        if self.offset is None:
            self.offset = offset
        surprise = offset - self.offset
        self.offset += elapsed * (v * self.heading + 3.0 * w * surprise)
        self.heading += elapsed * (yaw_rate - v * self.curvature + 3.0 * w**2 / v * surprise)
        self.curvature -= elapsed * w**3 / v**2 * surprise
        back = (self.PATH / v) ** 2 * self.offset + 1.8 * self.PATH / v * self.heading
        wanted = self.curvature - back
        if speed > 3.0:
            self.trim += elapsed * self.YAW * (v * wanted - yaw_rate)
        return RATIO * (WHEELBASE + UNDERSTEER * v**2) * wanted + self.trim


class Controller:
    """Reads the truck's frames, sends commands, keeps account."""

    def __init__(self, bus: can.BusABC, speed: float) -> None:
        self.bus, self.speed = bus, speed
        # Of J1939 the DBC's identifiers are matched without priority and source.
        self.dbc = cantools.database.can.Database(frame_id_mask=PGN_MASK)
        self.dbc.add_dbc_file(str(DBC))
        self.heard: dict[str, float] = {}
        self.heard_at = time.monotonic()
        self.counter = 0
        self.line: float | None = None
        self.speed_keeper, self.lane_keeper = SpeedKeeper(), LaneKeeper()
        self.speed_errors: list[float] = []
        self.line_errors: list[float] = []

    def listen(self, until: float) -> None:
        """Takes what comes until a time of the monotonic clock."""
        while (left := until - time.monotonic()) > 0.0:
            message = self.bus.recv(timeout=left)
            if message is None or not message.is_extended_id or message.is_error_frame:
                continue
            try:
                layout = self.dbc.get_message_by_frame_id(message.arbitration_id)
                if layout.name in ("CCVS1", "VDC2", "IITS_ROUTE"):
                    self.heard |= layout.decode(message.data, decode_choices=False)
                    self.heard_at = time.monotonic()
            except (KeyError, cantools.database.DecodeError):
                continue

    def control(self, step: int) -> None:
        """One 20 ms cycle: commands from what was heard."""
        speed = self.heard["wheel_based_speed_kph"] / 3.6
        offset = self.heard["route_offset"]
        if self.line is None:
            # Wherever the truck is when we come is where it is to stay.
            self.line = offset
        error = self.speed - speed
        pedal, demand = self.speed_keeper.step(error, STEP)
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


def wait_for_truck(controller: Controller, patience: float) -> bool:
    """Listens until all that is needed was heard; False when that takes too long [s]."""
    wanted = ("wheel_based_speed_kph", "route_offset", "yaw_rate")
    end = time.monotonic() + patience
    while not all(name in controller.heard for name in wanted):
        if time.monotonic() > end:
            return False
        controller.listen(time.monotonic() + STEP)
    return True


def drive(controller: Controller, duration: float, patience: float = 0.5) -> bool:
    """Drives for a time [s]; False when the truck falls silent for `patience` [s]."""
    start = time.monotonic()
    for step in range(round(duration / STEP)):
        controller.control(step)
        controller.listen(start + (step + 1) * STEP)
        if time.monotonic() - controller.heard_at > patience:
            return False
    return True


def main() -> int:
    """Command line; exit code 0 when speed and line were kept."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--interface", default="udp_multicast", help="of python-can")
    parser.add_argument("--channel", default="239.74.163.2", help="group or CAN interface")
    parser.add_argument("--port", type=int, default=43113, help="of udp_multicast")
    parser.add_argument("--speed", type=float, default=60.0, help="km/h")
    parser.add_argument("--duration", type=float, default=60.0, help="s")
    parser.add_argument("--settle", type=float, default=5.0, help="s before errors count")
    given = parser.parse_args()
    port = {"port": given.port} if given.interface == "udp_multicast" else {}
    with can.Bus(interface=given.interface, channel=given.channel, **port) as bus:
        controller = Controller(bus, given.speed / 3.6)
        if not wait_for_truck(controller, patience=20.0):
            print("no truck on this bus", file=sys.stderr)
            return 2
        if not drive(controller, given.duration):
            print("the truck fell silent", file=sys.stderr)
            return 2
    text, kept = controller.result(given.settle)
    print(text)
    return 0 if kept else 1


if __name__ == "__main__":
    sys.exit(main())
