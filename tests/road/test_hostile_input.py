from __future__ import annotations

import os
import re

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from iits_mj.core.errors import MapError
from iits_mj.road import RoadMap
from iits_mj.road.opendrive import parse
from iits_mj.road.xml_input import read_file
from tests.road.opendrive_text import LANES, LINE, document, line, road, successor
from tests.road.test_route import PROFILES, SPIRAL, WIDE

BOMB = '<?xml version="1.0"?><!DOCTYPE OpenDRIVE [<!ENTITY a "aaaa"><!ENTITY b "&a;&a;&a;">]>'
ELEVATION = '<elevation s="0" a="{}" b="0" c="0" d="0"/>'

BAD = {
    "empty": ("", "empty"),
    "blank": (" \n ", "empty"),
    "not XML": ("hello", "well-formed"),
    "cut off": (document(road())[:200], "well-formed"),
    "entity bomb": (BOMB + "<OpenDRIVE>&b;</OpenDRIVE>", "entity"),
    "external entity": (
        '<!DOCTYPE x [<!ENTITY e SYSTEM "file:///etc/passwd">]><OpenDRIVE>&e;</OpenDRIVE>',
        "DOCTYPE",
    ),
    "another root": ("<svg/>", "not OpenDRIVE"),
    "deep": ("<OpenDRIVE>" + "<a>" * 500 + "</a>" * 500 + "</OpenDRIVE>", "nested deeper"),
    "version 2": ('<OpenDRIVE><header revMajor="2" revMinor="0"/></OpenDRIVE>', "OpenDRIVE 2"),
    "no road": (document(), "no <road>"),
    "10 001 signals": (
        document(road(extra="<signals>" + '<signal id="a" s="1"/>' * 10_001 + "</signals>")),
        "has 10001 signals; at most 10000",
    ),
    "twice": (document(road(), road()), "defined twice"),
    "no id": (document(road().replace('id="1"', "", 1)), "'id'"),
    "no geometry": (document(road(geometry="")), "<geometry>"),
    "no lanes": (document(road(lanes="")), "<lanes>"),
    "no section": (document(road(lanes="<lanes/>")), "<laneSection>"),
    "no width": (document(road(lanes=LANES.replace("<width", "<wide"))), "lane -1"),
    "lane on the wrong side": (document(road(lanes=LANES.replace('id="-1"', 'id="1"'))), "<right>"),
    "negative length": (document(road(length=-5)), "length='-5'"),
    "endless road": (document(road(length=1e12)), "length="),
    "NaN length": (document(road(length="nan")), "length='nan'"),
    "infinite x": (document(road(geometry=line(float("inf")))), "x='inf'"),
    "NaN height": (document(road(elevation=ELEVATION.format("NaN"))), "'NaN'"),
    "text for a number": (document(road(elevation=ELEVATION.format("high"))), "not a number"),
    "missing x": (document(road(geometry=LINE.replace('x="0"', ""))), "'x'"),
    "unknown shape": (document(road(geometry=LINE.replace("line", "bezier"))), "bezier"),
    "no shape": (document(road(geometry=LINE.replace("<line/>", ""))), "no shape"),
    "endless spin": (
        document(road(geometry=LINE.replace("<line/>", '<arc curvature="9"/>'))),
        "turns by more",
    ),
    "jump in the plan": (
        document(
            road(geometry=line(0.0) + LINE.replace('s="0" x="0"', 's="100" x="150"'), length=200)
        ),
        "jumps by 50.0 m",
    ),
    "plan view that ends early": (document(road(length=1000)), "900 m before s = 1000"),
    "plan view that starts late": (
        document(road(geometry=LINE.replace('s="0"', 's="50"'), length=150)),
        "starts at s = 50",
    ),
    "bad contact": (document(road(link=successor("2", "middle"))), "'middle'"),
    "bad unit": (
        document(road(extra='<type s="0" type="town"><speed max="3" unit="knots"/></type>')),
        "knots",
    ),
    "no driving lane": (
        document(road(lanes=LANES.replace("driving", "shoulder"))),
        "driving lanes",
    ),
    "kink inside a road": (
        document(
            road(
                geometry=line(0.0) + line(100.0, heading=1.0).replace('s="0"', 's="100"'),
                length=200,
            )
        ),
        "heading steps by 57 degrees",
    ),
    "height step inside a road": (
        document(
            road(elevation=ELEVATION.format(0.0) + '<elevation s="50" a="9" b="0" c="0" d="0"/>')
        ),
        "height steps by 9.00 m",
    ),
}


@pytest.mark.parametrize("name", BAD)
def test_malformed_map_is_refused_in_one_clear_line(name, tmp_path):
    text, expected = BAD[name]
    path = tmp_path / "bad.xodr"
    path.write_text(text)
    with pytest.raises(MapError) as caught:
        RoadMap.from_opendrive(path).route()
    message = str(caught.value)
    assert expected in message
    assert "bad.xodr" in message
    assert "\n" not in message


def test_missing_file_folder_and_device_are_refused(tmp_path):
    for path in (tmp_path / "none.xodr", tmp_path, "/dev/null"):
        with pytest.raises(MapError, match=r"no such file|regular file"):
            RoadMap.from_opendrive(path)


def test_huge_file_is_refused_before_it_is_read(tmp_path):
    path = tmp_path / "huge.xodr"
    with path.open("wb") as file:
        os.truncate(file.fileno(), 300 * 2**20)
    with pytest.raises(MapError, match="too large"):
        RoadMap.from_opendrive(path)


def test_size_limit_can_be_chosen(tmp_path):
    path = tmp_path / "map.xodr"
    path.write_text("x" * 100)
    with pytest.raises(MapError, match="too large"):
        read_file(path, size_limit=50)


def test_unknown_encoding_and_zero_bytes_are_refused():
    for content in (b'<?xml version="1.0" encoding="klingon"?><a/>', b"\x00\x01\x02", b"\xff" * 9):
        with pytest.raises(MapError):
            parse(content, "x")


NASTY = ["", "0", "-1", "7", "1e9", "-1e9", "1e-9", "nan", "inf", "1e300", "abc", "start", "99"]


@settings(max_examples=150, deadline=None)
@given(data=st.data())
def test_a_map_with_wrong_attributes_gives_a_finite_route_or_map_error(data):
    text = document(road(geometry=SPIRAL, lanes=WIDE, link=successor("2"), **PROFILES), road("2"))
    for _ in range(data.draw(st.integers(1, 3))):
        chosen = data.draw(st.sampled_from(list(re.finditer(r'="([^"]*)"', text))))
        text = text[: chosen.start(1)] + data.draw(st.sampled_from(NASTY)) + text[chosen.end(1) :]
    try:
        route = RoadMap(parse(text.encode(), "wrong"), "wrong").route()
    except MapError as error:
        assert "wrong" in str(error)  # noqa: PT017 - either outcome is right
    else:
        assert np.isfinite(route.table(1.0)).all()


@settings(max_examples=150, deadline=None)
@given(data=st.data())
def test_a_map_with_a_damaged_byte_parses_or_raises_map_error(data):
    content = bytearray(document(road(elevation=ELEVATION.format(1.0))).encode())
    for _ in range(data.draw(st.integers(1, 4))):
        content[data.draw(st.integers(0, len(content) - 1))] = data.draw(st.integers(0, 255))
    try:
        parse(bytes(content), "damaged")
    except MapError as error:
        assert "damaged" in str(error)  # noqa: PT017 - either outcome is right
