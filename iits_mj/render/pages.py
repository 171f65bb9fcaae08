"""Pages as HTML and Markdown, from the templates beside this module.

An HTML page is one self-contained file with plots that answer, see `interactive`; only films and
3-D replays lie beside it. A Markdown page has its plots as pictures in a folder beside it, so that
a repository can hold both.
"""

from __future__ import annotations

import base64
import functools
import os
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import quote

import jinja2
from markupsafe import Markup, escape

from iits_mj.core.arrays import FloatArray
from iits_mj.core.output_files import write_whole
from iits_mj.core.results import COLUMNS, Check, Results
from iits_mj.render.interactive import PageData, Plot, plotly_base64

_DPI = 72  # of the plots beside a Markdown page
# A Markdown section with more checks shows only those that fall short.
_LONG = 300


@dataclass(frozen=True, slots=True)
class Section:
    """A section of a page, its parts from top to bottom; a page omits empty parts.

    Attributes:
      title: heading; notes: remarks set apart from the text.
      sentences: paragraphs; they, titles and cells may have Markdown's `**bold**` and code marks.
      header, rows: a table of text; checks: a table of checks (HTML only, see `check_section`).
      plots: answer to the reader (HTML only).
      pictures: caption and PNG, as bytes (HTML) or path (Markdown).
    """

    title: str = ""
    notes: Sequence[str] = ()
    sentences: Sequence[str] = ()
    header: Sequence[str] = ()
    rows: Sequence[Sequence[str]] = ()
    checks: Sequence[Check] = ()
    pictures: Sequence[tuple[str, bytes | str]] = ()
    plots: Sequence[Plot] = ()

    def __bool__(self) -> bool:
        """Whether the section has any content below its title."""
        parts = (self.notes, self.sentences, self.rows, self.checks, self.pictures, self.plots)
        return any(parts)


@dataclass(frozen=True, slots=True)
class Film:
    """A film that lies beside the page."""

    label: str
    path: Path


@dataclass(frozen=True, slots=True)
class Stage:
    """What moves with the cursor of the page of a drive, or of several drives.

    Attributes:
      map: a plan view with the paths.
      clocks: columns "time" [s], "station", "x", "y" [m] and "yaw" [rad] of each drive.
      films: of the drives, in the same order; times of film and drive are equal.
      replay: a page with the first drive in 3-D, beside this one.
    """

    map: Plot
    clocks: Sequence[Mapping[str, FloatArray]]
    films: Sequence[Film] = ()
    replay: Path | None = None


@dataclass(frozen=True, slots=True)
class Page:
    """A page: heading, lead, checks that fall short (Markdown only), sections, stage (HTML)."""

    title: str
    lead: str = ""
    sections: Sequence[Section] = ()
    short: Sequence[Check] = ()
    stage: Stage | None = None

    def to_html(self, folder: Path | None = None) -> str:
        """Returns the page as HTML; `folder` is its place, for links to what lies beside it."""
        data = PageData()
        if self.stage is not None:
            data.extra["clocks"] = [
                {name: data.array(values) for name, values in clock.items()}
                for clock in self.stage.clocks
            ]
        return (
            _templates()
            .get_template("page.html.j2")
            .render(
                page=self,
                data=data,
                folder=folder,
                check_columns=COLUMNS,
                titles=[section.title for section in self.sections if section and section.title],
                plotly=plotly_base64,
                style=Markup(_beside("page.css")),
                script=Markup(_beside("page.js")),
            )
        )

    def to_markdown(self) -> str:
        """Returns the page as Markdown."""
        return _templates().get_template("page.md.j2").render(page=self).rstrip() + "\n"

    def write(self, path: Path) -> Path:
        """Writes the page in the format of the suffix; replaces an older file completely."""
        text = self.to_markdown() if path.suffix == ".md" else self.to_html(path.parent)
        write_whole(path, text.encode(), "page")
        return path


def check_section(
    checks: Sequence[Check],
    title: str = "",
    notes: Sequence[str] = (),
    sentences: Sequence[str] = (),
) -> Section:
    """Returns a Markdown section with a table of checks; only bounded checks get a verdict."""
    rows = [
        (*check.cells(), ("ok" if check.must else "") if check.ok else "**falls short**")
        for check in checks
    ]
    return Section(title, notes, sentences, COLUMNS, rows)


def write_pictures(folder: Path, pictures: Iterable[tuple[str, bytes]]) -> None:
    """Writes PNG files with these names; removes other PNG files from the folder."""
    folder.mkdir(exist_ok=True)
    written = set()
    for name, content in pictures:
        write_whole(folder / name, content, "page")
        written.add(name)
    for old in folder.glob("*.png"):
        if old.name not in written:
            old.unlink()


