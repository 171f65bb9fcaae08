"""Trains and scores the baselines of docs/benchmark.md with Stable-Baselines3; resumable.

    python benchmarks/rl_suite.py train --out out/rl             # all, seed 0 of every task first
    python benchmarks/rl_suite.py train --out out/rl --only Cruise --seeds 0
    python benchmarks/rl_suite.py train --out out/slow --only HighwayFast --algorithms dqn \\
        --steps 100000 --set target_update_interval=10000        # a variant, in its own folder
    python benchmarks/rl_suite.py status --out out/rl
    python benchmarks/rl_suite.py check --out out/rl             # shipped policies, scored again
    python benchmarks/rl_suite.py levels --out out/rl            # scores of the levels
    python benchmarks/rl_suite.py results --out out/rl           # tables, figures and weights
    python benchmarks/rl_suite.py train --out out/rl --only LaneChange --plant kinematic
    python benchmarks/rl_suite.py transfer --out out/rl          # table of kinematic and physical

`train` may be killed at any time and started again. Start it twice to use two cores: each process
takes trainings that no other one holds. rl_suite.toml has the tasks, budgets and hyperparameters.
`results` adds the finished trainings to docs/benchmark/*.csv; `train` leaves those out, also when
their folder is gone, but never a variant (--steps, --set, --plant). Remove a training's rows to
train it again. Trainings with --plant have the folder OUT/PLANT, in which `transfer` finds them.

A training is cut into parts. Every part, also the first and also without an interruption, begins
from the stored model, with random numbers and episodes that follow from the seed and the part. So a
training that was interrupted ends with the same policy as one that was not, on the same machine
with the same versions. Other processors and versions of PyTorch round differently.
"""

from __future__ import annotations

import argparse
import csv
import fcntl
import functools
import os
import shutil
import time
import tomllib
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np

from benchmarks import rl_results
from controllers import decision
from controllers.decision.trip import ACTIONS, TEST_SEEDS, TRAINING_SEEDS, VALIDATION_SEEDS
from iits_mj import suite
from iits_mj.core.timing import PLANTS
from iits_mj.envs import LEVELS, level_id
from iits_mj.envs.baselines import FOLDER, Policy, shipped_file
from iits_mj.evaluation.hoel2020 import StackDriver

SETTINGS = Path(__file__).with_suffix(".toml")
SEEDS = range(5)
KINEMATIC = "kinematic"
VALIDATION_EPISODES = 5
TEST_EPISODES = 50
LEVEL_EPISODES = 20
SCORES = ("environment", "method", "seed", "episode", "return", "steps")
CURVES = ("environment", "method", "seed", "steps", "return", "cpu_seconds")


@dataclass(frozen=True)
class Training:
    """A training: environment, algorithm, its settings, and a seed.

    `rows` has the arguments of `row_features` for a network that does not depend on the order of
    the vehicles. The agent gets `reward_scale` times the reward.
    """

    environment: str
    algorithm: str
    seed: int
    steps: int
    parts: int
    environments: int = 1
    arguments: dict[str, Any] | None = None
    hyperparameters: dict[str, Any] | None = None
    rows: dict[str, Any] | None = None
    reward_scale: float = 1.0

    @property
    def name(self) -> str:
        return f"{short(self.environment)}-{self.algorithm}-{self.seed}"


def short(environment: str) -> str:
    """Returns an id without namespace and version."""
    return environment.partition("/")[2].rpartition("-v")[0]


def trainings() -> list[Training]:
    """Returns all trainings, seed 0 of every task first."""
    tasks = tomllib.loads(SETTINGS.read_text(encoding="utf-8"))["training"]
    return [Training(seed=seed, **task) for seed in SEEDS for task in tasks]


# --- training --------------------------------------------------------------------------------


