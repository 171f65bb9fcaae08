"""Colors on a terminal. Output to a file or a pipe stays plain text."""

from __future__ import annotations

import os
import re
import sys
from collections.abc import Mapping
from typing import TextIO

# Verdicts of checks, and of parts of the installation.
VERDICTS = {
    r"(?m)(?<=  )ok$|^ok(?=  )": "green",
    r"(?m)(?<=  )FALLS SHORT$|^falls short(?=:)|^MISSING(?= )": "bold red",
    r"(?m)^absent(?= )": "yellow",
}


def is_colored(stream: TextIO) -> bool:
    """Returns whether a stream is a terminal on which the user wants colors (no-color.org)."""
    return (
        stream.isatty() and not os.environ.get("NO_COLOR") and os.environ.get("TERM", "") != "dumb"
    )


def show(text: str, styles: Mapping[str, str] = VERDICTS, stream: TextIO | None = None) -> None:
    """Prints text; on a terminal, matches of the patterns have their style."""
    stream = sys.stdout if stream is None else stream
    if not is_colored(stream):
        print(text, file=stream)
        return
    from rich.console import Console
    from rich.text import Text

    shown = Text(text)
    for pattern, style in styles.items():
        shown.highlight_regex(re.compile(pattern), style)
    Console(file=stream, highlight=False).print(shown, soft_wrap=True)
