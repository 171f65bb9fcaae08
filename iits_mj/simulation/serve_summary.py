"""What serving came to: the drive, what was obeyed and what was not, the clock and the bus."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

from iits_mj.simulation.summary import counts_text, to_text, with_units


@dataclass(frozen=True, slots=True)
class ServeSummary:
    """Figures of a served truck, SI units.

    Attributes:
      ended: why, in words.
      failed: True after a roll-over, off the road, or when the simulation diverged.
      duration: simulated time [s]; distance [m]; mean_speed, max_speed, last_speed [m/s].
      accepted: command frames obeyed, by message; rejected: unsound ones, by message and reason.
      passed_over: sound ones that were not for this truck or not from who may command, likewise.
      lost: command frames that never arrived, as the counters of the others tell, by message.
      silences: how often commands were lost; silent_time: for how long in all [s].
      sent, received, dropped: frames of the bus; ignored: what is no J1939 frame, by kind.
      requests: answered, refused and ignored, and claims contested.
      bus_failures: how often the bus was lost; bus_restarts: opened again; bus_state: at the end.
      log_failure: why the log of the bus ends early, "" when it does not.
      ticks: of 10 ms; late_ticks: more than half a tick behind the clock.
      worst_lateness, mean_lateness: of a tick [s].
      slips, slipped: how often simulated time fell behind the clock for good, by how much [s].
      processor_load: processor time over wall time.
    """

    ended: str
    failed: bool
    duration: float
    distance: float
    mean_speed: float
    max_speed: float
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

    def rows(self) -> list[tuple[str, str]]:
        """Name and value with its unit, for tables that people read."""
        late = 100.0 * self.late_ticks / self.ticks if self.ticks else 0.0
        rows = [
            ("ended", self.ended),
            ("time", f"{self.duration:.2f} s"),
            ("distance", f"{self.distance / 1e3:z.3f} km"),
            (
                "speed",
                f"mean {self.mean_speed:z.2f} m/s, most {self.max_speed:z.2f} m/s, last "
                f"{self.last_speed:z.2f} m/s",
            ),
            ("commands accepted", counts_text(self.accepted)),
            ("commands rejected", counts_text(self.rejected)),
            ("commands passed over", counts_text(self.passed_over)),
            ("commands that never came", counts_text(self.lost)),
            ("commands lost", f"{self.silences} times, {self.silent_time:.2f} s in all"),
            ("frames", f"{self.sent} sent, {self.received} received, {self.dropped} dropped"),
            ("not J1939", counts_text(self.ignored)),
            ("requests", counts_text(self.requests)),
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
        if self.log_failure:
            rows.append(("log", f"ends early: {self.log_failure}"))
        return rows

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
        return with_units(asdict(self), units)
