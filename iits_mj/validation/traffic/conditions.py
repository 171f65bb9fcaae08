"""Conditions of a recorded road for a simulation: recorded first vehicle, IDM drivers behind it.

Each recorded lane becomes a straight road of its own, because no recorded pair changes lanes:

- A column of vehicles, each at its distance for the first recorded speeds, is long enough to feed
  the stretch to the end. The recorded stretch lies inside a queue, so the drivers determine the
  inflow; the flow is a result that is compared with the recorded flow.
- At every time the recorded vehicle farthest ahead in the lane, which follows no recorded vehicle,
  is the downstream boundary: a vehicle at its place has its speed.

Behind the boundary, where flows are compared, nothing is prescribed: every vehicle follows its
leader by the Intelligent Driver Model. A long recording is simulated in windows.

A fixed boundary (with the speeds on the last part of the stretch) is less faithful to this kind of
recording, a selection of platoons: most of the time no vehicle was recorded there, and the speed
between two platoons differs from that of both. A prescribed inflow does not work: slightly less
than the capacity dissolves the queue into free traffic, slightly more changes nothing. In a queue
information travels upstream.
"""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from iits_mj.core.arrays import FloatArray
from iits_mj.core.errors import InputError
from iits_mj.validation.traffic.flow import FlowSamples
from traffic_bridge.config import Departure
from traffic_bridge.vehicles.idm import IdmParameters, equilibrium_gap

# Draws the driver of a vehicle in a lane.
Drivers = Callable[[int, np.random.Generator], IdmParameters]

EXIT_SHARE = 0.8  # of the stretch: place of a fixed boundary
WARM_UP = 60.0  # [s] before a window, with its first conditions
WINDOW = 150.0  # [s]
RESERVE = 1.15  # length of the column over the length that the recorded flow needs
CLOSE = 0.3  # [s]: time headway beyond the boundary
BIN = 2.0  # [s] for averages of recorded speeds
TYPE = "car"
SLOWEST = 0.5  # [m/s]: least prescribed speed
WAVE = 4.5  # [m/s] upstream, see `without_model`


