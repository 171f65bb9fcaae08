"""Writes the tables of `iits_mj/j1939/README.md` from the DBC and `signals.csv`.

    python tools/j1939_manual.py

The tables are between the page's markers; a test compares them with the DBC.
"""

from __future__ import annotations

import math
from pathlib import Path

import cantools.database

from iits_mj.j1939.database import message_names, pgn_of
from iits_mj.j1939.frame import Frame
from iits_mj.j1939.groups import layouts
from iits_mj.j1939.mapping import SignalRow, commands, reports, sender

# A longer list of sensors is shortened to the first and the last.
_MOST_NAMES = 3
PAGE = Path(__file__).resolve().parents[1] / "iits_mj" / "j1939" / "README.md"


def tables() -> dict[str, str]:
    """Name of the marker to Markdown."""
    own = [name for name in message_names() if name.startswith("IITS_")]
    return {
        "messages": _messages(),
        "commands": _commands(),
        "paper": _paper(),
        "reports": _reports(),
        "silent": _silent(),
        "layouts": "\n\n".join(_layout(name) for name in own),
    }


def fill(page: str) -> str:
    """The page with new tables between `<!-- begin NAME -->` and `<!-- end NAME -->`."""
    for name, table in tables().items():
        begin, end = f"<!-- begin {name} -->\n", f"<!-- end {name} -->"
        head, _, rest = page.partition(begin)
        _, _, tail = rest.partition(end)
        page = f"{head}{begin}{table}\n{end}{tail}"
    return page


def _messages() -> str:
    rows = ["| message | PGN | priority | from | period | |", "|---|---|---|---|---|---|"]
    for name in message_names():
        message = layouts().get_message_by_name(name)
        head = Frame(message.frame_id, b"")
        period = f"{message.cycle_time} ms" if message.cycle_time else "on request"
        senders = sorted({sender(row) for row in reports() if row.message == name})
        source = ", ".join(map(str, senders or [head.source]))
        rows.append(
            f"| `{name}` | {head.pgn} | {head.priority} | {source} | {period} | {message.comment} |"
        )
    return "\n".join(rows)


def _commands() -> str:
    rows = ["| control | message, signal | SPN | to | step |", "|---|---|---|---|---|"]
    for row in commands():
        address = "all" if row.address is None else row.address
        rows.append(
            f"| {_elements(row)} | `{row.message}`, `{row.signal}` | {_spn(row)} | {address} | "
            f"{_step(row)} |"
        )
    return "\n".join(rows)


def _paper() -> str:
    """The inputs and outputs of the paper by number, then the additions of its release."""
    rows = [
        "| | the paper's | message, signal | SPN | control or sensor |",
        "|---|---|---|---|---|",
    ]
    for way, table in (("in", commands()), ("out", reports())):
        named = [(paper, row) for row in table for paper in row.paper]
        for paper, row in sorted(named, key=lambda item: item[0].number or math.inf):
            number = "more" if paper.number is None else f"{way} {paper.number}"
            rows.append(
                f"| {number} | {paper.name} | `{row.message}`, `{row.signal}` | {_spn(row)} | "
                f"{_elements(row)} |"
            )
    return "\n".join(rows)


def _reports() -> str:
    rows = ["| quantity | control or sensor | message, signal | SPN | from | step |"]
    rows.append("|---|---|---|---|---|---|")
    for row in reports():
        rows.append(
            f"| {row.quantity.replace('_', ' ')} | {_elements(row)} | `{row.message}`, "
            f"`{row.signal}` | {_spn(row)} | {sender(row)} | {_step(row)} |"
        )
    return "\n".join(rows)


def _silent() -> str:
    """Signals that are always "not available" in the messages of the truck."""
    rows = ["| message | signals |", "|---|---|"]
    sent = {(row.message, row.signal) for row in reports()} | {("VW", "axle_location")}
    for name in dict.fromkeys(row.message for row in reports()):
        missing = [
            f"`{signal.name}`"
            for signal in layouts().get_message_by_name(name).signals
            if (name, signal.name) not in sent
        ]
        if missing:
            rows.append(f"| `{name}` | {', '.join(missing)} |")
    return "\n".join(rows)


def _layout(name: str) -> str:
    rows = [f"### `{name}`, PGN {pgn_of(name)} (0x{pgn_of(name):04X})", ""]
    rows += ["| signal | start bit | bits | scale | offset | unit |", "|---|---|---|---|---|---|"]
    for s in layouts().get_message_by_name(name).signals:
        unit = s.unit or "-"
        rows.append(
            f"| `{s.name}` | {s.start} | {s.length} | {s.scale:g} | {s.offset:g} | {unit} |"
        )
    return "\n".join(rows)


def _elements(row: SignalRow) -> str:
    if len(row.elements) > _MOST_NAMES:
        return f"`{row.elements[0]}` ... `{row.elements[-1]}`"
    return ", ".join(f"`{element}`" for element in row.elements) or "the truck's parameters"


def _spn(row: SignalRow) -> str:
    return str(_signal(row).spn or "own")


def _step(row: SignalRow) -> str:
    signal = _signal(row)
    return f"{signal.scale:g} {signal.unit or ''}".strip()


def _signal(row: SignalRow) -> cantools.database.can.Signal:
    return layouts().get_message_by_name(row.message).get_signal_by_name(row.signal)


def main() -> None:
    """Writes the page."""
    PAGE.write_text(fill(PAGE.read_text(encoding="utf-8")), encoding="utf-8")


if __name__ == "__main__":
    main()
