"""Tables and figures of docs/benchmark.md from the tables in docs/benchmark.

    python benchmarks/rl_results.py

A score is the mean return of a trained policy over the held-out test episodes. Intervals are those
of Agarwal et al. (2021), "Deep reinforcement learning at the edge of the statistical precipice":
interquartile mean over the seeds, with a 95 % interval by bootstrap of the seeds, stratified by
task.
"""

from __future__ import annotations

import csv
from collections.abc import Sequence
from pathlib import Path

import gymnasium
import numpy as np
from scipy import stats

from iits_mj.envs import ENVIRONMENTS, LEVELS, level_id

DOCS = Path(__file__).resolve().parents[1] / "docs"
TABLES, PAGE = DOCS / "benchmark", DOCS / "benchmark.md"
SCORES = ("environment", "method", "seed", "return", "deviation", "steps", "cpu_seconds")
TRANSFERS = ("environment", "method", "trained", "tested", "seed", "return", "success")
SEEDS = 5
_METHODS = ("random", "scripted", "ppo", "sac", "dqn")
_RESAMPLES = 2_000


def interquartile_mean(samples: Sequence[np.ndarray]) -> tuple[float, float, float]:
    """Returns interquartile mean and 95 % interval of samples of several strata, one an array."""

    def mean(*parts: np.ndarray, axis: int = -1) -> np.ndarray:
        return stats.trim_mean(np.concatenate(parts, axis=axis), 0.25, axis=axis)

    middle = float(mean(*samples))
    if min(len(sample) for sample in samples) < 2:
        return middle, np.nan, np.nan
    found = stats.bootstrap(
        tuple(samples), mean, n_resamples=_RESAMPLES, method="percentile", vectorized=True,
        random_state=np.random.default_rng(0),
    ).confidence_interval  # fmt: skip
    return middle, float(found.low), float(found.high)


def read(name: str) -> list[dict[str, str]]:
    """Returns the rows of a table of docs/benchmark; none before the first results."""
    path = TABLES / f"{name}.csv"
    if not path.exists():
        return []
    with path.open(newline="", encoding="utf-8") as stream:
        return list(csv.DictReader(stream))


def returns(rows: list[dict[str, str]]) -> dict[tuple[str, str], np.ndarray]:
    """Returns the scores of the seeds by environment and method."""
    found: dict[tuple[str, str], list[float]] = {}
    for row in rows:
        found.setdefault((row["environment"], row["method"]), []).append(float(row["return"]))
    return {key: np.array(values) for key, values in found.items()}


def planned() -> set[tuple[str, str]]:
    """Returns the trained cells of the table."""
    from benchmarks.rl_suite import trainings

    return {(task.environment, task.algorithm) for task in trainings()}


def score_table(rows: list[dict[str, str]]) -> str:
    """Returns the table of scores; a cell without all its seeds says how many it has."""
    found, cells = returns(rows), planned()
    environments = [name for name in ENVIRONMENTS if name in {name for name, _ in cells}]
    lines = ["| environment | threshold | " + " | ".join(_METHODS) + " |", "|---" * 7 + "|"]
    for environment in environments:
        shown = []
        for method in _METHODS:
            scores = found.get((environment, method))
            wanted = 1 if method in _METHODS[:2] else SEEDS
            if method not in _METHODS[:2] and (environment, method) not in cells:
                shown.append("-")
            elif scores is None:
                shown.append(f"pending (0 of {wanted})")
            elif wanted == 1:
                shown.append(_number(scores[0]))
            else:
                middle, low, high = interquartile_mean([scores])
                interval = "" if np.isnan(low) else f" [{_number(low)}, {_number(high)}]"
                pending = f" pending ({len(scores)} of {SEEDS})" if len(scores) < SEEDS else ""
                shown.append(f"{_number(middle)}{interval}{pending}")
        threshold = gymnasium.spec(environment).reward_threshold
        lines.append(f"| `{environment}` | {threshold:g} | {' | '.join(shown)} |")
    return "\n".join(lines)


def level_table(rows: list[dict[str, str]]) -> str:
    """Returns the table of the random and the scripted driver on the levels."""
    found = returns(rows)
    kinds = ("Easy", "", "Hard")
    titles = [f"{kind or 'plain'}, {method}" for kind in kinds for method in _METHODS[:2]]
    lines = ["| environment | " + " | ".join(titles).lower() + " |", "|---" * 7 + "|"]
    for name in (name for name in ENVIRONMENTS if LEVELS[name]):
        keys = [(level_id(name, kind), method) for kind in kinds for method in _METHODS[:2]]
        shown = [_number(found[key][0]) if key in found else "pending" for key in keys]
        lines.append(f"| `{name}` | {' | '.join(shown)} |")
    return "\n".join(lines)


def summary_table(rows: list[dict[str, str]]) -> str:
    """Returns each algorithm's score over its tasks: 0 is random, 1 is the scripted driver."""
    found = returns(rows)
    lines = ["| method | tasks | interquartile mean | 95 % interval |", "|---|---|---|---|"]
    for method in _METHODS[2:]:
        samples = []
        for (environment, name), values in found.items():
            ends = [found[key][0] for end in _METHODS[:2] if (key := (environment, end)) in found]
            if name == method and len(values) == SEEDS and len(ends) == 2:
                samples.append((values - ends[0]) / (ends[1] - ends[0]))
        if samples:
            middle, low, high = interquartile_mean(samples)
            lines.append(f"| {method} | {len(samples)} | {middle:.2f} | {low:.2f} to {high:.2f} |")
        else:
            lines.append(f"| {method} | 0 | pending | |")
    return "\n".join(lines)


