import numpy as np
import pytest

from iits_mj.core.vehicles import TrackedVehicle
from iits_mj.road import RoadMap
from iits_mj.simulation import DriveConfig, Simulation
from traffic_bridge import Recording

EVENTS = """
[[events]]
event = "place_vehicle"
name = "car"
gap = 30.0
relative_lane = 1
speed_difference = -1.0

[[events]]
event = "brake"
actor = "car"
at_time = 1.0
deceleration = 4.0
"""


@pytest.fixture(scope="session")
def highway():
    return RoadMap.builtin().route()


@pytest.fixture(scope="session")
def drive(tmp_path_factory):
    """A recording of 4 s behind a braking car."""
    folder = tmp_path_factory.mktemp("drive")
    (folder / "events.toml").write_text(EVENTS)
    config = DriveConfig(
        traffic_mode="none",
        events=folder / "events.toml",
        start_station=300.0,
        duration=4.0,
    )
    with Simulation(config, record=True, visuals=False) as simulation:
        simulation.run()
        return simulation.save_recording(folder / "drive.npz")


def on_highway(route, name, station, lane, **values):
    """A road user in the center of a lane."""
    offset = float(route.lane_offset(lane, station))
    point = route.evaluate(station, offset)
    return TrackedVehicle(
        name,
        x=float(point.x),
        y=float(point.y),
        z=float(point.z),
        yaw=float(point.heading),
        station=station,
        offset=offset,
        lane=lane,
        **values,
    )


@pytest.fixture
def comings_and_goings(highway):
    """10 s: a car stands from 2 s on, a van comes at 1 s and leaves after 3 s, and comes again."""
    frames = []
    for step in range(101):
        time = 0.1 * step
        way = 20.0 * min(time, 2.0) - 5.0 * min(time, 2.0) ** 2
        here = [on_highway(highway, "car", 500.0 + way, 0, speed=max(20.0 - 10.0 * time, 0.0))]
        if 1.0 <= round(time, 1) <= 3.0 or round(time, 1) >= 6.0:
            here.append(
                on_highway(
                    highway, "van", 450.0 + 25.0 * time, 1, kind="van", length=6.0, speed=25.0
                )
            )
        here.append(on_highway(highway, "lead", 900.0 + 20.0 * time, 0, speed=20.0))
        frames.append(here)
    road_map = highway.road_map
    meta = {"map_hash": road_map.content_hash, "map_name": road_map.path.name}
    return Recording.of_frames(meta, 0.1 * np.arange(101), frames)
