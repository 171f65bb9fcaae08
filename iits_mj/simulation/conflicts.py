"""Measures of traffic conflicts between the truck and the vehicles of scripted events."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from iits_mj.core.results import Line, Panel
from iits_mj.simulation.frame import DriveFrame
from iits_mj.simulation.lock_step import LockStep, Observer
from iits_mj.simulation.loop import Simulation
from traffic_bridge import EventRecord
from traffic_bridge.scenario.conditions import (
    Body,
    Situation,
    gap,
    time_gap,
    time_to_collision,
)

# Of the safe distance; our choice for a laden truck behind a car: response time [s], greatest
# acceleration during it, the truck's sure braking and the car's hardest braking [m/s2].
RESPONSE, SPEEDING_UP, SURE_BRAKING, HARDEST_BRAKING = 0.5, 0.5, 4.0, 8.0
# Greater times are not drawn [s], nor distances [m].
TIME_SHOWN, DISTANCE_SHOWN = 20.0, 150.0


def required_deceleration(behind: Body, ahead: Body) -> float:
    """Deceleration rate to avoid a crash (DRAC) [m/s2]: closing speed squared over twice the gap.

    It is constant, and brings the vehicle behind to the speed of the one ahead when they would
    touch. 0 where they do not close in, inf without a gap.
    """
    closing, distance = behind.pace - ahead.pace, gap(behind, ahead)
    if closing <= 0.0:
        return 0.0
    return 0.5 * closing**2 / distance if distance > 0.0 else math.inf


def rss_distance(speed: float, ahead: float) -> float:
    """Safe longitudinal distance of the truck at a speed behind a vehicle at another [m].

    Shalev-Shwartz, Shammah and Shashua, "On a formal model of safe and scalable self-driving cars",
    arXiv 1708.06374 (2017), definition 1.
    """
    after = speed + RESPONSE * SPEEDING_UP
    way = RESPONSE * speed + 0.5 * SPEEDING_UP * RESPONSE**2 + after**2 / (2.0 * SURE_BRAKING)
    return max(way - ahead**2 / (2.0 * HARDEST_BRAKING), 0.0)


@dataclass(frozen=True, slots=True)
class Conflict:
    """The closest the truck came to one road user of an event.

    All but the last are while the body is ahead of the truck and reaches into its width.

    Attributes:
      actor: id; gap: least [m]; time_gap: least [s]; ttc: least time to collision [s].
      drac: greatest deceleration rate to avoid a crash [m/s2].
      rss_margin: least gap minus safe distance [m].
      pet: post-encroachment time [s]: from the moment at which the first of the two leaves the
        stretch of road where the road user enters the truck's width, to the arrival of the second;
        nan if only one of them was there.
    """

    actor: str
    gap: float = math.inf
    time_gap: float = math.inf
    ttc: float = math.inf
    drac: float = 0.0
    rss_margin: float = math.inf
    pet: float = math.nan

    def as_dict(self) -> dict[str, Any]:
        """Returns the figures with units in their names; None for one that is not finite."""
        units = {"gap": "m", "time_gap": "s", "ttc": "s", "drac": "mps2", "pet": "s"}
        units["rss_margin"] = "m"
        values = asdict(self)
        return {"actor": values.pop("actor")} | {
            f"{name}_{units[name]}": value if math.isfinite(value) else None
            for name, value in values.items()
        }


@dataclass(slots=True)
class _Track:
    """Time [s], ends of a road user and of the truck [m], and whether it is in the truck's way."""

    rows: list[tuple[float, float, float, float, float, bool]]
    worst: Conflict