def train(task: Training, folder: Path) -> None:
    """Runs or continues a training; a finished one ends at once.

    The newest complete folder `part-N` has the model after N parts, the replay buffer and the
    learning curve so far.
    """
    import torch

    torch.set_num_threads(1)
    done = finished_parts(folder)
    while done < task.parts:
        begin = time.process_time()
        part = folder / f"part-{done}"
        model = _model(task, part if done else None)
        _begin_part(model, task, done)
        target = task.steps * (done + 1) // task.parts
        model.learn(target - model.num_timesteps, reset_num_timesteps=False)
        curve = _rows(part / "curve.csv") if done else []
        seconds = time.process_time() - begin + (float(curve[-1]["cpu_seconds"]) if curve else 0.0)
        policy = exported(model)
        model.env.close()
        returns, *_ = score(
            task.environment, _network(policy), VALIDATION_SEEDS, VALIDATION_EPISODES
        )
        figures = (model.num_timesteps, f"{np.mean(returns):.4f}", f"{seconds:.1f}")
        row = (task.environment, task.algorithm, task.seed, *figures)
        curve.append(dict(zip(CURVES, map(str, row), strict=True)))
        done += 1
        _store(folder, done, model, curve, policy)
        print(f"{task.name} part {done}/{task.parts}", *figures, flush=True)
    if not (folder / "scores.csv").exists():
        policy = Policy.load(folder / f"part-{done}" / "policy.npz")
        returns, lengths, _ = score(task.environment, _network(policy), TEST_SEEDS, TEST_EPISODES)
        _write(folder / "scores.csv", SCORES, score_rows(task, returns, lengths))
        print(f"{task.name} test {np.mean(returns):.4f}", flush=True)
        for name in ("model.zip", "buffer.pkl"):
            (folder / f"part-{done}" / name).unlink(missing_ok=True)


def finished_parts(folder: Path) -> int:
    """Returns the number of parts that are complete."""
    return max((int(path.name[5:]) for path in folder.glob("part-*")), default=0)


def _model(task: Training, part: Path | None) -> Any:
    """Returns the model of a stored part, or an untrained one."""
    import stable_baselines3
    from stable_baselines3.common.monitor import Monitor
    from stable_baselines3.common.vec_env import DummyVecEnv

    kind: Any = getattr(stable_baselines3, task.algorithm.upper())
    arguments = task.arguments or {}

    def make() -> Any:
        env = gymnasium.make(task.environment, **arguments)
        scale = task.reward_scale
        return Monitor(gymnasium.wrappers.TransformReward(env, lambda r: scale * float(r)))

    vector = DummyVecEnv([make] * task.environments)
    if part is not None:
        model = kind.load(part / "model.zip", env=vector, device="cpu")
        if (part / "buffer.pkl").exists():
            model.load_replay_buffer(part / "buffer.pkl")
        return model
    settings = dict(task.hyperparameters or {})
    if task.rows is not None:
        extractor = {
            "features_extractor_class": row_features(),
            "features_extractor_kwargs": task.rows,
        }
        settings["policy_kwargs"] = {**settings.get("policy_kwargs", {}), **extractor}
    model = kind("MlpPolicy", vector, seed=task.seed, device="cpu", **settings)
    # The exploration of DQN depends on the share of the whole training, not of a part.
    model.budget = task.steps
    return model


def _begin_part(model: Any, task: Training, part: int) -> None:
    """Gives a model the random numbers, the first episodes and the schedules of a part."""
    seed = TRAINING_SEEDS + 10_000 * task.seed + 100 * part
    model.set_random_seed(seed)
    # New episodes: the ones that were under way are not in the stored model.
    model._last_obs = None
    plain = type(model)._update_current_progress_remaining
    model._update_current_progress_remaining = lambda steps, _: plain(model, steps, model.budget)


def _store(
    folder: Path, done: int, model: Any, curve: list[dict[str, str]], policy: Policy
) -> None:
    """Writes a part beside its place, moves it there, and removes the previous one."""
    partial = folder / "partial"
    shutil.rmtree(partial, ignore_errors=True)
    partial.mkdir(parents=True)
    model.save(partial / "model.zip", exclude=["_update_current_progress_remaining"])
    if getattr(model, "replay_buffer", None) is not None:
        model.save_replay_buffer(partial / "buffer.pkl")
    policy.save(partial / "policy.npz")
    _write(partial / "curve.csv", CURVES, curve)
    os.replace(partial, folder / f"part-{done}")
    shutil.rmtree(folder / f"part-{done - 1}", ignore_errors=True)


