"""Long drives: nothing warns, nothing becomes infinite, nothing collides."""

import numpy as np
import pytest

from iits_mj.simulation import DriveConfig, Simulation


@pytest.mark.slow
@pytest.mark.parametrize(("payload", "seed"), [(36_000.0, 0), (0.0, 1)])
def test_23_minutes_of_traffic_leave_no_warning(payload, seed):
    config = DriveConfig(payload=payload, seed=seed, speed=9.8, start_speed=9.0, duration=1380.0)
    # On a free road the plan is faster than so slow a cruise where that is cheaper, too: the road
    # would end within 25 minutes.
    with Simulation(config) as simulation:
        summary = simulation.run()
        data = simulation.truck.data
    assert summary.ended == "reached the end of the time"
    assert not summary.collision
    assert not data.warning.number.any()
    assert np.isfinite(data.qpos).all()
    assert np.isfinite(data.sensordata).all()
