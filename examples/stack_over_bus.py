"""Drives a truck over its bus with the controllers of this package.

    iits-mj serve --bus udp_multicast --start-speed 15 --on-silence release
    python examples/stack_over_bus.py --duration 60

The controllers get the truck's state from the bus alone. For a real truck use
`--interface socketcan --channel can0` and the map of its road.
"""

from __future__ import annotations

import argparse
import math
import sys
import time
from dataclasses import dataclass, replace
from pathlib import Path

from keep_speed import Parser, number

from controllers.planning.planner import PlannerConfig
from controllers.stack import Stack
from iits_mj.core.errors import Error
from iits_mj.core.messages import EgoState, Scene
from iits_mj.j1939 import CommandSender, Link, StateReceiver, pgn_of
from iits_mj.j1939.network import CONTROLLER, request
from iits_mj.road import RoadMap

STEP = 0.02
PLAN_EVERY = 5
NEEDED = ("IITS_ROUTE", "IITS_POSE", "IITS_ATTITUDE", "IITS_MOTION", "VDC2", "EEC1", "ETC2", "CVW")


@dataclass(slots=True)
class Figures:
    """Errors of the drive; SI units."""

    steps: int = 0
    squares: float = 0.0
    worst: float = 0.0
    offset: float = 0.0

    def add(self, speed_error: float, offset_error: float) -> None:
        """Adds the errors of one step."""
        self.steps += 1
        self.squares += speed_error**2
        self.worst = max(self.worst, abs(speed_error))
        self.offset = max(self.offset, abs(offset_error))


class BusDriver:
    """Connects the controllers to the bus."""

    def __init__(self, link: Link, stack: Stack) -> None:
        self.link, self.stack = link, stack
        # The mass is unknown until CVW arrives.
        self.receiver, self.sender = StateReceiver(mass=math.nan), CommandSender()
        self.heard: set[int] = set()
        self.start = self.heard_at = time.monotonic()

    def listen(self) -> EgoState:
        """Receives all pending frames and returns the state."""
        now = time.monotonic()
        for frame in self.link.receive(now - self.start):
            if self.receiver.receive(frame):
                self.heard.add(frame.pgn)
                self.heard_at = now
        return replace(self.receiver.state(), time=now - self.start)

    def meet(self, patience: float) -> bool:
        """Waits for a truck that sends all required messages; returns False if there is none."""
        needed = {pgn_of(name) for name in NEEDED}
        while time.monotonic() - self.start < patience:
            self.listen()
            if needed <= self.heard:
                return True
            # Requests messages that are sent only once a second.
            for pgn in needed - self.heard:
                self.link.send(request(pgn, CONTROLLER))
            time.sleep(0.1)
        return False

    def drive(self, duration: float, settle: float) -> Figures:
        """Drives for a time [s]; ends early if the truck stops sending."""
        figures, begin = Figures(), time.monotonic()
        for step in range(round(duration / STEP)):
            ego = self.listen()
            if time.monotonic() - self.heard_at > 0.5:
                print("the truck stopped sending", file=sys.stderr)
                break
            if step % PLAN_EVERY == 0:
                trajectory = self.stack.plan(Scene(ego.time, ego))
            for frame in self.sender.frames(self.stack.control(ego), ego.time):
                self.link.send(frame)
            if step * STEP >= settle:
                lane = self.stack.route.lane_offset(trajectory.target_lane, ego.station)
                wanted = self.stack.reference_speed(ego.station)
                figures.add(wanted - ego.speed, ego.offset - float(lane))
            time.sleep(max(0.0, begin + (step + 1) * STEP - time.monotonic()))
        return figures


def arguments() -> argparse.Namespace:
    """The command line."""
    parser = Parser(description=__doc__.splitlines()[0])
    parser.add_argument("--interface", default="udp_multicast", help="python-can interface")
    parser.add_argument("--channel", help="group or group:port, or CAN interface")
    parser.add_argument("--map", type=Path, help="OpenDRIVE map of the road; default: the built-in")
    parser.add_argument("--speed", type=number(5.0, 90.0), default=60.0, help="km/h")
    parser.add_argument("--duration", type=number(STEP, 86400.0), default=60.0, help="s")
    parser.add_argument(
        "--settle", type=number(0.0, 86400.0), default=10.0, help="s before errors count"
    )
    given = parser.parse_args()
    if given.settle >= given.duration:
        parser.error(f"--settle {given.settle:g}: use less than --duration {given.duration:g}")
    return given


def main() -> int:
    """Runs the command line; returns exit code 0 if speed and lane were kept."""
    given = arguments()
    try:
        road = RoadMap.builtin() if given.map is None else RoadMap.from_opendrive(given.map)
        plan = PlannerConfig()
        speed = replace(plan.speed, cruise_speed=given.speed / 3.6)
        stack = Stack(road.route(), planner=replace(plan, speed=speed))
        with Link(given.interface, given.channel) as link:
            driver = BusDriver(link, stack)
            if not driver.meet(patience=20.0):
                print("no truck on this bus", file=sys.stderr)
                return 2
            figures = driver.drive(given.duration, given.settle)
    except Error as error:
        print(f"stack_over_bus: {error}", file=sys.stderr)
        return 2
    if not figures.steps:
        print("stopped before the end of the settling time")
        return 1
    rms = 3.6 * math.sqrt(figures.squares / figures.steps)
    print(
        f"{given.speed:.1f} km/h for {figures.steps * STEP:.1f} s: speed error rms {rms:.2f} km/h, "
        f"worst {3.6 * figures.worst:.2f} km/h; off the lane's center at most "
        f"{figures.offset:.2f} m"
    )
    return 0 if 3.6 * figures.worst < 3.0 and figures.offset < 0.5 else 1


if __name__ == "__main__":
    sys.exit(main())
