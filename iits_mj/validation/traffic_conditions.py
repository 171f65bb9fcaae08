"""PureSim on a recorded road: recorded lanes and downstream speed, IDM drivers upstream of it.

The road is straight, with the recorded lanes. Lane by lane

- at the beginning there is a column of vehicles at the distances they keep at the recorded mean
  speed, long enough to feed the recorded stretch to the end: the stretch lies
  inside a queue, so the drivers decide how many come in, and how many did is compared;
- who has come to the last fifth of the stretch drives at the mean speed recorded there at that
  time.

Nothing else is prescribed: everybody on the stretch and before it follows its leader by the
Intelligent Driver Model. Nobody changes lanes, as in the recorded pairs. The last fifth is left out
when flows are compared, because the speed recorded there went into the boundary. A
long recording is simulated window by window, each from a beginning of its own.
"""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from iits_mj.errors import InputError
from iits_mj.road import Route
from iits_mj.validation.traffic_flow import FlowLog, FlowSamples
from traffic_bridge.config import TrafficConfig
from traffic_bridge.departures import Departure
from traffic_bridge.frame import VehicleFrame
from traffic_bridge.idm import PARAMETERS, IdmParameters, equilibrium_gap
from traffic_bridge.modes import PureSim
from traffic_bridge.vehicle_types import VehicleType, default_types

FloatArray = NDArray[np.float64]
# The driver of a vehicle of a lane, drawn with a generator.
Drivers = Callable[[int, np.random.Generator], IdmParameters]

EXIT_SHARE = 0.8  # of the recorded stretch; what is beyond gives the downstream speed
RUN_OUT = 100.0  # [m] beyond the stretch
WARM_UP = 60.0  # [s] before a window begins, under its first conditions
WINDOW = 150.0  # [s]
RESERVE = 1.25  # length of the column over what the recorded flow would use up
CLOSE = 0.3  # [s]: time headway on the last fifth
BIN = 2.0  # [s] over which recorded speeds are averaged
SAMPLE_PERIOD = 0.5  # [s] between samples of the simulated flow
SPEED_CAP = 40.0  # [m/s]: limit of the simulated road, above every desired speed
LANE_WIDTH = 3.66  # [m]
NO_CHANGE = 1e3  # [m/s2]: a MOBIL threshold that nothing reaches


@dataclass(frozen=True, eq=False)
class Conditions:
    """What drives a simulated road; arrays over lanes, and over time every `BIN` seconds.

    Attributes:
      start, end: of the recording [s]; length: of the recorded stretch [m].
      time: middle of the bins [s], shape (n,).
      exit_speed: on the last fifth [m/s], shape (lanes, n).
      covered: share of the bins in which somebody was recorded there, shape (lanes,); between them
        the speed is interpolated.
      speed, spacing: means over the stretch [m/s], [m], shape (lanes,).
      vehicle_length: mean [m].
    """

    start: float
    end: float
    length: float
    time: FloatArray
    exit_speed: FloatArray
    covered: FloatArray
    speed: FloatArray
    spacing: FloatArray
    vehicle_length: float

    @property
    def lanes(self) -> int:
        """Number of lanes."""
        return len(self.speed)

    @property
    def flow(self) -> FloatArray:
        """Recorded flow by Edie's definition, distance driven over area of road and time [1/s]."""
        return self.speed / self.spacing

    @classmethod
    def of(cls, recorded: FlowSamples, others: FlowSamples, vehicle_length: float) -> Conditions:
        """The conditions of a recorded flow whose stations begin near zero.

        Args:
          recorded: followers.
          others: their leaders, who tell the speed on the last fifth too.
          vehicle_length: mean [m].

        Raises:
          InputError: a lane has nobody with a leader, or nobody on the last fifth.
        """
        length = float(recorded.station.max())
        start, end = float(recorded.time.min()), float(recorded.time.max())
        edges = np.arange(start, end + BIN, BIN)
        exit_speed, covered, speed, spacing = [], [], [], []
        for lane in range(int(recorded.lane.max()) + 1):
            here = recorded.select((recorded.lane == lane) & np.isfinite(recorded.spacing))
            last = [
                flow.select((flow.lane == lane) & (flow.station > EXIT_SHARE * length))
                for flow in (recorded, others)
            ]
            time = np.concatenate([flow.time for flow in last])
            if not len(here) or not len(time):
                raise InputError(
                    f"lane {lane}: nobody with a leader was recorded, or nobody on the last fifth "
                    f"of the stretch of {length:.0f} m"
                )
            inside = (time >= start) & (time <= end)
            values, share = _binned(
                time[inside], np.concatenate([flow.speed for flow in last])[inside], edges
            )
            exit_speed.append(values)
            covered.append(share)
            speed.append(float(here.speed.mean()))
            spacing.append(float(here.spacing.mean()))
        return cls(
            start,
            end,
            length,
            0.5 * (edges[1:] + edges[:-1]),
            np.array(exit_speed),
            np.array(covered),
            np.array(speed),
            np.array(spacing),
            vehicle_length,
        )

    def lead_in(self, duration: float) -> float:
        """Length of the road before the stretch that holds the columns [m]."""
        return float(self.speed.max()) * duration * RESERVE

    def column(
        self, type_name: str, duration: float, drivers: Drivers, rng: np.random.Generator
    ) -> tuple[tuple[Departure, ...], list[IdmParameters]]:
        """The vehicles of a simulation of some duration [s], all there at its beginning.

        Each keeps its own equilibrium distance at its lane's mean speed.

        Returns:
          The departures, and the driver of each.
        """
        end = self.lead_in(duration) + self.length
        departures, found = [], []
        for lane in range(self.lanes):
            mean = float(self.speed[lane])
            # Half the speed: who is put on the road wants at least a second's distance there.
            begin = 0.5 * mean
            station, last = end - 1.0, end - self.length - mean * duration * RESERVE
            while station > max(last, self.vehicle_length + 1.0):
                driver = drivers(lane, rng)
                departures.append(
                    Departure(time=0.0, type=type_name, lane=lane, station=station, speed=begin)
                )
                found.append(driver)
                even = min(mean, 0.9 * driver.desired_speed)
                gap = max(float(equilibrium_gap(driver.as_array(), even)), begin + 2.5)
                station -= gap + self.vehicle_length
        return tuple(departures), found

    def exit_speed_at(self, lane: int, time: float) -> float:
        """Speed on the last fifth at a recorded time [m/s]."""
        return float(np.interp(time, self.time, self.exit_speed[lane]))

    def windows(self) -> list[tuple[float, float]]:
        """Beginnings and ends of the windows to simulate [s]."""
        count = max(1, round((self.end - self.start) / WINDOW))
        edges = np.linspace(self.start, self.end, count + 1).tolist()
        return list(itertools.pairwise(edges))