@functools.cache
def row_features() -> type[Any]:
    """Returns layers that each row of an observation shares, with the maximum over the rows.

    Hoel et al. (2020) read the cars in this way.
    """
    import torch
    from stable_baselines3.common.torch_layers import BaseFeaturesExtractor
    from torch import nn

    class RowFeatures(BaseFeaturesExtractor):
        """Arguments: numbers before the rows, numbers of a row, outputs of the layers."""

        def __init__(self, space: gymnasium.spaces.Box, own: int, row: int, layers: list[int]):
            super().__init__(space, own + layers[-1])
            self.own, self.row = own, row
            sizes = zip([row, *layers[:-1]], layers, strict=True)
            pairs = [(nn.Linear(before, after), nn.ReLU()) for before, after in sizes]
            self.shared = nn.Sequential(*(module for pair in pairs for module in pair))

        def forward(self, observations: Any) -> Any:
            rows = observations[:, self.own :].unflatten(1, (-1, self.row))
            return torch.cat([observations[:, : self.own], self.shared(rows).amax(1)], 1)

    return RowFeatures


def exported(model: Any) -> Policy:
    """Returns the network of a model's deterministic action."""
    from stable_baselines3 import DQN, SAC
    from torch import nn

    policy, shared = model.policy, 0
    if isinstance(model, DQN):
        network = policy.q_net
        shared = sum(isinstance(m, nn.Linear) for m in network.features_extractor.modules())
        networks, activation = [network.features_extractor, network.q_net], "relu"
        head = "argmax"
    elif isinstance(model, SAC):
        networks, activation, head = [policy.actor.latent_pi, policy.actor.mu], "relu", "tanh"
    else:
        networks, activation = [policy.mlp_extractor.policy_net, policy.action_net], "tanh"
        head = "argmax" if isinstance(model.action_space, gymnasium.spaces.Discrete) else "clip"
    layers = [m for network in networks for m in network.modules() if isinstance(m, nn.Linear)]
    arrays = [[p.detach().numpy().copy() for p in (m.weight, m.bias)] for m in layers]
    return Policy(
        tuple(w for w, _ in arrays), tuple(b for _, b in arrays), activation, head, shared
    )


# --- scores ----------------------------------------------------------------------------------

Act = Callable[[Any, Any], Any]


def score(
    environment: str,
    act: Act,
    first_seed: int,
    episodes: int,
    arguments: Mapping[str, Any] | None = None,
) -> tuple[list[float], list[int], list[bool]]:
    """Returns return and length of each episode, and whether it failed before its time limit.

    Episode k begins with the seed first + k.
    """
    env = gymnasium.make(environment, **(arguments or {}))
    returns, lengths, failures = [], [], []
    for episode in range(episodes):
        observation, _ = env.reset(seed=first_seed + episode)
        env.action_space.seed(first_seed + episode)
        total, steps, over, terminated = 0.0, 0, False, False
        while not over:
            observation, reward, terminated, truncated, _ = env.step(act(env, observation))
            total, steps, over = total + float(reward), steps + 1, terminated or truncated
        returns.append(total)
        lengths.append(steps)
        failures.append(terminated)
    env.close()
    return returns, lengths, failures


def _network(policy: Policy) -> Act:
    return lambda _, observation: policy(observation)


def _random(env: Any, observation: Any) -> Any:
    del observation
    return env.action_space.sample()


def scripted(environment: str) -> Act:
    """Returns the scripted driver of an environment.

    Highways have the rule `lookahead`, in the published scenario with car following, and the speed
    planning has cruise control at the reference speed.
    """
    name = short(environment)
    if name.startswith("Hoel"):
        driver = StackDriver(decision.make("lookahead"))

        def drive(env: Any, observation: Any) -> Any:
            del observation
            world = env.unwrapped.world
            if world.step_number == 0:
                driver.reset()
            return np.int64(driver.act(world))

        return drive
    if name.startswith("Highway"):
        maker = decision.make("lookahead")
        return lambda env, _: np.int64(ACTIONS.index(maker.decide(env.unwrapped.context())))
    if name.startswith("SpeedPlanning"):
        return lambda *_: np.full(1, 1.0 / 3.0, np.float32)
    driver = suite.DRIVERS[gymnasium.spec(environment).kwargs["task"]]

    def act(env: Any, observation: Any) -> Any:
        del observation
        unwrapped = env.unwrapped
        seen = unwrapped.task.get_observation(unwrapped.physics)
        return driver(seen).astype(np.float32)

    return act


