"""Heights of GeoTIFF files, and the projections of maps."""

from __future__ import annotations

import numpy as np
import pytest
from PIL import Image, TiffImagePlugin

from iits_mj.core.errors import InputError
from iits_mj.road.elements import OpenDriveMap
from iits_mj.road.terrain import geographic, read_geotiff

PIXEL, WEST, NORTH = 0.001, 10.0, 50.0


def write_geotiff(path, heights, model=2):
    """Heights with the outer corner of the first pixel in the north west."""
    tags = TiffImagePlugin.ImageFileDirectory_v2()
    for tag, kind, value in (
        (33550, 12, (PIXEL, PIXEL, 0.0)),
        (33922, 12, (0.0, 0.0, 0.0, WEST, NORTH, 0.0)),
        (34735, 3, (1, 1, 0, 2, 1024, 0, 1, model, 1025, 0, 1, 1)),
    ):
        tags[tag] = value
        tags.tagtype[tag] = kind
    Image.fromarray(np.asarray(heights, dtype=np.float32)).save(path, tiffinfo=tags)
    return path


def projected(text, offset=(0.0, 0.0)):
    return geographic(OpenDriveMap((), geo_reference=text, offset=offset, name="map"))


def test_a_geotiff_gives_the_heights_between_the_centers_of_its_pixels(tmp_path):
    row, column = np.mgrid[0:20, 0:30]
    terrain = read_geotiff(write_geotiff(tmp_path / "plane.tif", 100.0 + 2.0 * column - row))
    longitude, latitude = np.array([10.0105, 10.02]), np.array([49.9895, 49.99])
    wanted = 100.0 + 2.0 * ((longitude - WEST) / PIXEL - 0.5) - ((NORTH - latitude) / PIXEL - 0.5)
    assert terrain(longitude, latitude) == pytest.approx(wanted, abs=1e-4)


def test_a_place_outside_a_geotiff_is_refused(tmp_path):
    terrain = read_geotiff(write_geotiff(tmp_path / "plane.tif", np.zeros((5, 5))))
    with pytest.raises(InputError, match="no height at longitude 11"):
        terrain(np.array([11.0]), np.array([49.998]))


def test_a_geotiff_in_meters_or_a_plain_picture_is_refused(tmp_path):
    with pytest.raises(InputError, match="EPSG:4326"):
        read_geotiff(write_geotiff(tmp_path / "utm.tif", np.zeros((5, 5)), model=1))
    Image.new("RGB", (5, 5)).save(tmp_path / "photo.tif")
    with pytest.raises(InputError, match="EPSG:4326"):
        read_geotiff(tmp_path / "photo.tif")
    (tmp_path / "text.tif").write_text("no picture")
    with pytest.raises(InputError, match="not a GeoTIFF"):
        read_geotiff(tmp_path / "text.tif")


def test_a_degree_along_the_central_meridian_is_that_of_the_ellipsoid():
    place = projected("+proj=utm +zone=32", offset=(500000.0, 0.0))
    # The quadrant of the meridian of WGS 84 is 10 001 965.729 m.
    longitude, latitude = place(np.zeros(2), np.array([0.0, 0.9996 * 10_001_965.729]))
    assert longitude[0] == pytest.approx(9.0, abs=1e-12)
    assert latitude == pytest.approx([0.0, 90.0], abs=1e-8)


def test_projections_with_another_origin_are_the_same_one():
    x, y = np.array([310.0, -25.0]), np.array([40.0, 900.0])
    local = projected("+proj=tmerc +lat_0=48.5 +lon_0=9 +k=0.9996 +x_0=0 +y_0=0")
    origin = projected("+proj=utm +zone=32", offset=(500000.0, 0.0))
    north = 5_371_966.0  # about latitude 48.5
    longitude, latitude = origin(x, y + north)
    zero = origin(np.zeros(1), np.array([north]))[1][0]
    assert local(x, y)[0] == pytest.approx(longitude, abs=1e-5)
    assert local(x, y)[1] - 48.5 == pytest.approx(latitude - zero, abs=1e-5)


@pytest.mark.parametrize("text", ["", "+proj=merc", "+proj=utm +zone=x", "EPSG:25832"])
def test_an_unknown_projection_is_refused(text):
    with pytest.raises(InputError, match="utm or tmerc"):
        projected(text)
