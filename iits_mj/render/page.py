"""Results as a Markdown page with its plots beside it, to be kept in a repository."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

from iits_mj.render import plots
from iits_mj.results import Check, Results

_DPI = 72
# A section with more checks than this shows only those that fall short.
_LONG = 300


def write_markdown(results: Results, version: str, folder: Path) -> Path:
    """Writes `<command>.md` and its plots into the folder; older ones are replaced whole.

    Args:
      results: their parts become the page's sections; without parts the page has one.
      version: of the package.
      folder: exists; the plots go into `<command>/` inside it.
    """
    stem = slug(results.command)
    pictures = folder / stem
    pictures.mkdir(exist_ok=True)
    short = [check for check in results.checks if not check.ok]
    verdict = f"{len(results.checks) - len(short)} of {len(results.checks)} checks hold"
    lines = [
        f"# iits-mj {results.command}",
        "",
        f"Made by `iits-mj {results.command} --report DIR`, version {version}, "
        f"seed {results.seed}; {verdict}.",
        "",
    ]
    if short:
        lines += ["**Falls short:**", ""]
        lines += [f"- {c.name}: {c.value:.4g} {c.unit}, must be {c.must}" for c in short]
        lines += [""]
    written = set()
    for part in results.parts or [results]:
        if part is not results:
            lines += [f"## {part.command.removeprefix(results.command).strip().capitalize()}", ""]
        lines += [f"> {note}\n" for note in part.notes]
        shown = part.checks
        if len(shown) > _LONG:
            shown = [check for check in part.checks if not check.ok]
            held = len(part.checks) - len(shown)
            lines += [f"{held} checks hold and are left out here; these do not:", ""]
        lines += [*table(shown), ""]
        for title, panels in part.figures.items():
            name = f"{slug(part.command)}-{slug(title)}.png"
            plots.write_whole(pictures / name, plots.to_png(plots.draw(panels), dpi=_DPI))
            written.add(name)
            caption = title.replace("_", " ")
            lines += [f"![{caption}]({stem}/{name})", ""]
    for old in pictures.glob("*.png"):
        if old.name not in written:
            old.unlink()
    page = folder / f"{stem}.md"
    plots.write_whole(page, ("\n".join(lines).rstrip() + "\n").encode())
    return page


def table(checks: Sequence[Check]) -> list[str]:
    """The checks as lines of a Markdown table."""
    rows = ["| check | value | unit | reference | must | |", "|---|---|---|---|---|---|"]
    for check in checks:
        reference = check.reference
        shown = f"{reference:.4g}" if isinstance(reference, float) else str(reference or "")
        verdict = ("ok" if check.must else "") if check.ok else "**falls short**"
        cells = (check.name, f"{check.value:.4g}", check.unit, shown, check.must, verdict)
        rows.append("| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |")
    return rows


def slug(text: str) -> str:
    """Lower-case words joined by dashes, for file names."""
    return re.sub(r"[^a-z0-9.]+", "-", text.lower()).strip("-")
