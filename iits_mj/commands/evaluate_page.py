"""Writes the page of `iits-mj evaluate`, as HTML and as Markdown with the pictures beside it."""

from __future__ import annotations

import html
import re
from collections.abc import Sequence
from pathlib import Path

import iits_mj
from iits_mj.commands import evaluate_plots
from iits_mj.render import page, plots
from iits_mj.render.report import Report
from iits_mj.results import Results
from iits_mj.validation.evaluate import EvaluateConfig
from iits_mj.validation.evaluate_figures import CellFigures
from iits_mj.validation.evaluate_results import shortfall
from iits_mj.validation.evaluate_sections import Section, sections
from iits_mj.validation.trials import Trial

TITLE = "Decision makers compared"
_BEFORE = "<h2>Checks</h2>"
_DPI = 100


def write_page(
    results: Results,
    cells: Sequence[CellFigures],
    trials: Sequence[Trial],
    config: EvaluateConfig,
    folder: Path,
) -> tuple[Path, Path]:
    """Writes `evaluate.html`, `evaluate.md` and the pictures of the latter; the two pages.

    Args:
      results: the checks.
      cells: what they are made of.
      trials: what was driven.
      config: settings.
      folder: exists.
    """
    parts = sections(cells, trials, config)
    names = config.names()
    pictures = {
        "Speed loss of every trip": plots.to_png(evaluate_plots.draw_trips(cells, names), _DPI),
        "Speed loss over lane changes": plots.to_png(
            evaluate_plots.draw_balance(cells, names), _DPI
        ),
    }
    short = [check for check in results.checks if not check.ok]
    held = f"{len(results.checks) - len(short)} of {len(results.checks)} checks hold"
    lead = f"iits-mj {iits_mj.__version__}; {held}"
    stem = page.slug(results.command)
    web, text = folder / f"{stem}.html", folder / f"{stem}.md"
    report = Report(TITLE, lead, checks=results.checks, images=list(pictures.items()))
    content = report.to_html().replace(_BEFORE, "".join(map(_to_html, parts)) + _BEFORE, 1)
    plots.write_whole(web, content.encode())

    lines = [f"# {TITLE}", "", f"Made by {lead}.", ""]
    if short:
        lines += ["**Falls short:**", ""]
        lines += [f"- {shortfall(check)}" for check in short]
        lines += [""]
    for part in parts:
        lines += [*_to_markdown(part), ""]
    (folder / stem).mkdir(exist_ok=True)
    for caption, png in pictures.items():
        name = f"{page.slug(caption)}.png"
        plots.write_whole(folder / stem / name, png)
        lines += [f"## {caption}", "", f"![{caption}]({stem}/{name})", ""]
    lines += ["## Checks", "", *page.table(results.checks)]
    plots.write_whole(text, ("\n".join(lines).rstrip() + "\n").encode())
    return web, text


def _to_markdown(part: Section) -> list[str]:
    lines = [f"## {part.title}", ""]
    for sentence in part.sentences:
        lines += [sentence, ""]
    if part.rows:
        lines += [_row(part.header), "|" + "---|" * len(part.header), *map(_row, part.rows)]
    return lines


def _row(cells: Sequence[str]) -> str:
    return "| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |"


def _to_html(part: Section) -> str:
    text = f"<h2>{_inline(part.title)}</h2>\n"
    text += "".join(f"<p>{_inline(sentence)}</p>\n" for sentence in part.sentences)
    if part.rows:
        rows = "".join(_html_row(row, "td") for row in part.rows)
        head = _html_row(part.header, "th")
        text += (
            '<div style="overflow-x: auto"><table><thead>'
            f"{head}</thead><tbody>{rows}</tbody></table></div>\n"
        )
    return text


def _html_row(cells: Sequence[str], tag: str) -> str:
    return "<tr>" + "".join(f"<{tag}>{_inline(cell)}</{tag}>" for cell in cells) + "</tr>"


def _inline(text: str) -> str:
    """Escaped text with the two marks of Markdown that the sections use."""
    shown = re.sub(r"\*\*(.+?)\*\*", r"<strong>\1</strong>", html.escape(text, quote=True))
    return re.sub(r"`(.+?)`", r"<code>\1</code>", shown)
