"""The tables of the manual page (`README.md`), made from the DBC and `signals.csv`.

`python -m iits_mj.j1939` writes them between the page's markers; a test holds the page to them.
"""

from __future__ import annotations

from pathlib import Path

import cantools.database

from iits_mj.j1939.database import message_names, pgn_of
from iits_mj.j1939.frame import Frame
from iits_mj.j1939.layouts import layouts
from iits_mj.j1939.mapping import Mapping, commands, reports

PAGE = Path(__file__).with_name("README.md")


def tables() -> dict[str, str]:
    """Name of the marker to Markdown."""
    own = [name for name in message_names() if name.startswith("IITS_")]
    return {
        "messages": _messages(),
        "commands": _commands(),
        "reports": _reports(),
        "layouts": "\n\n".join(_layout(name) for name in own),
    }


def fill(page: str) -> str:
    """The page with fresh tables between `<!-- begin NAME -->` and `<!-- end NAME -->`."""
    for name, table in tables().items():
        begin, end = f"<!-- begin {name} -->\n", f"<!-- end {name} -->"
        head, _, rest = page.partition(begin)
        _, _, tail = rest.partition(end)
        page = f"{head}{begin}{table}\n{end}{tail}"
    return page


def _messages() -> str:
    rows = ["| message | PGN | period | |", "|---|---|---|---|"]
    for name in message_names():
        message = layouts().get_message_by_name(name)
        rows.append(f"| `{name}` | {pgn_of(name)} | {message.cycle_time} ms | {message.comment} |")
    return "\n".join(rows)


def _commands() -> str:
    rows = [
        "| control | message, signal | SPN | to | step | the paper's |",
        "|---|---|---|---|---|---|",
    ]
    for row in commands():
        address = "all" if row.address is None else row.address
        paper = f"`{row.paper}`" if row.paper else ""
        rows.append(
            f"| `{row.element}` | `{row.message}`, `{row.signal}` | {_spn(row)} | {address} | "
            f"{_step(row)} | {paper} |"
        )
    return "\n".join(rows)


def _reports() -> str:
    rows = ["| quantity | sensor | message, signal | SPN | from | step | the paper's |"]
    rows.append("|---|---|---|---|---|---|---|")
    for row in reports():
        source = _source(row.message) if row.address is None else row.address
        rows.append(
            f"| {row.quantity.replace('_', ' ')} | `{row.element}` | `{row.message}`, "
            f"`{row.signal}` | {_spn(row)} | {source} | {_step(row)} | {row.paper} |"
        )
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


def _source(message: str) -> int:
    return Frame(layouts().get_message_by_name(message).frame_id, b"").source


def _spn(row: Mapping) -> str:
    return str(_signal(row).spn or "own")


def _step(row: Mapping) -> str:
    signal = _signal(row)
    return f"{signal.scale:g} {signal.unit or ''}".strip()


def _signal(row: Mapping) -> cantools.database.can.Signal:
    return layouts().get_message_by_name(row.message).get_signal_by_name(row.signal)
