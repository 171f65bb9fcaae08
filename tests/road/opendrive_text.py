"""Small OpenDRIVE texts for tests."""

from __future__ import annotations

LINE = '<geometry s="0" x="0" y="0" hdg="0" length="100"><line/></geometry>'
LANES = """<lanes><laneSection s="0"><center><lane id="0" type="none"/></center><right>
<lane id="-1" type="driving"><width sOffset="0" a="3.5" b="0" c="0" d="0"/></lane>
</right></laneSection></lanes>"""


def road(
    identity: str = "1",
    geometry: str = LINE,
    length: float | str = 100,
    link: str = "",
    lanes: str = LANES,
    elevation: str = "",
    extra: str = "",
    attributes: str = 'junction="-1"',
) -> str:
    return (
        f'<road id="{identity}" length="{length}" {attributes}><link>{link}</link>'
        f"<planView>{geometry}</planView><elevationProfile>{elevation}</elevationProfile>"
        f"{extra}{lanes}</road>"
    )


def document(*roads: str, extra: str = "") -> str:
    return (
        '<?xml version="1.0"?><OpenDRIVE><header revMajor="1" revMinor="6"/>'
        + "".join(roads)
        + extra
        + "</OpenDRIVE>"
    )


def successor(identity: str, contact: str = "start") -> str:
    return f'<successor elementType="road" elementId="{identity}" contactPoint="{contact}"/>'


def line(x: float, y: float = 0.0, heading: float = 0.0, length: float = 100.0) -> str:
    return f'<geometry s="0" x="{x}" y="{y}" hdg="{heading}" length="{length}"><line/></geometry>'
