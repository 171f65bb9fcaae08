"""On the MuJoCo truck: who stands is passed, a start fits the bends, turns are waited before."""

import pytest

from iits_mj.simulation.config import DriveConfig
from iits_mj.simulation.loop import Simulation
from tests.paths import ROOT

MAPS = ROOT / "../shared/data/xodr"
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
def test_a_truck_stopped_behind_a_stopped_van_passes_it(tmp_path, model):
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


def test_start_speed_is_limited_by_the_bends_ahead():
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


def turn(seed, duration, payload=0.0):
    """A turn to the left with a light, oncoming cars stopping where the trailer will sweep."""
    return DriveConfig(
        map=needed("esmini_fabriksgatan_traffic_lights.xodr"),
        payload=payload,
        start_speed=12.0,
        traffic_scope="both",
        duration=duration,
        seed=seed,
    )


@pytest.mark.slow
def test_no_oncoming_vehicle_is_touched_in_a_turn_on_green():
    with Simulation(turn(seed=5, duration=60.0)) as simulation:
        summary = simulation.run()
        assert not summary.failed
        assert summary.red_lights_run == 0
        assert simulation.frame.ego.station > 100.0
        # A car stands on the ground that the trailer needs: there is no way, and it is said.
        assert "stands in the way" in simulation.frame.trajectory.reason


@pytest.mark.slow
@pytest.mark.parametrize(
    ("seed", "payload", "duration"), [(6, 0.0, 65.0), (6, 36e3, 70.0), (1, 0.0, 160.0)]
)
def test_the_turn_is_driven_once_its_area_is_free(seed, payload, duration):
    with Simulation(turn(seed, duration, payload)) as simulation:
        summary = simulation.run()
        assert not summary.failed
        assert summary.red_lights_run == 0
        assert simulation.frame.ego.station > 150.0
