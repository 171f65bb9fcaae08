"""Check an OpenDRIVE map, convert another map to OpenDRIVE, or make a map of a table.

  iits-mj road check MAP                  read the map, find a route, make SUMO's net, draw it
  iits-mj road check MAP --route turns:left,straight
  iits-mj road convert MAP OUT.xodr       from OpenStreetMap (.osm) or a SUMO net (.net.xml)
  iits-mj road convert MAP OUT.xodr --heights z.csv
  iits-mj road make TABLE OUT.xodr        from stations or points (.csv) or a design (.toml)

A drive takes .osm and .net.xml files in place of OpenDRIVE, too. Columns of a table: s_m with
curvature_1pm and heading_rad, or x_m and y_m; z_m, superelevation_rad, lanes, oncoming_lanes,
lane_width_m, speed_limit_mps. Columns of heights: z_m with s_m of the route, with x_m and y_m of
the map, or with easting_m and northing_m of its projection.

Exit code: 0 when the truck can drive on the map, with or without warnings; 1 when only a drive
without traffic is possible, because netconvert cannot make a net of the map; 2 when the map, or the
route on it, cannot be used.
"""

from __future__ import annotations

import json as json_module
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

import iits_mj
from iits_mj.commands.output import prepare_file
from iits_mj.core.errors import InputError, MapError, TrafficError
from iits_mj.core.options import option
from iits_mj.core.output_files import OutputFile
from iits_mj.core.progress import task
from iits_mj.road import RoadMap, Route
from iits_mj.road.design import Design, build
from iits_mj.road.elements import OpenDriveMap
from iits_mj.road.measured import road_from_csv
from iits_mj.road.route_choice import route_option
from iits_mj.road.writer import write

DPI = 110
SHOWN = 12  # notes of a kind in the text; --json has all
_LEFT_OUT = ("left out", "ignored", "not used", "only the first")
_KINDS = {
    "repaired": "repaired or assumed",
    "left_out": "left out",
    "not_driven": "not driven",
}


@dataclass(frozen=True, kw_only=True)
class Options:
    """Flags of `iits-mj road`."""

    what: str = option(
        help="what to do", choices=("check", "convert", "make"), positional=True, metavar="WHAT"
    )
    map: Path = option(help="map, or table of make", positional=True, metavar="FILE")
    out: Path | None = option(
        None, help="OpenDRIVE map that convert and make write", positional=True, metavar="OUT.xodr"
    )
    route: str | None = route_option()
    heights: Path | None = option(
        None,
        help="heights for convert: a CSV table, or a GeoTIFF over longitude and latitude; without "
        "it those of the map",
        metavar="FILE",
        group="road",
    )
    left_hand: bool = option(
        False, help="vehicles drive on the left on the OpenStreetMap roads of convert", group="road"
    )
    line: str = option(
        "lane",
        help="line that the table of make describes: the middle of the rightmost lane, or the "
        "center line between the directions of travel",
        choices=("lane", "center"),
        group="road",
    )
    net: bool = option(True, help="make SUMO's net of the map, too", group="traffic")
    picture: Path | None = option(
        None,
        help="picture of the map that check draws; without it the map's name with .png, in the "
        "current folder",
        metavar="FILE.png",
        group="output",
    )
    json: bool = option(False, help="print the findings as one JSON object", group="output")


def run(options: Options) -> int:
    """Checks, converts or makes a map; returns the exit code.

    Raises:
      InputError: the map has no such route, a table cannot be used, or an output cannot be written.
      MapError: the map cannot be used.
      TrafficError: netconvert, which converts maps, is missing or does not end.
    """
    if options.what == "check":
        if options.out is not None:
            raise InputError(f"road check writes no map: {options.out}")
        return _check(options)
    if options.out is None or options.out.suffix != ".xodr":
        raise InputError(f"road {options.what} needs the file to write: OUT.xodr")
    prepare_file(options.out, "OUT.xodr")
    if options.what == "convert":
        from traffic_bridge.network.map_sources import convert

        with task("converting the map"):
            content = convert(options.map, options.left_hand, options.heights, options.route)
    elif options.map.suffix == ".toml":
        content = build(Design.load(options.map))
    else:
        content = road_from_csv(options.map, centered=options.line == "center")
    return _write(content, options)


def _write(content: OpenDriveMap, options: Options) -> int:
    """Writes a map, reads it back and prints what it is."""
    assert options.out is not None
    write(content, options.out)
    road_map = RoadMap.from_opendrive(options.out)
    route = road_map.route(along=options.route)
    places = np.array([[g.x, g.y] for road in content.roads for g in road.geometries])
    low, high = places.min(axis=0), places.max(axis=0)
    found: dict[str, Any] = {
        "out": str(options.out),
        "roads": len(content.roads),
        "length_m": round(sum(road.length for road in content.roads), 1),
        "route_m": round(route.length, 1),
        "x_m": [round(float(low[0]), 1), round(float(high[0]), 1)],
        "y_m": [round(float(low[1]), 1), round(float(high[1]), 1)],
        "origin_m": list(content.offset),
        "projection": " ".join(content.geo_reference.split()),
    }
    if options.json:
        head = {"command": f"road {options.what}", "version": iits_mj.__version__}
        print(json_module.dumps(head | found))
        return 0
    print(f"{options.out}: {found['roads']} roads, {found['length_m'] / 1000.0:.2f} km in total")
    print(f"route           {route.length:.0f} m")
    print("starts of roads x {:g} to {:g} m, y {:g} to {:g} m".format(*found["x_m"], *found["y_m"]))
    if content.geo_reference:
        x, y = content.offset
        print(f"origin          {x:.2f}, {y:.2f} m in {found['projection']}")
    return 0


