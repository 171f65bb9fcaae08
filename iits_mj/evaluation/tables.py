"""The long tables of the page of `iits-mj evaluate`, a row for each method in each cell."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from iits_mj.core.units import DIESEL_DENSITY
from iits_mj.evaluation.figures import POLICY, CellFigures
from iits_mj.evaluation.trials import CLOSE, Trial


@dataclass(frozen=True)
class Section:
    """A heading with sentences and perhaps a table below it."""

    title: str
    sentences: tuple[str, ...] = ()
    header: tuple[str, ...] = ()
    rows: tuple[tuple[str, ...], ...] = ()


def details(cells: Sequence[CellFigures]) -> Section:
    """Means, spreads and lane changes."""
    rows = []
    for cell in cells:
        for name, own in cell.trials.items():
            loss, changes = cell.loss[name], cell.changes[name]
            more = cell.more_changes.get(name)
            rows.append(
                (
                    cell.name,
                    name,
                    str(len(own)),
                    f"{loss.mean:.2f} ± {loss.half:.2f}",
                    f"{loss.std:.2f}",
                    f"{loss.mean - cell.floor:.2f}",
                    f"{changes.mean:.2f} ± {changes.half:.2f}",
                    f"{changes.std:.2f}",
                    "" if more is None else f"{more.mean:+.2f} ± {more.half:.2f}",
                )
            )
    return Section(
        "Speed loss and lane changes",
        (),
        (
            "cell",
            "method",
            "trips",
            "loss [%]",
            "std",
            "above the free road",
            "changes a trip",
            "std",
            f"changes, {POLICY} less it",
        ),
        tuple(rows),
    )


def safety(cells: Sequence[CellFigures]) -> Section:
    """Collisions, unsafe decisions, gaps."""
    rows = []
    for cell in cells:
        for name, own in cell.trials.items():
            way = sum(t.distance for t in own) / 1e5
            rows.append(
                (
                    cell.name,
                    name,
                    str(sum(t.collisions for t in own)),
                    str(sum(t.failures for t in own)),
                    f"{sum(t.unsafe for t in own) / way:.2f}",
                    f"{sum(t.refused for t in own) / way:.2f}",
                    f"{min(t.time_gap for t in own):.2f}",
                    f"{np.median([t.time_gap for t in own]):.2f}",
                    f"{100.0 * _weighted(own, 'close_share'):.2f}",
                    f"{min(t.box_distance for t in own):.2f}",
                )
            )
    return Section(
        "Safety",
        (
            "Unsafe: decisions to change that the planner refused because of a vehicle; refused: "
            "all that it refused. The time gap is the bumper gap to the vehicle ahead in the "
            "truck's way over the truck's speed, above 1 m/s, looked at every 0.1 s. One that cuts "
            "in counts from the instant its box reaches into the truck's width, so that the least "
            "time gap is often another driver's doing, and not the policy's; the share of the time "
            f"under {CLOSE:g} s shows how long it lasted.",
        ),
        (
            "cell",
            "method",
            "collisions",
            "failed trips",
            "unsafe per 100 km",
            "refused per 100 km",
            "least time gap [s]",
            "its median over trips",
            f"time under {CLOSE:g} s [%]",
            "closest box [m]",
        ),
        tuple(rows),
    )


def effort(cells: Sequence[CellFigures]) -> Section:
    """Fuel, time, reward and computing."""
    rows = []
    for cell in cells:
        for name, own in cell.trials.items():
            fuel = sum(t.fuel for t in own) / DIESEL_DENSITY
            rates = np.mean([t.reward_rates for t in own], axis=0)
            rows.append(
                (
                    cell.name,
                    name,
                    f"{fuel / (sum(t.distance for t in own) / 1e5):.1f}",
                    f"{np.mean([t.distance for t in own]) / 1e3:.2f}",
                    f"{np.mean([t.time for t in own]):.0f}",
                    *(f"{rate:.3f}" for rate in rates),
                    f"{np.mean([t.wall_time for t in own]):.0f}",
                )
            )
    return Section(
        "Fuel, time and reward",
        (
            "Reward: its terms a second, means over the trips, not discounted. Wall time: of a "
            "trip on the computer that drove it, whatever else it did.",
        ),
        (
            "cell",
            "method",
            "fuel [l/100 km]",
            "distance [km]",
            "time [s]",
            "reward: changes",
            "danger",
            "speed",
            "wall time [s]",
        ),
        tuple(rows),
    )


def _weighted(trials: Sequence[Trial], name: str) -> float:
    """Mean of a share of the time over trips."""
    return sum(getattr(t, name) * t.time for t in trials) / sum(t.time for t in trials)