def write_results_page(results: Results, version: str, folder: Path) -> tuple[Path, Path]:
    """Writes `<command>.html`, `<command>.md` and its plots; returns the paths of both pages.

    Args:
      results: each part is a section of the Markdown page.
      version: of the package.
      folder: an existing one; the plots go into its subfolder `<command>`.
    """
    stem, title = slug(results.command), f"iits-mj {results.command}"
    short = [check.name for check in results.short()]
    verdict = f"falls short: {', '.join(short)}" if short else "every check holds"
    # Load matplotlib only for Markdown pages with plots.
    from iits_mj.render import plots

    web = Page(
        title,
        f"version {version}, seed {results.seed}; {verdict}",
        [
            Section(notes=results.notes),
            *_tables(results),
            Section("Checks" if results.checks else "", checks=results.checks),
            *(
                Section(name.replace("_", " "), plots=[Plot((panel,)) for panel in panels])
                for name, panels in results.figures.items()
            ),
        ],
    )
    parts = results.parts or [results]
    drawn = [
        (f"{slug(part.command)}-{slug(name)}.png", plots.to_png(plots.draw(panels), dpi=_DPI))
        for part in parts
        for name, panels in part.figures.items()
    ]
    write_pictures(folder / stem, drawn)
    text = Page(
        title,
        f"Made by `{title} --report DIR`, version {version}, seed {results.seed}; "
        f"{results.count_text()}.",
        [section for part in parts for section in _part_sections(part, results, stem)],
        results.short(),
    )
    return web.write(folder / f"{stem}.html"), text.write(folder / f"{stem}.md")


def _tables(results: Results) -> list[Section]:
    """Returns a section for each table of the results."""
    return [Section(title, header=rows[0], rows=rows[1:]) for title, rows in results.tables.items()]


def picture_section(caption: str, picture: bytes | str) -> Section:
    """Returns a section with one picture under its caption."""
    return Section(caption, pictures=[(caption, picture)])


def slug(text: str) -> str:
    """Returns the words of a text in lower case, joined by dashes, for file names."""
    return re.sub(r"[^a-z0-9.]+", "-", text.lower()).strip("-")


def _part_sections(part: Results, whole: Results, stem: str) -> list[Section]:
    """Returns the sections of a Markdown page for one part of the results."""
    title, sentences, shown = "", [], part.checks
    if part is not whole:
        title = part.command.removeprefix(whole.command).strip().capitalize()
    if len(shown) > _LONG:
        shown = part.short()
        held = len(part.checks) - len(shown)
        sentences = [f"{held} checks hold and are left out here; these do not:"]

    def path(name: str) -> str:
        return f"{stem}/{slug(part.command)}-{slug(name)}.png"

    return [
        check_section(shown, title, part.notes, sentences),
        *_tables(part),
        Section(pictures=[(name.replace("_", " "), path(name)) for name in part.figures]),
    ]


@functools.cache
def _templates() -> jinja2.Environment:
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(Path(__file__).with_name("templates")),
        autoescape=jinja2.select_autoescape(["html.j2"]),
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    environment.filters |= {"inline": _inline, "plain": _plain, "row": _row, "source": _source}
    environment.filters |= {"link": _link, "slug": slug}
    return environment


def _inline(text: str) -> Markup:
    """Returns escaped text with Markdown's bold and code marks as HTML."""
    shown = re.sub(r"\*\*(.+?)\*\*", r"<strong>\1</strong>", str(escape(text)))
    return Markup(re.sub(r"`(.+?)`", r"<code>\1</code>", shown))


def _plain(text: str) -> str:
    """Returns text without Markdown's bold and code marks."""
    return re.sub(r"\*\*(.+?)\*\*|`(.+?)`", r"\1\2", text)


def _row(cells: Sequence[str]) -> str:
    """Returns a row of a Markdown table."""
    return "| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |"


def _source(picture: bytes | str) -> str:
    """Returns the source of an <img>: embedded data, or a path."""
    if isinstance(picture, str):
        return picture
    return f"data:image/png;base64,{base64.b64encode(picture).decode()}"


def _link(path: Path, folder: Path | None) -> str:
    """Returns the relative link from a page in the folder to a file."""
    return quote(os.path.relpath(path, folder) if folder is not None else str(path))


def _beside(name: str) -> str:
    """The text of a file beside the templates."""
    return Path(__file__).with_name("templates").joinpath(name).read_text(encoding="utf-8")
