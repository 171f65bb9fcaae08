"""Writes the typed messages, `iits_mj/j1939/groups.py`, from the DBC.

    python tools/j1939_groups.py

A test compares the file with the DBC.
"""

from __future__ import annotations

from pathlib import Path

import cantools.database.can

from iits_mj.j1939.frame import Frame
from iits_mj.j1939.group import class_name, layouts

PATH = Path(__file__).resolve().parents[1] / "iits_mj" / "j1939" / "groups.py"
_WIDTH = 100
_HEAD = '''"""The typed messages. `python tools/j1939_groups.py` makes them from `iits_mj.dbc`.

Numbers are in the units of the signals; a field that is left out says "not available".
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from iits_mj.j1939.group import NOT_AVAILABLE, Group, Value
'''


def source() -> str:
    """The text of `groups.py`."""
    return "\n\n".join([_HEAD, *map(_class, layouts().messages)])


def _class(message: cantools.database.can.Message) -> str:
    pgn = Frame(message.frame_id, b"").pgn
    comment = (message.comment or "").rstrip(".")
    about = [line for signal in message.signals for line in _attribute(signal)]
    fields = [f"    {signal.name}: Value = NOT_AVAILABLE" for signal in message.signals]
    lines = [
        "@dataclass(frozen=True, slots=True)",
        f"class {class_name(message.name)}(Group):",
        f'    """{message.name}, PGN {pgn} (0x{pgn:04X}).',
        "",
        *_wrapped(f"    {comment}.", "    "),
        "",
        "    Attributes:",
        *about,
        '    """',
        "",
        f'    MESSAGE: ClassVar[str] = "{message.name}"',
        "",
        *fields,
    ]
    return "\n".join(lines) + "\n"


def _attribute(signal: cantools.database.can.Signal) -> list[str]:
    spn = f"SPN {signal.spn}" if signal.spn else "our own"
    unit = f" [{signal.unit}]" if signal.unit else ""
    text = f"{signal.comment.rstrip('.')}; {spn}" if signal.comment else spn
    return _wrapped(f"      {signal.name}:{unit} {text}.", "        ")


def _wrapped(text: str, indent: str) -> list[str]:
    lines, line = [], text
    while len(line) > _WIDTH:
        cut = line.rindex(" ", 0, _WIDTH)
        lines.append(line[:cut])
        line = indent + line[cut + 1 :]
    return [*lines, line]


def main() -> None:
    """Writes the file."""
    PATH.write_text(source(), encoding="utf-8")


if __name__ == "__main__":
    main()
