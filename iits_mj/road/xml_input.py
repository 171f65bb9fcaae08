"""Reads XML from files that may be hostile, and numbers from attributes that may be wrong.

The standard parser is used through expat's own handlers: a document type declaration (and with it
every entity) is refused before anything of it is expanded.
"""

from __future__ import annotations

import hashlib
import math
from pathlib import Path
from typing import NoReturn
from xml.etree.ElementTree import Element, TreeBuilder
from xml.parsers import expat

from iits_mj.core.errors import MapError
from iits_mj.road.elements import Lane, LaneSection, RoadMark
from iits_mj.road.polynomials import Cubic

SIZE_LIMIT = 256 * 2**20
DEPTH_LIMIT = 64


def read_file(path: Path, size_limit: int = SIZE_LIMIT) -> bytes:
    """Content of a map file.

    Raises:
      MapError: it is missing, empty, no regular file, unreadable or larger than `size_limit`.
    """
    try:
        if not path.exists():
            raise MapError(f"{path}: there is no such file")
        if not path.is_file():
            raise MapError(f"{path}: is not a regular file; give an OpenDRIVE file (.xodr)")
        size = path.stat().st_size
        if size > size_limit:
            raise MapError(
                f"{path}: {size / 2**20:.0f} MB is too large for a map; "
                f"the limit is {size_limit / 2**20:.0f} MB"
            )
        content = path.read_bytes()
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise MapError(f"{path}: cannot be read: {reason}") from error
    if not content.strip():
        raise MapError(f"{path}: the file is empty; an OpenDRIVE file (.xodr) is wanted")
    return content


def content_hash(content: bytes) -> str:
    """SHA-256 of a file's content, in hexadecimal."""
    return hashlib.sha256(content).hexdigest()


def parse_xml(content: bytes, source: str) -> Element:
    """Root element of an XML document; `source` names it in errors.

    Raises:
      MapError: not well-formed, nested too deeply, or with a document type declaration.
    """
    parser = expat.ParserCreate()
    parser.buffer_text = True
    builder = TreeBuilder()
    depth = 0

    def refuse(*_: object) -> NoReturn:
        raise MapError(
            f"{source}: line {parser.CurrentLineNumber}: document type and entity declarations "
            "are refused, because they can hide an entity bomb; remove the DOCTYPE"
        )

    def start(tag: str, attributes: dict[str, str]) -> None:
        nonlocal depth
        depth += 1
        if depth > DEPTH_LIMIT:
            raise MapError(
                f"{source}: line {parser.CurrentLineNumber}: elements are nested deeper than "
                f"{DEPTH_LIMIT} levels; OpenDRIVE needs fewer than 20"
            )
        # OpenDRIVE 1.7 files may carry a default namespace; the local name is enough here.
        builder.start(tag.rpartition(":")[2], attributes)

    def end(tag: str) -> None:
        nonlocal depth
        depth -= 1
        builder.end(tag.rpartition(":")[2])

    parser.StartDoctypeDeclHandler = refuse
    parser.EntityDeclHandler = refuse
    parser.StartElementHandler = start
    parser.EndElementHandler = end
    parser.CharacterDataHandler = builder.data
    try:
        parser.Parse(content, True)
    except expat.ExpatError as error:
        reason = expat.ErrorString(error.code)
        raise MapError(
            f"{source}: line {error.lineno}: is not well-formed XML: {reason}"
        ) from error
    except (LookupError, ValueError) as error:
        raise MapError(f"{source}: is not readable as XML text: {error}") from error
    return builder.close()


class Reader:
    """Reads attributes of elements and says, when one is wrong, where it stands."""

    def __init__(self, place: str) -> None:
        """`place` opens every error message: file, road, lane."""
        self.place = place

    def within(self, what: str) -> Reader:
        """A reader whose messages name one more level."""
        return Reader(f"{self.place}: {what}")

    def fail(self, message: str) -> NoReturn:
        """Raises MapError at this place."""
        raise MapError(f"{self.place}: {message}")

    def text(self, element: Element, name: str, default: str | None = None) -> str:
        """An attribute as text; without a default it must be there."""
        value = element.get(name, default)
        if value is None:
            self.fail(f"<{element.tag}> has no attribute {name!r}")
        return value

    def number(
        self,
        element: Element,
        name: str,
        default: float | None = None,
        low: float = -1e8,
        high: float = 1e8,
    ) -> float:
        """An attribute as a finite number within [low, high]."""
        value = element.get(name)
        if value is None or (not value.strip() and default is not None):
            if default is None:
                self.fail(f"<{element.tag}> has no attribute {name!r}")
            return default
        try:
            number = float(value)
        except ValueError:
            self.fail(f"<{element.tag} {name}={value[:40]!r}> is not a number")
        if not math.isfinite(number) or not low <= number <= high:
            self.fail(
                f"<{element.tag} {name}={value[:40]!r}> is not allowed; "
                f"it must be a finite number within [{low:g}, {high:g}]"
            )
        return number

    def integer(self, element: Element, name: str) -> int:
        """An attribute as an integer that fits a lane id."""
        number = self.number(element, name, low=-1000, high=1000)
        if number != int(number):
            self.fail(f"<{element.tag} {name}={element.get(name)!r}> is not a whole number")
        return int(number)


