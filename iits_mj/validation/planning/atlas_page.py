"""The atlas of savings as a page: a picture, the middle cells, and all cells as a table file."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from iits_mj.core.output_files import write_whole
from iits_mj.core.tables import write_rows
from iits_mj.render import plots
from iits_mj.render.plots import GRID, INK, PALETTE
from iits_mj.validation.planning.pcc_atlas import (
    BANDS,
    MASSES,
    MIDDLE,
    WINDS,
    Atlas,
    AtlasRow,
    Cell,
    DrivenRow,
)

_DPI = 130
_NEAR = 0.5  # difference of driven and expected savings that counts as agreement [points]
_WIND_NAMES = {0.0: "calm", 6.0: "head\n6 m/s", -6.0: "tail\n6 m/s"}


def one_at_a_time() -> list[tuple[str, Cell]]:
    """Returns a short name and the cell for each mass, band and wind around the middle."""
    mass, band, wind = MIDDLE
    found: list[tuple[str, Cell]] = [(f"{m / 1e3:.0f} t", (m, band, wind)) for m in MASSES]
    found += [(f"{b[1]:g} to\n{b[2]:g}", (mass, b, wind)) for b in BANDS]
    return found + [(_WIND_NAMES[w], (mass, band, w)) for w in WINDS]


def row_at(atlas: Atlas, road: str, cell: Cell) -> AtlasRow | None:
    """Returns the row of a road's cell, None if the atlas lacks it."""
    mass, band, wind = cell
    key = road, mass, band[0], wind
    return next((row for row in atlas.rows if row.key == key), None)


def draw_atlas(atlas: Atlas) -> Figure:
    """Returns the picture: savings of the middle cells, and what mass, band and wind change."""
    middle = atlas.middle
    figure = Figure(figsize=(12.5, 1.6 + 0.42 * len(middle)), layout="constrained")
    FigureCanvasAgg(figure)
    left, right = figure.subplots(1, 2, sharey=True, width_ratios=(1.25, 1.0))
    _draw_middle(left, atlas, middle)
    _draw_changes(right, atlas, middle)
    return figure


def _draw_middle(ax: Axes, atlas: Atlas, middle: Sequence[AtlasRow]) -> None:
    place = np.arange(len(middle))

    def values(name: str) -> list[float]:
        return [float(getattr(row, name)) for row in middle]

    low, joint, high = (np.array(values(name)) for name in ("low", "joint", "high"))
    ax.hlines(place, values("alone"), values("bound"), color=GRID, linewidth=9, zorder=1)
    ax.plot(values("alone"), place, "|", color=PALETTE[0], markersize=13, label="speed alone")
    ax.errorbar(
        joint,
        place,
        xerr=np.maximum([joint - low, high - joint], 0.0),
        fmt="o",
        color=PALETTE[0],
        markersize=7,
        capsize=3,
        zorder=4,
        label="speed, gear and eco-roll",
    )
    ax.plot(values("bound"), place, "|", color=INK, markersize=13, label="no plan saves more")
    for cruise, color, label in (
        ("rolling", PALETTE[1], "driven on the MuJoCo truck"),
        ("braking", PALETTE[3], "the same against the braking cruise"),
    ):
        drives = [(i, atlas.on_truck(row.road, cruise)) for i, row in enumerate(middle)]
        points = [(drive.saving, i) for i, drive in drives if drive is not None]
        if points:
            ax.plot(*zip(*points, strict=True), "D", color=color, markersize=5, label=label)
    ax.plot(
        values("braking"),
        place,
        "o",
        markerfacecolor="none",
        color="#8a949e",
        label="against a cruise that brakes at its set speed (the paper's)",
    )
    ax.set_yticks(place, [row.road for row in middle])
    ax.set_xlabel("fuel saved at equal trip time [%]", color=INK)
    plots.dress(ax, "Against a cruise that rolls downhill; bars to the bound")
    ax.legend(loc="lower right", fontsize=8, frameon=False)


def _draw_changes(ax: Axes, atlas: Atlas, middle: Sequence[AtlasRow]) -> None:
    columns = one_at_a_time()
    table = np.full((len(middle), len(columns)), np.nan)
    for i, row in enumerate(middle):
        for j, (_, cell) in enumerate(columns):
            found = row_at(atlas, row.road, cell)
            if found is not None:
                table[i, j] = found.joint
                ax.text(
                    j,
                    i,
                    f"{max(found.joint, 0.0):.1f}",
                    ha="center",
                    va="center",
                    fontsize=8,
                    color=INK,
                )
    ax.imshow(table, aspect="auto", cmap="YlGnBu", vmin=0.0, vmax=30.0, alpha=0.7)
    ax.set_ylim(-0.5, len(middle) - 0.5)
    ax.set_xticks(range(len(columns)), [name for name, _ in columns], fontsize=8)
    for edge in (len(MASSES) - 0.5, len(MASSES) + len(BANDS) - 0.5):
        ax.axvline(edge, color="white", linewidth=4)
    plots.dress(ax, "The same saving by mass, band [km/h] and wind")
    ax.grid(False)
    ax.tick_params(axis="y", length=0)


def _number(value: float) -> str:
    return f"{value:.1f}".replace("-0.0", "0.0")


