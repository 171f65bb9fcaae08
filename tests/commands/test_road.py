"""The command `iits-mj road`."""

from __future__ import annotations

import json

import pytest
from PIL import Image

from iits_mj import cli
from iits_mj.commands.road import sort_notes
from iits_mj.core.errors import MapError
from iits_mj.road import RoadMap
from tests.paths import ROOT
from tests.road.opendrive_text import LANES, document, line, road, successor
from tests.village import write_osm
from traffic_bridge.network import nets

HIGHWAY = ROOT / "tools" / "highway.toml"

STEEP = '<elevation s="0" a="0" b="0.3" c="0" d="0"/>'
ROADS = (
    road("a", link=successor("b")),
    road("b", line(100.0), extra="<signals><signal id='1' s='5' t='x'/></signals>"),
    road("steep", line(0.0, 60.0), elevation=STEEP),
    road("nowhere", line(0.0, 90.0), lanes=""),
)


@pytest.fixture
def path(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("IITS_MJ_CACHE", str(tmp_path / "cache"))
    (tmp_path / "village.xodr").write_text(document(*ROADS))
    return "village.xodr"


def test_check_reports_what_was_left_out_and_draws_the_map(path, tmp_path, capsys):
    assert cli.main(["road", "check", path]) == 0
    text = capsys.readouterr().out
    assert "200 m on 2 roads: a:+1, b:+1" in text
    assert "road 'nowhere': has no <lanes>" in text
    assert "signal '1'" in text
    assert "left out: 2" in text
    picture = Image.open(tmp_path / "village.png").convert("RGB")
    # Both the usable lanes and the road that is too steep are drawn in their colors.
    colors = {color for _, color in picture.getcolors(picture.width * picture.height)}
    assert {(0x8A, 0x94, 0x9E), (0xE9, 0xA0, 0x3B)} <= colors


def test_check_gives_all_findings_as_json(path, capsys):
    assert cli.main(["road", "check", path, "--route", "b", "--no-net", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["route"] == ["b:+1"]
    assert found["route_m"] == 100.0
    assert found["roads"] == 3
    assert found["net"] == "not made"
    assert len(found["notes"]["left_out"]) == 2


def test_a_map_that_netconvert_refuses_still_drives_without_traffic(path, capsys, monkeypatch):
    def refuse(*_):
        raise MapError(f"{path}: netconvert is not pleased{nets.ADVICE}")

    monkeypatch.setattr("traffic_bridge.build_network", refuse)
    assert cli.main(["road", "check", path]) == 1
    assert "refused: netconvert is not pleased; a drive with traffic-mode none" in (
        capsys.readouterr().out
    )


def test_a_map_without_lanes_is_refused(tmp_path, capsys):
    file = tmp_path / "bare.xodr"
    lanes = LANES.replace('type="driving"', 'type="sidewalk"')
    file.write_text(document(road(lanes=lanes)))
    assert cli.main(["road", "check", str(file), "--picture", str(tmp_path / "bare.png")]) == 2
    assert "no road has driving lanes" in capsys.readouterr().err
    assert (tmp_path / "bare.png").is_file()


def test_notes_are_sorted_by_what_they_report():
    notes = (
        "left out: road '1': has no <lanes>",
        "not driven: where road '1' meets '2': the height steps by 9 m",
        "road '3': <successor> has no contactPoint, 'start' is taken",
    )
    found = sort_notes(notes)
    assert found["left_out"] == ["road '1': has no <lanes>"]
    assert found["not_driven"] == ["where road '1' meets '2': the height steps by 9 m"]
    assert found["repaired"] == [notes[2]]


def test_a_made_map_is_written_and_described(tmp_path, capsys):
    (tmp_path / "lane.csv").write_text("s_m,z_m,lanes\n0,5,1\n100,6,2\n300,7,2\n")
    out = tmp_path / "lane.xodr"
    assert cli.main(["road", "make", str(tmp_path / "lane.csv"), str(out), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["command"] == "road make"
    assert (found["roads"], found["route_m"]) == (1, 300.0)
    route = RoadMap.from_opendrive(out).route()
    assert (route.lane_count(50.0), route.lane_count(200.0)) == (1, 2)


def test_a_design_table_is_made_into_a_map(tmp_path, capsys):
    out = tmp_path / "highway.xodr"
    assert cli.main(["road", "make", str(HIGHWAY), str(out)]) == 0
    assert "15.00 km" in capsys.readouterr().out
    assert out.read_bytes() == RoadMap.builtin().path.read_bytes()


def test_an_extract_is_converted_and_checked(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("IITS_MJ_CACHE", str(tmp_path / "cache"))
    write_osm(tmp_path / "village.osm")
    assert cli.main(["road", "convert", "village.osm", "village.xodr"]) == 0
    text = capsys.readouterr().out
    assert "origin          648814.92, 5318068.71 m in +proj=utm +zone=32" in text
    assert cli.main(["road", "check", "village.osm", "--no-net", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert (found["map"], found["junctions"]) == ("village.osm", 2)
    assert found["notes"]["not_driven"] == []


@pytest.mark.parametrize(
    ("words", "reason"),
    [
        (["make", "x.csv"], "needs the file to write"),
        (["convert", "x.osm", "y.png"], "needs the file to write"),
        (["check", "x.osm", "y.xodr"], "check writes no map"),
        (["convert", "x.osm", "y.xodr"], "there is no such file"),
    ],
)
def test_wrong_uses_of_the_command_are_refused(tmp_path, monkeypatch, capsys, words, reason):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("IITS_MJ_CACHE", str(tmp_path / "cache"))
    assert cli.main(["road", *words]) == 2
    assert reason in capsys.readouterr().err
