"""The trained policy as a decision maker, and its network's file; needs numpy only.

The network is the paper's, 216-256-512-256-3 with ReLU. Its file is an npz without pickled objects:
`w0..w3` of shape (outputs, inputs), `b0..b3`, and `metadata`, a JSON text with the version of the
observation, the layers and the origin.
"""

from __future__ import annotations

import itertools
import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from controllers.decision.base import DecisionContext, Memoryless
from controllers.decision.observation import (
    FRAME_AGES,
    FRAME_SHAPE,
    OBSERVATION_SIZE,
    OBSERVATION_VERSION,
    check_finite,
)
from controllers.decision.trip import ACTIONS
from iits_mj.core.errors import InputError
from iits_mj.core.input_files import read_json, read_npz
from iits_mj.core.messages import Decision
from iits_mj.core.output_files import OutputFile

LAYERS = (OBSERVATION_SIZE, 256, 512, 256, 3)
_KEEP = ACTIONS.index(Decision.KEEP)
FORMAT = "iits_mj.q_network.1"
_SIZE_MAX = 64 * 2**20
SHIPPED = Path(__file__).resolve().parent / "weights" / "ddqn.npz"
SHIPPED_PRICED = SHIPPED.with_name("priced.npz")

FloatArray = NDArray[np.float32]


def write_layers(
    path: str | Path,
    what: str,
    header: Mapping[str, Any],
    weights: Sequence[NDArray[np.floating[Any]]],
    biases: Sequence[NDArray[np.floating[Any]]],
) -> None:
    """Writes a network as an npz file without Python objects: `metadata`, `w0`, `b0`, `w1` ...

    Args:
      path: of the file.
      what: its kind, for messages.
      header: what JSON can hold.
      weights: of the layers, each of shape (outputs, inputs).
      biases: of the layers, each of shape (outputs,).

    Raises:
      InputError: the file cannot be written.
    """
    arrays: dict[str, Any] = {"metadata": np.array(json.dumps(header, sort_keys=True))}
    for i, (weight, bias) in enumerate(zip(weights, biases, strict=True)):
        arrays[f"w{i}"], arrays[f"b{i}"] = weight, bias
    with OutputFile(path, what) as partial, partial.open("wb") as stream:
        np.savez_compressed(stream, **arrays)


def read_layers(
    path: str | Path, kind: str, count: int
) -> tuple[tuple[FloatArray, ...], tuple[FloatArray, ...], dict[str, Any]]:
    """Returns weights, biases and metadata of a file of `write_layers`, in float32.

    Args:
      path: of the file.
      kind: that its metadata must name as `format`.
      count: of the layers.

    Raises:
      InputError: the file is missing, damaged, of another kind or for another observation.
    """
    needed = ("metadata", *(f"{letter}{i}" for i in range(count) for letter in "wb"))
    arrays = read_npz(path, "weights file", _SIZE_MAX, needed)
    metadata = _metadata(arrays, f"weights file {str(path)!r}", kind)
    weights = tuple(arrays[f"w{i}"].astype(np.float32) for i in range(count))
    biases = tuple(arrays[f"b{i}"].astype(np.float32) for i in range(count))
    return weights, biases, metadata


