"""An OpenStreetMap extract written by hand: a main road with a crossing and a side road."""

from __future__ import annotations

from pathlib import Path

NODES = {
    1: (48.0000, 10.9950),
    2: (48.0002, 10.9975),
    3: (48.0008, 11.0000),
    4: (48.0010, 11.0030),
    5: (48.0004, 11.0060),
    6: (48.0000, 11.0090),
    7: (48.0030, 11.0001),
    8: (47.9985, 10.9999),
    9: (48.0025, 11.0062),
}
"""Latitude and longitude [degrees] by id; traffic lights stand at node 3."""
LIGHT = 3
WAYS = {
    100: ((1, 2, 3, 4, 5, 6), {"highway": "primary", "maxspeed": "70"}),
    101: ((7, 3, 8), {"highway": "secondary", "maxspeed": "50"}),
    102: ((9, 5), {"highway": "residential", "maxspeed": "30"}),
    103: ((7, 9), {"highway": "footway"}),
}


def write_osm(path: Path, ways: dict = WAYS) -> Path:
    nodes = [
        f'<node id="{name}" lat="{lat}" lon="{lon}">'
        + ('<tag k="highway" v="traffic_signals"/>' if name == LIGHT else "")
        + "</node>"
        for name, (lat, lon) in NODES.items()
    ]
    roads = [
        f'<way id="{name}">'
        + "".join(f'<nd ref="{node}"/>' for node in ids)
        + "".join(f'<tag k="{k}" v="{v}"/>' for k, v in tags.items())
        + "</way>"
        for name, (ids, tags) in ways.items()
    ]
    path.write_text(f'<osm version="0.6">{"".join(nodes + roads)}</osm>')
    return path
