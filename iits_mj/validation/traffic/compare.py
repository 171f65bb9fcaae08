"""Recorded and simulated flow: distances of their distributions, by lane and by density."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from iits_mj.core.errors import InputError
from iits_mj.core.results import Findings, Line, Panel, Results
from iits_mj.road import Route
from iits_mj.validation.traffic.conditions import (
    CLOSE,
    TYPE,
    WARM_UP,
    Conditions,
    Drivers,
    compared,
    without_model,
)
from iits_mj.validation.traffic.fit import Fit
from iits_mj.validation.traffic.flow import (
    FlowLog,
    FlowSamples,
    densities,
    kolmogorov_smirnov,
    levels,
    matched,
    wasserstein,
    weighted_mean,
)
from traffic_bridge.config import TrafficConfig
from traffic_bridge.datasets import Pair, Trajectories, pairs, read_trajectories
from traffic_bridge.modes.sumo_modes import PureSim
from traffic_bridge.vehicles.calibration import trimmed
from traffic_bridge.vehicles.idm import IdmParameters
from traffic_bridge.vehicles.types import VehicleType, default_types

RUN_OUT = 100.0  # [m] beyond the stretch
SAMPLE_PERIOD = 0.5  # [s] between samples of the simulated flow
SPEED_CAP = 40.0  # [m/s]: limit of the simulated road, above every desired speed
RESOLUTION = 0.05  # [m/s] of prescribed speeds
# A vehicle with a prescribed speed keeps a short distance, so that its leader does not limit it.
DRIVEN = {"time_headway": CLOSE, "acceleration": 2.0}
LANE_WIDTH = 3.66  # [m]
QUANTITIES = {"speed": "m/s", "spacing": "m", "time_headway": "s"}
SPEED_BOUND = "<= 1"  # [m/s] for calibrated traffic in the recorded conditions
QUICK_WINDOWS = 1


def entering_type(length: float) -> VehicleType:
    """Type of a vehicle until it is on the road and gets a driver."""
    return dataclasses.replace(
        default_types()[0],
        length=length,
        minimum_gap=0.5,
        time_headway=CLOSE,
        acceleration=1.5,
        deceleration=2.0,
    )


def drive(
    conditions: Conditions, drivers: Drivers, window: tuple[float, float], seed: int = 0
) -> FlowSamples:
    """Runs PureSim under recorded conditions, lane by lane.

    Args:
      conditions: of all lanes.
      drivers: draws the driver of each vehicle.
      window: beginning and end in the time of the recording [s].
      seed: of the drivers.

    Returns:
      The simulated flow at the recording's times, lanes and stations.
    """
    rng = np.random.default_rng(seed)
    parts = [
        _drive_lane(conditions, drivers, window, lane, rng) for lane in range(conditions.lanes)
    ]
    return FlowSamples.joined(parts)


def _drive_lane(
    conditions: Conditions,
    drivers: Drivers,
    window: tuple[float, float],
    lane: int,
    rng: np.random.Generator,
) -> FlowSamples:
    begin, end = window
    total = WARM_UP + end - begin
    before = conditions.lead_in(lane, begin, end)
    route = Route.straight(
        before + conditions.length + RUN_OUT, 1, lane_width=LANE_WIDTH, speed_limit=SPEED_CAP
    )
    departures, found = conditions.column(lane, begin, end, drivers, rng)
    config = TrafficConfig(
        density="empty",
        speed_limit=SPEED_CAP,
        lane_change_duration=0.0,
        types=(entering_type(conditions.vehicle_length),),
        mix=((TYPE, 1.0),),
        departures=departures,
    )
    log = FlowLog()
    prescribed: dict[str, float] = {}  # speed of each vehicle, inf when it has a driver
    with PureSim(route, config) as traffic:
        frame = traffic.reset()
        stride = round(SAMPLE_PERIOD / config.step_length)
        for step in range(round(total / config.step_length) + 1):
            if step % stride == 0:
                time = traffic.time - WARM_UP + begin
                speed = conditions.speed_at(lane, time)
                station = frame.column("station") + 0.5 * frame.column("length") - before
                free = station < conditions.head_at(lane, time)
                for i, name in enumerate(frame.ids):
                    if free[i]:
                        if prescribed.get(name) != math.inf:
                            prescribed[name] = math.inf
                            # The names of vehicles end with their place in the list.
                            driver = found[int(name.rpartition(".d")[2])]
                            traffic.vehicles.change(name, **dataclasses.asdict(driver))
                    elif abs(prescribed.get(name, math.inf) - speed) > RESOLUTION:
                        prescribed[name] = speed
                        traffic.vehicles.change(name, desired_speed=speed, **DRIVEN)
                if time >= begin:
                    log.add(time, frame, before)
            frame = traffic.step()
    samples = log.samples
    return dataclasses.replace(
        samples,
        station=samples.station - before,
        lane=np.full(len(samples), lane, dtype=np.int64),
    )


@dataclass(frozen=True)
class RecordedFlow:
    """A recorded set with its pairs, its flow (stations from zero on) and its conditions.

    Attributes:
      data: as read; found: pairs; flow: of the followers.
      conditions: with the vehicle farthest ahead as boundary; fixed: with a fixed boundary, None
        if the set lacks the speeds for it.
    """

    data: Trajectories
    found: Sequence[Pair]
    flow: FlowSamples
    conditions: Conditions
    fixed: Conditions | None

    @classmethod
    def read(cls, path: Path) -> RecordedFlow:
        """Reads a set.

        Raises:
          InputError: the set cannot be read, has no pairs, or gives no conditions.
        """
        data = read_trajectories(path)
        found = trimmed(pairs(data))
        flow, others = FlowSamples.of_pairs(found), FlowSamples.of_leaders(found)
        begin = float(min(flow.station.min(), others.station.min()))
        flow, others = flow.moved(-begin), others.moved(-begin)
        length = float(np.mean(data.length))
        conditions = Conditions.of(flow, others, length)
        try:
            fixed = Conditions.of(flow, others, length, fixed=True)
        except InputError:
            fixed = None
        return cls(data, found, flow, conditions, fixed)


def compare_flows(results: Results, recorded: RecordedFlow, fit: Fit, quick: bool) -> None:
    """Simulates the recorded conditions with three kinds of drivers, and adds the distances."""
    conditions = recorded.conditions
    windows = conditions.windows()[: QUICK_WINDOWS if quick else None]
    reference = compared(recorded.flow, conditions)
    by_lane: dict[int, list[IdmParameters]] = {}
    for entry, pair in zip(fit.headways, fit.fitted, strict=True):
        by_lane.setdefault(pair.lane, []).append(entry.parameters)

    def own(lane: int, rng: np.random.Generator) -> IdmParameters:
        choices = by_lane.get(lane) or [entry.parameters for entry in fit.headways]
        return choices[int(rng.integers(len(choices)))]

    drivers: dict[str, Drivers] = {
        "default": lambda _lane, _rng: fit.default,
        "calibrated": lambda _lane, _rng: fit.common.parameters,
        "own headways": own,
    }
    flows = {name: _driven(conditions, who, windows) for name, who in drivers.items()}
    cells = levels(reference)
    for name, flow in flows.items():
        # One window is too short for the bound.
        bound = SPEED_BOUND if name == "calibrated" and not quick else ""
        found = Findings()
        ours, theirs = matched(reference, flow)
        _check_distances(found, f"{name}, all", ours, theirs, bound)
        _check_lanes(found, name, ours, theirs, conditions)
        for level, members in cells.items():
            a, b = (part.select(np.isin(part.cells(), members)) for part in (ours, theirs))
            _check_distances(found, f"{name}, {level}", a, b)
        results.add("", found)
    for quantity, unit in QUANTITIES.items():
        results.figures[quantity] = _panels(quantity, unit, reference, flows, cells)
    _other_boundaries(results, recorded, drivers["calibrated"], flows["calibrated"], windows)
    covered = ", ".join(f"{100.0 * share:.0f} %" for share in conditions.covered)
    results.notes.append(
        f"a vehicle was recorded in {covered} of the time, by lane from the right; in between "
        "place and speed of the boundary are interpolated"
    )
    density = ", ".join(f"{name} {k:.0f}" for name, k in densities(reference, cells).items())
    results.notes.append(
        f"the levels are thirds of this recording; vehicles per km and lane: {density}"
    )


def _driven(
    conditions: Conditions, drivers: Drivers, windows: list[tuple[float, float]]
) -> FlowSamples:
    """The simulated flow of all windows, to compare."""
    parts = [drive(conditions, drivers, window) for window in windows]
    return compared(FlowSamples.joined(parts), conditions)


def _check_lanes(
    found: Findings, name: str, ours: FlowSamples, theirs: FlowSamples, conditions: Conditions
) -> None:
    """Flow and speed of each lane, and the mean distance of the lanes."""
    single = []
    for lane in range(conditions.lanes):
        mine = theirs.select((theirs.lane == lane) & np.isfinite(theirs.spacing))
        if not len(mine):
            continue
        flow = weighted_mean(mine, "speed") / weighted_mean(mine, "spacing")
        recorded = 3600.0 * float(conditions.flow[lane])
        found.check(f"{name}, lane {lane}: flow", 3600.0 * flow, "1/h", recorded)
        a, b = (part.select(part.lane == lane) for part in (ours, theirs))
        _check_distances(found, f"{name}, lane {lane}", a, b, quantities=("speed",))
        single.append((len(a), wasserstein(a, b)))
    if single:
        counts, distances = zip(*single, strict=True)
        mean = np.average(distances, weights=counts)
        found.check(f"{name}, mean of the lanes: speed, Wasserstein", mean, "m/s")


def _other_boundaries(
    results: Results,
    recorded: RecordedFlow,
    drivers: Drivers,
    flow: FlowSamples,
    windows: list[tuple[float, float]],
) -> None:
    """Distances of a flow without a model, and with the less faithful fixed boundary."""
    conditions, fixed, found = recorded.conditions, recorded.fixed, Findings()
    ours, _ = matched(compared(recorded.flow, conditions), flow)
    label = "no model, only the boundary's speed as a wave, all: speed, Wasserstein"
    found.check(label, wasserstein(ours, without_model(ours, conditions)), "m/s")
    if fixed is not None:
        ours, theirs = matched(compared(recorded.flow, fixed), _driven(fixed, drivers, windows))
        label = "calibrated, boundary at the exit, all"
        _check_distances(found, label, ours, theirs, quantities=("speed",))
    results.add("", found)


def _check_distances(
    found: Findings,
    name: str,
    ours: FlowSamples,
    theirs: FlowSamples,
    bound: str = "",
    quantities: Iterable[str] = tuple(QUANTITIES),
) -> None:
    """Distances of the distributions of some quantities; the bound is that of the speed."""
    if not (len(ours) and len(theirs)):
        return
    for quantity in quantities:
        unit, label = QUANTITIES[quantity], f"{name}: {quantity.replace('_', ' ')}"
        must = bound if quantity == "speed" else ""
        distance = wasserstein(ours, theirs, quantity)
        found.check(f"{label}, Wasserstein", distance, unit, must=must)
        gap = kolmogorov_smirnov(ours, theirs, quantity)
        found.check(f"{label}, Kolmogorov-Smirnov", gap, "1")
        reference = weighted_mean(ours, quantity)
        found.check(f"{label}, mean", weighted_mean(theirs, quantity), unit, reference)


def _panels(
    quantity: str,
    unit: str,
    reference: FlowSamples,
    flows: dict[str, FlowSamples],
    cells: dict[str, np.ndarray],
) -> list[Panel]:
    """Probability densities of each level: recorded and simulated."""
    values = reference.quantity(quantity)
    top = float(np.nanpercentile(values, 99.5)) * 1.15
    edges = np.linspace(0.0, top, 41)
    middle = 0.5 * (edges[1:] + edges[:-1])
    panels = []
    for level, members in cells.items():
        lines = []
        for name, flow in ({"recorded": reference} | flows).items():
            ours, theirs = matched(reference, flow)
            part = ours if name == "recorded" else theirs
            part = part.select(np.isin(part.cells(), members))
            known = np.isfinite(part.quantity(quantity))
            if not known.any():
                continue
            share, _ = np.histogram(
                part.quantity(quantity)[known], edges, weights=part.weight[known], density=True
            )
            role = {"recorded": "reference", "calibrated": "simulation"}.get(name, "")
            lines.append(Line(name, middle, share, role))
        title = f"{level.capitalize()} traffic"
        x_label = f"{quantity.replace('_', ' ')} [{unit}]"
        panels.append(Panel(title, x_label, "density of probability", tuple(lines)))
    return panels
