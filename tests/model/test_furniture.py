"""Objects, signs and lights of a map are drawn where OpenDRIVE puts them."""

import numpy as np
import pytest

from iits_mj.model.scenery.furniture import furniture
from iits_mj.model.scenery.signs import lamp_of
from iits_mj.road import RoadMap
from tests.model.meshes import vertices
from tests.model.test_network import scene, seen
from tests.road.opendrive_text import document, road

BUILDING = (
    '<object id="1" type="building" s="30" t="-20" hdg="1.5707963" length="12" width="6" '
    'height="8"/>'
)
BARRIER = """<object id="2" type="barrier" s="0" t="6"><repeat s="20" length="40" distance="0"
tStart="6" tEnd="6" widthStart="0.4" widthEnd="0.4" heightStart="0.9" heightEnd="0.9"/></object>"""
POSTS = """<object id="3" type="pole" s="0" t="-6" radius="0.1"><repeat s="10" length="50"
distance="10" tStart="-6" tEnd="-6" heightStart="3" heightEnd="3"/></object>"""
CROSSING = """<object id="4" type="crosswalk" s="50" t="0"><outline>
<cornerLocal u="-2" v="-3.5"/><cornerLocal u="2" v="-3.5"/><cornerLocal u="2" v="3.5"/>
<cornerLocal u="-2" v="3.5"/></outline></object>"""


def town(objects="", signals=""):
    extra = f"<objects>{objects}</objects><signals>{signals}</signals>"
    return scene(document(road(extra=extra)))


def test_building_is_a_box_of_its_size():
    model, data, _ = town(BUILDING)
    points = vertices(model, "road_building")
    np.testing.assert_allclose(points.max(axis=0), [33.0, -14.0, 8.0], atol=1e-3)
    np.testing.assert_allclose(points.min(axis=0)[:2], [27.0, -26.0], atol=1e-3)
    name, z = seen(model, data, 30.0, -20.0)
    assert name.startswith("road_building")
    assert z == pytest.approx(8.0)


def test_barrier_runs_along_the_road():
    model, data, _ = town(BARRIER)
    for x in (20.5, 40.0, 59.5):
        name, z = seen(model, data, x, 6.0)
        assert name.startswith("road_concrete")
        assert z == pytest.approx(0.9, abs=1e-3)
    for x in (19.0, 61.0):
        assert not seen(model, data, x, 6.0)[0].startswith("road_concrete")


def test_copies_stand_at_their_distance():
    model, _, _ = town(POSTS)
    points = vertices(model, "road_post_map")
    centers = np.unique(np.round(points[:, 0] / 10.0) * 10.0)
    np.testing.assert_allclose(centers, [10.0, 20.0, 30.0, 40.0, 50.0, 60.0])
    assert points[:, 2].max() == pytest.approx(3.0)


def test_stripes_of_a_crossing_lie_along_the_road():
    model, data, _ = town(CROSSING)
    across = np.arange(-3.4, 3.4, 0.05)
    paint = [seen(model, data, 50.3, y)[0].startswith("road_marking_map") for y in across]
    # Stripes and gaps of half a meter over seven meters.
    assert np.sum(np.diff(np.array(paint, dtype=int)) == 1) >= 6
    assert 0.4 < np.mean(paint) < 0.6
    assert not seen(model, data, 47.0, 0.3)[0].startswith("road_marking_map")


def test_crossing_of_a_signal_ends_at_the_edges_of_the_road():
    model, _, _ = town(
        signals='<signal id="6" s="60" t="1" type="1000003" value="2" width="30" height="0.01" '
        'orientation="+"/>'
    )
    paint = vertices(model, "road_marking_map")
    assert [paint[:, 1].min(), paint[:, 1].max()] == pytest.approx([-3.5, 0.0], abs=0.5)
    assert np.ptp(paint[:, 0]) == pytest.approx(2.0, abs=0.01)


