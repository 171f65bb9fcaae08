"""Summaries of a drive and of a served truck."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import Any

from controllers.emergency_braking import EmergencyReport, EmergencyState
from iits_mj.core.messages import LightState, PlanMode
from iits_mj.core.timing import CYCLE_PERIOD
from iits_mj.core.units import DIESEL_DENSITY
from iits_mj.simulation.frame import DriveFrame
from iits_mj.simulation.traffic_flow import FlowMeter, TrafficFlow

# Units that are appended to the names of the figures in JSON.
_UNITS = {
    "duration": "s",
    "first_red_light": "s",
    "distance": "m",
    "mean_speed": "mps",
    "max_speed": "mps",
    "last_speed": "mps",
    "impact_speed": "mps",
    "closest_gap": "m",
    "closest_box": "m",
    "fuel": "kg",
    "max_lateral_acceleration": "mps2",
    "max_articulation": "rad",
    "silent_time": "s",
    "worst_lateness": "s",
    "mean_lateness": "s",
    "slipped": "s",
}


def to_text(rows: Sequence[tuple[str, str]]) -> str:
    """Returns names and values as aligned plain text."""
    width = max(len(name) for name, _ in rows)
    return "\n".join(f"  {name.ljust(width)}  {value}" for name, value in rows)


def counts_text(counts: Mapping[str, int]) -> str:
    """Returns "3 x this, 2 x that" with the most frequent first, or "none"."""
    ordered = sorted(counts.items(), key=lambda item: (-item[1], item[0]))
    return ", ".join(f"{count} x {name}" for name, count in ordered if count) or "none"


def _with_units(values: Mapping[str, Any]) -> dict[str, Any]:
    """Returns figures with their units in the names; a number that is not finite becomes None."""
    return {
        f"{name}_{_UNITS[name]}" if name in _UNITS else name: (
            None if isinstance(value, float) and not math.isfinite(value) else value
        )
        for name, value in values.items()
    }


def _metres(value: float, otherwise: str) -> str:
    return f"{value:.2f} m" if math.isfinite(value) else otherwise


@dataclass(frozen=True, slots=True, kw_only=True)
class _Summary:
    """Figures that a drive and a served truck share, SI units.

    Attributes:
      ended: reason, in words; failed: whether this is a failure.
      duration: simulated time [s]; distance [m]; mean_speed, max_speed [m/s].
    """

    ended: str
    failed: bool
    duration: float
    distance: float
    mean_speed: float
    max_speed: float

    def rows(self) -> list[tuple[str, str]]:
        """Returns names and values with units, for tables."""
        raise NotImplementedError

    def to_text(self) -> str:
        """Returns the rows as aligned plain text."""
        return to_text(self.rows())

    def as_dict(self) -> dict[str, Any]:
        """Returns all figures for JSON, units in the names; None for a value that is not finite."""
        return _with_units(asdict(self))


@dataclass(slots=True)
class AebFigures:
    """What the emergency braking did in a drive, seen every 100 ms.

    Attributes:
      warnings, partial_brakings, brakings: number of times that each stage began.
      braking_time: in partial or emergency braking [s]; state: at the end.
    """

    warnings: int = 0
    partial_brakings: int = 0
    brakings: int = 0
    braking_time: float = 0.0
    state: str = EmergencyState.OFF.value

    def add(self, report: EmergencyReport) -> None:
        """Adds the report of one frame."""
        state = report.state
        if state.value != self.state:
            self.warnings += state is EmergencyState.WARNING
            self.partial_brakings += state is EmergencyState.PARTIAL
            self.brakings += state is EmergencyState.BRAKING
        self.braking_time += CYCLE_PERIOD * (report.demand < 0.0)
        self.state = state.value

    def to_text(self) -> str:
        """Returns the figures in words."""
        partly, fully = self.partial_brakings, self.brakings
        return f"{self.warnings} warnings, {partly} partial brakings, {fully} emergency brakings"


@dataclass(frozen=True, slots=True, kw_only=True)
class DriveSummary(_Summary):
    """Figures of one drive, SI units.

    Attributes:
      ended, duration, distance, mean_speed, max_speed: see `ServeSummary`.
      failed: True after a collision or a roll-over, or when the simulation diverged.
      collision: True when the truck touched another vehicle.
      impact_speed: magnitude of the difference of both velocities then [m/s], None without.
      lane_changes: completed; refused: requested and refused.
      aeb: what the emergency braking did, None without it.
      unsure_decisions: decisions that a learned policy left to a rule because it was unsure.
      red_lights_run: stop lines that the front bumper crossed at red; first_red_light: time of the
        first [s], None without one.
      emergency_brakings: number of emergency brakings of the planner.
      closest_gap: least bumper-to-bumper gap to the vehicle ahead in the lane [m], inf without one.
      closest_box: least distance of the truck's boxes to any other vehicle [m], inf without one.
      fuel [kg]; real_time_factor: simulated time over wall time, everything included.
      traffic: density, flow, speed and level of service of the traffic around the truck.
      max_lateral_acceleration [m/s2], max_articulation [rad]: greatest magnitudes.
      road_surface: cross slope and unevenness in words.
      warnings: MuJoCo's warnings that were raised, by name, and limits of the plant's validity that
        were exceeded, once each.
    """

    collision: bool
    lane_changes: int
    refused: int
    red_lights_run: int
    first_red_light: float | None
    emergency_brakings: int
    closest_gap: float
    closest_box: float
    fuel: float
    real_time_factor: float
    max_lateral_acceleration: float
    max_articulation: float
    road_surface: str = "smooth"
    traffic: TrafficFlow
    warnings: dict[str, int] = field(default_factory=dict)
    unsure_decisions: int = 0
    impact_speed: float | None = None
    aeb: AebFigures | None = None

    @property
    def fuel_per_100km(self) -> float:
        """Consumption [l/100 km]; nan before the first ten metres."""
        if self.distance < 10.0:
            return math.nan
        return self.fuel / DIESEL_DENSITY / (self.distance / 100e3)

    def rows(self) -> list[tuple[str, str]]:
        """Returns names and values with units, for tables."""
        per_100km = self.fuel_per_100km
        consumption = "" if math.isnan(per_100km) else f" ({per_100km:.1f} l/100 km)"
        red_lights = "none"
        if self.first_red_light is not None:
            red_lights = f"{self.red_lights_run}, the first at t = {self.first_red_light:.1f} s"
        unsure = f"{self.unsure_decisions} decisions, made by look-ahead"
        hit = self.impact_speed
        return [
            ("ended", self.ended),
            *([] if hit is None else [("impact speed", f"{hit:.2f} m/s ({hit * 3.6:.1f} km/h)")]),
            ("time", f"{self.duration:.1f} s"),
            ("distance", f"{self.distance / 1e3:z.3f} km"),
            ("mean speed", f"{self.mean_speed:z.2f} m/s ({self.mean_speed * 3.6:z.1f} km/h)"),
            ("lane changes", f"{self.lane_changes} completed, {self.refused} refused"),
            *([("policy unsure", unsure)] if self.unsure_decisions else []),
            ("red lights run", red_lights),
            ("emergency brakings", f"{self.emergency_brakings}"),
            *([("AEB", self.aeb.to_text())] if self.aeb is not None else []),
            ("closest gap ahead", _metres(self.closest_gap, "no vehicle was ahead in the lane")),
            ("closest vehicle", _metres(self.closest_box, "none nearby")),
            ("traffic", self.traffic.to_text()),
            ("fuel", f"{self.fuel:.2f} kg{consumption}"),
            ("largest lateral acceleration", f"{self.max_lateral_acceleration:.2f} m/s2"),
            ("largest articulation", f"{math.degrees(self.max_articulation):.2f} deg"),
            *([("road surface", self.road_surface)] if self.road_surface != "smooth" else []),
            ("real-time factor", f"{self.real_time_factor:.1f}"),
            ("engine warnings", counts_text(self.warnings)),
        ]

    def as_dict(self) -> dict[str, Any]:
        """Returns all figures for JSON, units in the names; None for a value that is not finite."""
        values = asdict(self) | {"fuel_per_100km_l": self.fuel_per_100km}
        del values["traffic"]
        aeb = values.pop("aeb")
        if aeb is not None:
            values["aeb"] = {"braking_time_s": aeb.pop("braking_time"), **aeb}
        traffic = {
            "traffic_density_per_km": 1e3 * self.traffic.density,
            "traffic_flow_per_hour": 3600.0 * self.traffic.flow,
            "traffic_speed_mps": self.traffic.speed,
            "level_of_service": self.traffic.level,
        }
        return _with_units(values | traffic)


@dataclass(slots=True)
class SummaryBuilder:
    """Collects the figures of a drive, frame by frame (every 100 ms)."""

    traffic: FlowMeter
    max_speed: float = 0.0
    closest_gap: float = math.inf
    closest_box: float = math.inf
    max_lateral_acceleration: float = 0.0
    max_articulation: float = 0.0
    red_lights: list[float] = field(default_factory=list)
    emergencies: int = 0
    aeb: AebFigures | None = None
    _front: float = math.inf
    _braking: bool = False

    def add(self, frame: DriveFrame) -> None:
        """Adds one frame."""
        ego = frame.ego
        self.traffic.add(frame)
        self._add_red_light(frame)
        braking = frame.trajectory.mode is PlanMode.EMERGENCY
        self.emergencies += braking and not self._braking
        self._braking = braking
        if frame.emergency is not None:
            self.aeb = self.aeb or AebFigures()
            self.aeb.add(frame.emergency)
        self.max_speed = max(self.max_speed, ego.speed)
        self.closest_gap = min(self.closest_gap, frame.gap_ahead)
        self.closest_box = min(self.closest_box, frame.box_distance)
        self.max_lateral_acceleration = max(
            self.max_lateral_acceleration, abs(ego.lateral_acceleration)
        )
        articulations = map(abs, (ego.articulation, *ego.rear_articulations))
        self.max_articulation = max(self.max_articulation, *articulations)

    def _add_red_light(self, frame: DriveFrame) -> None:
        """Counts a stop line that the front bumper has crossed at red since the last frame."""
        front = frame.ego.station + frame.scene.footprint.front_overhang
        light = frame.scene.signals.light
        red = light is not None and light.state is LightState.RED
        if light is not None and red and self._front <= light.station < front:
            self.red_lights.append(frame.time)
        self._front = front

    def build(
        self,
        last: DriveFrame,
        *,
        wall_time: float,
        ended: str,
        collision: bool,
        failed: bool,
        fuel: float,
        road_surface: str,
        warnings: dict[str, int],
        unsure_decisions: int,
        impact_speed: float | None = None,
    ) -> DriveSummary:
        """Returns the summary up to the frame `last`; `wall_time` in seconds, `fuel` in kg."""
        duration = last.time
        return DriveSummary(
            ended=ended,
            collision=collision,
            failed=failed,
            duration=duration,
            distance=last.distance,
            mean_speed=last.distance / duration if duration > 0.0 else 0.0,
            max_speed=self.max_speed,
            lane_changes=last.lane_changes,
            refused=last.refused,
            red_lights_run=len(self.red_lights),
            first_red_light=self.red_lights[0] if self.red_lights else None,
            emergency_brakings=self.emergencies,
            closest_gap=self.closest_gap,
            closest_box=self.closest_box,
            fuel=fuel,
            real_time_factor=duration / wall_time if wall_time > 0.0 else 0.0,
            max_lateral_acceleration=self.max_lateral_acceleration,
            max_articulation=self.max_articulation,
            road_surface=road_surface,
            traffic=self.traffic.flow,
            warnings=warnings,
            unsure_decisions=unsure_decisions,
            impact_speed=impact_speed,
            aeb=None if self.aeb is None else replace(self.aeb),
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class ServeSummary(_Summary):
    """Figures of a served truck, SI units.

    Attributes:
      ended: reason, in words.
      failed: True after a roll-over, off the road, or when the simulation diverged.
      duration: simulated time [s]; distance [m]; mean_speed, max_speed, last_speed [m/s].
      accepted: command frames obeyed, by message; rejected: invalid frames, by message and reason.
      passed_over: valid frames for another truck or from an unauthorized sender, likewise.
      lost: missing command frames, by message, counted by the counters of the others.
      silences: number of losses of the commands; silent_time: total duration [s].
      sent, received, dropped: frames of the bus; ignored: frames that are not J1939, by kind.
      requests: answered, refused and ignored, and claims contested.
      lost_addresses: of the truck's units, claimed by another node.
      bus_failures: number of losses of the bus; bus_restarts: of reopenings; bus_state: at the end.
      log_failure: why the log of the bus ends early, "" when it is complete.
      ticks: of 10 ms; late_ticks: more than half a tick behind the clock.
      worst_lateness, mean_lateness: of a tick [s].
      slips: number of times that the clock was set back; slipped: total time [s].
      processor_load: processor time over wall time.
      left_range: limits of the plant's validity that were exceeded.
    """

    last_speed: float
    accepted: dict[str, int]
    rejected: dict[str, int]
    passed_over: dict[str, int]
    lost: dict[str, int]
    silences: int
    silent_time: float
    sent: int
    received: int
    dropped: int
    ignored: dict[str, int]
    requests: dict[str, int]
    lost_addresses: list[int]
    bus_failures: int
    bus_restarts: int
    bus_state: str
    log_failure: str
    ticks: int
    late_ticks: int
    worst_lateness: float
    mean_lateness: float
    slips: int
    slipped: float
    processor_load: float
    left_range: tuple[str, ...] = ()

    def rows(self) -> list[tuple[str, str]]:
        """Returns names and values with units, for tables."""
        late = 100.0 * self.late_ticks / self.ticks if self.ticks else 0.0
        rows = [
            ("ended", self.ended),
            ("time", f"{self.duration:.2f} s"),
            ("distance", f"{self.distance / 1e3:z.3f} km"),
            (
                "speed",
                f"mean {self.mean_speed:z.2f} m/s, highest {self.max_speed:z.2f} m/s, last "
                f"{self.last_speed:z.2f} m/s",
            ),
            ("commands accepted", counts_text(self.accepted)),
            ("commands rejected", counts_text(self.rejected)),
            ("commands ignored", counts_text(self.passed_over)),
            ("commands missing", counts_text(self.lost)),
            ("commands lost", f"{self.silences} times, {self.silent_time:.2f} s in total"),
            ("frames", f"{self.sent} sent, {self.received} received, {self.dropped} dropped"),
            ("not J1939", counts_text(self.ignored)),
            ("requests", counts_text(self.requests)),
            ("addresses lost", ", ".join(f"0x{a:02X}" for a in self.lost_addresses) or "none"),
            (
                "bus",
                f"{self.bus_state}; lost {self.bus_failures} times, reopened "
                f"{self.bus_restarts} times",
            ),
            ("late ticks", f"{self.late_ticks} of {self.ticks} ({late:.2f} %)"),
            (
                "lateness",
                f"mean {1e3 * self.mean_lateness:.2f} ms, worst {1e3 * self.worst_lateness:.1f} ms",
            ),
            ("behind the clock", f"{1e3 * self.slipped:.0f} ms in {self.slips} slips"),
            ("processor load", f"{100.0 * self.processor_load:.0f} % of one core"),
        ]
        if self.log_failure:
            rows.append(("log", f"ends early: {self.log_failure}"))
        if self.left_range:
            rows.append(("plant not valid", "; ".join(self.left_range)))
        return rows
