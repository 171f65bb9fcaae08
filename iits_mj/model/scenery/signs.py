"""Traffic signs and traffic lights as meshes: pole, mast arm, plate or housing.

Signs are recognized by their number in the German catalog of signs (StVO), which OpenDRIVE maps
use, or by their name; any other sign is a plain white plate.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from iits_mj.core.arrays import FloatArray
from iits_mj.core.units import KMH
from iits_mj.model.visuals.shapes import Shape, beam, boxes, merge, prism
from iits_mj.road.elements import PEDESTRIAN_LIGHT, Signal

PLATE = 0.6  # [m] width of a sign without one
PLATE_BOTTOM = 2.0  # [m] above the road where the map gives no height
LIGHT_TOP, OVERHEAD_TOP = 3.3, 6.2  # [m] of a traffic light beside, and above, the road
POLE = 0.09
HEAD = (0.34, 0.26, 0.95)  # [m] width, depth and height of a housing with three lamps
LAMPS = ("road_lamp_red", "road_lamp_yellow", "road_lamp_green")
# Corners, turn [deg], outer and inner material, share of the inner plate, by words of the sign.
_PLATES = (
    (("274", "speed", "hoechst", "maximum"), (24, 0.0, "road_sign_red", "road_sign_white", 0.78)),
    (("206", "stop"), (8, 22.5, "road_sign_white", "road_sign_red", 0.92)),
    (("205", "yield", "giveway"), (3, -90.0, "road_sign_red", "road_sign_white", 0.62)),
    (("306", "priority"), (4, 0.0, "road_sign_white", "road_sign_yellow", 0.72)),
    (("209", "211", "222", "arrow"), (24, 0.0, "road_sign_blue", "road_sign_white", 0.3)),
)
_SPEED = _PLATES[0][0]
# Bars of a digit in a box 1 high: middle in x and z, width, height; those that each digit has.
_BAR = 0.15
_BARS = [
    *[(0.0, z, 0.5, _BAR) for z in (0.925, 0.5, 0.075)],
    *[(x, z, _BAR, 0.5) for z in (0.75, 0.25) for x in (-0.2, 0.2)],
]
_DIGITS = ("023456", "46", "01245", "01246", "1346", "01236", "012356", "046", "0123456", "012346")
_DIGIT_PITCH = 0.68  # of the height
_PLAIN_PLATE = (4, 45.0, "road_steel", "road_sign_white", 0.92)


def sign(
    signal: Signal,
    base: FloatArray,
    head: FloatArray,
    heading: float,
    station: float | None = None,
) -> Iterator[tuple[str, Shape]]:
    """Yields (material, shape) of a sign or a traffic light.

    Args:
      signal: of the map.
      base: foot of its pole on the road plane (3,) [m].
      head: point of the road plane below its face (3,) [m].
      heading: of its road [rad].
      station: of a traffic light that faces the route, on the route [m].
    """
    facing = heading + signal.heading + (0.0 if signal.orientation == "-" else np.pi)
    overhead = float(np.hypot(*(head - base)[:2])) > 0.3
    if signal.is_traffic_light:
        top, parts = _light(signal, overhead)
    else:
        top, parts = _plate(signal, overhead)
    c, s = np.sin(facing), -np.cos(facing)
    turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    for material, shape in parts:
        if material in LAMPS:
            material = lamp_name(material, signal.id, facing, station)
        yield material, Shape(shape.vertices @ turn.T + head, shape.faces)
    low, high = base - np.array([0.0, 0.0, 0.4]), base + np.array([0.0, 0.0, top])
    post = boxes([(0.5 * (low + high), (POLE, POLE, high[2] - low[2]))])
    if overhead:
        end = head + np.array([0.0, 0.0, top])
        post = merge([post, beam(high, end, POLE, POLE)])
    yield "road_steel", post


class Lamp(NamedTuple):
    """A lamp of a traffic light: its material, the light's signal, and where it is.

    `facing` is the direction that it faces [rad]; `station` is its place on the route if it faces
    the route [m], else NaN.
    """

    material: str
    facing: float
    station: float
    signal: str


def lamp_name(material: str, signal: str, facing: float, station: float | None = None) -> str:
    """Name of the geom of a lamp, from which `lamp_of` reads it."""
    facing = (facing + np.pi) % (2.0 * np.pi) - np.pi
    return f"{material}@{facing:.2f}@{np.nan if station is None else station:.1f}@{signal}"


def lamp_of(name: str) -> Lamp | None:
    """The lamp of a geom that has a `lamp_name`; None for other geoms."""
    parts = name.rsplit("_map_", 1)[0].split("@", 3)
    return Lamp(parts[0], float(parts[1]), float(parts[2]), parts[3]) if len(parts) == 4 else None


def _light(signal: Signal, overhead: bool) -> tuple[float, list[tuple[str, Shape]]]:
    """Height of the pole, and the housing with its lamps; it faces +y."""
    top = signal.z_offset + signal.height
    top = OVERHEAD_TOP if overhead else (top if 2.2 < top < 12.0 else LIGHT_TOP)
    lamps = (LAMPS[0], LAMPS[2]) if signal.kind == PEDESTRIAN_LIGHT else LAMPS
    width, depth, full = HEAD
    height = full * len(lamps) / 3.0
    middle = top - 0.5 * height
    parts = [
        ("road_lamp_housing", boxes([((0.0, 0.5 * depth, middle), (width, depth, height))])),
    ]
    # A map may place both kinds of lights on one pole.
    aside = np.array([width if signal.kind == PEDESTRIAN_LIGHT else 0.0, 0.0, 0.0])
    for place, material in enumerate(lamps):
        z = top - (place + 0.5) * full / 3.0
        parts.append((material, prism(_polygon(12, 0.0, 0.11, z), depth, 0.02)))
    return top, [(material, shape.moved(aside)) for material, shape in parts]


def _plate(signal: Signal, overhead: bool) -> tuple[float, list[tuple[str, Shape]]]:
    """Height of the pole, and the plate; it faces +y."""
    words = f"{signal.kind} {signal.name.lower()}"
    corners, turn, outer, inner, share = next(
        (plate for keys, plate in _PLATES if any(key in words for key in keys)), _PLAIN_PLATE
    )
    width = min(signal.width, 4.0) if signal.width > 0.1 else PLATE
    bottom = signal.z_offset if 1.0 < signal.z_offset < 10.0 else PLATE_BOTTOM
    if overhead:
        bottom = OVERHEAD_TOP - width
    middle = bottom + 0.5 * width
    radius = 0.5 * width / (np.cos(np.pi / 4.0) if corners == 4 and turn else 1.0)
    parts = [
        (outer, prism(_polygon(corners, turn, radius, middle), 0.05, 0.02)),
        (inner, prism(_polygon(corners, turn, share * radius, middle), 0.07, 0.01)),
    ]
    if any(key in words for key in _SPEED) and (number := _limit(signal)):
        parts.append(("road_sign_black", _number(number, middle, radius)))
    return middle + 0.4 * width, parts


def _limit(signal: Signal) -> str:
    """The number on a speed sign, "" without one: km/h where the map has m/s."""
    value = signal.value
    if value is None:
        # Maps without a value often have it in the name, as in "Sign_Speed_60".
        return next(iter(re.findall(r"\d+", signal.name)), "")[:3]
    value = value / KMH if signal.unit == "m/s" else value
    return f"{value:.0f}" if 0.0 < value < 1000.0 else ""


def _number(digits: str, middle: float, radius: float) -> Shape:
    """Digits on a plate of a radius about the height `middle`; the plate faces +y."""
    size = radius * (0.8 if len(digits) < 3 else 0.62)
    parts = []
    for place, digit in enumerate(digits):
        # Seen from +y, x runs to the left.
        across = (0.5 * (len(digits) - 1) - place) * _DIGIT_PITCH
        for bar in _DIGITS[int(digit)]:
            x, z, width, height = _BARS[int(bar)]
            center = (size * (across - x), 0.085, middle + size * (z - 0.5))
            parts.append((center, (size * width, 0.01, size * height)))
    return boxes(parts)


def _polygon(corners: int, turn: float, radius: float, middle: float) -> FloatArray:
    """A regular polygon (n, 2) in x and z about the height `middle`, turned by degrees."""
    angle = 2.0 * np.pi * np.arange(corners) / corners + np.radians(turn)
    return np.stack([radius * np.cos(angle), middle + radius * np.sin(angle)], axis=-1)
