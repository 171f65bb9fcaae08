"""Paths of the repository and of the outside data that some tests read."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
DATA = Path(os.environ.get("IITS_MJ_TEST_DATA") or ROOT.parent / "shared" / "data")
"""Folder of the outside data; `tests/README.md` lists the files and their sources."""
MISSING = "outside data is missing"


def outside(name: str) -> Path:
    """Path of an outside file or folder, such as "xodr/esmini_velodrome.xodr".

    Skips the calling test if the file is missing.
    """
    path = DATA / name
    if not path.exists():
        pytest.skip(f"{MISSING}: {name}")
    return path


def needs(name: str) -> pytest.MarkDecorator:
    """Mark for tests that need an outside file or folder."""
    return pytest.mark.skipif(not (DATA / name).exists(), reason=f"{MISSING}: {name}")