def check(environments: Sequence[str]) -> None:
    """Scores fixed drivers and shipped policies again, and prints the table's score beside it."""
    known = _by_training(rl_results.read("scores"))
    for environment in environments:
        actors: dict[str, Act] = {"random": _random, "scripted": scripted(environment)}
        for algorithm in ("ppo", "sac", "dqn"):
            if (path := shipped_file(environment, algorithm)).exists():
                actors[algorithm] = _network(Policy.load(path))
        for name, act in actors.items():
            if row := known.get((environment, name, "0")):
                returns, *_ = score(environment, act, TEST_SEEDS, TEST_EPISODES)
                figures = f"{float(row[0]['return']):.4f} in the table, {np.mean(returns):.4f} now"
                print(f"{short(environment)}-{name}: {figures}", flush=True)


def score_rows(
    task: Training, returns: Sequence[float], lengths: Sequence[int]
) -> list[dict[str, str]]:
    """Returns the rows of a table of scores."""
    first = (task.environment, task.algorithm, task.seed)
    rows = [
        (*first, TEST_SEEDS + k, f"{value:.4f}", length)
        for k, (value, length) in enumerate(zip(returns, lengths, strict=True))
    ]
    return [dict(zip(SCORES, map(str, row), strict=True)) for row in rows]


def score_fixed(environment: str, out: Path, episodes: int = TEST_EPISODES) -> None:
    """Scores the random and the scripted driver of an environment, unless that is done."""
    for name, act in (("random", _random), ("scripted", scripted(environment))):
        folder = out / f"{short(environment)}-{name}"
        with held(folder) as free:
            if not free or (folder / "scores.csv").exists():
                continue
            task = Training(environment, name, 0, 0, 0)
            if episodes == TEST_EPISODES and recorded(task):
                continue
            returns, lengths, _ = score(environment, act, TEST_SEEDS, episodes)
            _write(folder / "scores.csv", SCORES, score_rows(task, returns, lengths))
            print(f"{folder.name} test {np.mean(returns):.4f}", flush=True)


def recorded(task: Training) -> bool:
    """Returns whether the tables have a task with all of its steps, and the policy of seed 0."""
    key = (task.environment, task.algorithm, str(task.seed))
    if key not in _by_training(rl_results.read("scores")):
        return False
    if task.steps == 0:
        return True
    curve = _by_training(rl_results.read("curves")).get(key, [])
    complete = bool(curve) and int(curve[-1]["steps"]) >= task.steps
    return complete and (task.seed > 0 or shipped_file(task.environment, task.algorithm).exists())


# --- files and processes ---------------------------------------------------------------------


@contextmanager
def held(folder: Path) -> Iterator[bool]:
    """Holds a folder against other processes; yields whether it could."""
    folder.mkdir(parents=True, exist_ok=True)
    with (folder / "lock").open("w") as lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            yield False
        else:
            yield True


def _rows(path: Path) -> list[dict[str, str]]:
    with path.open(newline="", encoding="utf-8") as stream:
        return list(csv.DictReader(stream))


def _write(path: Path, columns: Sequence[str], rows: list[dict[str, str]]) -> None:
    partial = path.with_suffix(".partial")
    with partial.open("w", newline="", encoding="utf-8") as stream:
        writer = csv.DictWriter(stream, columns, lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)
    os.replace(partial, path)


def _by_training(rows: list[dict[str, str]]) -> dict[tuple[str, ...], list[dict[str, str]]]:
    """Returns the rows of each environment, method and seed."""
    found: dict[tuple[str, ...], list[dict[str, str]]] = {}
    for row in rows:
        found.setdefault((row["environment"], row["method"], row["seed"]), []).append(row)
    return found


