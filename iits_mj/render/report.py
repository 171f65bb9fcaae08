"""One self-contained HTML page: figures in tables, plots and video inside the file itself."""

from __future__ import annotations

import base64
import html
import os
import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

from iits_mj.core.results import Check, Results
from iits_mj.render import plots

# --- Results as a Markdown page with its plots beside it, to be kept in a repository ---

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


# --- One self-contained HTML page: figures in tables, plots and video inside the file itself ---

# A larger video stays beside the page, which then links to it.
INLINE_VIDEO_BYTES = 20_000_000

_STYLE = """
:root { color-scheme: light dark;
  --ink: #22303c; --paper: #ffffff; --line: #d9dee3; --soft: #f4f6f8; }
@media (prefers-color-scheme: dark) { :root {
  --ink: #e4e8ec; --paper: #161b20; --line: #37414b; --soft: #1e252c; } }
body { margin: 0 auto; max-width: 62rem; padding: 2rem 1.2rem 4rem; color: var(--ink);
  background: var(--paper); font: 16px/1.5 system-ui, sans-serif; }
h1 { font-size: 1.6rem; margin: 0 0 .2rem; } h2 { font-size: 1.15rem; margin: 2.2rem 0 .6rem; }
p.lead { margin: 0 0 1.4rem; opacity: .75; }
table { border-collapse: collapse; width: 100%; font-variant-numeric: tabular-nums; }
th, td { text-align: left; padding: .35rem .7rem; border-bottom: 1px solid var(--line); }
th { font-weight: 600; } tr:nth-child(even) td { background: var(--soft); }
img, video { width: 100%; height: auto; border-radius: 6px; background: #fff; }
figure { margin: 0 0 1.2rem; } .short { color: #c1121f; font-weight: 600; } .ok { color: #2a8f5f; }
.note { border-left: 4px solid #e9a03b; padding: .4rem .9rem; background: var(--soft); }
"""


@dataclass(frozen=True, slots=True)
class Report:
    """What a page shows, from top to bottom; empty parts are left out.

    Attributes:
      title, lead: heading and the line below it.
      rows: name and value with its unit, the summary table.
      checks: figures with their bounds.
      video: an MP4 file; images: caption and PNG bytes.
      settings: name and value, the configuration table.
      notes: sentences the reader must see, for instance why there is no video.
    """

    title: str
    lead: str = ""
    rows: Sequence[tuple[str, str]] = ()
    checks: Sequence[Check] = ()
    video: Path | None = None
    images: Sequence[tuple[str, bytes]] = ()
    settings: Sequence[tuple[str, str]] = ()
    notes: Sequence[str] = field(default_factory=tuple)

    def to_html(self, folder: Path | None = None) -> str:
        """The page; `folder` is where it will lie, for the link to a large video."""
        parts = [f"<h1>{_text(self.title)}</h1>", f'<p class="lead">{_text(self.lead)}</p>']
        parts += [f'<p class="note">{_text(note)}</p>' for note in self.notes]
        if self.video is not None:
            parts += ["<h2>Video</h2>", _video(self.video, folder)]
        if self.rows:
            parts += ["<h2>Summary</h2>", _table(("figure", "value"), self.rows)]
        if self.checks:
            parts += ["<h2>Checks</h2>", _check_table(self.checks)]
        for caption, png in self.images:
            source = f"data:image/png;base64,{base64.b64encode(png).decode()}"
            parts.append(
                f"<h2>{_text(caption)}</h2>"
                f'<figure><img alt="{_text(caption)}" src="{source}"></figure>'
            )
        if self.settings:
            parts += ["<h2>Settings</h2>", _table(("setting", "value"), self.settings)]
        return (
            '<!doctype html>\n<html lang="en"><head><meta charset="utf-8">'
            '<meta name="viewport" content="width=device-width, initial-scale=1">'
            f"<title>{_text(self.title)}</title><style>{_STYLE}</style></head>\n<body>\n"
            + "\n".join(parts)
            + "\n</body></html>\n"
        )

    def write(self, path: Path) -> None:
        """Writes the page, replacing an older one whole."""
        plots.write_whole(path, self.to_html(path.parent).encode())


def from_results(results: Results, version: str) -> Report:
    """The page of a validation or benchmark: its checks, its figures, its notes."""
    short = [check.name for check in results.checks if not check.ok]
    verdict = "every check holds" if not short else f"falls short: {', '.join(short)}"
    return Report(
        title=f"iits-mj {results.command}",
        lead=f"version {version}, seed {results.seed}; {verdict}",
        checks=results.checks,
        images=[
            (name.replace("_", " "), plots.to_png(plots.draw(panels)))
            for name, panels in results.figures.items()
        ],
        notes=tuple(results.notes),
    )


def _text(value: str) -> str:
    return html.escape(value, quote=True)


def _table(header: tuple[str, ...], rows: Sequence[tuple[str, ...]]) -> str:
    head = "".join(f"<th>{_text(cell)}</th>" for cell in header)
    body = "".join(
        "<tr>" + "".join(f"<td>{_text(cell)}</td>" for cell in row) + "</tr>" for row in rows
    )
    return f"<table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>"


def _check_table(checks: Sequence[Check]) -> str:
    head = "".join(
        f"<th>{name}</th>" for name in ("check", "value", "unit", "reference", "must", "")
    )
    body = ""
    for check in checks:
        reference = check.reference
        shown = f"{reference:.4g}" if isinstance(reference, float) else str(reference or "")
        verdict = '<td class="ok">ok</td>' if check.ok else '<td class="short">falls short</td>'
        cells = (check.name, f"{check.value:.4g}", check.unit, shown, check.must)
        body += "<tr>" + "".join(f"<td>{_text(cell)}</td>" for cell in cells) + verdict + "</tr>"
    return f"<table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>"


def _video(path: Path, folder: Path | None) -> str:
    if path.stat().st_size <= INLINE_VIDEO_BYTES:
        data = base64.b64encode(path.read_bytes()).decode()
        return f'<video controls muted playsinline src="data:video/mp4;base64,{data}"></video>'
    link = os.path.relpath(path, folder) if folder is not None else str(path)
    return (
        f'<video controls muted playsinline src="{_text(link)}"></video>'
        f'<p><a href="{_text(link)}">{_text(path.name)}</a> lies beside this page: '
        f"{path.stat().st_size / 1e6:.0f} MB are too much to carry inside it.</p>"
    )
