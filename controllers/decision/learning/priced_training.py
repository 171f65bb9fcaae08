"""Training of the priced policy: rounds of roll-outs in the fast world, each followed by a fit.

Round 0 labels the decisions of the look-ahead rule, each later round those of the network before.
Several processes make the labels of a round in chunks and fit the members of a network. Each chunk
and each member is a file, so an interrupted training continues from the last one, and the result
depends neither on the number of processes nor on interruptions.
"""

from __future__ import annotations

import functools
import json
from collections.abc import Callable
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np

from controllers.decision.learning.config import RolloutConfig
from controllers.decision.learning.rollouts import Chunk, Labels, make_labels
from controllers.decision.priced import PricedNetwork
from controllers.decision.trip import TRAINING_SEEDS
from iits_mj.core.errors import InputError
from iits_mj.core.input_files import read_json, read_npz
from iits_mj.core.output_files import OutputFile, write_whole
from iits_mj.core.process_pool import run_all

RESULT, LABELS, POLICIES, SETTINGS = "priced.npz", "labels", "policies", "settings.json"
# A fit uses the labels of this many rounds, of the rule's only while there are no others.
_ROUNDS_USED = 2
# Shares of the chunks in the first rounds, whose labels only begin the training.
_SHARES = (0.25, 0.5)
_LABELS_MAX = 2**30  # bytes


@dataclass(frozen=True)
class Part:
    """One chunk of labels: its number, the network that drives (None: the rule), and its file."""

    round: int
    chunk: int
    policy: Path | None
    file: Path


@dataclass(frozen=True)
class Member:
    """One member of a network: the labels that it is fitted to, and its file."""

    labels: tuple[Path, ...]
    seed: int
    epochs: int
    file: Path


def train_priced(
    config: RolloutConfig,
    out: Path,
    *,
    seed: int,
    jobs: int,
    resume: bool = False,
    progress: Callable[[int, int], None] | None = None,
    command: str = "",
) -> Path:
    """Trains a priced policy; returns the file of its weights, `priced.npz` in `out`.

    Args:
      config: settings.
      out: folder, created if missing.
      seed: of all randomness.
      jobs: number of processes.
      resume: whether to continue the training in `out`.
      progress: called with the numbers of chunks done and of all chunks.
      command: the command line, for the weights' metadata.

    Raises:
      InputError: torch is missing, or the folder is not usable or is of another training.
      TasksError: chunks or fits failed; the others are kept.
    """
    try:
        import torch  # noqa: F401
    except ImportError as error:
        raise InputError("training needs torch: pip install 'iits-mj[train]'") from error
    from controllers.decision.learning import fitting

    settings = {**vars_of(config), "seed": seed}
    _begin(out, settings, resume)
    policy: Path | None = None
    for number in range(config.rounds):
        _make_labels(config, out, number, policy, seed, jobs, progress or (lambda *_: None))
        last = number == config.rounds - 1
        policy = out / RESULT if last else out / POLICIES / f"priced_{number:02d}.npz"
        if policy.exists():
            continue
        used = tuple(_used(out, number, config))
        first = seed * 1000 + number * 100
        members = [
            Member(
                used,
                first + member,
                config.epochs,
                out / POLICIES / f"member_{number:02d}_{member}.npz",
            )
            for member in range(config.members if last else 1)
        ]
        network = _fit_members(members, jobs)
        labels = fitting.joined([_read(part) for part in used])
        network = fitting.with_limit(network, labels)
        network.save(policy, command=command, config=settings, round=number)
    assert policy is not None
    return policy