def results(out: Path) -> None:
    """Adds to the tables of `docs/benchmark`; writes the shipped policies and the page's tables."""
    scores = _by_training(rl_results.read("scores"))
    curves = _by_training(rl_results.read("curves"))
    for folder in sorted(path for path in out.iterdir() if path.is_dir()):
        parts = finished_parts(folder)
        curve = _rows(folder / f"part-{parts}" / "curve.csv") if parts else []
        if not (folder / "scores.csv").exists():
            continue
        row = _summary(folder, float(curve[-1]["cpu_seconds"]) if curve else 0.0)
        key = (row["environment"], row["method"], row["seed"])
        scores[key] = [row]
        if not curve:
            continue
        curves[key] = curve
        if key[2] == "0":
            FOLDER.mkdir(exist_ok=True)
            policy = Policy.load(folder / f"part-{parts}" / "policy.npz")
            policy.save(shipped_file(key[0], key[1]), **row)
    rl_results.TABLES.mkdir(parents=True, exist_ok=True)
    for name, columns, tables in (
        ("scores", rl_results.SCORES, scores),
        ("curves", CURVES, curves),
    ):
        rows = [row for key in sorted(tables) for row in tables[key]]
        _write(rl_results.TABLES / f"{name}.csv", columns, rows)
    rl_results.write_page()


def score_levels(environments: Sequence[str], out: Path) -> None:
    """Scores the fixed drivers on all levels of environments, and adds them to the page's table."""
    for environment in environments:
        for level in ("", *LEVELS[environment]):
            score_fixed(level_id(environment, level), out, LEVEL_EPISODES)
    levels = _by_training(rl_results.read("levels"))
    for path in sorted(out.glob("*/scores.csv")):
        row = _summary(path.parent, 0.0)
        levels[row["environment"], row["method"], row["seed"]] = [row]
    rows = [row for key in sorted(levels) for row in levels[key]]
    _write(rl_results.TABLES / "levels.csv", rl_results.SCORES, rows)
    rl_results.write_page()


def _summary(folder: Path, seconds: float) -> dict[str, str]:
    """Returns the row of a table for the episodes of a test."""
    rows = _rows(folder / "scores.csv")
    returns = [float(row["return"]) for row in rows]
    return {
        **{key: rows[0][key] for key in ("environment", "method", "seed")},
        "return": f"{np.mean(returns):.4f}",
        "deviation": f"{np.std(returns):.4f}",
        "steps": f"{np.mean([int(row['steps']) for row in rows]):.1f}",
        "cpu_seconds": f"{seconds:.0f}",
    }


# --- transfer ----------------------------------------------------------------------------------


@dataclass(frozen=True)
class World:
    """One of the two worlds of a task: where it is trained, and where it is tested."""

    training: Training
    plant: str | None  # of the test; None: the environment has none

    def policy(self, out: Path) -> Policy | None:
        """Returns the policy of its finished training: of `out`, or the shipped one."""
        arguments = self.training.arguments or {}
        folder = out / arguments["plant"] if arguments.get("plant") == KINEMATIC else out
        folder /= self.training.name
        if (folder / "scores.csv").exists():
            return Policy.load(folder / f"part-{finished_parts(folder)}" / "policy.npz")
        shipped = shipped_file(self.training.environment, self.training.algorithm)
        if folder.parent == out and self.training.seed == 0 and shipped.exists():
            return Policy.load(shipped)
        return None


def worlds(task: Training) -> dict[str, World] | None:
    """Returns the kinematic and the physical world of a training in the latter; None: not both.

    The decisions have a fast world of kinematic vehicles, the tasks with pedals and steering wheel
    a truck without slip.
    """
    if task.environment == "iits_mj/Highway-v0":
        fast = next(
            other
            for other in trainings()
            if other.environment == "iits_mj/HighwayFast-v0"
            and (other.algorithm, other.seed) == (task.algorithm, task.seed)
        )
        return {"kinematic": World(fast, None), "physical": World(task, "full")}
    if gymnasium.spec(task.environment).kwargs.get("task") is None:
        return None
    return {
        "kinematic": World(with_plant(task, KINEMATIC), KINEMATIC),
        "physical": World(task, "full"),
    }


def with_plant(task: Training, plant: str) -> Training:
    """Returns a training on another plant."""
    return replace(task, arguments={**(task.arguments or {}), "plant": plant})


