"""The policy for every price beside the rules in the fast world, and where it is unsure.

    python benchmarks/priced_policy.py compare --trips 300 --seeds test --out out/priced
    python benchmarks/priced_policy.py keep-right --trips 100 --out out/priced
    python benchmarks/priced_policy.py unsure --picture docs/images/policy_unsure.png

`compare` drives the policy at some prices and a sweep of the rules over the same trips, of the five
cells that leave something to gain. In each cell the rules' lower convex hull, of loss over lane
changes, gives the rules' loss at the policy's number of changes: a mixture of two rules. The
difference of a trip is the policy's loss less that of the mixture, less the hull's slope times the
difference of their changes. The table has the mean over the cells with its 95 % interval. Trips are
stored in --out; a stopped comparison continues.
"""

from __future__ import annotations

import argparse
import dataclasses
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from controllers.decision.fast_world.worlds import FastWorlds
from controllers.decision.learning.rollouts import (
    NetworkPolicy,
    braking_of_actions,
    drive_step,
    possible_or_keep,
)
from controllers.decision.policy import load_policy
from controllers.decision.priced import (
    RULE_SHARE,
    PricedNetwork,
    chosen,
    disagreement,
    fallback_rule,
)
from controllers.decision.rules import ClearanceRule, LookAhead, Mobil, Rule, compiled
from controllers.decision.trip import (
    CELLS,
    TEST_SEEDS,
    VALIDATION_SEEDS,
    TripConfig,
    cell_trip,
)
from iits_mj.evaluation.hulls import against_hull, mean_over_cells
from iits_mj.validation.harness.statistics import estimate

SEEDS = {"validation": VALIDATION_SEEDS + 500_000, "test": TEST_SEEDS + 900_000}
COMPARED = [cell for cell in CELLS if cell != ("sparse", 15.0)]
# Columns of a trip.
FIGURES = ("loss", "changes", "imposed_brakings", "collisions", "right_share")
Trips = NDArray[np.float64]  # shape (cells, trips, figures)
Drive = Callable[[FastWorlds], None]


def rules() -> Iterator[tuple[str, Rule]]:
    """Yields the rules to beat, by name: look-ahead, MOBIL and the paper's rules."""
    costs = {
        14: (4, 9, 12, 16, 22, 30),
        30: (12, 18, 25, 35, 45, 60, 80, 100, 125),
        60: (20, 35, 50, 70, 95, 130, 170, 220, 280),
    }
    for horizon, values in costs.items():
        for cost in values:
            rule = LookAhead(horizon=float(horizon), change_cost=float(cost))
            yield f"lookahead:horizon={horizon}:change_cost={cost}", rule
    for threshold in (0.05, 0.15, 0.25, 0.35, 0.5, 0.7, 0.9):
        yield f"mobil:threshold={threshold}", Mobil(threshold=threshold)
    for threshold in (0.05, 0.3, 0.5, 0.8):
        selfish = Mobil(threshold=threshold, politeness=0.0, right_bias=0.0)
        yield f"mobil:threshold={threshold}:politeness=0:right_bias=0", selfish
    for name in ("aggressive", "neutral", "conservative"):
        yield name, ClearanceRule(name)


def started(trips: list[tuple[int, TripConfig]]) -> FastWorlds:
    """Returns worlds at the start of trips with their seeds."""
    worlds = FastWorlds(len(trips))
    for index, (seed, trip) in enumerate(trips):
        worlds.reset(index, np.random.default_rng(seed), trip)
    return worlds


def running(worlds: FastWorlds) -> bool:
    """Whether a trip is not over."""
    return bool(((worlds.states["terminated"] + worlds.states["truncated"]) == 0).any())


def drive(worlds: FastWorlds, network: PricedNetwork, prices: tuple[float, ...]) -> None:
    """Drives all trips by the policy at some prices, as `PricedPolicy` does."""
    policy, table = NetworkPolicy(network), np.tile(prices, (len(worlds), 1))
    rule = compiled(fallback_rule(prices[0]))
    assert rule is not None
    while running(worlds):
        braking = braking_of_actions(worlds, network.actions)
        gains = policy.member_gains(worlds, table, braking)
        decisions = chosen(gains.mean(axis=0), braking)
        spread = disagreement(np.where(np.isfinite(braking), gains, 0.0), table).max(axis=1)
        unsure = np.flatnonzero(spread > network.disagreement_max)
        if unsure.size:
            ruled = worlds.copy(unsure).decide(rule)
            decisions[unsure] = possible_or_keep(ruled, braking[unsure])
        drive_step(worlds, decisions)


def figures(worlds: FastWorlds) -> NDArray[np.float64]:
    """Returns the figures of trips that are over, shape (trips, figures)."""
    state = worlds.states
    columns = (
        100.0 * state["loss_integral"] / state["driven_time"],
        state["changes"],
        state["imposed_brakings"],
        state["collisions"],
        state["right_time"] / state["driven_time"],
    )
    return np.stack(columns, axis=-1).astype(float)


