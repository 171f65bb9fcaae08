"""Baseline policies of the benchmark: small networks that need NumPy only.

    import gymnasium
    from iits_mj.envs.baselines import load_baseline

    environment = gymnasium.make("iits_mj:iits_mj/Cruise-v0")
    policy = load_baseline("iits_mj/Cruise-v0", "ppo")
    observation, _ = environment.reset(seed=1)
    action = policy(observation)

`docs/benchmark.md` has their scores; `benchmarks/rl_suite.py` trains and writes them.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from controllers.decision.policy import write_layers
from iits_mj.core.errors import InputError
from iits_mj.core.input_files import read_npz

FOLDER = Path(__file__).resolve().parent / "weights"
_SIZE_MAX = 2**24
_ACTIVATIONS: dict[str, Callable[[Any], Any]] = {
    "tanh": np.tanh,
    "relu": lambda x: np.maximum(x, 0.0),
}
_HEADS: dict[str, Callable[[Any], Any]] = {
    "clip": lambda x: np.clip(x, -1.0, 1.0).astype(np.float32),
    "tanh": lambda x: np.tanh(x).astype(np.float32),
    "argmax": lambda x: np.int64(np.argmax(x)),
}


@dataclass(frozen=True)
class Policy:
    """A network that maps an observation to an action, without noise.

    Attributes:
      weights: of the layers, of shape (outputs, inputs); biases: (outputs,).
      activation: between the layers, "tanh" or "relu".
      head: what makes the action of the last layer: "clip", "tanh" or "argmax".
      row_layers: number of first layers that read one row of the observation at a time, so that the
        order of the rows is without effect. Each output's maximum over the rows follows the numbers
        of the observation that stand before the rows. 0: all layers read the whole.
      metadata: JSON values: environment, algorithm, seed, steps, score.

    Raises:
      InputError: unknown activation or head, or layers that do not fit.
    """

    weights: tuple[NDArray[np.float32], ...]
    biases: tuple[NDArray[np.float32], ...]
    activation: str
    head: str
    row_layers: int = 0
    metadata: dict[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if self.activation not in _ACTIVATIONS or self.head not in _HEADS:
            raise InputError(f"network has activation {self.activation!r} and head {self.head!r}")
        if not 0 <= self.row_layers < len(self.weights):
            raise InputError(f"network has {len(self.weights)} layers, {self.row_layers} for rows")
        sizes = [self.weights[0].shape[-1], *(len(b) for b in self.biases)]
        shapes = list(zip(sizes[1:], sizes[:-1], strict=True))
        shapes[self.row_layers] = (sizes[self.row_layers + 1], sizes[self.row_layers] + self._own)
        if self._own < 0 or [w.shape for w in self.weights] != shapes:
            raise InputError(f"network has layers of shape {[w.shape for w in self.weights]}")
        if not all(np.isfinite(a).all() for a in (*self.weights, *self.biases)):
            raise InputError("network contains numbers that are not finite")

    @property
    def _own(self) -> int:
        """Numbers of the observation before its rows."""
        after = self.weights[self.row_layers].shape[-1]
        return after - len(self.biases[self.row_layers - 1]) if self.row_layers else 0

    def __call__(self, observation: NDArray[np.floating[Any]]) -> Any:
        """Returns the action: numbers in [-1, 1], or the number of a discrete action.

        Raises:
          InputError: the observation has another shape.
        """
        x, row = np.asarray(observation, np.float32), self.weights[0].shape[-1]
        if self.row_layers:
            if x.ndim != 1 or len(x) <= self._own or (len(x) - self._own) % row:
                raise InputError(
                    f"observation has shape {x.shape}; the policy needs {self._own} numbers and "
                    f"rows of {row}"
                )
            rows = self._hidden(x[self._own :].reshape(-1, row), 0, self.row_layers)
            x = np.concatenate([x[: self._own], rows.max(axis=0)])
        elif x.shape != (row,):
            raise InputError(f"observation has shape {x.shape}; the policy needs {(row,)}")
        x = self._hidden(x, self.row_layers, len(self.weights) - 1)
        return _HEADS[self.head](self.weights[-1] @ x + self.biases[-1])

    def _hidden(self, x: Any, first: int, end: int) -> Any:
        """Returns the outputs of some layers for inputs of shape (..., inputs)."""
        for weight, bias in zip(self.weights[first:end], self.biases[first:end], strict=True):
            x = _ACTIVATIONS[self.activation](x @ weight.T + bias)
        return x

    def save(self, path: str | Path, **metadata: Any) -> None:
        """Writes an npz file without Python objects; keyword arguments join the metadata."""
        header = {
            **self.metadata,
            **metadata,
            "layers": len(self.weights),
            "row_layers": self.row_layers,
            "activation": self.activation,
            "head": self.head,
        }
        write_layers(path, "policy", header, self.weights, self.biases)

    @classmethod
    def load(cls, path: str | Path) -> Policy:
        """Reads a file written by `save`.

        Raises:
          InputError: the file does not exist, is not such a file, or its layers do not fit.
        """
        text = read_npz(path, "policy", _SIZE_MAX, ("metadata",))["metadata"]
        try:
            header = json.loads(str(text))
            names = [f"{kind}{i}" for i in range(header["layers"]) for kind in "wb"]
            kinds = header["activation"], header["head"], int(header.get("row_layers", 0))
        except (ValueError, KeyError, TypeError) as error:
            raise InputError(f"policy {str(path)!r}: its metadata cannot be read") from error
        found = read_npz(path, "policy", _SIZE_MAX, names)
        arrays = [found[name].astype(np.float32) for name in names]
        return cls(tuple(arrays[::2]), tuple(arrays[1::2]), *kinds, header)


def load_baseline(environment: str, algorithm: str) -> Policy:
    """Returns the shipped policy of an environment: the one of the training with seed 0.

    Args:
      environment: id, with or without "iits_mj:" before it.
      algorithm: "ppo", "sac" or "dqn".

    Raises:
      InputError: there is no such policy; the message names those that exist.
    """
    path = shipped_file(environment, algorithm)
    if not path.exists():
        known = ", ".join(sorted(p.stem for p in FOLDER.glob("*.npz"))) or "none"
        raise InputError(f"there is no policy {path.stem}; shipped are: {known}")
    return Policy.load(path)


def shipped_file(environment: str, algorithm: str) -> Path:
    """Returns the place of a shipped policy, whether it exists or not."""
    name = environment.rpartition(":")[2].rpartition("/")[2]
    return FOLDER / f"{name}-{algorithm}.npz"
