"""Keeps large maps that were read, and routes that were found in them, between runs.

A file belongs to the map's content and name, to the sources of this package, and to the versions of
Python and NumPy. A damaged file, or one that holds anything but records of roads, is not used.
"""

from __future__ import annotations

import functools
import gc
import hashlib
import io
import pickle
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from iits_mj.core.cache import cache_folder, read_sealed, write_sealed
from iits_mj.core.errors import MapError
from iits_mj.kernels import Table

SIZE_MIN = 256 * 1024  # bytes of a map's file; a smaller one is read in some tenths of a second
KEPT_MAX = 60  # files, of about 10 MB for a town
_PROTOCOL = 5
_NUMPY = {"ndarray", "dtype", "_reconstruct", "_frombuffer", "scalar"}


class MapCache:
    """The kept results of one map.

    Args:
      digest: SHA-256 of the map's content; source: its name in messages, which are kept, too.
    """

    def __init__(self, digest: str, source: str) -> None:
        self._key = f"{digest} {source} {_code_digest()}"

    def recall(self, what: str, shared: Mapping[str, Any] | None = None) -> Any:
        """Returns what `keep` wrote, or None.

        Args:
          what: name of the result.
          shared: the objects that the result refers to, by the names that `keep` got.
        """
        path = self._path(what)
        body = None if path is None else read_sealed(path)
        if body is None:
            return None
        # A million new objects would start the garbage collector hundreds of times.
        collecting = gc.isenabled()
        gc.disable()
        try:
            return _Unpickler(body, shared or {}).load()
        except Exception:  # whatever is wrong with the file, the map is read again
            return None
        finally:
            if collecting:
                gc.enable()

    def keep(self, what: str, result: Any, shared: Mapping[str, Any] | None = None) -> None:
        """Writes a result; without an effect where the cache cannot be written.

        Args:
          what: name of the result.
          result: records of this package, numbers, texts and arrays.
          shared: objects that the file names instead of containing them.
        """
        path = self._path(what)
        if path is None:
            return
        stream = io.BytesIO()
        _Pickler(stream, shared or {}).dump(result)
        write_sealed(path, stream.getvalue(), KEPT_MAX)

    def _path(self, what: str) -> Path | None:
        folder = cache_folder()
        if folder is None:
            return None
        name = hashlib.sha256(f"{self._key} {what}".encode()).hexdigest()[:32]
        return folder / "maps" / f"{name}.bin"


@functools.cache
def _code_digest() -> str:
    """SHA-256 over the sources of this package and the versions of Python and NumPy."""
    digest = hashlib.sha256(f"{sys.version} {np.__version__}".encode())
    for path in sorted(Path(__file__).parent.glob("*.py")):
        digest.update(path.read_bytes())
    return digest.hexdigest()


class _Pickler(pickle.Pickler):
    def __init__(self, stream: io.BytesIO, shared: Mapping[str, Any]) -> None:
        super().__init__(stream, _PROTOCOL)
        self._names = {id(value): name for name, value in shared.items()}

    def persistent_id(self, value: Any) -> str | None:
        """Name of a shared object."""
        return self._names.get(id(value))


class _Unpickler(pickle.Unpickler):
    """Makes objects of this package and arrays only, so that a file cannot run other code."""

    def __init__(self, body: bytes, shared: Mapping[str, Any]) -> None:
        super().__init__(io.BytesIO(body))
        self._shared = shared

    def persistent_load(self, name: str) -> Any:
        """The shared object of a name."""
        return self._shared[name]

    def find_class(self, module: str, name: str) -> Any:
        """The class of a name, if it is one of those that maps consist of."""
        known = sys.modules.get(module)
        own = module.startswith("iits_mj.road.") and isinstance(getattr(known, name, None), type)
        table = (module, name) == (Table.__module__, Table.__name__)
        if own or table or (module.partition(".")[0] == "numpy" and name in _NUMPY):
            return super().find_class(module, name)
        raise MapError(f"a kept map contains {module}.{name}")