class ConflictLog(Observer):
    """Observer that measures the conflicts with the vehicles of events, every 100 ms.

    Attributes:
      records: events that have begun; deceleration: the truck's greatest so far [m/s2].
    """

    def __init__(self) -> None:
        self._tracks: dict[str, _Track] = {}
        self._time: list[float] = []
        # Gap [m], time gap [s], TTC [s], DRAC [m/s2] and RSS margin [m] to the body ahead.
        self._ahead: list[tuple[float, ...]] = []
        self.records: tuple[EventRecord, ...] = ()
        self.deceleration = 0.0

    def observe(self, simulation: LockStep, frame: DriveFrame) -> None:
        """Adds one instant."""
        assert isinstance(simulation, Simulation)
        self.records = simulation.events
        self.deceleration = max(self.deceleration, -frame.ego.acceleration)
        scene = frame.scene
        now = Situation(
            frame.time, simulation.route, scene.footprint, frame.ego, simulation.vehicles
        )
        truck, bodies = now.truck, now.bodies
        assert truck is not None
        ways = {name: _in_way(truck, body) for name, body in bodies.items()}
        ahead = [b for b in bodies.values() if ways[b.name] and b.front > truck.front]
        self._time.append(frame.time)
        nearest = min(ahead, key=lambda b: (gap(truck, b), b.name), default=None)
        self._ahead.append((math.nan,) * 5 if nearest is None else _figures(truck, nearest))
        for name in {record.actor for record in self.records if record.actor in bodies}:
            body, way = bodies[name], ways[name]
            track = self._tracks.setdefault(name, _Track([], Conflict(name)))
            track.rows.append((frame.time, body.front, body.rear, truck.front, truck.rear, way))
            if way and body.front > truck.front:
                distance, headway, ttc, drac, margin = _figures(truck, body)
                worst = track.worst
                track.worst = Conflict(
                    name,
                    min(worst.gap, distance),
                    min(worst.time_gap, headway),
                    min(worst.ttc, ttc),
                    max(worst.drac, drac),
                    min(worst.rss_margin, margin),
                )

    def conflicts(self) -> list[Conflict]:
        """Returns the conflict with each road user of an event, in the order of their events."""
        order = {record.actor: k for k, record in reversed(list(enumerate(self.records)))}
        found = []
        for name in sorted(self._tracks, key=lambda name: order.get(name, 0)):
            worst, rows = self._tracks[name].worst, self._tracks[name].rows
            found.append(
                Conflict(
                    **(asdict(worst) | {"pet": post_encroachment_time(np.array(rows, dtype=float))})
                )
            )
        return found

    def panels(self, axis: str) -> list[Panel]:
        """Returns plots of the measures to the body ahead over time, with the events marked.

        Args:
          axis: label of the time axis.
        """
        time = np.array(self._time)
        distance, headway, ttc, drac, margin = np.array(self._ahead, dtype=float).reshape(-1, 5).T
        times = (("time gap", headway, "second"), ("time to collision", ttc, "simulation"))
        return [
            self._panel("Times to the vehicle ahead", "time [s]", axis, time, times, TIME_SHOWN),
            self._panel(
                "Deceleration rate to avoid a crash",
                "deceleration [m/s²]",
                axis,
                time,
                (("DRAC", drac, "simulation"),),
                20.0,
            ),
            self._panel(
                "Distance to the vehicle ahead",
                "distance [m]",
                axis,
                time,
                (("gap", distance, "second"), ("margin of the RSS distance", margin, "simulation")),
                DISTANCE_SHOWN,
            ),
        ]

    def _panel(
        self,
        title: str,
        label: str,
        axis: str,
        time: np.ndarray,
        lines: Sequence[tuple[str, np.ndarray, str]],
        most: float,
    ) -> Panel:
        drawn = []
        for name, values, role in lines:
            shown = np.where(np.abs(values) <= most, values, np.nan)
            drawn.append(Line(name, time, shown, role))
        finite = np.concatenate([line.y[np.isfinite(line.y)] for line in drawn])
        low, high = (min(finite.min(), 0.0), finite.max()) if len(finite) else (0.0, 1.0)
        for record in self.records:
            at = np.full(2, record.begun)
            drawn.append(Line(record.event.title, at, np.array([low, high]), "mark"))
        return Panel(title, axis, label, tuple(drawn))

    def tables(self) -> tuple[list[tuple[str, ...]], list[tuple[str, ...]]]:
        """Returns the rows of the events, and of the conflicts, as text."""
        events: list[tuple[str, ...]] = [
            (
                record.event.title,
                record.event.kind,
                record.actor or "-",
                f"{record.begun:.1f} s",
                "-" if record.ended is None else f"{record.ended:.1f} s",
            )
            for record in self.records
        ]
        conflicts = [
            (
                c.actor,
                *(
                    f"{value:.2f} {unit}" if math.isfinite(value) else "-"
                    for value, unit in (
                        *((c.gap, "m"), (c.time_gap, "s"), (c.ttc, "s"), (c.drac, "m/s²")),
                        *((c.rss_margin, "m"), (c.pet, "s")),
                    )
                ),
            )
            for c in self.conflicts()
        ]
        return events, conflicts

    def rows(self) -> list[tuple[str, str]]:
        """Returns name and value of the figures of the drive's summary."""
        begun = ", ".join(f"{r.event.title} {r.begun:.1f} s" for r in self.records)
        rows = [("events", begun or "none began")]
        for c in self.conflicts():
            values = [f"gap {c.gap:.1f} m, time gap {c.time_gap:.2f} s, TTC {c.ttc:.1f} s"]
            values += [f"DRAC {c.drac:.2f} m/s2"]
            text = ", ".join(values) if math.isfinite(c.gap) else "never ahead in the truck's way"
            if math.isfinite(c.pet):
                text += f", PET {c.pet:.2f} s"
            rows.append((f"conflict with {c.actor}", text))
        return [*rows, ("greatest deceleration", f"{self.deceleration:.2f} m/s2")]

    def as_dict(self) -> dict[str, Any]:
        """Returns the events and conflicts for JSON, units in the names."""
        return {
            "events": [
                {
                    "name": record.event.title,
                    "event": record.event.kind,
                    "actor": record.actor,
                    "begun_s": record.begun,
                    "ended_s": record.ended,
                }
                for record in self.records
            ],
            "conflicts": [conflict.as_dict() for conflict in self.conflicts()],
            "greatest_deceleration_mps2": self.deceleration,
        }


