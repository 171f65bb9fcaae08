"""pyarrow, imported where a file needs it."""

from __future__ import annotations

import importlib
from typing import Any

from iits_mj.errors import InputError


def load(module: str, path: object) -> Any:
    """A module of pyarrow, for reading a file.

    Raises:
      InputError: pyarrow is not installed.
    """
    try:
        return importlib.import_module(f"pyarrow.{module}" if module else "pyarrow")
    except ImportError as error:
        raise InputError(
            f"data set {path}: reading it needs pyarrow, to be had by: pip install 'iits-mj[data]'"
        ) from error
