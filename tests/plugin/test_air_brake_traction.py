"""Brakes against the engine: braking cuts the traction, which returns smoothly afterwards."""

import numpy as np
import pytest

from tests.plugin.vehicle_sled import KMH, Sled

XBR = {"xbr_demand": -1.5, "xbr_mode": 2.0}


@pytest.mark.parametrize("controls", [XBR, {"brake_pedal": 0.15}], ids=["xbr", "pedal"])
def test_braking_cuts_the_traction_of_the_engine(controls):
    sled = Sled(40_000.0, speed=60 * KMH).run(4.0, accelerator_pedal=0.8)
    assert sled["propeller_shaft_torque"] > 1000
    sled.run(2.5, **controls)
    before = sled["speed"]
    rows = sled.record(2.0, "propeller_shaft_torque", "speed")
    assert np.all(rows[:, 0] < 50)
    assert (before - sled["speed"]) / 2.0 == pytest.approx(1.5, rel=0.04)


def test_traction_returns_after_braking():
    sled = Sled(40_000.0, speed=60 * KMH).run(3.0, accelerator_pedal=0.5).run(2.0, **XBR)
    rows = sled.record(5.0, "propeller_shaft_torque", "speed", xbr_demand=0.0)
    assert rows[-1, 0] > 500
    acceleration = np.convolve(np.gradient(rows[:, 1], 0.002), np.ones(100) / 100, mode="valid")
    assert np.gradient(acceleration, 0.002).max() < 8.0
    assert acceleration[-1] > 0.05


def test_brake_pedal_holds_the_truck_against_the_engine():
    sled = Sled(20_000.0).run(2.0, brake_pedal=0.4)
    sled.run(4.0, accelerator_pedal=1.0)
    assert abs(sled["position"]) < 0.02
