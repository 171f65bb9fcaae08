"""Where a command puts its files, and how it shows results."""

from __future__ import annotations

import json
import sys
import tempfile
from pathlib import Path
from typing import Any

import iits_mj
from iits_mj.errors import InputError
from iits_mj.results import Results


def prepare_folder(folder: Path, name: str = "out") -> Path:
    """Makes the folder and proves that it can be written to; what lies in it stays.

    Raises:
      InputError: it cannot be made, is not a folder, or cannot be written to.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        raise InputError(
            f"--{name} {str(folder)!r} cannot be written: {error.strerror or error}"
        ) from None
    return folder


def write_json(path: Path, content: dict[str, Any]) -> None:
    """Writes an object as indented JSON, replacing an older file whole."""
    from iits_mj.render.plots import write_whole

    write_whole(path, (json.dumps(content, indent=2, allow_nan=False) + "\n").encode())


def show_results(results: Results, *, as_json: bool, report: Path | None) -> int:
    """Prints the table or the JSON object, writes the page, and returns the exit code (0 or 1)."""
    if report is not None:
        from iits_mj.render.report import from_results

        from_results(results, iits_mj.__version__).write(report / f"{results.command}.html")
    if as_json:
        print(results.to_json(iits_mj.__version__))
    else:
        print(results.to_table())
        if report is not None:
            print(f"report: {report / f'{results.command}.html'}")
    sys.stdout.flush()
    return 0 if results.ok else 1