def _check(options: Options) -> int:
    # Loads matplotlib and SUMO's net.
    from iits_mj.render.map_drawing import draw_map
    from traffic_bridge.network.map_sources import read_map

    picture = Path(f"{options.map.stem}.png") if options.picture is None else options.picture
    prepare_file(picture, "--picture")
    with task("reading the map"):
        road_map = read_map(options.map)
    route, refused = None, ""
    try:
        with task("finding a route"):
            route = road_map.route(along=options.route)
    except MapError as error:
        refused = str(error)
    notes = sort_notes(road_map.notes if route is None else route.notes)
    with task("drawing the map"), OutputFile(picture, "picture") as partial:
        draw_map(road_map, route, road_map.unusable()).savefig(partial, dpi=DPI, format="png")
    if route is None:
        print(f"picture: {picture}")
        raise MapError(refused)
    net = _net(road_map) if options.net else "not made"
    found = findings(road_map, route) | {
        "map": str(options.map),
        "net": net,
        "picture": str(picture),
    }
    if options.json:
        head = {"command": "road check", "version": iits_mj.__version__}
        print(json_module.dumps(head | found | {"notes": notes}))
    else:
        print(_text(found, notes))
    return 1 if net.startswith("refused") else 0


def sort_notes(notes: tuple[str, ...]) -> dict[str, list[str]]:
    """Returns the notes of a map by what they report: `repaired`, `left_out`, `not_driven`."""
    found: dict[str, list[str]] = {kind: [] for kind in _KINDS}
    for note in notes:
        kind = "left_out" if any(words in note for words in _LEFT_OUT) else "repaired"
        kind = "not_driven" if note.startswith("not driven: ") else kind
        found[kind].append(note.removeprefix("not driven: ").removeprefix("left out: "))
    return found


def findings(road_map: RoadMap, route: Route) -> dict[str, Any]:
    """Returns the figures of a map and of a route on it, by name with the unit."""
    roads = road_map.roads.values()
    steps = [seam.step for seam in route.chain.seams]
    return {
        "map": str(road_map.path),
        "roads": len(roads),
        "length_m": round(sum(road.length for road in roads), 1),
        "junctions": len(road_map.content.junctions),
        "traffic": "left-hand" if road_map.left_hand else "right-hand",
        "lights": sum(signal.is_traffic_light for road in roads for signal in road.signals),
        "signs": sum(not signal.is_traffic_light for road in roads for signal in road.signals),
        "route": [f"{part.road_id}:{part.direction:+d}" for part in route.segments],
        "route_m": round(route.length, 1),
        "blended_steps": len(steps),
        "blended_place_m": round(max((math.hypot(*step[0, :2]) for step in steps), default=0.0), 3),
        "blended_height_m": round(max((abs(float(step[0, 2])) for step in steps), default=0.0), 3),
        "blended_heading_deg": round(
            math.degrees(max((math.hypot(*step[1, :2]) for step in steps), default=0.0)), 2
        ),
        "grade_max_percent": round(100.0 * float(np.abs(route.table(5.0)[:, 5]).max()), 1),
    }


def _net(road_map: RoadMap) -> str:
    from traffic_bridge import build_network

    try:
        with task("making SUMO's net"):
            net = build_network(road_map)
    except (MapError, TrafficError) as error:
        return f"refused: {str(error).removeprefix(f'{road_map.path}: ')}"
    return f"{len(net.lanes)} lanes, {len(net.lights)} lights"


def _text(found: dict[str, Any], notes: dict[str, list[str]]) -> str:
    roads = found["route"]
    shown = ", ".join(roads[:SHOWN]) + (
        f" and {len(roads) - SHOWN} more" if len(roads) > SHOWN else ""
    )
    rows = [
        ("map", found["map"]),
        ("roads", f"{found['roads']}, {found['length_m'] / 1000.0:.2f} km in total"),
        ("junctions", str(found["junctions"])),
        ("traffic", found["traffic"]),
        ("lights, signs", f"{found['lights']}, {found['signs']}"),
        (
            "route",
            f"{found['route_m']:.0f} m on {len(roads)} road{'s' * (len(roads) > 1)}: {shown}",
        ),
        ("steepest grade", f"{found['grade_max_percent']:g} %"),
        (
            "blended steps",
            f"{found['blended_steps']} on the route; at most {found['blended_place_m']:g} m in "
            f"place, {found['blended_height_m']:g} m in height, "
            f"{found['blended_heading_deg']:g} degrees",
        ),
        ("SUMO's net", found["net"]),
    ]
    lines = [f"{name.ljust(16)}{value}" for name, value in rows]
    for kind, title in _KINDS.items():
        lines += [f"{title}: {len(notes[kind]) or 'nothing'}"]
        lines += [f"  {note}" for note in notes[kind][:SHOWN]]
        if len(notes[kind]) > SHOWN:
            lines += [f"  and {len(notes[kind]) - SHOWN} more; --json lists all"]
    return "\n".join([*lines, f"picture: {found['picture']}"])
