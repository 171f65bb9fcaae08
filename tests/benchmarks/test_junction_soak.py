"""The soak of junctions: what fails a row, and the table that continues."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from benchmarks import junction_soak as soak
from iits_mj.core.vehicles import TrackedVehicle, VehicleFrame
from traffic_bridge import TrafficConfig


def test_contacts_red_lights_and_long_standstills_fail_a_row():
    row = soak.Row("town", "truck", 0, cycle_s=60.0, truck_stand_s=120.0, stand_s=120.0)
    assert row.faults == []
    for change, names in (
        ({"collisions": 1}, ["collisions"]),
        ({"touches": 2, "red_lights": 1}, ["touches", "red_lights"]),
        ({"truck_stand_s": 125.0}, ["truck_stand_s"]),
        ({"stand_s": 130.0}, ["stand_s"]),
    ):
        assert dataclasses.replace(row, **change).faults == names


def test_a_table_is_read_as_it_was_written_and_summed(tmp_path):
    rows = [
        soak.Row("town", "truck", k, 600.0, 20.0, 3, 12.5, 90.0, note='hit "a", b') for k in (0, 1)
    ]
    path = tmp_path / "table.csv"
    soak.write_rows(path, rows)
    assert soak.read_rows(path) == rows
    assert "| town | truck | 2 | 20 | 12.5 |" in soak.summary(rows)


@pytest.mark.parametrize(("apart", "touches"), [(16.4, 1), (17.0, 0)])
def test_boxes_of_articulated_trucks_in_a_queue_touch_when_they_overlap(apart, touches):
    row = soak.Row("town", "traffic", 0)
    watch = soak.TrafficWatch(TrafficConfig(), row)
    trucks = [
        TrackedVehicle(
            id=f"articulated.{k}", kind="articulated", x=apart * k, y=0.0, z=0.0, yaw=0.0,
            speed=0.0, length=16.5, width=2.55, height=4.0, station=apart * k, offset=0.0, lane=0,
        )
        for k in range(2)
    ]  # fmt: skip
    frame = VehicleFrame.of(trucks)
    watch.look(frame, 0.0, boxes=True)
    watch.look(frame, 200.0, boxes=True)
    assert row.touches == touches
    assert row.stand_s == pytest.approx(200.0)
    assert np.isclose(row.vehicles, 2.0)
