"""Reads the objects of a road: buildings, barriers, poles, crossings. They are for pictures only.

Element and attribute names follow ASAM OpenDRIVE 1.6, chapter 11. An object that cannot be read is
left out with a note, because no drive depends on it.
"""

from __future__ import annotations

from dataclasses import dataclass
from xml.etree.ElementTree import Element

from iits_mj.core.errors import MapError
from iits_mj.road.xml_input import Reader

OBJECTS_MAX = 20_000  # of one road
CROSSINGS = ("crosswalk", "crossing")  # words in the kind or the name of a painted crossing


@dataclass(frozen=True)
class Corner:
    """A corner of an outline.

    Attributes:
      on_road: whether a and b are s and t of the road; else they are u and v of the object.
      a, b: its place [m]; z: above the road, or above the object's origin [m].
      height: of the outline here [m].
    """

    on_road: bool
    a: float
    b: float
    z: float
    height: float


@dataclass(frozen=True)
class Repeat:
    """Copies of an object along its road; a `distance` of 0 is one continuous object.

    Attributes:
      s, length: where the copies begin, and over which length [m]; distance: between them [m].
      t, z, width, height: (at the start, at the end) [m].
    """

    s: float
    length: float
    distance: float
    t: tuple[float, float]
    z: tuple[float, float]
    width: tuple[float, float]
    height: tuple[float, float]


@dataclass(frozen=True)
class MapObject:
    """An object on or beside a road.

    Attributes:
      kind, name: OpenDRIVE type and name in lower case.
      s, t, z: its place [m]; heading: against the road's [rad].
      length, width, height, radius: 0 where the file gives none [m].
      outlines: of its ground plan; repeats: of its copies.
    """

    kind: str
    name: str
    s: float
    t: float
    z: float = 0.0
    heading: float = 0.0
    length: float = 0.0
    width: float = 0.0
    height: float = 0.0
    radius: float = 0.0
    outlines: tuple[tuple[Corner, ...], ...] = ()
    repeats: tuple[Repeat, ...] = ()

    @property
    def is_crossing(self) -> bool:
        """Whether it is a painted crossing for pedestrians."""
        return any(word in f"{self.kind} {self.name}" for word in CROSSINGS)


def read_objects(place: Reader, parent: Element | None, notes: list[str]) -> tuple[MapObject, ...]:
    """Returns the objects of a road in the order of the file.

    Args:
      place: of the road in the file.
      parent: its `<objects>`, if there are some.
      notes: gets a line for each object that is left out.
    """
    found: list[MapObject] = []
    for item in () if parent is None else parent.findall("object"):
        if len(found) == OBJECTS_MAX:
            notes.append(f"{place.place}: only the first {OBJECTS_MAX} objects are drawn")
            break
        try:
            found.append(_read_object(place.within(f"object {item.get('id')!r}"), item))
        except MapError as error:
            notes.append(f"{error}; the object is left out of pictures")
    return tuple(found)


def _read_object(place: Reader, item: Element) -> MapObject:
    def size(name: str) -> float:
        return place.number(item, name, 0.0, low=0.0, high=1e4)

    outlines = [*item.findall("outlines/outline"), *item.findall("outline")]
    corners = (_corners(place, outline) for outline in outlines)
    return MapObject(
        kind=item.get("type", "").lower(),
        name=item.get("name", "").lower(),
        s=place.number(item, "s"),
        t=place.number(item, "t", 0.0),
        z=place.number(item, "zOffset", 0.0),
        heading=place.number(item, "hdg", 0.0),
        length=size("length"),
        width=size("width"),
        height=size("height"),
        radius=size("radius"),
        outlines=tuple(outline for outline in corners if len(outline) > 1),
        repeats=tuple(_read_repeat(place, repeat) for repeat in item.findall("repeat")),
    )


def _corners(place: Reader, outline: Element) -> tuple[Corner, ...]:
    found = []
    for item in outline:
        if item.tag not in ("cornerRoad", "cornerLocal"):
            continue
        on_road = item.tag == "cornerRoad"
        names = ("s", "t", "dz") if on_road else ("u", "v", "z")
        a, b, z = (place.number(item, name, 0.0) for name in names)
        found.append(Corner(on_road, a, b, z, place.number(item, "height", 0.0)))
    return tuple(found)


def _read_repeat(place: Reader, item: Element) -> Repeat:
    def pair(name: str) -> tuple[float, float]:
        start = place.number(item, f"{name}Start", 0.0)
        return start, place.number(item, f"{name}End", start)

    return Repeat(
        s=place.number(item, "s", 0.0),
        length=place.number(item, "length", 0.0, low=0.0),
        distance=place.number(item, "distance", 0.0, low=0.0),
        t=pair("t"),
        z=pair("zOffset"),
        width=pair("width"),
        height=pair("height"),
    )
