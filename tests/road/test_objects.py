"""Objects of an OpenDRIVE file are read for pictures, and change no map."""

from iits_mj.road import RoadMap
from iits_mj.road.opendrive import parse
from tests.road.opendrive_text import document, road

OBJECTS = """<objects>
<object id="1" type="building" name="Mill" s="20" t="-15" zOffset="0.5" hdg="0.3" length="9"
  width="6" height="7"><outline><cornerLocal u="0" v="0" z="0" height="7"/>
  <cornerLocal u="9" v="0" z="0" height="7"/><cornerLocal u="9" v="6" z="0" height="6"/></outline>
</object>
<object id="2" type="barrier" s="0" t="5"><repeat s="10" length="30" distance="0" tStart="5"
  tEnd="6" heightStart="0.8" heightEnd="0.8" zOffsetStart="0" zOffsetEnd="0"/></object>
<object id="3" type="pole" s="nan" t="5"/></objects>"""


def test_object_has_its_place_size_outline_and_copies():
    content = parse(document(road(extra=OBJECTS)).encode(), "x")
    mill, barrier = content.roads[0].objects
    assert (mill.kind, mill.name) == ("building", "mill")
    assert (mill.s, mill.t, mill.z, mill.heading) == (20.0, -15.0, 0.5, 0.3)
    assert [(one.a, one.b, one.height) for one in mill.outlines[0]] == [
        (0.0, 0.0, 7.0),
        (9.0, 0.0, 7.0),
        (9.0, 6.0, 6.0),
    ]
    (repeat,) = barrier.repeats
    assert (repeat.s, repeat.length, repeat.t, repeat.height) == (10.0, 30.0, (5, 6), (0.8, 0.8))


def test_unreadable_object_is_left_out_with_a_note():
    content = parse(document(road(extra=OBJECTS)).encode(), "x")
    assert len(content.roads[0].objects) == 2
    (note,) = content.notes
    assert "object '3'" in note
    assert "nan" in note
    assert "left out of pictures" in note


def test_objects_change_neither_equality_nor_hash_of_a_map():
    readable = OBJECTS.replace('s="nan"', 's="3"')
    bare, full = (parse(document(road(extra=e)).encode(), "x") for e in ("", readable))
    assert len(full.roads[0].objects) == 3
    assert bare == full
    assert RoadMap(bare, "x").content_hash == RoadMap(full, "x").content_hash