def stored(path: Path, make: Callable[[], Trips]) -> Trips:
    """Returns trips of a file, or makes and stores them."""
    if path.exists():
        with np.load(path) as content:
            return np.asarray(content["trips"])
    trips = make()
    path.parent.mkdir(parents=True, exist_ok=True)
    np.savez(path, trips=trips)
    return trips


def trips_of(asked: argparse.Namespace, cells: list[Any], drive_all: Drive, **more: Any) -> Trips:
    """Drives the trips of all cells; returns their figures."""
    found = []
    for number, cell in enumerate(cells):
        first = SEEDS[asked.seeds] + 1_000 * number
        trip = dataclasses.replace(cell_trip(*cell), **more)
        worlds = started([(first + i, trip) for i in range(asked.trips)])
        drive_all(worlds)
        found.append(figures(worlds))
    return np.stack(found)


def by_rule(rule: Rule) -> Drive:
    """Returns a function that drives all trips by a rule."""
    return lambda worlds: worlds.drive(rule.table)


class Trip(NamedTuple):
    """A trip for the comparison with the rules."""

    seed: int
    changes: int
    speed_loss: float


def by_method(trips: dict[str, Trips], cell: int) -> dict[str, list[Trip]]:
    """Returns the trips of a cell by method."""
    return {
        name: [Trip(i, int(row[1]), 0.01 * row[0]) for i, row in enumerate(found[cell])]
        for name, found in trips.items()
    }


def compare(asked: argparse.Namespace) -> None:
    """Prints the table of the policy against the rules."""
    folder = asked.out / f"{asked.seeds}-{asked.trips}"
    of_rules = {
        name: stored(folder / f"{name}.npz", lambda r=rule: trips_of(asked, COMPARED, by_rule(r)))
        for name, rule in rules()
    }
    cells = " | ".join(f"{density} {speed:g}" for density, speed in COMPARED)
    print(f"| policy | loss % / changes | to the hull | {cells} | hard braking % | collisions |")
    print("|---" * (len(COMPARED) + 5) + "|")
    network = PricedNetwork.load(asked.weights)
    makers: dict[str, Drive] = {
        f"price {price:g} m": lambda worlds, p=price: drive(worlds, network, (p, 0.0, 0.0))
        for price in asked.prices
    }
    makers["one price (double DQN)"] = _drive_one_price
    for name, drive_all in makers.items():
        policy = trips_of(asked, COMPARED, drive_all)
        found = [
            against_hull(by_method({**of_rules, name: policy}, cell), name)
            for cell in range(len(COMPARED))
        ]
        # A policy with fewer changes than each rule has no hull beside it.
        cells_of = [one for one in found if one is not None]
        whole = mean_over_cells(cells_of) if len(cells_of) == len(found) else estimate([])
        words = " | ".join(
            "-" if c is None else f"{c.loss:.1f} / {c.changes:.1f} ({c.difference.mean:+.2f})"
            for c in found
        )
        hard = 100.0 * policy[..., 2].sum() / policy[..., 1].sum()
        loss, changes = policy[..., 0].mean(), policy[..., 1].mean()
        print(
            f"| {name} | {loss:.2f} / {changes:.2f} | {whole.mean:+.2f} ± {whole.half:.2f} | "
            f"{words} | {hard:.1f} | {policy[..., 3].sum():.0f} |",
            flush=True,
        )


def _drive_one_price(worlds: FastWorlds) -> None:
    network = load_policy().network
    while running(worlds):
        worlds.step(network.values(worlds.observations).argmax(axis=1) - 1)


def keep_right(asked: argparse.Namespace) -> None:
    """Prints loss, changes and share of the right lane in traffic that keeps right."""
    cells = [cell for cell in CELLS if cell[0] == "sparse"]
    network = PricedNetwork.load(asked.weights)
    makers: dict[str, Drive] = {
        f"policy, price 60 m, right lane {left:g} m/s": (
            lambda worlds, p=left: drive(worlds, network, (60.0, 0.0, p))
        )
        for left in (0.0, 0.25, 0.5, 1.0, 2.0, 3.0, 4.0)
    }
    for name, rule in rules():
        if name in ("lookahead:horizon=30:change_cost=25", "mobil:threshold=0.15", "aggressive"):
            makers[name] = by_rule(rule)
    print("| sparse traffic that keeps right | loss % | changes | share of the right lane % |")
    print("|---|---:|---:|---:|")
    for name, drive_all in makers.items():
        trips = trips_of(asked, cells, drive_all, keeps_right=True)
        loss, changes, right = (trips[..., i].mean() for i in (0, 1, 4))
        print(f"| {name} | {loss:.2f} | {changes:.2f} | {100.0 * right:.0f} |", flush=True)