@dataclass(frozen=True)
class QNetwork:
    """The four layers of the network.

    Attributes:
      weights: of shape (outputs, inputs), float32; biases: (outputs,).
      metadata: JSON values of the file.
      margin: by how much the value of a change must exceed that of keeping the lane, in the
        values' units: hysteresis against their noise.
    """

    weights: tuple[FloatArray, ...]
    biases: tuple[FloatArray, ...]
    metadata: dict[str, Any] = field(default_factory=dict)
    margin: float = 0.0

    def __post_init__(self) -> None:
        """Raises InputError for shapes other than the paper's or numbers that are not finite."""
        shapes = list(zip(LAYERS[1:], LAYERS[:-1], strict=True))
        found = [w.shape for w in self.weights]
        if found != shapes or [b.shape for b in self.biases] != [s[:1] for s in shapes]:
            names = ", ".join(map(str, found))
            raise InputError(f"network has layers of shape {names}; must be {shapes}")
        if not all(np.isfinite(a).all() for a in (*self.weights, *self.biases)):
            raise InputError("network contains numbers that are not finite")
        margin = self.margin
        number = isinstance(margin, int | float) and not isinstance(margin, bool)
        if not number or not (math.isfinite(margin) and margin >= 0.0):
            raise InputError(f"network has the margin {margin!r}; use a number, zero or more")
        object.__setattr__(self, "margin", float(margin))

    @classmethod
    def random(cls, generator: np.random.Generator) -> QNetwork:
        """Returns a network with He-initialized weights, for tests and as a control."""
        pairs = list(itertools.pairwise(LAYERS))
        weights = tuple(
            generator.normal(0.0, math.sqrt(2.0 / n), (m, n)).astype(np.float32) for n, m in pairs
        )
        return cls(weights, tuple(np.zeros(m, np.float32) for _, m in pairs))

    def values(self, observation: NDArray[np.floating[Any]]) -> FloatArray:
        """Returns Q of (left, keep, right), shape (3,) or (n, 3), for observations of (n, 216).

        Raises:
          InputError: wrong shape, or a value that is not finite; the message names its feature.
        """
        check_observation(observation)
        x = np.asarray(observation, dtype=np.float32)
        last = len(self.weights) - 1
        for i, (weight, bias) in enumerate(zip(self.weights, self.biases, strict=True)):
            x = x @ weight.T + bias
            if i < last:
                x = np.maximum(x, 0.0)
        return x

    def greedy(self, observation: NDArray[np.floating[Any]]) -> Decision:
        """Returns the decision of greatest value, with the margin added to that of keeping."""
        values = self.values(observation).copy()
        values[_KEEP] += self.margin
        return ACTIONS[int(np.argmax(values))]

    def save(self, path: str | Path, **metadata: Any) -> None:
        """Writes the npz file; keyword arguments are added to its metadata."""
        header = {
            **self.metadata,
            **metadata,
            "format": FORMAT,
            "observation_version": OBSERVATION_VERSION,
            "layers": list(LAYERS),
            "margin": self.margin,
        }
        write_layers(path, "weights file", header, self.weights, self.biases)

    @classmethod
    def load(cls, path: str | Path) -> QNetwork:
        """Reads a file written by `save`.

        Raises:
          InputError: the file does not exist, is not such an npz file, has other shapes or another
            version of the observation, or a number is not finite; the message gives the reason.
        """
        weights, biases, metadata = read_layers(path, FORMAT, len(LAYERS) - 1)
        try:
            return cls(weights, biases, metadata, metadata.get("margin", 0.0))
        except InputError as error:
            raise InputError(f"weights file {str(path)!r}: {error}") from error


def check_observation(observation: NDArray[np.floating[Any]]) -> None:
    """Raises InputError for a wrong shape or a number that is not finite, naming its feature."""
    if observation.ndim not in (1, 2) or observation.shape[-1] != OBSERVATION_SIZE:
        raise InputError(
            f"observation has shape {observation.shape}: must be ({OBSERVATION_SIZE},)"
        )
    check_finite(observation.reshape(-1, len(FRAME_AGES), *FRAME_SHAPE))


def _metadata(arrays: dict[str, Any], name: str, wanted: str) -> dict[str, Any]:
    try:
        metadata = read_json(str(arrays["metadata"]), f"{name}: its metadata")
        kind, version = metadata["format"], metadata["observation_version"]
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(f"{name} has no usable metadata: {error}") from error
    if kind != wanted:
        raise InputError(f"{name} has format {kind!r}; must be {wanted!r}")
    if version != OBSERVATION_VERSION:
        raise InputError(
            f"{name} is for version {version!r} of the observation; "
            f"this program has version {OBSERVATION_VERSION}: train the policy again"
        )
    return dict(metadata)


class GreedyPolicy(Memoryless):
    """Takes the action of greatest value; keeps the lane if the truck may not use the other one.

    Args:
      network: of the action values.
    """

    name = "ddqn"

    def __init__(self, network: QNetwork) -> None:
        self.network = network

    def values(self, observation: NDArray[np.floating[Any]]) -> FloatArray:
        """Returns Q of (left, keep, right), shape (3,)."""
        return self.network.values(observation)

    def decide(self, context: DecisionContext) -> Decision:
        """Returns the greedy decision; KEEP if the truck may not use the lane that it asks for."""
        decision = self.network.greedy(context.observation)
        if decision is not Decision.KEEP and not context.may_use(context.lane - int(decision)):
            return Decision.KEEP
        return decision


def load_policy(path: str | Path | None = None) -> GreedyPolicy:
    """Returns the policy of a weights file; default: the shipped one.

    Raises:
      InputError: the file is missing, damaged, of another shape, or for another observation.
    """
    return GreedyPolicy(QNetwork.load(SHIPPED if path is None else path))