@dataclass(frozen=True, eq=False)
class Conditions:
    """Conditions by lane, and over time every `BIN` seconds.

    Attributes:
      start, end: of the recording [s]; length: of the recorded stretch [m].
      time: middle of the bins [s], shape (n,).
      head, head_speed: station [m] and speed [m/s] of the recorded vehicle farthest ahead, shape
        (lanes, n).
      covered: share of the bins with a recorded vehicle, shape (lanes,); between them station and
        speed are interpolated.
      speed, spacing: means over the stretch [m/s], [m], shape (lanes,).
      vehicle_length: mean [m].
    """

    start: float
    end: float
    length: float
    time: FloatArray
    head: FloatArray
    head_speed: FloatArray
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
    def of(
        cls,
        recorded: FlowSamples,
        others: FlowSamples,
        vehicle_length: float,
        fixed: bool = False,
    ) -> Conditions:
        """The conditions of a recorded flow whose stations begin near zero.

        Args:
          recorded: followers.
          others: their leaders.
          vehicle_length: mean [m].
          fixed: the boundary stays at the beginning of the last fifth of the stretch, with the
            mean speed of the vehicles recorded there, interpolated between them.

        Raises:
          InputError: a lane has no vehicle with a leader.
        """
        length = float(recorded.station.max())
        start, end = float(recorded.time.min()), float(recorded.time.max())
        edges = np.arange(start, end + BIN, BIN)
        whole = FlowSamples.joined([recorded, others])
        whole = whole.select((whole.time >= start) & (whole.time <= end))
        head, head_speed, covered, speed, spacing = [], [], [], [], []
        for lane in range(int(recorded.lane.max()) + 1):
            mine = whole.select(whole.lane == lane)
            known = mine.select(np.isfinite(mine.spacing))
            if not len(known):
                raise InputError(f"lane {lane}: no vehicle behind a leader was recorded")
            if fixed:
                first = mine.select(mine.station > EXIT_SHARE * length)
                if not len(first):
                    raise InputError(
                        f"lane {lane}: no vehicle was recorded on the last fifth of {length:.0f} m"
                    )
            else:
                first = _foremost(mine)
            place, share = _binned(first.time, first.station, edges)
            head.append(np.full_like(place, EXIT_SHARE * length) if fixed else place)
            head_speed.append(_binned(first.time, first.speed, edges)[0])
            covered.append(share)
            speed.append(float(known.speed.mean()))
            spacing.append(float(known.spacing.mean()))
        return cls(
            start,
            end,
            length,
            0.5 * (edges[1:] + edges[:-1]),
            np.array(head),
            np.array(head_speed),
            np.array(covered),
            np.array(speed),
            np.array(spacing),
            vehicle_length,
        )

    def lead_in(self, lane: int, begin: float, end: float) -> float:
        """Length of road before the stretch for the column of a lane in a window [m]."""
        times = np.arange(begin - WARM_UP, end, BIN)
        driven = float(sum(self.speed_at(lane, float(time)) * BIN for time in times))
        return driven * RESERVE

    def column(
        self, lane: int, begin: float, end: float, drivers: Drivers, rng: np.random.Generator
    ) -> tuple[tuple[Departure, ...], list[IdmParameters]]:
        """The vehicles of a simulated window [s], all present at its beginning.

        Returns:
          The departures, and the driver of each.
        """
        departures, found = [], []
        # Only the speeds of the boundary are prescribed; the flow upstream of it is a result.
        times = np.arange(begin - WARM_UP, begin, BIN)
        mean = float(np.mean([self.speed_at(lane, float(time)) for time in times]))
        # Half the speed: SUMO inserts a vehicle only with at least one second of distance.
        first = 0.5 * mean
        station = self.lead_in(lane, begin, end) + self.length - 1.0
        while station > self.vehicle_length + 1.0:
            driver = drivers(lane, rng)
            departures.append(Departure(time=0.0, type=TYPE, lane=0, station=station, speed=first))
            found.append(driver)
            even = min(mean, 0.9 * driver.desired_speed)
            gap = max(float(equilibrium_gap(driver.as_array(), even)), first + 2.5)
            station -= gap + self.vehicle_length
        return tuple(departures), found

    def speed_at(self, lane: int, time: float) -> float:
        """Speed of the vehicle farthest ahead at a recorded time [m/s]."""
        return max(float(np.interp(time, self.time, self.head_speed[lane])), SLOWEST)

    def head_at(self, lane: int, time: Any) -> Any:
        """Station of the vehicle farthest ahead at recorded times [m]."""
        return np.interp(time, self.time, self.head[lane])

    def is_free(self, samples: FlowSamples) -> NDArray[np.bool_]:
        """Mask of the entries on the stretch that are not prescribed, shape (n,)."""
        free = samples.station >= 0.0
        for lane in range(self.lanes):
            mine = samples.lane == lane
            free[mine] &= samples.station[mine] < self.head_at(lane, samples.time[mine])
        return np.asarray(free)

    def windows(self) -> list[tuple[float, float]]:
        """Begin and end of the windows to simulate [s]."""
        count = max(1, round((self.end - self.start) / WINDOW))
        edges = np.linspace(self.start, self.end, count + 1).tolist()
        return list(itertools.pairwise(edges))


def compared(samples: FlowSamples, conditions: Conditions) -> FlowSamples:
    """The part of a flow to compare: on the stretch, behind the boundary."""
    return samples.select(conditions.is_free(samples))


def without_model(samples: FlowSamples, conditions: Conditions) -> FlowSamples:
    """The entries with the speed of the boundary, travelling upstream as a wave.

    Treiber and Kesting (2013), section 8.5: disturbances in congested traffic travel upstream at
    about 15 to 20 km/h for all drivers. The agreement of this flow is not the merit of a model.
    """
    speed = np.empty(len(samples))
    for lane in range(conditions.lanes):
        mine = samples.lane == lane
        time = samples.time[mine]
        apart = conditions.head_at(lane, time) - samples.station[mine]
        speed[mine] = np.interp(time - apart / WAVE, conditions.time, conditions.head_speed[lane])
    return dataclasses.replace(samples, speed=speed)


def _foremost(samples: FlowSamples) -> FlowSamples:
    """The entry farthest ahead at each time, in samples of one lane."""
    order = np.lexsort((samples.station, samples.time))
    times = samples.time[order]
    last = np.append(np.diff(times) > 1e-6, True)
    keep = np.zeros(len(samples), dtype=bool)
    keep[order[last]] = True
    return samples.select(keep)


def _binned(time: FloatArray, values: FloatArray, edges: FloatArray) -> tuple[FloatArray, float]:
    """Means over bins, interpolated over empty bins, and the share of bins with a value."""
    count, _ = np.histogram(time, edges)
    total, _ = np.histogram(time, edges, weights=values)
    middle = 0.5 * (edges[1:] + edges[:-1])
    known = count > 0
    return np.interp(middle, middle[known], total[known] / count[known]), float(known.mean())
