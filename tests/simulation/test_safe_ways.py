"""On the MuJoCo truck: who stands is passed, a start fits the bends, turns are waited before."""

from pathlib import Path

import pytest

from iits_mj.simulation.config import DriveConfig
from iits_mj.simulation.loop import Simulation

MAPS = Path(__file__).resolve().parents[2] / "../shared/data/xodr"
STOPPED = """
[[events]]
event = "stopped_vehicle"
station = 125.0
lane = 0
type = "van"
at_station = 60.0
duration = 200.0
"""


def needed(name):
    path = MAPS / name
    if not path.exists():
        pytest.skip(f"the map is not there: ../shared/data/xodr/{name}")
    return path


@pytest.mark.slow
@pytest.mark.parametrize("model", ["mobil", "lc2013"])
def test_a_truck_that_stands_behind_a_stopped_van_passes_it(tmp_path, model):
    events = tmp_path / "events.toml"
    events.write_text(STOPPED)
    config = DriveConfig(
        density="sparse",
        lane_change=model,
        start_station=85.0,
        start_speed=0.0,
        events=events,
        duration=40.0,
        seed=3,
    )
    with Simulation(config) as simulation:
        summary = simulation.run()
        assert not summary.failed
        assert summary.lane_changes == 1
        assert simulation.frame.ego.station > 150.0


def test_a_start_is_held_to_the_bends_ahead():
    config = DriveConfig(
        map=needed("esmini_curves_elevation.xodr"),
        start_station=940.0,
        start_speed=22.0,
        speed=25.0,
        traffic_mode="none",
        duration=8.0,
    )
    with Simulation(config) as simulation:
        assert simulation.frame.ego.speed < 20.0
        while not simulation.ended:
            simulation.cycle()
        assert not simulation.failed


@pytest.mark.slow
def test_no_oncoming_vehicle_is_touched_in_a_turn_on_green():
    config = DriveConfig(
        map=needed("esmini_fabriksgatan_traffic_lights.xodr"),
        payload=0.0,
        start_speed=12.0,
        traffic_scope="both",
        duration=60.0,
        seed=5,
    )
    with Simulation(config) as simulation:
        summary = simulation.run()
        assert not summary.failed
        assert simulation.frame.ego.station > 100.0
