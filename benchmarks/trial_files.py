"""Files of `iits-mj evaluate`, as the benchmarks that read them take them."""

from __future__ import annotations

import sys
from pathlib import Path

from iits_mj.core.errors import InputError
from iits_mj.evaluation.trials import Trial, read_trials


def trials_of(path: Path) -> list[Trial]:
    """The trials of a file; the program ends with the reason when they cannot be had."""
    if not path.exists():
        sys.exit(f"file of trials {str(path)!r} does not exist")
    try:
        return list(read_trials(path, print).values())
    except InputError as error:
        sys.exit(str(error))
