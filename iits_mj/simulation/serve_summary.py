"""What serving came to: the drive, what was obeyed and what was not, the clock and the bus."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

from iits_mj.simulation.summary import to_text


@dataclass(frozen=True, slots=True)
class ServeSummary:
    """Figures of a served truck, SI units.

    Attributes:
      ended: why, in words.
      duration: simulated time [s]; distance [m]; mean_speed, max_speed, last_speed [m/s].
      accepted: command frames obeyed, by message; rejected: unsound ones, by message and reason.
      passed_over: sound ones that were not for this truck or not from who may command, likewise.
      silences: how often commands were lost; silent_time: for how long in all [s].
      sent, received, dropped: frames of the bus; ignored: what is no J1939 frame, by kind.
      requests: answered, refused and ignored, and claims contested.
      bus_failures: how often the bus was lost; bus_restarts: opened again; bus_state: at the end.
      ticks: of 10 ms; late_ticks: more than half a tick behind the clock.
      worst_lateness, mean_lateness: of a tick [s].
      slips, slipped: how often simulated time fell behind the clock for good, by how much [s].
      processor_load: processor time over wall time.
    """

    ended: str
    duration: float
    distance: float
    mean_speed: float
    max_speed: float
    last_speed: float
    accepted: dict[str, int]
    rejected: dict[str, int]
    passed_over: dict[str, int]
    silences: int
    silent_time: float
    sent: int
    received: int
    dropped: int
    ignored: dict[str, int]
    requests: dict[str, int]
    bus_failures: int
    bus_restarts: int
    bus_state: str
    ticks: int
    late_ticks: int
    worst_lateness: float
    mean_lateness: float
    slips: int
    slipped: float
    processor_load: float

    def rows(self) -> list[tuple[str, str]]:
        """Name and value with its unit, for tables that people read."""
        late = 100.0 * self.late_ticks / self.ticks if self.ticks else 0.0
        return [
            ("ended", self.ended),
            ("time", f"{self.duration:.2f} s"),
            ("distance", f"{max(self.distance, 0.0) / 1e3:.3f} km"),
            (
                "speed",
                f"mean {self.mean_speed:.2f} m/s, most {self.max_speed:.2f} m/s, last "
                f"{self.last_speed:.2f} m/s",
            ),
            ("commands accepted", _counts(self.accepted)),
            ("commands rejected", _counts(self.rejected)),
            ("commands passed over", _counts(self.passed_over)),
            ("commands lost", f"{self.silences} times, {self.silent_time:.2f} s in all"),
            ("frames", f"{self.sent} sent, {self.received} received, {self.dropped} dropped"),
            ("not J1939", _counts(self.ignored)),
            ("requests", _counts(self.requests)),
            (
                "bus",
                f"{self.bus_state}; lost {self.bus_failures} times, opened again "
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

    def to_text(self) -> str:
        """The rows as aligned plain text."""
        return to_text(self.rows())

    def as_dict(self) -> dict[str, Any]:
        """Everything for JSON, units in the names."""
        units = {
            "duration": "s",
            "distance": "m",
            "mean_speed": "mps",
            "max_speed": "mps",
            "last_speed": "mps",
            "silent_time": "s",
            "worst_lateness": "s",
            "mean_lateness": "s",
            "slipped": "s",
        }
        return {f"{k}_{units[k]}" if k in units else k: v for k, v in asdict(self).items()}


def _counts(counts: dict[str, int]) -> str:
    """Says "3 x this, 2 x that", the most frequent first."""
    ordered = sorted(counts.items(), key=lambda item: -item[1])
    return ", ".join(f"{count} x {name}" for name, count in ordered if count) or "none"
