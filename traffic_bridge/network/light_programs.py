"""Corrects the traffic lights of nets: their programs, and lights in wrong places.

When a SUMO net becomes an OpenDRIVE map, netconvert writes a signal for each link of a light, named
LIGHT_LINK, and reads these names back. So each link of the driven net takes the letters of its link
in the source.
"""

from __future__ import annotations

import gzip
from collections.abc import Mapping
from pathlib import Path
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

import numpy as np

from iits_mj.road.elements import LightProgram, Road
from iits_mj.road.xml_input import Reader, parse_xml, read_file
from traffic_bridge.network.net_file import signals_of

NEAR = 20.0  # [m] from a node in which its signals stand
# Subtypes of netconvert's signals by SUMO's letter of the turn.
SUBTYPES = {"l": "10", "L": "10", "r": "20", "R": "20", "s": "30"}


def read_programs(net: Path, size_max: int) -> tuple[LightProgram, ...]:
    """Returns the programs of the lights of a SUMO net; of several for a light, the last one.

    Args:
      net: the file.
      size_max: bytes of it.

    Raises:
      MapError: the file cannot be read.
    """
    content = read_file(net, size_max)
    if net.name.lower().endswith(".gz"):
        with gzip.open(net) as file:
            content = file.read(size_max)
    reader, found = Reader(str(net)), {}
    for item in parse_xml(content, str(net)).findall("tlLogic"):
        name = reader.text(item, "id")
        phases = tuple(
            (reader.number(phase, "duration"), reader.text(phase, "state"))
            for phase in item.findall("phase")
        )
        if phases:
            found[name] = LightProgram(name, reader.number(item, "offset", 0.0), phases)
    return tuple(found.values())


def with_programs(text: str, programs: tuple[LightProgram, ...], roads: Mapping[str, Road]) -> str:
    """Returns a net whose lights have the programs of their source.

    A light keeps netconvert's program if a link of it is not in one program of the source: lights
    of crossings that the source does not have, or of two lights that netconvert has joined.

    Args:
      text: the net, made of the map.
      programs: of the source.
      roads: of the map, by id; their signals name the links of the source.
    """
    if not programs:
        return text
    root = ElementTree.fromstring(text)
    subtypes = {signal.id: signal.subtype for road in roads.values() for signal in road.signals}
    links: dict[str, dict[int, str]] = {}
    for link in root.findall("connection"):
        if light := link.get("tl"):
            links.setdefault(light, {})[int(link.attrib["linkIndex"])] = link.get("dir", "s")
    for item in root.findall("tlLogic"):
        sources = _sources(item, links.get(item.attrib["id"], {}), subtypes)
        for program in programs:
            length = len(program.phases[0][1])
            if sources and all(name == program.id and number < length for name, number in sources):
                _take(item, program, [number for _, number in sources])
    return ElementTree.tostring(root, encoding="unicode") + "\n"


def without_misplaced_lights(text: str, roads: Mapping[str, Road]) -> str:
    """Returns a net without lights at joints of two roads whose signals are elsewhere.

    Where lanes begin or end on a road, netconvert sets its signals at the wrong end of the part.
    The junction for which they are has its light all the same.

    Args:
      text: the net, made of the map.
      roads: of the map, by id.
    """
    root = ElementTree.fromstring(text)
    offset = [float(value) for value in root.findall("location")[0].attrib["netOffset"].split(",")]
    places = {}
    for road in roads.values():
        for signal in road.signals:
            point = road.plan.evaluate(signal.s)
            places[signal.id] = np.array([float(point.x), float(point.y)]) + offset
    nodes = {node.attrib["id"]: node for node in root.findall("junction")}
    links: dict[str, list[Element]] = {}
    for link in root.findall("connection"):
        if light := link.get("tl"):
            links.setdefault(light, []).append(link)
    dropped = False
    for item in root.findall("tlLogic"):
        node, own = nodes.get(item.attrib["id"]), links.get(item.attrib["id"], [])
        names = {name for some in signals_of(item).values() for name in some}
        signals = [places[name] for name in sorted(names & places.keys())]
        walks = {link.get("linkIndex") for link in own if link.attrib["from"].startswith(":")}
        ways = {(r.get("from"), r.get("to")) for r in own if r.get("linkIndex") not in walks}
        # Two roads meet: one way in each direction, straight on.
        joint = len(ways) <= 2 and len({start for start, _ in ways}) == len(ways)
        if node is None or not signals or not joint or any(link.get("dir") != "s" for link in own):
            continue
        apart = np.array(signals) - [float(node.attrib[key]) for key in ("x", "y")]
        if np.hypot(*apart.T).min() > NEAR:
            dropped = True
            root.remove(item)
            node.set("type", "priority")
            # Persons give way to vehicles, as at netconvert's other crossings without a light.
            for request in node.findall("request"):
                foes = request.attrib["foes"]
                waits = request.get("index") in walks
                request.set("response", foes if waits else "0" * len(foes))
            for link in own:
                link.set("state", "m" if link.get("linkIndex") in walks else "M")
                for key in ("tl", "linkIndex"):
                    del link.attrib[key]
    return ElementTree.tostring(root, encoding="unicode") + "\n" if dropped else text


def _sources(
    item: Element, turns: Mapping[int, str], subtypes: Mapping[str, str]
) -> list[tuple[str, int]]:
    """Light and link of the source for each link of a program; empty if one is unknown."""
    signals, found = signals_of(item), []
    for number in range(len(item.findall("phase")[0].get("state", ""))):
        names = signals.get(number, ())
        wanted = SUBTYPES.get(turns.get(number, ""))
        chosen = [name for name in names if subtypes.get(name) == wanted] or names
        light, _, link = chosen[0].rpartition("_") if len(chosen) == 1 else ("", "", "")
        if not light or not link.isdigit():
            return []
        found.append((light, int(link)))
    return found


def _take(item: Element, program: LightProgram, numbers: list[int]) -> None:
    """Gives a light the phases of a program, with its links' letters in another order."""
    for phase in item.findall("phase"):
        item.remove(phase)
    item.set("type", "static")
    item.set("offset", f"{program.offset:g}")
    for place, (duration, state) in enumerate(program.phases):
        letters = "".join(state[number] for number in numbers)
        item.insert(place, Element("phase", duration=f"{duration:g}", state=letters))
