"""Traffic flow: samples of speed and headway, lane changes, and distances of distributions."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from iits_mj.core.arrays import FloatArray
from iits_mj.core.errors import InputError
from iits_mj.core.vehicles import VehicleFrame
from traffic_bridge.datasets import Pair, Trajectories

LEVELS = ("dense", "medium", "sparse")
CELL_TIME, CELL_LENGTH = 10.0, 50.0  # [s], [m]: cells in which two flows are compared
STANDING = 0.5  # [m/s] below which a time headway has no meaning


@dataclass(frozen=True, eq=False)
class FlowSamples:
    """Vehicles at places and times, as arrays of shape (n,).

    Attributes:
      time: [s]; lane: index from the outside; station: of the front bumper [m].
      speed: [m/s].
      spacing: front bumper to the leader's front bumper [m], NaN without one.
      weight: of the entry in a distribution.
    """

    time: FloatArray
    lane: NDArray[np.int64]
    station: FloatArray
    speed: FloatArray
    spacing: FloatArray
    weight: FloatArray

    def __len__(self) -> int:
        """Number of entries."""
        return len(self.time)

    @property
    def time_headway(self) -> FloatArray:
        """Spacing over speed [s]; NaN without a leader and for a standing vehicle."""
        moving = np.where(self.speed > STANDING, self.speed, np.nan)
        return np.asarray(self.spacing / moving)

    def quantity(self, name: str) -> FloatArray:
        """One of `speed`, `spacing` and `time_headway`, shape (n,)."""
        return np.asarray(getattr(self, name), dtype=float)

    def select(self, keep: NDArray[np.bool_]) -> FlowSamples:
        """The entries of a mask of shape (n,)."""
        return self.reweighted(self.weight, keep)

    def moved(self, distance: float) -> FlowSamples:
        """The flow with its stations moved by a distance [m]."""
        return dataclasses.replace(self, station=self.station + distance)

    def reweighted(self, weight: FloatArray, keep: NDArray[np.bool_]) -> FlowSamples:
        """The entries of a mask, with other weights, both of shape (n,)."""
        columns = vars(self) | {"weight": weight}
        return FlowSamples(**{name: values[keep] for name, values in columns.items()})

    @classmethod
    def joined(cls, parts: Sequence[FlowSamples]) -> FlowSamples:
        """All entries of several flows."""
        names = [entry.name for entry in dataclasses.fields(cls)]
        return cls(*(np.concatenate([getattr(part, name) for part in parts]) for name in names))

    def cells(self) -> NDArray[np.int64]:
        """Number of the cell of lane, time and place of each entry, shape (n,)."""
        place = np.floor(self.station / CELL_LENGTH).astype(np.int64) + 10_000
        instant = np.floor(self.time / CELL_TIME).astype(np.int64) + 100_000
        return (self.lane * 1_000_000 + instant) * 100_000 + place

    @classmethod
    def of_pairs(cls, pairs: Sequence[Pair]) -> FlowSamples:
        """The followers of recorded pairs.

        Raises:
          InputError: there are none.
        """
        if not pairs:
            raise InputError("no leader-follower pair in the data")
        spacing = np.concatenate([pair.gap + pair.leader_length for pair in pairs])
        return cls._joined_pairs(pairs, "station", "speed", spacing)

    @classmethod
    def of_leaders(cls, pairs: Sequence[Pair]) -> FlowSamples:
        """The leaders of recorded pairs, without spacing; a leader of two pairs occurs twice."""
        spacing = np.full(sum(len(pair.time) for pair in pairs), np.nan)
        return cls._joined_pairs(pairs, "leader_station", "leader_speed", spacing)

    @classmethod
    def _joined_pairs(
        cls, pairs: Sequence[Pair], station: str, speed: str, spacing: FloatArray
    ) -> FlowSamples:
        return cls(
            np.concatenate([pair.time for pair in pairs]),
            np.concatenate([np.full(len(pair.time), pair.lane, dtype=np.int64) for pair in pairs]),
            np.concatenate([getattr(pair, station) for pair in pairs]),
            np.concatenate([getattr(pair, speed) for pair in pairs]),
            spacing,
            np.ones(len(spacing)),
        )


@dataclass(slots=True)
class FlowLog:
    """Collects samples of running traffic and counts its lane changes.

    Attributes:
      distance: driven by all vehicles [m].
      lane_changes: changes between lanes of the route.
    """

    distance: float = 0.0
    lane_changes: int = 0
    _parts: list[tuple[FloatArray, ...]] = field(default_factory=list)
    _lanes: dict[str, int] = field(default_factory=dict)
    _time: float = 0.0

    def add(self, time: float, frame: VehicleFrame, begin: float = -math.inf) -> None:
        """Adds the vehicles on the route at a time [s], beyond a station [m]."""
        on_route = (frame.lanes >= 0) & (frame.column("station") >= begin)
        lane = np.asarray(frame.lanes, dtype=float)[on_route]
        length, speed = frame.column("length")[on_route], frame.column("speed")[on_route]
        front = frame.column("station")[on_route] + 0.5 * length
        order = np.lexsort((front, lane))
        lane, front, speed = lane[order], front[order], speed[order]
        spacing = np.full(len(lane), np.nan)
        if len(lane) > 1:
            spacing[:-1] = np.where(np.diff(lane) == 0, np.diff(front), np.nan)
        self._parts.append((np.full(len(lane), time), lane, front, speed, spacing))
        now = {frame.ids[i]: int(frame.lanes[i]) for i in np.flatnonzero(on_route)}
        both = [(lane, self._lanes[name]) for name, lane in now.items() if name in self._lanes]
        self.lane_changes += sum(a != b for a, b in both)
        if self._lanes:
            self.distance += float(speed.sum()) * (time - self._time)
        self._lanes, self._time = now, time

    @property
    def samples(self) -> FlowSamples:
        """All samples so far."""
        time, lane, station, speed, spacing = (
            np.concatenate(column) if column else np.zeros(0)
            for column in (zip(*self._parts, strict=True) if self._parts else ((),) * 5)
        )
        return FlowSamples(time, lane.astype(np.int64), station, speed, spacing, np.ones(len(time)))

    @property
    def lane_change_rate(self) -> float:
        """Lane changes per vehicle and kilometer; NaN without a distance."""
        return self.lane_changes / (self.distance / 1e3) if self.distance > 0.0 else float("nan")


def lane_change_rate(data: Trajectories) -> tuple[int, float]:
    """Lane changes of a recorded set, and its vehicle kilometers."""
    same = np.diff(data.vehicle) == 0
    changes = int((same & (np.diff(data.lane) != 0)).sum())
    driven = float(np.where(same, np.maximum(np.diff(data.station), 0.0), 0.0).sum())
    return changes, driven / 1e3


def matched(recorded: FlowSamples, simulated: FlowSamples) -> tuple[FlowSamples, FlowSamples]:
    """Both flows in their common cells of lane, 10 s and 50 m.

    The total weight of the simulated entries of a cell is that of the recorded entries, so that the
    distributions belong to the same times and places.
    """
    ours, theirs = recorded.cells(), simulated.cells()
    cells, counts = np.unique(theirs, return_counts=True)
    keep = np.isin(ours, cells)
    known, recorded_counts = np.unique(ours[keep], return_counts=True)
    use = np.isin(theirs, known)
    per_cell = dict(zip(cells.tolist(), counts.tolist(), strict=True))
    wanted = dict(zip(known.tolist(), recorded_counts.tolist(), strict=True))
    weight = np.array([wanted.get(cell, 0) / per_cell[cell] for cell in theirs.tolist()])
    return recorded.select(keep), simulated.reweighted(weight, use)


def levels(recorded: FlowSamples) -> dict[str, NDArray[np.int64]]:
    """Divides a recorded flow by its local density into three levels with equal numbers of entries.

    The density of a cell of lane, 10 s and 50 m is the inverse of the mean spacing in it.

    Returns:
      The cells of each level.
    """
    known = np.isfinite(recorded.spacing)
    cells, inverse = np.unique(recorded.cells()[known], return_inverse=True)
    count = np.bincount(inverse)
    density = count / np.bincount(inverse, weights=recorded.spacing[known])
    order = np.argsort(-density, kind="stable")
    share = np.cumsum(count[order]) / count.sum()
    level = np.minimum(np.searchsorted((1.0 / 3.0, 2.0 / 3.0), share, side="left"), 2)
    return {name: np.sort(cells[order[level == i]]) for i, name in enumerate(LEVELS)}


def densities(recorded: FlowSamples, cells: dict[str, NDArray[np.int64]]) -> dict[str, float]:
    """Mean density of each level [vehicles per kilometer and lane]."""
    return {
        name: 1e3 / weighted_mean(recorded.select(np.isin(recorded.cells(), members)), "spacing")
        for name, members in cells.items()
    }


def wasserstein(a: FlowSamples, b: FlowSamples, name: str = "speed") -> float:
    """Wasserstein distance of order one between two distributions, in the quantity's unit."""
    from scipy.stats import wasserstein_distance

    (x, u), (y, w) = _finite(a, name), _finite(b, name)
    return float(wasserstein_distance(x, y, u, w))


