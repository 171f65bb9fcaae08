"""Compares the truck's two safe states after a cut of the bus at 80 km/h in a bend.

    python benchmarks/bus_cut.py --picture bus_cut.png > bus_cut.md

A left-hand bend of 620 m on the built-in highway, laden and empty. The stack sends frames to the
truck's receiver; the frames end 4 s after the start. `release` releases pedal and brakes and holds
the steering wheel, `stop` is the stop in lane.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from controllers.planning.planner import PlannerConfig
from controllers.planning.speed_plan import SpeedConfig
from controllers.safe_stop.fallback import Fallback
from controllers.safe_stop.stop import SafeStop
from controllers.stack import Stack
from iits_mj.core.arrays import FloatArray
from iits_mj.core.messages import Scene
from iits_mj.core.results import Line, Panel
from iits_mj.core.timing import CONTROL_PERIOD, TIMESTEP
from iits_mj.j1939 import CommandReceiver, command_to_frames
from iits_mj.render.plots import save
from iits_mj.road import RoadMap, Route
from iits_mj.truck import Truck

STATION, SPEED, CUT, DURATION = 10_960.0, 80.0 / 3.6, 4.0, 26.0


def drive(route: Route, payload: float, stops: bool) -> FloatArray:
    """Rows of time, station, speed, and distances of truck and trailer from the lane's middle."""
    truck = Truck.load(payload=payload, route=route, visuals=False)
    truck.reset(station=STATION, offset=float(route.lane_offset(0, STATION)), speed=SPEED)
    config = PlannerConfig(speed=SpeedConfig(cruise_speed=SPEED))
    stack = Stack(route, planner=config, parameters=truck.parameters)
    fallback = Fallback(SafeStop(route, truck.parameters))
    receiver = CommandReceiver()
    rows = []
    for k in range(round(DURATION / CONTROL_PERIOD)):
        ego = truck.observe()
        if ego.time < CUT - 1e-6:
            if k % 5 == 0:
                stack.plan(Scene(ego.time, ego, ()))
            for frame in command_to_frames(stack.control(ego), k, ego.time):
                receiver.receive(frame)
        command = receiver.command(ego.time)
        if stops:
            command = fallback.command(ego, command, receiver.loss(ego.time).driver)
        truck.command(command)
        truck.step(round(CONTROL_PERIOD / TIMESTEP))
        middle = float(route.lane_offset(0, ego.station))
        rows.append(
            (ego.time, ego.station, ego.speed, ego.offset - middle, ego.trailer_offset - middle)
        )
    return np.array(rows)


def smoothed(speed: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Deceleration [m/s2], a mean over 0.2 s, and its jerk [m/s3]."""
    mean = np.convolve(np.gradient(speed, CONTROL_PERIOD), np.ones(10) / 10.0, "same")
    return -mean, np.gradient(-mean, CONTROL_PERIOD)


def row_of(name: str, rows: FloatArray, half: float) -> str:
    """One row of the table; half: greatest distance from the lane's middle inside the lane [m]."""
    time, station, speed, error, trailer = rows.T
    deceleration, jerk = smoothed(speed)
    after = time >= CUT
    inner = after & (time < time[-1] - 0.2)
    moving = inner & (speed > 0.5)
    worst = np.maximum(np.abs(error), np.abs(trailer))
    stands = np.flatnonzero(after & (np.abs(speed) < 0.05))
    leaves = np.flatnonzero(after & (worst > half))
    first = int(np.argmax(after))
    way = f"{station[stands[0]] - station[first]:.0f} m" if len(stands) else "rolls on"
    left = f"after {time[leaves[0]] - CUT:.1f} s" if len(leaves) else "no"
    figures = (
        f"{3.6 * speed[first]:.1f} km/h",
        f"{np.abs(error[after]).max():.2f} m",
        f"{np.abs(trailer[after]).max():.2f} m",
        left,
        f"{deceleration[inner].max():.2f} m/s2",
        f"{np.abs(jerk[moving]).max():.1f} m/s3",
        f"{np.abs(jerk[inner]).max():.1f} m/s3",
        way,
    )
    return f"| {name} | {' | '.join(figures)} |"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--picture", type=Path)
    arguments = parser.parse_args()
    route = RoadMap.builtin().route()
    half = 0.5 * (float(route.lane_width(0, STATION)) - 2.55)
    print(
        "| safe state | speed at the cut | steer axle off the middle | trailer's end | "
        "leaves the lane | deceleration | jerk above 0.5 m/s | jerk at standstill | way |"
    )
    print("|---|---|---|---|---|---|---|---|---|")
    lines: dict[str, list[Line]] = {"speed": [], "deceleration": [], "offset": []}
    for load, payload in (("laden", 36_000.0), ("empty", 0.0)):
        for state in ("stop", "release"):
            rows = drive(route, payload, state == "stop")
            name = f"{state}, {load}"
            print(row_of(name, rows, half))
            time, _, speed, error, _ = rows.T
            lines["speed"].append(Line(name, time, 3.6 * speed))
            lines["deceleration"].append(Line(name, time, smoothed(speed)[0]))
            lines["offset"].append(Line(name, time, np.clip(error, -3.0, 3.0)))
    if arguments.picture is not None:
        label = "time [s], cut at 4 s"
        panels = [
            Panel("Speed", label, "km/h", lines["speed"]),
            Panel("Deceleration", label, "m/s2", lines["deceleration"]),
            Panel("Distance to the lane's middle, at most 3 m shown", label, "m", lines["offset"]),
        ]
        save(panels, arguments.picture)


if __name__ == "__main__":
    main()
