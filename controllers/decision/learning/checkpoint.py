"""Checkpoint files of a training: written atomically, verified when read.

The first line is format and SHA-256 of the rest, a `torch.save` of tensors and plain values that is
read without unpickling objects. The previous checkpoint remains as a second file.
"""

from __future__ import annotations

import contextlib
import hashlib
import io
import os
from pathlib import Path
from typing import Any

import numpy as np

from controllers.decision.learning.config import CHANGEABLE
from iits_mj.core.errors import InputError
from iits_mj.core.output_files import OutputFile

CHECKPOINT, PREVIOUS = "checkpoint.pt", "checkpoint.previous.pt"
FORMAT = "iits_mj.training.1"


def write(folder: Path, state: dict[str, Any]) -> None:
    """Writes a checkpoint under another name, then renames it.

    Args:
      folder: of the training.
      state: nested dicts and lists of numbers, texts, tensors and numpy arrays.
    """
    import torch

    stream = io.BytesIO()
    torch.save(_exchange(state, np.ndarray, torch.from_numpy), stream)
    payload = stream.getbuffer()
    path = folder / CHECKPOINT
    with OutputFile(path, "checkpoint") as partial:
        with partial.open("wb") as file:
            file.write(f"{FORMAT} {hashlib.sha256(payload).hexdigest()}\n".encode())
            file.write(payload)
            file.flush()
            os.fsync(file.fileno())
        with contextlib.suppress(OSError):  # none yet, or a file system without hard links
            (folder / PREVIOUS).unlink(missing_ok=True)
            os.link(path, folder / PREVIOUS)
    directory = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(directory)
    finally:
        os.close(directory)


def read(folder: Path) -> dict[str, Any]:
    """Returns the state given to `write`, with numpy arrays for tensors except the learner's.

    Raises:
      InputError: there is no checkpoint, it has another format, or it is damaged.
    """
    import torch

    path = folder / CHECKPOINT
    if not path.is_file():
        raise InputError(f"resume: there is no checkpoint {str(path)!r}")
    try:
        header, _, payload = path.read_bytes().partition(b"\n")
        kind, _, digest = header.decode().partition(" ")
        if kind != FORMAT:
            raise ValueError(f"its format is {kind[:40]!r}, not {FORMAT!r}")
        if hashlib.sha256(payload).hexdigest() != digest:
            raise ValueError("it is damaged: its checksum does not match")
        state: dict[str, Any] = torch.load(io.BytesIO(payload), weights_only=True)
        learner = state.pop("learner")
        return {**_exchange(state, torch.Tensor, torch.Tensor.numpy), "learner": learner}
    except Exception as error:  # torch raises many kinds
        before = f"; {PREVIOUS!r} is the previous one" if (folder / PREVIOUS).is_file() else ""
        raise InputError(
            f"resume: checkpoint {str(path)!r} is not usable: {error}{before}"
        ) from error


def check_settings(stored: dict[str, Any], wanted: dict[str, Any]) -> None:
    """Compares the settings of a resumed training with those of its checkpoint.

    Raises:
      InputError: a setting outside `CHANGEABLE` differs.
    """
    for name in sorted((stored.keys() | wanted.keys()) - CHANGEABLE):
        if stored.get(name) != wanted.get(name):
            raise InputError(
                f"resume: {name.replace('_', '-')} is {wanted.get(name)!r}, but the checkpoint's "
                f"training has {stored.get(name)!r}; use the same, or another folder"
            )


def _exchange(value: Any, kind: type, make: Any) -> Any:
    """Returns a nested value with all entries of a type converted by `make`."""
    if isinstance(value, dict):
        return {key: _exchange(inner, kind, make) for key, inner in value.items()}
    if isinstance(value, list | tuple):
        return [_exchange(inner, kind, make) for inner in value]
    return make(value) if isinstance(value, kind) else value
