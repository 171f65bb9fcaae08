"""Drives past a stopped vehicle, into bends, and through a turn with oncoming traffic."""

import pytest

from iits_mj.simulation.config import DriveConfig
from iits_mj.simulation.loop import Simulation
from tests.paths import outside

STOPPED = """
[[events]]
event = "stopped_vehicle"
station = 125.0
lane = 0
type = "van"
at_station = 60.0
duration = 200.0
"""


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
        map=outside("xodr/esmini_curves_elevation.xodr"),
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
    """A left turn at a light, beside oncoming cars that wait at the light of the exit."""
    return DriveConfig(
        map=outside("xodr/esmini_fabriksgatan_traffic_lights.xodr"),
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
        # The stop line of the exit keeps cars out of the area that the trailer sweeps.
        assert "has stopped in the way" not in simulation.frame.trajectory.reason


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
