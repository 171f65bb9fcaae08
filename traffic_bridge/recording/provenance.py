"""Map, versions and net on which a recorded traffic depends besides its settings."""

from __future__ import annotations

import hashlib
import importlib.metadata
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from iits_mj.core.errors import InputError
from iits_mj.road import Route
from traffic_bridge.recording.recording import Recording
from traffic_bridge.recording.rows import SCHEMA

# netconvert writes the date and its command line into comments.
_COMMENT = re.compile(rb"<!--.*?-->", re.DOTALL)


def versions() -> dict[str, str]:
    """Versions on which a re-run depends."""
    return {
        "schema": str(SCHEMA),
        "iits-mj": importlib.metadata.version("iits-mj"),
        "libsumo": importlib.metadata.version("libsumo"),
        "numpy": np.__version__,
    }


def net_hash(net: Path) -> str:
    """SHA-256 of a SUMO net, without the comments."""
    return hashlib.sha256(_COMMENT.sub(b"", net.read_bytes())).hexdigest()


def demand_same(found: Any, here: dict[str, str], what: str, advice: str = "") -> None:
    """Checks that stored versions are the present ones.

    Args:
      found: the stored names and versions; anything but a mapping counts as empty.
      here: the present ones.
      what: beginning of the message.
      advice: end of the message.

    Raises:
      InputError: names the first that differs, with both versions.
    """
    stored = found if isinstance(found, Mapping) else {}
    for name, version in here.items():
        then = stored.get(name)
        if then != version:
            raise InputError(
                f"{what}: made with {name} {_short(then)}, here is {_short(version)}{advice}"
            )


def _short(version: Any) -> str:
    """The first digits of a hash; any other text unchanged."""
    text = str(version or "unknown")
    return text[:12] if re.fullmatch(r"[0-9a-f]{40,}", text) else text


def load(recording: str | Path | Recording) -> tuple[Recording, str]:
    """A recording, read if a path is given, and its name in error messages."""
    if isinstance(recording, Recording):
        return recording, "recording"
    return Recording.load(recording), f"recording {recording}"


def check_map(recording: Recording, name: str, route: Route) -> None:
    """Raises InputError if a recording was made on another map; the message names both."""
    then, now = str(recording.meta.get("map_hash")), route.road_map.content_hash
    if then != now:
        raise InputError(
            f"{name}: made on map {recording.meta.get('map_name')!r} of hash {then[:12]}, not on "
            f"{route.road_map.path.name!r} of hash {now[:12]}"
        )