def _table(header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    lines = ["| " + " | ".join(row) + " |" for row in (header, ["---"] * len(header), *rows)]
    return "\n".join(lines)


def page_text(atlas: Atlas, picture: str, table: str, driven: str) -> str:
    """Returns the page as Markdown.

    Args:
      atlas: to show.
      picture: file name of the picture beside the page.
      table: file name of the table of cells beside the page.
      driven: file name of the table of drives beside the page.
    """
    mass, band, _ = MIDDLE
    drives = {(r.road, k): atlas.on_truck(r.road, k) for r in atlas.middle for k in _CRUISES}
    rows = []
    for row in reversed(atlas.middle):
        truck = [_driven(drives[row.road, kind]) for kind in _CRUISES]
        rows.append(
            [
                row.road,
                f"**{_number(row.joint)}**",
                f"{_number(row.low)} to {_number(row.high)}",
                _number(row.alone),
                _number(row.bound),
                f"{row.closed:.0f} %" if row.bound - row.alone > _LEAST_GAP else "-",
                f"{row.changes}, {row.cruise_changes}",
                _number(row.braking),
                *truck,
            ]
        )
    header = (
        "road",
        "saved [%]",
        "interval",
        "speed alone",
        "bound",
        "gap closed",
        "gear changes, plan and cruise",
        "against the braking cruise",
        "driven, rolling",
        "driven, braking",
    )
    columns = [name.replace("\n", " ") for name, _ in one_at_a_time()]
    changes = []
    for row in reversed(atlas.middle):
        found = [row_at(atlas, row.road, cell) for _, cell in one_at_a_time()]
        changes.append([row.road, *("-" if f is None else _number(f.joint) for f in found)])
    return _PAGE.format(
        mass=f"{mass / 1e3:.0f}",
        set_speed=f"{band[0]:g}",
        low=f"{band[1]:g}",
        high=f"{band[2]:g}",
        picture=picture,
        table=table,
        driven=driven,
        cells=len(atlas.rows),
        drives=len(atlas.driven),
        middle=_table(header, rows),
        changes=_table(["road", *columns], changes),
        notes="".join(f"- {note}\n" for note in (*_agreement(atlas.driven), *atlas.notes)),
    )


def _agreement(driven: Sequence[DrivenRow]) -> list[str]:
    """Returns sentences about driven and expected savings and trip times, none without drives."""
    apart = [abs(drive.saving - drive.expected) for drive in driven]
    if not apart:
        return []
    near = sum(difference <= _NEAR for difference in apart)
    latest = max(driven, key=lambda drive: abs(drive.late))
    return [
        f"Driven and expected savings are within {_NEAR:g} points of each other in {near} of "
        f"{len(apart)} comparisons, and within {_number(max(apart))} in all. Where a change of "
        "gear falls on a climb decides some tenths of a point.",
        "Trip times of driven plan and cruise differ the most on the road "
        f"{latest.road}, {latest.cruise} cruise: by {latest.late:+.1f} %.",
    ]


def _driven(drive: DrivenRow | None) -> str:
    if drive is None:
        return "-"
    return f"{_number(drive.saving)} (expected {_number(drive.expected)})"


def write_page(atlas: Atlas, path: Path) -> None:
    """Writes the page, its picture and the tables of all cells and drives beside it.

    Raises:
      InputError: a file cannot be written.
    """
    picture, table = path.with_suffix(".png"), path.with_suffix(".csv")
    driven = path.with_name(f"{path.stem}_driven.csv")
    write_rows(table, AtlasRow, atlas.rows, "atlas")
    write_rows(driven, DrivenRow, atlas.driven, "atlas")
    write_whole(picture, plots.to_png(draw_atlas(atlas), _DPI), "picture")
    write_whole(path, page_text(atlas, picture.name, table.name, driven.name).encode(), "page")


_CRUISES = ("rolling", "braking")
_LEAST_GAP = 0.15  # between the plan of speed alone and the bound [points]
_PAGE = """# Atlas of savings

How much fuel does predictive cruise control save? It depends on the road, and on the cruise
control that it is compared with. This page is written by

```sh
iits-mj pcc --atlas --roads roads --runs out/atlas --page docs/atlas.md
```

Every saving is at equal trip time and equal speed at both ends, with the same engine, brakes and
limits. The *rolling cruise* may roll up to the top of the band downhill; trucks of the last 15
years do this, and the saving against it is a fleet's. The *braking cruise* brakes at its set
speed; savings against it reproduce the paper's figure.

![Savings on each road against both cruises, with interval, bound and drives]({picture})

## The middle cells

{mass} t, set speed {set_speed} km/h, {low} to {high} km/h, calm. The interval is the range when
rolling resistance and drag area change by 10 % and the mass by 3 %, one at a time. No plan saves
more than the bound. "Gap closed" is the share of the gap between the plan of speed alone and the
bound that the plan of speed, gear and eco-roll closes. A driven saving is that of the MuJoCo truck
by its fuel meter, corrected for the differences of end speed and trip time: the plan against the
rolling cruise in its planned gears, all other drives with gears by load. Beside it stands the
saving to expect, by the same cruise and plan driven ahead on the
[kinematic plant](../iits_mj/plugin/README_plant.md), which takes no figure from the truck's drive.
On a truck a cruise changes gears on hills where the map's cruise needs no change; so a driven
saving may exceed the bound.

{middle}

## Mass, band and wind

Saved against the rolling cruise by speed, gear and eco-roll [%]; one of mass, band [km/h] and wind
differs from the middle cell.

{changes}

All {cells} cells are in [the table]({table}); [{drives} comparisons]({driven}) were driven.

## How the figures are made

- Plans, cruises and bounds are by the engine's map in the best gears; see [planning](planning.md).
- The long haul is the road of VECTO's cycle, 108 km. The EPA cycles are 20 km long and have nearly
  the same grades; all other roads are 15 km long. A share of the fuel says little where the road
  falls: the roads here end within 80 m of the height at which they begin.
- Physics of the driven cells: steps of 5 ms.
- The paper's road, the long haul and the EPA cycles are files that the package lacks or has for
  another purpose; [planning](planning.md) names them. The other roads are made by formula, or come
  with the package.
{notes}"""