def _make_labels(
    config: RolloutConfig,
    out: Path,
    number: int,
    policy: Path | None,
    seed: int,
    jobs: int,
    progress: Callable[[int, int], None],
) -> None:
    """Makes the missing chunks of a round."""
    counts = [_chunks(config, other) for other in range(config.rounds)]
    parts = [
        Part(number, chunk, policy, out / LABELS / f"{number:02d}_{chunk:04d}.npz")
        for chunk in range(counts[number])
    ]
    missing = [part for part in parts if not part.file.exists()]
    done, total = sum(counts[: number + 1]) - len(missing), sum(counts)
    progress(done, total)

    def keep(part: Part) -> None:
        nonlocal done
        del part
        done += 1
        progress(done, total)

    work = functools.partial(make_part, config=config, seed=seed)
    run_all(missing, jobs, work, keep, _described, what="chunks of labels")


def vars_of(config: RolloutConfig) -> dict[str, Any]:
    """Returns the settings of a training by roll-outs, by name."""
    return {field.name: getattr(config, field.name) for field in fields(RolloutConfig)}


def make_part(part: Part, config: RolloutConfig, seed: int) -> Part:
    """Makes a chunk of labels and writes its file; returns the part."""
    network = None if part.policy is None else PricedNetwork.load(part.policy)
    generator = np.random.default_rng([seed, TRAINING_SEEDS, part.round, part.chunk])
    chunk = Chunk(config.chunk_trips, config.chunk_windows, config.horizon)
    labels = make_labels(chunk, network, generator, config.speed_action)
    with OutputFile(part.file, "labels") as partial, partial.open("wb") as stream:
        np.savez(stream, **vars(labels))
    return part


def fit_member(member: Member) -> Member:
    """Fits a member and writes its file; returns the member."""
    from controllers.decision.learning import fitting

    labels = fitting.joined([_read(part) for part in member.labels])
    network = fitting.fit(labels, member.seed, member.epochs)
    network.save(member.file)
    return member


def _fit_members(members: list[Member], jobs: int) -> PricedNetwork:
    """Fits the missing members; returns the network of all."""
    missing = [member for member in members if not member.file.exists()]
    run_all(missing, jobs, fit_member, lambda _: None, _described_fit, what="fits")
    return PricedNetwork.joined([PricedNetwork.load(member.file) for member in members])


def _begin(out: Path, settings: dict[str, Any], resume: bool) -> None:
    path = out / SETTINGS
    try:
        for folder in (LABELS, POLICIES):
            (out / folder).mkdir(parents=True, exist_ok=True)
        stored = read_json(path.read_text("utf-8"), str(path)) if path.exists() else None
    except OSError as error:
        raise InputError(f"folder {str(out)!r} cannot be used: {error}") from error
    if stored is not None and not resume:
        raise InputError(
            f"folder {str(out)!r} contains a training; continue it with --resume, or use another "
            "folder"
        )
    if stored is None and resume:
        raise InputError(f"resume: there is no training in folder {str(out)!r}")
    if stored is not None and stored != settings:
        raise InputError(
            f"resume: the training in {str(out)!r} has the settings {stored}; these are {settings}"
        )
    write_whole(path, json.dumps(settings, sort_keys=True).encode(), "settings")


def _used(out: Path, number: int, config: RolloutConfig) -> list[Path]:
    """Returns the files of the labels for the fit after a round."""
    first = max(min(number, 1), number - _ROUNDS_USED + 1)
    rounds = range(first, number + 1)
    return [
        out / LABELS / f"{number:02d}_{chunk:04d}.npz"
        for number in rounds
        for chunk in range(_chunks(config, number))
    ]


def _chunks(config: RolloutConfig, number: int) -> int:
    """Returns the number of chunks of a round."""
    share = _SHARES[number] if number < len(_SHARES) else 1.0
    return max(1, round(share * config.chunks))


def _read(path: Path) -> Labels:
    names = tuple(field.name for field in fields(Labels))
    arrays = read_npz(path, "labels", _LABELS_MAX, names)
    return Labels(*(arrays[name] for name in names))


def _described(part: Part) -> str:
    return f"chunk {part.chunk} of round {part.round}"


def _described_fit(member: Member) -> str:
    return f"fit of {member.file.name}"
