"""The truck yields to pedestrians who cross."""

from __future__ import annotations

import numpy as np
import pytest

from iits_mj.core.errors import InputError
from iits_mj.core.vehicles import VehicleFrame
from iits_mj.simulation import DriveConfig, Simulation
from iits_mj.simulation.parts import make_traffic
from tests.model.crossing import crossing


@pytest.fixture(scope="module")
def town(tmp_path_factory):
    path = tmp_path_factory.mktemp("town") / "town.xodr"
    path.write_text(crossing())
    return path


def test_the_truck_stops_for_a_person_who_crosses_and_drives_on(town):
    config = DriveConfig(
        map=town,
        route="turns:0,left",
        start_station=30.0,
        density="empty",
        traffic_scope="map",
        pedestrians=600.0,
        duration=90.0,
        seed=3,
    )
    yielded, crossed = False, False
    with Simulation(config, visuals=False, timestep=0.005) as simulation:
        width = 0.5 * simulation.truck.parameters.units[0].width
        while not simulation.ended:
            frame = simulation.cycle()
            assert frame.box_distance > 0.2
            vehicles = VehicleFrame.of(frame.scene.vehicles)
            if frame.ego.speed < 0.3 and frame.time > 1.0:
                yielded = yielded or "pedestrian" in frame.trajectory.reason
                station, offset = vehicles.columns("station", "offset")
                ahead = station - frame.ego.station
                there = (ahead > 0.0) & (ahead < 20.0)
                there &= np.abs(offset - frame.ego.offset) < width
                crossed = crossed or bool(there.any())
        summary = simulation.summary()
    assert not summary.failed, summary.ended
    assert yielded
    assert crossed
    assert summary.distance > 100.0


def test_pedestrians_need_sumo(town):
    config = DriveConfig(map=town, traffic_mode="none", pedestrians=100.0)
    with pytest.raises(InputError, match="pedestrians and bicycles need SUMO traffic"):
        make_traffic(config, None, None)
