"""The speed of the truck on hills stays near its plan, without pedal and brake by turns."""

import numpy as np
import pytest

from iits_mj.road import Route
from iits_mj.validation.harness.config import ValidateConfig
from iits_mj.validation.planning.closed_loop import DriveTask, drive
from iits_mj.validation.planning.speed_tracking import run_speed_tracking


def test_the_empty_truck_keeps_its_speed_on_a_hill():
    results = run_speed_tracking(ValidateConfig(quick=True))
    assert results.ok, results.to_table()
    assert len(results.checks) >= 3


def test_a_truck_that_starts_on_a_hill_was_standing_braked():
    route = Route.straight(length=400.0, grade=0.05)
    record = drive(
        DriveTask(route, 100.0, 100.5, 0.0, 5.0, payload=0.0, timestep=0.005, time_limit=30.0)
    )
    assert record["station"].min() > record["station"][0] - 0.01
    assert record["time"][0] == pytest.approx(2.0)
    assert np.all(record["station"] < 100.5)


@pytest.mark.slow
def test_speed_is_tracked_from_0_to_90_km_h_laden_and_empty():
    results = run_speed_tracking(ValidateConfig())
    assert results.ok, results.to_table()