def score_transfers(tasks: Sequence[Training], out: Path) -> None:
    """Scores finished trainings in both worlds, as far as the table lacks them, and adds them.

    A task has a row as soon as a policy of its kinematic world is there.
    """
    columns = rl_results.TRANSFERS
    rows = {tuple(row[key] for key in columns[:5]): row for row in rl_results.read("transfer")}
    for task in tasks:
        pair = worlds(task)
        if pair is None or pair["kinematic"].policy(out) is None:
            continue
        for trained, source in pair.items():
            policy = source.policy(out)
            for tested, target in pair.items():
                key = (task.environment, task.algorithm, trained, tested, str(task.seed))
                if policy is None or key in rows:
                    continue
                arguments = {} if target.plant is None else {"plant": target.plant}
                returns, _, failures = score(
                    target.training.environment,
                    _network(policy),
                    TEST_SEEDS,
                    TEST_EPISODES,
                    arguments,
                )
                figures = (f"{np.mean(returns):.4f}", f"{1.0 - np.mean(failures):.2f}")
                rows[key] = dict(zip(columns, (*key, *figures), strict=True))
                print(*rows[key].values(), flush=True)
                table = [rows[key] for key in sorted(rows)]
                _write(rl_results.TABLES / "transfer.csv", columns, table)
    rl_results.write_page()


def _setting(text: str) -> tuple[str, Any]:
    """Returns a hyperparameter and its value of KEY=VALUE."""
    key, equals, value = text.partition("=")
    if not equals:
        raise argparse.ArgumentTypeError(f"{text!r} must be KEY=VALUE")
    return key, tomllib.loads(f"value = {value}")["value"]


def main() -> None:
    """Runs a command."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n", maxsplit=1)[0])
    commands = ("train", "status", "check", "levels", "results", "transfer")
    parser.add_argument("command", choices=commands)
    parser.add_argument("--out", type=Path, required=True, help="folder of the trainings")
    parser.add_argument("--only", nargs="+", default=[], help="environments, without version")
    parser.add_argument("--algorithms", nargs="+", default=["ppo", "sac", "dqn"])
    parser.add_argument("--seeds", nargs="+", type=int, default=list(SEEDS))
    parser.add_argument("--steps", type=int, help="of each training, instead of its own")
    parser.add_argument(
        "--set", nargs="+", type=_setting, default=[], metavar="KEY=VALUE", help="hyperparameters"
    )
    parser.add_argument("--plant", choices=PLANTS, help="of each training, instead of its own")
    asked = parser.parse_args()
    variant = asked.steps is not None or bool(asked.set) or asked.plant is not None
    known = {short(task.environment) for task in trainings()}
    if unknown := sorted(set(asked.only) - known):
        parser.error(f"--only {' '.join(unknown)}: must be of {', '.join(sorted(known))}")
    tasks = [
        replace(
            task,
            steps=asked.steps or task.steps,
            hyperparameters={**(task.hyperparameters or {}), **dict(asked.set)},
        )
        for task in trainings()
        if task.seed in asked.seeds
        and task.algorithm in asked.algorithms
        and (not asked.only or short(task.environment) in asked.only)
    ]
    if not tasks:
        parser.error("no training has these --only, --algorithms and --seeds; see rl_suite.toml")
    if variant and asked.command not in ("train", "status"):
        parser.error(f"--steps, --set and --plant are of train and status, not of {asked.command}")
    if asked.plant is not None:
        tasks, asked.out = [with_plant(t, asked.plant) for t in tasks], asked.out / asked.plant
    asked.out.mkdir(parents=True, exist_ok=True)
    if asked.command == "transfer":
        score_transfers(tasks, asked.out)
        return
    if asked.command == "results":
        results(asked.out)
        return
    if asked.command == "check":
        check(list(dict.fromkeys(task.environment for task in tasks)))
        return
    if asked.command == "levels":
        # Apart from the tests, which have more episodes.
        score_levels(list(dict.fromkeys(task.environment for task in tasks)), asked.out / "levels")
        return
    for task in tasks:
        folder = asked.out / task.name
        if asked.command == "status":
            done = (folder / "scores.csv").exists()
            tested = f", test {_summary(folder, 0.0)['return']}" if done else ""
            tested = ", in the tables" if not variant and recorded(task) else tested
            print(f"{task.name}: {finished_parts(folder)} of {task.parts} parts{tested}")
            continue
        score_fixed(task.environment, asked.out)
        with held(folder) as free:
            if free and (variant or not recorded(task)):
                train(task, folder)
            else:
                print(f"{task.name} is {'in the tables' if free else 'with another process'}")


if __name__ == "__main__":
    main()