# --- Parses the <lanes> of an OpenDRIVE road: sections, widths or borders, paint, limits, friction

_UNITS = {"m/s": 1.0, "km/h": 1.0 / 3.6, "mph": 0.44704}
_UNLIMITED = ("no limit", "undefined")


def read_lanes(place: Reader, lanes: Element, road_length: float) -> tuple[LaneSection, ...]:
    """Lane sections of a road in order of s.

    Raises:
      MapError: there is none, or one is wrong.
    """
    sections = [_read_section(place, item) for item in lanes.findall("laneSection")]
    sections.sort(key=lambda section: section.s)
    sections = [section for section in sections if section.s < road_length]
    if not sections:
        place.fail("has no <laneSection>")
    return tuple(sections)


def read_speed(place: Reader, record: Element) -> float:
    """A limit [m/s]; infinite for "no limit"."""
    if record.get("max", "").strip().lower() in _UNLIMITED:
        return math.inf
    unit = record.get("unit", "m/s")
    if unit not in _UNITS:
        place.fail(f"<speed unit={unit!r}> must be one of {', '.join(_UNITS)}")
    return place.number(record, "max", low=0.0, high=1000.0) * _UNITS[unit]


def _read_section(place: Reader, item: Element) -> LaneSection:
    s = place.number(item, "s", low=0.0)
    where = place.within(f"lane section at s = {s:g}")
    lanes: list[Lane] = []
    for side, sign in (("left", 1), ("center", 0), ("right", -1)):
        group = item.find(side)
        for element in () if group is None else group.findall("lane"):
            lane = _read_lane(where, element)
            if (lane.id > 0) - (lane.id < 0) != sign:
                where.fail(f"lane {lane.id} stands in <{side}>")
            if any(other.id == lane.id for other in lanes):
                where.fail(f"lane {lane.id} is defined twice")
            lanes.append(lane)
    lanes.sort(key=lambda lane: -lane.id)
    return LaneSection(s, tuple(lanes))


def _read_lane(place: Reader, element: Element) -> Lane:
    identity = place.integer(element, "id")
    where = place.within(f"lane {identity}")
    widths = _read_cubics(where, element, "width")
    borders = _read_cubics(where, element, "border")
    # Some writers give borders as distances; t is negative on the right.
    if identity < 0 and borders and all(record.a >= 0.0 for record in borders):
        borders = tuple(Cubic(r.start, -r.a, -r.b, -r.c, -r.d) for r in borders)
    if identity != 0 and not widths and not borders:
        where.fail("has neither <width> nor <border>")
    return Lane(
        id=identity,
        kind=element.get("type", "none"),
        widths=widths if identity else (),
        borders=borders if identity and not widths else (),
        marks=tuple(_read_mark(where, mark) for mark in element.findall("roadMark")),
        speeds=tuple(
            (_offset(where, record), read_speed(where, record))
            for record in element.findall("speed")
        ),
        frictions=tuple(
            (_offset(where, record), where.number(record, "friction", low=0.0, high=2.0))
            for record in element.findall("material")
            if record.get("friction") is not None
        ),
        predecessor=_lane_link(where, element, "predecessor"),
        successor=_lane_link(where, element, "successor"),
    )


def _offset(place: Reader, record: Element) -> float:
    return place.number(record, "sOffset", 0.0, low=0.0)


def _read_cubics(place: Reader, element: Element, tag: str) -> tuple[Cubic, ...]:
    records = (
        Cubic(
            _offset(place, record),
            place.number(record, "a"),
            *(place.number(record, name, 0.0) for name in ("b", "c", "d")),
        )
        for record in element.findall(tag)
    )
    return tuple(sorted(records, key=lambda cubic: cubic.start))


def _read_mark(place: Reader, mark: Element) -> RoadMark:
    return RoadMark(
        start=_offset(place, mark),
        kind=mark.get("type", "none"),
        width=place.number(mark, "width", 0.12, low=0.0, high=10.0),
        color=mark.get("color", "standard"),
    )


def _lane_link(place: Reader, element: Element, name: str) -> int | None:
    link = element.find("link")
    target = None if link is None else link.find(name)
    return None if target is None else place.integer(target, "id")