EVENT_HEADER = ("event", "kind", "road user", "begins", "ends")
MEASURES = (
    "All but the last are while the road user is ahead of the truck and reaches into its width. "
    "DRAC is the constant deceleration that avoids a crash. The RSS margin is the gap minus the "
    f"safe distance of a truck that responds within {RESPONSE:g} s and then brakes with "
    f"{SURE_BRAKING:g} m/s² behind a vehicle that brakes with {HARDEST_BRAKING:g} m/s²."
)
CONFLICT_HEADER = (
    *("road user", "least gap", "least time gap", "least time to collision"),
    *("greatest DRAC", "least RSS margin", "post-encroachment time"),
)


def _in_way(truck: Body, body: Body) -> bool:
    """Whether a body reaches into the width of the truck's body."""
    return abs(body.offset - truck.offset) < 0.5 * (body.width + truck.width)


def _figures(truck: Body, body: Body) -> tuple[float, float, float, float, float]:
    distance = gap(truck, body)
    margin = distance - rss_distance(truck.pace, max(body.pace, 0.0))
    return (
        distance,
        time_gap(truck, body),
        time_to_collision(truck, body),
        required_deceleration(truck, body),
        margin,
    )


def post_encroachment_time(rows: np.ndarray) -> float:
    """Post-encroachment time of one road user and the truck [s]; nan if only one was there.

    B. L. Allen, B. T. Shin and P. J. Cooper, "Analysis of traffic conflicts and collisions",
    Transportation Research Record 667 (1978).

    Args:
      rows: time [s], front and rear of the road user, front and rear of the truck [m], and whether
        the road user reaches into the truck's width, shape (n, 6).
    """
    time, front, rear, truck_front, truck_rear, inside = rows.T
    if not inside.any():
        return math.nan
    first = int(np.argmax(inside > 0.0))
    low, high = rear[first], front[first]
    if truck_rear[first] > high:  # the truck was there before
        return float(time[first] - _crossing(time, truck_rear, high))
    if truck_front[first] >= low:
        return 0.0
    away = np.flatnonzero((inside[first:] == 0.0) | (rear[first:] > high))
    arrival = _crossing(time, truck_front, low)
    if not len(away) or math.isnan(arrival):
        return math.nan
    left = first + int(away[0])
    leaves = _crossing(time, rear, high) if rear[left] > high else float(time[left])
    return max(arrival - leaves, 0.0)


def _crossing(time: np.ndarray, station: np.ndarray, place: float) -> float:
    """Time at which a rising station first reaches a place; nan if it does not."""
    above = np.flatnonzero(station >= place)
    if not len(above):
        return math.nan
    k = int(above[0])
    if k == 0:
        return float(time[0])
    share = (place - station[k - 1]) / (station[k] - station[k - 1])
    return float(time[k - 1] + share * (time[k] - time[k - 1]))
