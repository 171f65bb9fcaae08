"""What the speed planner did in a drive, for its summary."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from controllers.speed_reference import CruiseReference
from controllers.stack import Stack
from iits_mj.simulation.driver import Driver
from iits_mj.simulation.summary import counts_text


def speed_rows(driver: Driver) -> list[tuple[str, str]]:
    """Names and values for tables that people read; empty where no speed was planned."""
    if not isinstance(driver, Stack):
        return []
    reference = driver.reference
    if isinstance(reference, CruiseReference):
        return [("speed planner", reference.reason)] if reference.reason else []
    report = _report(driver)
    if report is None:
        return []
    rows = [("speed plans", counts_text(report.plans))]
    if report.reasons:
        rows.append(("plans without optimum", counts_text(report.reasons)))
    if report.solve_time:
        p50, p95 = np.quantile(report.solve_time, [0.5, 0.95])
        rows.append(("time of a plan", f"{1e3 * p50:.1f} ms, 95 % within {1e3 * p95:.1f} ms"))
    if math.isfinite(report.lag):
        place = "behind" if report.lag >= 0.0 else "ahead of"
        rows.append(
            (
                "schedule",
                f"{abs(report.lag):.1f} s {place} it, made {report.schedules} x; a second is worth "
                f"{1e3 * report.price:.2f} g of fuel",
            )
        )
    return rows


def speed_object(driver: Driver) -> dict[str, Any]:
    """The same for JSON, {"speed_planner": {...}}; empty where none was to be planned."""
    if isinstance(driver, Stack) and isinstance(driver.reference, CruiseReference):
        # A cruise that was asked for needs no reason; one that PCC fell back to does.
        reason = driver.reference.reason
        return {"speed_planner": {"fallback": "cruise", "reason": reason}} if reason else {}
    report = _report(driver)
    if report is None:
        return {}
    solves = np.array(report.solve_time)
    p50, p95 = np.quantile(solves, [0.5, 0.95]) if solves.size else (math.nan, math.nan)
    figures = {
        "solve_p50_s": float(p50),
        "solve_p95_s": float(p95),
        "lag_s": report.lag,
        "price_kgps": report.price,
    }
    return {
        "speed_planner": {
            "plans": report.plans,
            "reasons": report.reasons,
            "schedules": report.schedules,
            **{n: v if math.isfinite(v) else None for n, v in figures.items()},
        }
    }


def _report(driver: Driver) -> Any:
    """The report of PCC, None where somebody else says how fast to go."""
    report = getattr(driver.reference, "report", None) if isinstance(driver, Stack) else None
    return None if report is None else report()