def crash_ahead(worlds: FastWorlds) -> None:
    """Stops the nearest vehicle more than 100 m ahead of the truck in each lane."""
    for state in worlds.states:
        vehicles = state["vehicles"][: int(state["count"])]
        for lane in range(int(state["lanes"])):
            far = vehicles["front"] - state["front"] > 100.0
            ahead = np.flatnonzero(far & (vehicles["lane"] == lane))
            if ahead.size:
                vehicles["speed"][ahead[0]] = vehicles["acceleration"][ahead[0]] = 0.0
                vehicles["desired"][ahead[0]] = 0.01


def spreads(
    network: PricedNetwork, trip: TripConfig, count: int, event: Drive | None
) -> NDArray[np.float64]:
    """Returns the members' disagreement at the decisions of trips, in units of its limit.

    Args:
      network: of the policy.
      trip: of all worlds; count: their number.
      event: changes the worlds after 200 s; the decisions of the next 20 s count.
    """
    prices, policy = np.tile([100.0, 0.0, 0.0], (count, 1)), NetworkPolicy(network)
    worlds = started([(VALIDATION_SEEDS + 700_000 + i, trip) for i in range(count)])
    rule = compiled(fallback_rule(100.0))
    assert rule is not None
    worlds.drive(rule, 200.0)
    if event is not None:
        event(worlds)
    found = []
    for _ in range(20 if event else 100):
        braking = braking_of_actions(worlds, network.actions)
        possible = np.isfinite(braking)
        gains = np.where(possible, policy.member_gains(worlds, prices, braking), 0.0)
        found.append(disagreement(gains, prices)[possible])
        worlds.step(np.zeros(count, dtype=np.int64))
    return np.concatenate(found) / network.disagreement_max


def unsure(asked: argparse.Namespace) -> None:
    """Prints where the policy is unsure, and draws it."""
    network = PricedNetwork.load(asked.weights)
    situations: dict[str, tuple[TripConfig, Drive | None]] = {
        **{f"{d}, {s:g} m/s": (cell_trip(d, s), None) for d, s in CELLS},
        "traffic of 40 m/s": (dataclasses.replace(cell_trip("medium", 40.0)), None),
        "vehicles stop ahead": (cell_trip("medium", 12.5), crash_ahead),
    }
    values = {
        name: spreads(network, trip, asked.trips, event)
        for name, (trip, event) in situations.items()
    }
    print("| traffic | decisions | look-ahead decides % |\n|---|---:|---:|")
    for name, found in values.items():
        print(f"| {name} | {found.size} | {100.0 * (found > 1.0).mean():.1f} |")
    print(f"The rule's cost of a change is {RULE_SHARE:g} of the price.")
    if asked.picture is not None:
        _draw(values, asked.picture)


def _draw(values: dict[str, NDArray[np.float64]], path: Path) -> None:
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(8.0, 4.2), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots()
    for place, found in enumerate(values.values()):
        low, quarter, middle, rest, high = np.quantile(found, [0.01, 0.25, 0.5, 0.75, 0.99])
        usual = place < len(CELLS)
        color = "#2f6690" if usual else "#c8553d"
        axes.plot([low, high], [place, place], color=color, linewidth=1.5)
        axes.plot([quarter, rest], [place, place], color=color, linewidth=7, solid_capstyle="butt")
        axes.plot(middle, place, "|", color="white", markersize=7, markeredgewidth=2)
    axes.axvline(1.0, color="#333333", linestyle="--", linewidth=1.2)
    axes.text(1.06, -0.75, "look-ahead decides", va="center", fontsize=9)
    axes.set_xscale("log")
    axes.set_ylim(len(values) - 0.5, -1.2)
    axes.set_yticks(range(len(values)), list(values))
    axes.set_xlabel("disagreement of the members, in units of its limit (1, 25, 50, 75, 99 %)")
    axes.spines[["top", "right"]].set_visible(False)
    figure.savefig(path, dpi=120)


def main() -> None:
    """Prints a table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("what", choices=("compare", "keep-right", "unsure"))
    parser.add_argument("--weights", type=Path, default=None, help="default: the shipped policy")
    parser.add_argument("--trips", type=int, default=100, help="in each cell")
    parser.add_argument("--seeds", choices=list(SEEDS), default="validation")
    parser.add_argument("--prices", type=float, nargs="+", default=[60.0, 100.0, 250.0])
    parser.add_argument("--out", type=Path, default=Path("out/priced"))
    parser.add_argument("--picture", type=Path, default=None)
    asked = parser.parse_args()
    {"compare": compare, "keep-right": keep_right, "unsure": unsure}[asked.what](asked)


if __name__ == "__main__":
    main()
