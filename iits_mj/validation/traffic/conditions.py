"""PureSim on a recorded road: the vehicle ahead of all as recorded, IDM drivers in a queue behind.

Each recorded lane is a straight road of its own, because no recorded pair changes lanes:

- a column of vehicles, each at the distance it keeps at the first recorded speeds, is long enough
  to feed the stretch to the end: the recorded stretch lies inside a queue, so its drivers decide
  how many come in, and the flow is a result that is compared with the recorded one;
- at every time the recorded vehicle farthest ahead in the lane, whom nobody of the recording leads,
  is the downstream boundary: who is as far as it is drives at its speed.

Behind it, where flows are compared, nothing is prescribed: everybody follows its leader by the
Intelligent Driver Model. A long recording is simulated window by window, each from a beginning of
its own.

A boundary that stands still (the speeds on the last part of the stretch) is less true to this kind
of recording, a selection of platoons: most of the time nobody was recorded there, and the speed
between two platoons is not that of either. Prescribing the recorded inflow does not work: a little
less than the drivers could take, and the queue dissolves into free traffic; a little more, and
nothing changes. In a queue information travels upstream.
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

# The driver of a vehicle of a lane, drawn with a generator.
Drivers = Callable[[int, np.random.Generator], IdmParameters]

EXIT_SHARE = 0.8  # of the stretch, where a boundary that stands still is
WARM_UP = 60.0  # [s] before a window begins, under its first conditions
WINDOW = 150.0  # [s]
RESERVE = 1.15  # length of the column over what the recorded flow would use up
CLOSE = 0.3  # [s]: time headway beyond the boundary
BIN = 2.0  # [s] over which recorded speeds are averaged
TYPE = "car"
SLOWEST = 0.5  # [m/s]: nobody is told to stand
WAVE = 4.5  # [m/s] upstream, see `without_model`


@dataclass(frozen=True, eq=False)
class Conditions:
    """What drives a simulated road; arrays over lanes, and over time every `BIN` seconds.

    Attributes:
      start, end: of the recording [s]; length: of the recorded stretch [m].
      time: middle of the bins [s], shape (n,).
      head, head_speed: where the recorded vehicle farthest ahead is [m], and its speed [m/s], shape
        (lanes, n).
      covered: share of the bins in which somebody was recorded, shape (lanes,); between them place
        and speed are interpolated.
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
          fixed: the boundary stands still instead, where the last fifth of the stretch begins, and
            its speed is the mean of who is recorded there, interpolated where nobody is.

        Raises:
          InputError: a lane has nobody with a leader.
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
                raise InputError(f"lane {lane}: nobody behind a leader was recorded")
            if fixed:
                first = mine.select(mine.station > EXIT_SHARE * length)
                if not len(first):
                    raise InputError(
                        f"lane {lane}: nobody was recorded on the last fifth of {length:.0f} m"
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
        """Length of the road before the stretch that holds a lane's column for a window [m]."""
        times = np.arange(begin - WARM_UP, end, BIN)
        driven = float(sum(self.speed_at(lane, float(time)) * BIN for time in times))
        return driven * RESERVE

    def column(
        self, lane: int, begin: float, end: float, drivers: Drivers, rng: np.random.Generator
    ) -> tuple[tuple[Departure, ...], list[IdmParameters]]:
        """The vehicles of a simulation of a window [s], all there at its beginning.

        Returns:
          The departures, and the driver of each.
        """
        departures, found = [], []
        # Only the boundary's speeds are used: what is upstream of it is to be found, not given.
        times = np.arange(begin - WARM_UP, begin, BIN)
        mean = float(np.mean([self.speed_at(lane, float(time)) for time in times]))
        # Half the speed: who is put on the road wants at least a second's distance there.
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
        """True for entries on the stretch for which nothing is prescribed, shape (n,)."""
        free = samples.station >= 0.0
        for lane in range(self.lanes):
            mine = samples.lane == lane
            free[mine] &= samples.station[mine] < self.head_at(lane, samples.time[mine])
        return np.asarray(free)

    def windows(self) -> list[tuple[float, float]]:
        """Beginnings and ends of the windows to simulate [s]."""
        count = max(1, round((self.end - self.start) / WINDOW))
        edges = np.linspace(self.start, self.end, count + 1).tolist()
        return list(itertools.pairwise(edges))


def compared(samples: FlowSamples, conditions: Conditions) -> FlowSamples:
    """The part of a flow that is compared: on the stretch, behind the boundary."""
    return samples.select(conditions.is_free(samples))


def without_model(samples: FlowSamples, conditions: Conditions) -> FlowSamples:
    """The entries with the speed that came upstream from the boundary as a wave, and no driver.

    Treiber and Kesting (2013), section 8.5: disturbances in congested traffic travel upstream at
    about 15 to 20 km/h, whatever the drivers. What this gets right a model cannot take credit for.
    """
    speed = np.empty(len(samples))
    for lane in range(conditions.lanes):
        mine = samples.lane == lane
        time = samples.time[mine]
        apart = conditions.head_at(lane, time) - samples.station[mine]
        speed[mine] = np.interp(time - apart / WAVE, conditions.time, conditions.head_speed[lane])
    return dataclasses.replace(samples, speed=speed)


def _foremost(samples: FlowSamples) -> FlowSamples:
    """The entry farthest ahead at each time, of samples of one lane."""
    order = np.lexsort((samples.station, samples.time))
    times = samples.time[order]
    last = np.append(np.diff(times) > 1e-6, True)
    keep = np.zeros(len(samples), dtype=bool)
    keep[order[last]] = True
    return samples.select(keep)


def _binned(time: FloatArray, values: FloatArray, edges: FloatArray) -> tuple[FloatArray, float]:
    """Means over bins, interpolated where there is no value, and the share of bins with one."""
    count, _ = np.histogram(time, edges)
    total, _ = np.histogram(time, edges, weights=values)
    middle = 0.5 * (edges[1:] + edges[:-1])
    known = count > 0
    return np.interp(middle, middle[known], total[known] / count[known]), float(known.mean())
