"""Draws an OpenDRIVE map from above: lanes by type, the truck's route, lights and road ids."""

from __future__ import annotations

import math
from collections.abc import Collection
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from iits_mj.core.arrays import FloatArray
from iits_mj.render.plots import INK, PALETTE, dress
from iits_mj.road import RoadMap, Route
from iits_mj.road.elements import DRIVING_TYPES, LaneSection, Road, lane_borders

STEP = 3.0  # [m] between samples of a border
SAMPLES_MAX = 400  # of one lane section
LABELS_MAX = 80  # roads; more ids would cover the map
LARGEST, SMALLEST = 14.0, 5.0  # [inch] of the picture's sides
_COLORS = {
    "driving": "#8a949e",
    "shoulder": "#c9ced3",
    "sidewalk": "#e3d9c6",
    "biking": "#d8a48f",
    "parking": "#b8c4d6",
    "median": "#bcd3b0",
    "other": "#e6e9ec",
}
_ODD, _ROUTE, _LIGHT = "#e9a03b", PALETTE[0], PALETTE[1]
_DRIVEN, _UNUSABLE = "driving lane", "driving lane that a truck cannot use"


def draw_map(road_map: RoadMap, route: Route | None, odd: Collection[str] = ()) -> Figure:
    """Returns a figure of the whole map in its own coordinates [m].

    Args:
      road_map: the map.
      route: is drawn as a line with an arrow; None: there is none.
      odd: ids of roads that a truck cannot drive.
    """
    shapes: dict[str, list[FloatArray]] = {}
    for road in road_map.roads.values():
        for start, end, section in road.section_spans():
            for kind, shape in _lanes(road, section, start, end):
                name = _UNUSABLE if kind == "driving" and road.id in odd else kind
                shapes.setdefault(name, []).append(shape)
    outlines = [shape for found in shapes.values() for shape in found]
    every = np.concatenate(outlines or [np.zeros((1, 2))])
    low, high = every.min(axis=0), every.max(axis=0)
    width, height = np.maximum(high - low, 1.0)
    scale = LARGEST / max(width, height)
    figure = Figure(
        figsize=(max(width * scale, SMALLEST) + 1.0, max(height * scale, SMALLEST) + 1.0),
        layout="constrained",
    )
    FigureCanvasAgg(figure)
    axes = figure.subplots()
    # Narrow lanes would vanish at the scale of a town without an outline.
    for name in sorted(shapes, key=lambda name: name in ("driving", _UNUSABLE)):
        color = _ODD if name == _UNUSABLE else _COLORS[name]
        axes.add_collection(PolyCollection(shapes[name], facecolor=color, edgecolor=color, lw=0.5))
    _draw_signals(axes, road_map)
    if route is not None:
        _draw_route(axes, route)
    if len(road_map.roads) <= LABELS_MAX:
        _label(axes, road_map)
    margin = 0.03 * max(width, height)
    axes.set_xlim(low[0] - margin, high[0] + margin)
    axes.set_ylim(low[1] - margin, high[1] + margin)
    axes.set_aspect("equal")
    axes.set_xlabel("x [m]", color=INK)
    axes.set_ylabel("y [m]", color=INK)
    dress(axes, f"{Path(road_map.name).name}: {len(road_map.roads)} roads")
    handles = [
        Patch(
            color=_ODD if name == _UNUSABLE else _COLORS[name],
            label=_DRIVEN if name == "driving" else name,
        )
        for name in shapes
    ]
    lines, labels = axes.get_legend_handles_labels()
    names = [str(handle.get_label()) for handle in handles]
    axes.legend([*lines, *handles], [*labels, *names], fontsize=8, loc="best")
    return figure


def _lanes(
    road: Road, section: LaneSection, start: float, end: float
) -> list[tuple[str, FloatArray]]:
    """Kind and outline (n, 2) of every lane of a section."""
    count = min(max(math.ceil((end - start) / STEP), 1) + 1, SAMPLES_MAX)
    s = np.linspace(start, end, count)
    line = road.plan.evaluate(s)
    found = []
    for side in (1, -1):
        borders = lane_borders(road, section, side)
        for lane in section.side(side):
            inside = borders[lane.id + side]
            edges = []
            for border in (inside, borders[lane.id]):
                t = border.evaluate(s)
                x = line.x - t * np.sin(line.heading)
                y = line.y + t * np.cos(line.heading)
                edges.append(np.column_stack((x, y)))
            kind = "driving" if lane.kind in DRIVING_TYPES else lane.kind
            kind = "shoulder" if kind in ("stop", "border") else kind
            kind = kind if kind in _COLORS else "other"
            found.append((kind, np.concatenate((edges[0], edges[1][::-1]))))
    return found


def _draw_signals(axes: Axes, road_map: RoadMap) -> None:
    lights = []
    for road in road_map.roads.values():
        for signal in road.signals:
            if signal.is_traffic_light:
                line = road.plan.evaluate([min(signal.s, road.length)])
                x = float(line.x[0]) - signal.t * math.sin(float(line.heading[0]))
                y = float(line.y[0]) + signal.t * math.cos(float(line.heading[0]))
                lights.append((x, y))
    if lights:
        x, y = np.array(lights).T
        axes.plot(x, y, "o", color=_LIGHT, markersize=3.5, linestyle="", label="traffic light")


def _draw_route(axes: Axes, route: Route) -> None:
    station = np.linspace(0.0, route.length, min(max(math.ceil(route.length / STEP), 2), 20_000))
    point = route.evaluate(station, route.lane_offset(0, station))
    axes.plot(point.x, point.y, color=_ROUTE, linewidth=1.6, label=f"route, {route.length:.0f} m")
    axes.plot(
        point.x[:1], point.y[:1], "o", color=_ROUTE, markersize=7, linestyle="", label="its begin"
    )
    ahead = max(len(station) // 50, 1)
    for at in np.linspace(0, len(station) - 1 - ahead, 8)[1:].astype(int):
        axes.annotate(
            "",
            xy=(point.x[at + ahead], point.y[at + ahead]),
            xytext=(point.x[at], point.y[at]),
            arrowprops={"arrowstyle": "-|>", "color": _ROUTE, "lw": 1.6},
        )


def _label(axes: Axes, road_map: RoadMap) -> None:
    for road in road_map.roads.values():
        if road.junction is not None:
            continue
        line = road.plan.evaluate([0.5 * road.length])
        axes.annotate(
            road.id,
            (float(line.x[0]), float(line.y[0])),
            color=INK,
            fontsize=8,
            ha="center",
            va="center",
            bbox={"boxstyle": "round,pad=0.15", "fc": "white", "ec": "none", "alpha": 0.8},
        )
