"""Check, show, compare and export trucks: truck.toml files, or shipped trucks by name.

  iits-mj truck check TRUCK...    read, compute loads, let it rest; warns of unusual figures
  iits-mj truck show TRUCK        one page: drawings, loads, turns, gears, traction, provenance
  iits-mj truck compare A B ...   figures side by side, traction, full pedal, coast-down, loads
  iits-mj truck export TRUCK DIR  a MuJoCo model folder: MJCF, meshes, README
  iits-mj truck schema            JSON Schema of truck.toml, for editors

Exit code: 0 when the trucks can be built, with or without warnings; 2 for a wrong file.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import iits_mj
from iits_mj.commands.output import prepare_file, prepare_folder
from iits_mj.core.errors import InputError, RenderError
from iits_mj.core.options import option
from iits_mj.core.progress import each, task
from iits_mj.parameters import shipped_trucks
from iits_mj.parameters.schema import truck_schema

_PAGE = "truck.html"


@dataclass(frozen=True, kw_only=True)
class Options:
    """Flags of `iits-mj truck`."""

    what: str = option(
        help="what to do",
        choices=("check", "show", "compare", "export", "schema"),
        positional=True,
        metavar="WHAT",
    )
    trucks: tuple[str, ...] = option(
        (),
        help="a name, a truck.toml or its folder; the last one of export is the new folder",
        names=shipped_trucks,
        positional=True,
        metavar="TRUCK",
    )
    out: Path = option(
        Path("out"),
        help="HTML page of show and compare, or its folder",
        metavar="FILE|DIR",
        group="output",
    )


def run(options: Options) -> int:
    """Runs one of the actions; returns the exit code.

    Raises:
      InputError: a truck's file is wrong, the number of trucks does not fit, or the output cannot
        be written.
    """
    least, most, action = _ACTIONS[options.what]
    count = len(options.trucks)
    if count < least or (most is not None and count > most):
        needed = f"{least}" if least == most else f"{least} or more"
        raise InputError(f"truck {options.what} needs {needed} names or files, got {count}")
    action(options)
    return 0


def _check(options: Options) -> None:
    # Loads MuJoCo.
    from iits_mj.truck.check import inspect_truck

    found = [inspect_truck(truck).to_text() for truck in each(options.trucks, "checking", str)]
    print("\n\n".join(found))


def _show(options: Options) -> None:
    # Loads matplotlib.
    from iits_mj.render.truck_page import truck_page

    path = _page(options)
    with task("drawing the truck"):
        page = truck_page(options.trucks[0], iits_mj.__version__)
    print(f"page: {page.write(path)}")


def _compare(options: Options) -> None:
    # Loads matplotlib.
    from iits_mj.render.truck_page import compare_page

    path = _page(options)
    with task("comparing the trucks"):
        page, text = compare_page(options.trucks, iits_mj.__version__)
    print(text)
    print(f"page: {page.write(path)}")


def _page(options: Options) -> Path:
    """The page's file; makes its folder."""
    if options.out.suffix == ".html":
        prepare_file(options.out, "--out")
        return options.out
    prepare_folder(options.out)
    return options.out / _PAGE


def _export(options: Options) -> None:
    # Load MuJoCo and OpenGL.
    from iits_mj.parameters import TruckParameters
    from iits_mj.render.truck_page import photo
    from iits_mj.truck.export import export_truck

    truck, folder = options.trucks[0], Path(options.trucks[1])
    picture = None
    try:
        picture = photo(TruckParameters.load(truck))
    except RenderError as error:
        print(f"without a picture: {error}", file=sys.stderr)
    export_truck(truck, folder, picture)
    print(f"model: {folder}")


def _schema(_: Options) -> None:
    print(json.dumps(truck_schema(), indent=1))


# Least and greatest number of words after the action, and what it does.
_ACTIONS: dict[str, tuple[int, int | None, Callable[[Options], None]]] = {
    "check": (1, None, _check),
    "show": (1, 1, _show),
    "compare": (2, None, _compare),
    "export": (2, 2, _export),
    "schema": (0, 0, _schema),
}