@pytest.mark.parametrize(("orientation", "side"), [("+", -1.0), ("-", 1.0)])
def test_traffic_light_faces_the_traffic_that_it_is_for(orientation, side):
    model, _, _ = town(
        signals=f'<signal id="7" s="60" t="-5" dynamic="yes" type="1000001" zOffset="2.4" '
        f'height="0.9" orientation="{orientation}"/>'
    )
    lamps = [vertices(model, f"road_lamp_{color}") for color in ("red", "yellow", "green")]
    heights = [points[:, 2].mean() for points in lamps]
    assert heights == sorted(heights, reverse=True)
    assert max(points[:, 2].max() for points in lamps) == pytest.approx(3.3, abs=0.1)
    for points in lamps:
        assert np.all(side * (points[:, 0] - 60.0) > 0.2)


def test_sign_over_the_road_has_its_pole_beside_it():
    model, data, _ = town(
        signals='<signal id="8" s="60" t="-1.8" dynamic="yes" type="1000001" orientation="+"/>'
    )
    pole = vertices(model, "road_steel_map")
    foot = pole[pole[:, 2] < 1.0]
    assert np.all(foot[:, 1] < -3.5)
    name, z = seen(model, data, 60.0, -1.8, height=4.0)
    assert name.startswith(("road_asphalt", "road_marking"))
    assert z == pytest.approx(0.0, abs=0.05)


def test_speed_sign_is_white_with_a_red_ring():
    model, _, _ = town(
        signals='<signal id="9" s="60" t="-5" type="274" value="80" unit="km/h" width="0.6" '
        'zOffset="2" height="0.6" orientation="+"/>'
    )
    red, white = (vertices(model, f"road_sign_{color}_map") for color in ("red", "white"))
    assert np.ptp(red[:, 1]) == pytest.approx(0.6, abs=0.02)
    assert np.ptp(white[:, 1]) < np.ptp(red[:, 1])
    assert white[:, 0].min() < red[:, 0].min() < 60.0


@pytest.mark.parametrize(
    ("attributes", "lit"),
    [
        ('name="30 sign" value="80" unit="km/h"', (7, 6)),
        ('name="Sign_Speed_30"', (5, 6)),
        ('name="limit" value="25" unit="m/s"', (6, 6)),
        ('name="limit" value="111" unit="mph"', (2, 2, 2)),
    ],
)
def test_speed_sign_shows_its_number(attributes, lit):
    """Each digit is made of as many of seven bars as on a display; m/s are shown as km/h."""
    model, _, _ = town(
        signals=f'<signal id="9" s="60" t="-5" type="274" {attributes} width="0.6" zOffset="2" '
        'orientation="+"/>'
    )
    black = vertices(model, "road_sign_black_map")
    # A bar is a box. Seen from the road, which leads to +x, the first digit is on the left.
    bars = black.reshape(-1, len(black) // sum(lit), 3).mean(axis=1)
    left = bars[:, 1] > bars[:, 1].mean()
    assert len(bars) == sum(lit)
    if len(lit) == 2:
        assert (left.sum(), (~left).sum()) == lit
    # In front of the plate, and inside its ring.
    assert black[:, 0].max() < vertices(model, "road_sign_white_map")[:, 0].min() + 1e-6
    assert np.abs(black[:, 1:] - [-5.0, 2.3]).max() < 0.23


def test_sign_that_is_no_limit_has_no_number():
    model, _, _ = town(signals='<signal id="9" s="60" t="-5" type="206" value="3" name="Stop 2"/>')
    assert not [i for i in range(model.ngeom) if "black" in model.geom(i).name]


def test_lamps_of_the_route_are_found_on_a_map_from_the_cache(tmp_path, monkeypatch):
    monkeypatch.setenv("IITS_MJ_CACHE", str(tmp_path / "cache"))
    monkeypatch.setattr("iits_mj.road.route.SIZE_MIN", 0)
    light = (
        '<signal id="1" s="80" t="-5" type="1000001" dynamic="yes" orientation="+" zOffset="3"/>'
    )
    path = tmp_path / "lit.xodr"
    path.write_text(document(road(extra=f"<signals>{light}</signals>")))
    for _ in range(2):
        route = RoadMap.from_opendrive(path).route()
        names = {material for _, material, _ in furniture(route, {"1": (0.0, 100.0)})}
        assert len([name for name in names if lamp_of(name)]) == 3
