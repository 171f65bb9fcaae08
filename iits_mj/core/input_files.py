"""Reads TOML, JSON and npz from untrusted files, with bounds on size and depth."""

from __future__ import annotations

import gzip
import io
import json
import re
import tomllib
import warnings
import zipfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any, BinaryIO, cast

import numpy as np
from numpy.typing import NDArray

from iits_mj.core.checks import did_you_mean
from iits_mj.core.errors import InputError

TEXT_SIZE_MAX = 4 * 2**20  # bytes of a TOML file
DEPTH_MAX = 32  # of nested tables
# Python's parser needs minutes and gigabytes for a key of thousands of parts.
_DEEP_KEY = re.compile(
    r"""(?:(?:[\w-]+|"[^"\n]*"|'[^'\n]*')[ \t]*\.[ \t]*){""" f"{DEPTH_MAX}}}", re.ASCII
)


def open_packed(path: Path) -> BinaryIO:
    """Opens a file that may be compressed by gzip, to read its content; OSError if it cannot."""
    with path.open("rb") as raw:
        packed = raw.read(2) == b"\x1f\x8b"
    return cast(BinaryIO, gzip.open(path)) if packed else path.open("rb")


def similar_file(path: Path) -> str:
    """Returns a question in brackets that names the file in the folder most like a path, or ""."""
    try:
        return did_you_mean(path.name, [file.name for file in path.parent.iterdir()])
    except OSError:
        return ""


def read_toml(path: str | Path, what: str) -> dict[str, Any]:
    """Returns the content of a TOML file.

    Args:
      path: of the file.
      what: the file's kind, for messages.

    Raises:
      InputError: the file cannot be read, is no TOML, is larger than 4 MiB, or its tables are
        nested deeper than 32 levels.
    """
    name = f"{what} {str(path)!r} cannot be read"
    try:
        size = Path(path).stat().st_size
        if size > TEXT_SIZE_MAX:
            raise InputError(f"{name}: {size} bytes are more than {TEXT_SIZE_MAX} allowed")
        text = Path(path).read_text(encoding="utf-8")
    except FileNotFoundError as error:
        raise InputError(f"{name}: {error.strerror}{similar_file(Path(path))}") from error
    except OSError as error:
        raise InputError(f"{name}: {error.strerror or error}") from error
    except UnicodeDecodeError as error:
        raise InputError(f"{name}: it is not UTF-8 text") from error
    try:
        if _DEEP_KEY.search(text):
            raise RecursionError
        content = tomllib.loads(text)
        _check_depth(content)
    except tomllib.TOMLDecodeError as error:
        raise InputError(f"{name}: it is not TOML: {error}") from error
    except RecursionError as error:
        raise InputError(f"{name}: its tables are nested deeper than {DEPTH_MAX} levels") from error
    return content


def read_json(text: str, name: str) -> Any:
    """Returns the content of a JSON text.

    Raises:
      InputError: it is no JSON, or nested deeper than 32 levels; the message begins with `name`.
    """
    try:
        content = json.loads(text)
        _check_depth(content)
    except ValueError as error:
        raise InputError(f"{name} is not JSON: {error}") from error
    except RecursionError as error:
        raise InputError(f"{name} is nested deeper than {DEPTH_MAX} levels") from error
    return content


def read_npz(
    path: str | Path,
    what: str,
    size_max: int,
    needed: Sequence[str],
    optional: Sequence[str] = (),
) -> dict[str, NDArray[Any]]:
    """Returns arrays of an npz file; others in it are not read.

    Args:
      path: of the file.
      what: the file's kind, for messages.
      size_max: allowed sum of the unpacked sizes of these arrays [bytes].
      needed: names of arrays that the file must have.
      optional: names of arrays that it may have.

    Raises:
      InputError: the file cannot be read, is damaged or lacks a needed array, an array holds Python
        objects, or the arrays are larger than allowed.
    """
    name = f"{what} {str(path)!r}"
    try:
        with zipfile.ZipFile(path) as archive:
            members = {
                entry.filename.removesuffix(".npy"): entry
                for entry in archive.infolist()
                if entry.filename.removesuffix(".npy") in (*needed, *optional)
            }
            missing = [key for key in needed if key not in members]
            if missing:
                raise InputError(f"{name} lacks {', '.join(missing)}")
            size = sum(entry.file_size for entry in members.values())
            if size > size_max:
                raise InputError(
                    f"{name}: its arrays have {size} bytes unpacked, allowed are {size_max}"
                )
            return {key: _array(archive.read(entry)) for key, entry in members.items()}
    except InputError:
        raise
    except FileNotFoundError as error:
        raise InputError(f"{name} does not exist") from error
    except Exception as error:  # headers are parsed as Python, with errors of any type
        raise InputError(f"{name}: cannot be read: {error}") from error


def _array(stored: bytes) -> NDArray[Any]:
    stream = io.BytesIO(stored)
    version = np.lib.format.read_magic(stream)
    if version != (1, 0):
        raise ValueError(f"an array has the format {version}, allowed is (1, 0)")
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # about headers that no version of ours has written
        shape, _, kind = np.lib.format.read_array_header_1_0(stream)
    if kind.hasobject:
        raise ValueError("an array holds Python objects")
    count = 1
    for length in shape:
        count *= length
    if count * kind.itemsize != len(stored) - stream.tell():
        raise ValueError("an array has another size than its header says")
    stream.seek(0)
    array: NDArray[Any] = np.lib.format.read_array(stream, allow_pickle=False)
    return array


def _check_depth(content: Any) -> None:
    level, depth = [content], 0
    while level:
        if depth > DEPTH_MAX:
            raise RecursionError
        level = [
            child
            for node in level
            if isinstance(node, dict | list)
            for child in (node.values() if isinstance(node, dict) else node)
            if isinstance(child, dict | list)
        ]
        depth += 1
