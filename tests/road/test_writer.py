from __future__ import annotations

import dataclasses

import pytest

from iits_mj.core.errors import MapError
from iits_mj.road import RoadMap
from iits_mj.road.elements import LightProgram, OpenDriveMap
from iits_mj.road.geometry import Arc, Line, ParamPoly3, Poly3, Spiral
from iits_mj.road.opendrive import parse
from iits_mj.road.straight import straight_road
from iits_mj.road.writer import to_xml, write
from tests.road.map_peers import OUTSIDE_MAPS
from tests.road.opendrive_text import document, road
from tests.road.test_route import PROFILES, SPIRAL, WIDE


def test_written_map_reads_back_equal():
    lanes = WIDE.replace(
        '<lane id="-3" type="shoulder"><width sOffset="0" a="2" b="0" c="0" d="0"/>',
        '<lane id="-3" type="shoulder"><border sOffset="0" a="-9" b="0" c="0" d="0"/>'
        '<speed sOffset="0" max="no limit"/>',
    )
    junction = """<junction id="9"><connection id="0" incomingRoad="1" connectingRoad="5"
      contactPoint="end"><laneLink from="-1" to="1"/></connection></junction>"""
    text = document(road(geometry=SPIRAL, lanes=lanes, **PROFILES), extra=junction)
    content = parse(text.encode(), "x")
    assert content.roads[0].sections[0].lane(-3).borders
    assert parse(to_xml(content).encode(), "x") == content


def test_every_geometry_is_written_exactly():
    place = (0.0, 1.0 / 3.0, -2.0, 0.1, 77.7)
    shapes = (
        Line(*place),
        Arc(*place, 1.0 / 7.0),
        Spiral(*place, 0.1, -0.2),
        Poly3(*place, (0.0, 0.1, 1e-3, -1e-7)),
        ParamPoly3(*place, (0.0, 1.0, 0.0, 1e-9), (0.0, 0.0, 1e-3, 0.0), False),
        ParamPoly3(*place, (0.0, 70.0, 0.0, 1e-9), (0.0, 0.0, 1e-3, 0.0), True),
    )
    for shape in shapes:
        base = straight_road(77.7, 2, 4.0, 20.0, 0.01, 0.7).roads[0]
        content = OpenDriveMap(roads=(type(base)(**{**vars(base), "geometries": (shape,)}),))
        assert parse(to_xml(content).encode(), "x") == content


@pytest.mark.parametrize("path", OUTSIDE_MAPS)
def test_real_map_reads_back_equal(path):
    content = RoadMap.from_opendrive(path).content
    assert parse(to_xml(content).encode(), path.name) == content


def test_programs_of_lights_read_back_equal_and_unusable_ones_are_left_out():
    program = LightProgram("a b", 7.5, ((30.0, "GGrr"), (3.0, "yyrr")))
    content = dataclasses.replace(parse(document(road()).encode(), "x"), light_programs=(program,))
    text = to_xml(content)
    assert parse(text.encode(), "x") == content
    for wrong in ("nan:GGrr", "30.0:G", "-1:GGrr", "30.0"):
        damaged = parse(text.replace("30.0:GGrr", wrong).encode(), "x")
        assert damaged.light_programs == ()
        assert any("program of traffic light 'a b'" in note for note in damaged.notes)


def test_text_is_escaped():
    content = straight_road(100.0, 1, 4.0, 20.0, 0.0, 0.8)
    named = OpenDriveMap(roads=content.roads, name='a "b" <c> & d')
    assert parse(to_xml(named).encode(), "x").name == 'a "b" <c> & d'


def test_unwritable_path_is_a_map_error(tmp_path):
    with pytest.raises(MapError, match="cannot be written"):
        write(straight_road(100.0, 1, 4.0, 20.0, 0.0, 0.8), tmp_path / "no" / "map.xodr")
