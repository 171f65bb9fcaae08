"""SUMO's netconvert: found, run, and its refusals told in one sentence."""

from __future__ import annotations

import importlib.util
import re
import shutil
import subprocess
import sys
from functools import cache
from pathlib import Path

from iits_mj.errors import MapError, TrafficError

TIMEOUT = 120.0  # [s]; the largest of our test maps takes 0.3 s.


def find_netconvert() -> Path:
    """The netconvert program: of this Python environment, of PATH, or of the eclipse-sumo package.

    Raises:
      TrafficError: there is none.
    """
    own = Path(sys.prefix) / "bin" / "netconvert"
    if own.is_file():
        return own
    found = shutil.which("netconvert")
    if found:
        return Path(found)
    package = importlib.util.find_spec("sumo")
    for location in (package.submodule_search_locations or ()) if package else ():
        candidate = Path(location) / "bin" / "netconvert"
        if candidate.is_file():
            return candidate
    raise TrafficError(
        "netconvert is missing: SUMO needs it to read a map; install it with: "
        "pip install eclipse-sumo"
    )


@cache
def netconvert_version() -> str:
    """Version of netconvert, as text."""
    first = run_netconvert(["--version"]).splitlines()
    match = re.search(r"Version\s+(\S+)", " ".join(first[:2]))
    return match.group(1) if match else "unknown"


def run_netconvert(arguments: list[str], name: str = "netconvert") -> str:
    """Runs netconvert and returns what it prints; `name` is the map's in errors.

    Raises:
      MapError: its exit code or its messages say that it failed.
      TrafficError: it is missing, or did not end in time.
    """
    command = [str(find_netconvert()), *arguments]
    try:
        result = subprocess.run(
            command, capture_output=True, text=True, timeout=TIMEOUT, check=False
        )
    except (OSError, subprocess.TimeoutExpired) as error:
        raise TrafficError(f"{name}: netconvert cannot be run: {error}") from error
    errors = [line for line in result.stderr.splitlines() if line.startswith("Error:")]
    if result.returncode != 0 or errors:
        reason = "; ".join(dict.fromkeys(line.removeprefix("Error:").strip() for line in errors))
        raise MapError(
            f"{name}: SUMO's netconvert cannot use the map: "
            f"{reason or result.stderr.strip() or f'exit code {result.returncode}'}"[:600]
        )
    return result.stdout