def kolmogorov_smirnov(a: FlowSamples, b: FlowSamples, name: str = "speed") -> float:
    """Greatest difference between two weighted distribution functions, 0 to 1."""
    (x, u), (y, w) = _finite(a, name), _finite(b, name)
    places = np.unique(np.concatenate([x, y]))
    return float(np.abs(distribution(x, u, places) - distribution(y, w, places)).max())


def distribution(values: FloatArray, weights: FloatArray, places: FloatArray) -> FloatArray:
    """Weighted share of values at or below each place, shape of `places`."""
    order = np.argsort(values)
    total = np.concatenate([[0.0], np.cumsum(weights[order])])
    return np.asarray(total[np.searchsorted(values[order], places, side="right")] / total[-1])


def weighted_mean(samples: FlowSamples, name: str) -> float:
    """Weighted mean of a quantity."""
    values, weights = _finite(samples, name)
    return float(np.average(values, weights=weights))


def _finite(samples: FlowSamples, name: str) -> tuple[FloatArray, FloatArray]:
    """Known values of a quantity, and their weights."""
    values = samples.quantity(name)
    known = np.isfinite(values) & (samples.weight > 0.0)
    if not known.any():
        raise InputError(f"no {name} to compare: the flow has no vehicle with one")
    return values[known], samples.weight[known]
