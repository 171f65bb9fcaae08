"""The folder of results that are kept between runs, and files in it that detect damage."""

from __future__ import annotations

import contextlib
import hashlib
import os
from pathlib import Path

CACHE_VARIABLE = "IITS_MJ_CACHE"
_SEAL = hashlib.sha256().digest_size


def cache_folder() -> Path | None:
    """Returns $IITS_MJ_CACHE, else iits_mj in the user's cache folder; None without a home."""
    chosen, base = os.environ.get(CACHE_VARIABLE), os.environ.get("XDG_CACHE_HOME")
    try:
        if chosen:
            return Path(chosen).expanduser()
        return (Path(base) if base else Path.home() / ".cache") / "iits_mj"
    except RuntimeError:
        return None


def read_sealed(path: Path) -> bytes | None:
    """Returns the content of a file of `write_sealed`; None if it is missing or damaged."""
    try:
        content = path.read_bytes()
    except OSError:
        return None
    seal, body = content[:_SEAL], content[_SEAL:]
    if hashlib.sha256(body).digest() != seal:
        return None
    with contextlib.suppress(OSError):
        os.utime(path)
    return body


def write_sealed(path: Path, body: bytes, kept_max: int) -> None:
    """Writes a file with the hash of its content; without an effect if it cannot be written.

    Processes that write the same file at the same time each move their own into place. Of the files
    in the folder, only the `kept_max` that were last written or read stay.
    """
    partial = path.with_name(f"{path.name}.{os.getpid()}")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        partial.write_bytes(hashlib.sha256(body).digest() + body)
        partial.replace(path)
        files = sorted(path.parent.glob(f"*{path.suffix}"), key=lambda file: file.stat().st_mtime)
        for old in files[:-kept_max]:
            old.unlink(missing_ok=True)
    except OSError:
        with contextlib.suppress(OSError):
            partial.unlink(missing_ok=True)
