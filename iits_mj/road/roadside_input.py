"""Parses what stands along an OpenDRIVE road: signals, tunnels, bridges."""

from __future__ import annotations

from xml.etree.ElementTree import Element

from iits_mj.road.elements import Signal, Structure
from iits_mj.road.xml_input import Reader


def read_signals(place: Reader, signals: Element | None) -> tuple[Signal, ...]:
    """Signs and traffic lights in the order of the file."""
    result = []
    for item in () if signals is None else signals.findall("signal"):
        identity = place.text(item, "id")
        where = place.within(f"signal {identity!r}")
        value = item.get("value")
        result.append(
            Signal(
                id=identity,
                s=where.number(item, "s", low=0.0),
                t=where.number(item, "t", 0.0),
                kind=item.get("type", ""),
                subtype=item.get("subtype", ""),
                country=item.get("country", ""),
                name=item.get("name", ""),
                dynamic=item.get("dynamic", "no") == "yes",
                orientation=item.get("orientation", "none"),
                value=where.number(item, "value") if value and value.strip() else None,
                unit=item.get("unit", ""),
                z_offset=where.number(item, "zOffset", 0.0),
                height=where.number(item, "height", 0.0),
                width=where.number(item, "width", 0.0),
            )
        )
    return tuple(result)


def read_structures(place: Reader, objects: Element | None) -> tuple[Structure, ...]:
    """Tunnels and bridges in order of s."""
    result = []
    for item in () if objects is None else objects:
        if item.tag not in ("tunnel", "bridge"):
            continue
        identity = place.text(item, "id")
        where = place.within(f"{item.tag} {identity!r}")
        result.append(
            Structure(
                kind=item.tag,
                id=identity,
                s=where.number(item, "s", low=0.0),
                length=where.number(item, "length", low=0.0),
                name=item.get("name", ""),
                subtype=item.get("type", "standard"),
            )
        )
    return tuple(sorted(result, key=lambda structure: structure.s))
