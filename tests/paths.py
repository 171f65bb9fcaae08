"""Where the repository lies, and where data that is no part of it may lie."""

from __future__ import annotations

from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
