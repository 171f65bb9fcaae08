"""Cameras inside a tunnel stay between its walls and below its roof, whatever the lane."""

import math

import numpy as np
import pytest

from iits_mj.model.scenery.structures import TUNNEL_ROOF, WALL_GAP
from iits_mj.render.cameras import FollowCamera
from iits_mj.road import RoadMap
from iits_mj.truck import Truck


@pytest.fixture(scope="module")
def truck():
    return Truck.load(route=RoadMap.builtin().route(), visuals=False)


def place(camera):
    """Position of a free camera (3,) from what it looks at."""
    azimuth, elevation = math.radians(camera.azimuth), math.radians(camera.elevation)
    forward = np.array(
        [
            math.cos(elevation) * math.cos(azimuth),
            math.cos(elevation) * math.sin(azimuth),
            math.sin(elevation),
        ]
    )
    return np.array(camera.lookat) - camera.distance * forward


@pytest.mark.parametrize("name", ["chase", "side", "front", "trailer"])
@pytest.mark.parametrize("lane", [0, 1])
def test_camera_in_the_tunnel_is_inside_the_tube(truck, name, lane):
    route = truck.route
    (start, end), *_ = route.tunnels
    for station in np.linspace(start + 40, end - 40, 5):
        truck.reset(station=station, offset=route.lane_offset(lane, station), speed=16.0)
        camera = FollowCamera(name, route.tunnels).follow(truck.data, station)
        position = place(camera)
        along, offset = route.locate(position[0], position[1], station)
        right, left = route.surface_edges(along)
        assert right - WALL_GAP < offset < left + WALL_GAP
        height = position[2] - float(route.evaluate(along, offset).z)
        assert 0.5 < height < TUNNEL_ROOF