def transfer_table(rows: list[dict[str, str]]) -> str:
    """Returns success and return of policies in the world they were trained in and in the other."""
    found: dict[tuple[str, str], dict[tuple[str, str], list[dict[str, str]]]] = {}
    for row in rows:
        cells = found.setdefault((row["environment"], row["method"]), {})
        cells.setdefault((row["trained"], row["tested"]), []).append(row)
    lines = [
        "| task | trained | seeds | tested kinematic | tested physical |",
        "|---|---|---|---|---|",
    ]
    for (environment, method), cells in found.items():
        for trained in ("kinematic", "physical"):
            # Only seeds with both tests count, so that the two cells are of the same policies.
            tests = [cells.get((trained, tested), []) for tested in ("kinematic", "physical")]
            seeds = set.intersection(*({row["seed"] for row in cell} for cell in tests))
            shown = []
            for cell in tests:
                both = [row for row in cell if row["seed"] in seeds]
                if both:
                    success, value = (
                        np.mean([float(row[key]) for row in both]) for key in ("success", "return")
                    )
                    shown.append(f"{100.0 * success:.1f} %, {_number(value)}")
                else:
                    shown.append("pending")
            lines.append(
                f"| `{environment}` {method} | {trained} | {len(seeds)} | {' | '.join(shown)} |"
            )
    return "\n".join(lines)


def cost_table(rows: list[dict[str, str]]) -> str:
    """Returns steps, settings and processor time of each training."""
    from benchmarks.rl_suite import trainings

    lines = ["| training | steps | environments | settings | minutes of a core |", "|---" * 5 + "|"]
    seconds: dict[tuple[str, str], list[float]] = {}
    for row in rows:
        seconds.setdefault((row["environment"], row["method"]), []).append(
            float(row["cpu_seconds"])
        )
    for task in trainings():
        if task.seed:
            continue
        settings = {**(task.arguments or {}), **(task.hyperparameters or {})}
        if task.rows is not None:
            settings["rows"] = task.rows
        if task.reward_scale != 1.0:
            settings["reward_scale"] = task.reward_scale
        text = ", ".join(f"{key} {value}" for key, value in settings.items()) or "defaults"
        taken = seconds.get((task.environment, task.algorithm))
        minutes = f"{np.mean(taken) / 60.0:.0f}" if taken else "pending"
        steps = f"{task.steps:,}".replace(",", " ")
        lines.append(
            f"| `{task.environment}` {task.algorithm} | {steps} | {task.environments} | {text} |"
            f" {minutes} |"
        )
    return "\n".join(lines)


def _number(value: float) -> str:
    return f"{value:.3g}" if abs(value) < 100.0 else f"{value:.0f}"


def page(text: str) -> str:
    """Returns the page with its tables made again from the results."""
    rows = read("scores")
    tables = {
        "scores": score_table(rows),
        "summary": summary_table(rows),
        "levels": level_table(read("levels")),
        "transfer": transfer_table(read("transfer")),
        "costs": cost_table(rows),
    }
    for name, table in tables.items():
        begin, end = f"<!-- {name} -->\n", "<!-- end -->"
        before, _, rest = text.partition(begin)
        text = f"{before}{begin}\n{table}\n\n{end}{rest.partition(end)[2]}"
    return text


def write_page() -> None:
    """Writes the page's tables and figure."""
    PAGE.write_text(page(PAGE.read_text(encoding="utf-8")), encoding="utf-8")
    curves = read("curves")
    if curves:
        draw_curves(curves, read("scores"), TABLES / "curves.png")


def draw_curves(curves: list[dict[str, str]], rows: list[dict[str, str]], path: Path) -> None:
    """Draws the learning curves: interquartile mean of the seeds and its interval."""
    from matplotlib.figure import Figure

    environments = list(dict.fromkeys(row["environment"] for row in curves))
    columns = 3
    lines = -(-len(environments) // columns)
    figure = Figure(figsize=(10.0, 2.6 * lines), layout="constrained")
    fixed = returns(rows)
    colors = dict(zip(_METHODS, ("0.6", "0.2", "C0", "C1", "C2"), strict=True))
    for place, environment in enumerate(environments):
        axes = figure.add_subplot(lines, columns, place + 1)
        axes.set_title(environment.partition("/")[2], fontsize=9)
        for method in _METHODS[:2]:
            if (environment, method) in fixed:
                axes.axhline(fixed[environment, method][0], color=colors[method], ls="--", lw=1)
        for method in _METHODS[2:]:
            points: dict[int, list[float]] = {}
            for row in curves:
                if (row["environment"], row["method"]) == (environment, method):
                    points.setdefault(int(row["steps"]), []).append(float(row["return"]))
            if points:
                steps = sorted(points)
                middles = np.array([interquartile_mean([np.array(points[s])]) for s in steps])
                places = np.array(steps) / 1e3
                axes.plot(places, middles[:, 0], color=colors[method], label=method)
                axes.fill_between(places, *middles[:, 1:].T, color=colors[method], alpha=0.2)
        axes.legend(fontsize=7)
        axes.tick_params(labelsize=7)
    figure.supxlabel("thousand steps of the environment", fontsize=9)
    figure.supylabel("return of validation episodes", fontsize=9)
    figure.savefig(path, dpi=100)


if __name__ == "__main__":
    write_page()