def entering_type(length: float) -> VehicleType:
    """Of a vehicle until it is on the road, where it gets a driver; it never changes lanes."""
    return dataclasses.replace(
        default_types()[0],
        length=length,
        minimum_gap=0.5,
        time_headway=CLOSE,
        acceleration=1.5,
        deceleration=2.0,
        change_threshold=NO_CHANGE,
    )


def drive(
    conditions: Conditions, drivers: Drivers, window: tuple[float, float], seed: int = 0
) -> FlowSamples:
    """Runs PureSim under recorded conditions.

    Args:
      conditions: see the module.
      drivers: who drives.
      window: beginning and end of what is simulated, in the recording's time [s].
      seed: of the traffic and of the drivers.

    Returns:
      The simulated flow at the recording's times, lanes and stations.
    """
    begin, end = window
    total = WARM_UP + end - begin
    before = conditions.lead_in(total)
    length = before + conditions.length + RUN_OUT
    route = Route.straight(
        length, lanes=conditions.lanes, lane_width=LANE_WIDTH, speed_limit=SPEED_CAP
    )
    kind = entering_type(conditions.vehicle_length)
    departures, found = conditions.column(kind.name, total, drivers, np.random.default_rng(seed))
    config = TrafficConfig(
        density="empty",
        speed_limit=SPEED_CAP,
        lane_change="mobil",
        lane_change_duration=0.0,
        types=(kind,),
        mix=((kind.name, 1.0),),
        departures=departures,
    )
    log = FlowLog()
    known: set[str] = set()
    with PureSim(route, config, seed) as traffic:
        frame = traffic.reset()
        stride = round(SAMPLE_PERIOD / config.step_length)
        for step in range(round(total / config.step_length) + 1):
            for name in sorted(set(frame.ids) - known):
                # Vehicles of the list are named by their place in it.
                _become(traffic, name, found[int(name.rpartition(".d")[2])])
            known.update(frame.ids)
            if step % stride == 0:
                time = traffic.time - WARM_UP + begin
                _leave(traffic, frame, conditions, before, time)
                if time >= begin:
                    log.add(time, frame, before)
            frame = traffic.step()
    samples = log.samples
    return dataclasses.replace(samples, station=samples.station - before)


def compared(samples: FlowSamples, conditions: Conditions) -> FlowSamples:
    """The part of the stretch on which flows are compared: without its last fifth."""
    return samples.select(
        (samples.station >= 0.0) & (samples.station < EXIT_SHARE * conditions.length)
    )


def _become(traffic: PureSim, name: str, parameters: IdmParameters) -> None:
    values = {entry: getattr(parameters, entry) for entry in PARAMETERS}
    traffic.vehicles.change(name, **values)


def _leave(
    traffic: PureSim, frame: VehicleFrame, conditions: Conditions, before: float, time: float
) -> None:
    """Lets everybody on the last fifth drive at the recorded speed, closely behind."""
    station = frame.column("station") + 0.5 * frame.column("length")
    beyond = station >= before + EXIT_SHARE * conditions.length
    for i in np.flatnonzero(beyond & (frame.lanes >= 0)):
        speed = max(conditions.exit_speed_at(int(frame.lanes[i]), time), 0.5)
        traffic.vehicles.change(
            frame.ids[i], desired_speed=speed, time_headway=CLOSE, acceleration=2.0
        )


def _binned(time: FloatArray, values: FloatArray, edges: FloatArray) -> tuple[FloatArray, float]:
    """Means over bins, interpolated where there is no value, and the share of bins with one."""
    count, _ = np.histogram(time, edges)
    total, _ = np.histogram(time, edges, weights=values)
    middle = 0.5 * (edges[1:] + edges[:-1])
    known = count > 0
    return np.interp(middle, middle[known], total[known] / count[known]), float(known.mean())
