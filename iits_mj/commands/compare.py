"""Compare two drives: figures, configuration, and where they part.

A and B are output folders of 'iits-mj drive', telemetry tables (.csv) or recordings (.npz). --out
writes a page with both drives and their differences over time and station.
"""

from __future__ import annotations

import json
import sys
from dataclasses import dataclass
from pathlib import Path

import iits_mj
from iits_mj.commands.output import prepare_file, prepare_folder
from iits_mj.core.options import option
from iits_mj.core.progress import task
from iits_mj.render.compare_page import Comparison
from iits_mj.simulation.compare import Run

_PAGE = "compare.html"


@dataclass(frozen=True, kw_only=True)
class Options:
    """Flags of `iits-mj compare`."""

    first: Path = option(help="the first drive", metavar="A", positional=True)
    second: Path = option(help="the second drive", metavar="B", positional=True)
    out: Path | None = option(
        None,
        help=f"page to write, or a folder for {_PAGE}",
        metavar="FILE.html|DIR",
        group="output",
    )
    json: bool = option(False, help="print one JSON object instead of the tables", group="output")


def run(options: Options) -> int:
    """Compares, prints the tables, writes the page; returns 0, whether they differ or not.

    Raises:
      InputError: a drive cannot be read, they have no time in common, or the page cannot be
        written.
    """
    page = options.out
    if page is not None and page.suffix == ".html":
        prepare_file(page, "--out")
    elif page is not None:
        prepare_folder(page)
        page = page / _PAGE
    with task("comparing"):
        found = Comparison(Run.read(options.first), Run.read(options.second))
    print(json.dumps(found.as_dict(), allow_nan=False) if options.json else found.to_text())
    if page is not None:
        found.page(iits_mj.__version__).write(page)
        print(f"page: {page}", file=sys.stderr if options.json else sys.stdout)
    return 0
