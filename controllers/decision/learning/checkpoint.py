"""The file a training continues from: whole or not there, checked when it is read.

First line: format and SHA-256 of the rest. Rest: a `torch.save` of tensors and plain values, read
back without pickled objects. The one before it is kept beside it, for the case of a damaged disk.
"""

from __future__ import annotations

import contextlib
import hashlib
import io
import os
from pathlib import Path
from typing import Any

import numpy as np
import torch

from controllers.decision.learning.config import CHANGEABLE
from iits_mj.core.errors import InputError

CHECKPOINT, PREVIOUS = "checkpoint.pt", "checkpoint.previous.pt"
FORMAT = "iits_mj.training.1"


def write(folder: Path, state: dict[str, Any]) -> None:
    """Writes the checkpoint beside its place, then moves it there: a kill leaves one whole.

    Args:
      folder: where it lies.
      state: nested dicts and lists of numbers, texts, tensors and numpy arrays.
    """
    stream = io.BytesIO()
    torch.save(_exchange(state, np.ndarray, torch.from_numpy), stream)
    payload = stream.getbuffer()
    path, partial = folder / CHECKPOINT, folder / (CHECKPOINT + ".partial")
    with partial.open("wb") as file:
        file.write(f"{FORMAT} {hashlib.sha256(payload).hexdigest()}\n".encode())
        file.write(payload)
        file.flush()
        os.fsync(file.fileno())
    with contextlib.suppress(OSError):  # none yet, or a file system without hard links
        (folder / PREVIOUS).unlink(missing_ok=True)
        os.link(path, folder / PREVIOUS)
    partial.replace(path)
    directory = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(directory)
    finally:
        os.close(directory)


def read(folder: Path) -> dict[str, Any]:
    """What `write` was given, with numpy arrays for tensors, but for those of the learner.

    Raises:
      InputError: there is none, or it is of another format or damaged.
    """
    path = folder / CHECKPOINT
    if not path.is_file():
        raise InputError(f"resume: there is no checkpoint {str(path)!r}")
    try:
        header, _, payload = path.read_bytes().partition(b"\n")
        kind, _, digest = header.decode().partition(" ")
        if kind != FORMAT:
            raise ValueError(f"its format is {kind[:40]!r}, {FORMAT!r} is wanted")
        if hashlib.sha256(payload).hexdigest() != digest:
            raise ValueError("it is damaged: its checksum is another")
        state: dict[str, Any] = torch.load(io.BytesIO(payload), weights_only=True)
    except Exception as error:  # torch raises many kinds
        before = f"; {PREVIOUS!r} is the one before it" if (folder / PREVIOUS).is_file() else ""
        raise InputError(
            f"resume: checkpoint {str(path)!r} is not usable: {error}{before}"
        ) from error
    learner = state.pop("learner")
    return {**_exchange(state, torch.Tensor, torch.Tensor.numpy), "learner": learner}


def check_settings(stored: dict[str, Any], wanted: dict[str, Any]) -> None:
    """Refuses to go on with other settings than those of the checkpoint.

    Raises:
      InputError: names the first setting that differs and may not.
    """
    for name in sorted((stored.keys() | wanted.keys()) - CHANGEABLE):
        if stored.get(name) != wanted.get(name):
            raise InputError(
                f"resume: {name.replace('_', '-')} is {wanted.get(name)!r}, but the checkpoint's "
                f"training has {stored.get(name)!r}; give the same, or begin in another folder"
            )


def _exchange(value: Any, kind: type, make: Any) -> Any:
    """The nested value with everything of a kind made into something else."""
    if isinstance(value, dict):
        return {key: _exchange(inner, kind, make) for key, inner in value.items()}
    if isinstance(value, list | tuple):
        return [_exchange(inner, kind, make) for inner in value]
    return make(value) if isinstance(value, kind) else value
