"""OpenDRIVE text of a crossing of two roads with sidewalks, and of a road over another."""

from __future__ import annotations

import math

from tests.road.opendrive_text import document, line, road

HALF = 12.0  # [m] from the middle of the crossing to the ends of its roads
ARM = 100.0
LANE, SIDEWALK = 3.5, 2.0
_MARK = '<roadMark sOffset="0" type="{}" color="{}" width="0.15"/>'


def lane(identity: int, kind: str, width: float, mark: str = "", color: str = "standard") -> str:
    paint = _MARK.format(mark, color) if mark else ""
    return (
        f'<lane id="{identity}" type="{kind}"><width sOffset="0" a="{width}" b="0" c="0" d="0"/>'
        f"{paint}</lane>"
    )


def lanes(right: str, left: str = "", center: str = "", color: str = "standard") -> str:
    paint = _MARK.format(center, color) if center else ""
    sides = f"<left>{left}</left>" if left else ""
    return (
        f'<lanes><laneSection s="0">{sides}<center><lane id="0" type="none">{paint}</lane></center>'
        f"<right>{right}</right></laneSection></lanes>"
    )


def two_way(center: str = "broken", color: str = "standard") -> str:
    sides = [
        lane(sign, "driving", LANE, "solid") + lane(2 * sign, "sidewalk", SIDEWALK)
        for sign in (-1, 1)
    ]
    return lanes(*sides, center=center, color=color)


def crossing(extra: str = "") -> str:
    """Returns a map of four roads "0" to "3" that meet at the origin; `extra` is added to "0"."""
    junction, roads = [], []
    for k in range(4):
        angle = 0.5 * math.pi * k
        place = HALF * math.cos(angle), HALF * math.sin(angle)
        link = '<predecessor elementType="junction" elementId="9"/>'
        roads.append(
            road(
                str(k),
                line(*place, angle, ARM),
                ARM,
                link,
                two_way(),
                extra=extra if k == 0 else "",
            )
        )
        for turn in (1, 2, 3):
            other, name = (k + turn) % 4, f"{k}{(k + turn) % 4}"
            length, shape = 2.0 * HALF, "<line/>"
            if turn != 2:
                length = 0.5 * math.pi * HALF
                shape = f'<arc curvature="{(-1 if turn == 1 else 1) / HALF}"/>'
            geometry = (
                f'<geometry s="0" x="{place[0]}" y="{place[1]}" hdg="{angle + math.pi}" '
                f'length="{length}">{shape}</geometry>'
            )
            link = (
                f'<predecessor elementType="road" elementId="{k}" contactPoint="start"/>'
                f'<successor elementType="road" elementId="{other}" contactPoint="start"/>'
            )
            paint = lanes(lane(-1, "driving", LANE, "solid"), center="solid")
            roads.append(road(name, geometry, length, link, paint, attributes='junction="9"'))
            junction.append(
                f'<connection id="{name}" incomingRoad="{k}" connectingRoad="{name}" '
                'contactPoint="start"><laneLink from="1" to="-1"/></connection>'
            )
    return document(*roads, extra=f'<junction id="9">{"".join(junction)}</junction>')


def overpass(height: float = 7.0) -> str:
    """Returns a road "low" along x of 400 m, and a road "high" that crosses over its middle."""
    elevation = f'<elevation s="0" a="{height}" b="0" c="0" d="0"/>'
    high = line(200.0, -200.0, 0.5 * math.pi, 400.0)
    return document(
        road("low", line(0.0, length=400.0), 400, lanes=two_way()),
        road("high", high, 400, lanes=two_way(), elevation=elevation),
    )
