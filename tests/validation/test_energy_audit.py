"""The ledger closes, and notices when a force is not what it should be."""

import dataclasses

import numpy as np
import pytest

from iits_mj.truck import Truck
from iits_mj.validation import energy_audit
from iits_mj.validation.energy import Ledger
from iits_mj.validation.slopes import hills

NEUTRAL = 1.0
PARTS = ("air", "rolling", "slip", "tire_damping", "suspension", "brakes")


def roll(payload=0.0, timestep=0.002, duration=4.0, **command):
    truck = Truck.load(payload, route=hills(), timestep=timestep, visuals=False)
    truck.reset(station=200.0, speed=20.0)
    truck.command(**command)
    truck.step(round(0.5 / timestep))
    ledger = Ledger(truck)
    before = ledger.stored()
    ledger.step(round(duration / timestep))
    return truck, ledger, before.total - ledger.stored().total


@pytest.mark.parametrize("payload", [0.0, 36_000.0])
def test_a_rolling_truck_loses_what_road_and_air_take(payload):
    _, ledger, lost = roll(payload, transmission_mode=NEUTRAL)
    found = sum(getattr(ledger.losses, name) for name in PARTS)
    assert found == pytest.approx(lost + ledger.losses.shaft, rel=0.005)


def test_energy_of_a_braked_truck_goes_into_the_brakes():
    _, ledger, lost = roll(transmission_mode=NEUTRAL, xbr_mode=2.0, xbr_demand=-2.0)
    losses = ledger.losses
    assert losses.brakes > 0.8 * lost
    found = sum(getattr(losses, name) for name in PARTS)
    assert found == pytest.approx(lost + losses.shaft, rel=0.005)


def test_a_wrong_force_leaves_a_gap():
    truck, ledger, lost = roll(transmission_mode=NEUTRAL)
    right = sum(getattr(ledger.losses, name) for name in PARTS)
    air = dataclasses.replace(truck.parameters.aerodynamics, drag_area=7.0)
    wrong = Truck.load(0.0, route=hills(), visuals=False)
    wrong.parameters = dataclasses.replace(truck.parameters, aerodynamics=air)
    assert Ledger(wrong)._air_share == ledger._air_share
    surplus = ledger.losses.air * (7.0 / truck.parameters.aerodynamics.drag_area - 1.0)
    assert abs(right + surplus - lost) > 0.01 * lost


def test_contact_of_the_ledger_gives_the_load_of_the_tires():
    truck, ledger, _ = roll(36_000.0, duration=1.0)
    truck.observe()
    vx, _, vz = (part[:12] for part in ledger._velocity())
    deflection, _, away = ledger._contact(vx, vz)
    load = ledger._stiffness * deflection - ledger._damping * away
    names = [f"{a.name}_{s}_tire_force" for a in truck.parameters.axles for s in ("left", "right")]
    read = np.array([truck.read(name, 2) for name in names])
    np.testing.assert_allclose(load, read, rtol=1e-4)


def test_energy_of_a_short_trip_is_found_within_half_a_percent():
    trip = energy_audit.drive(0.0, 0.005, length=300.0)
    assert trip.counters["engine_work"] > 1e6
    assert abs(trip.error) < 0.005
    assert abs(trip.driveline_error) < 0.005
    assert abs(trip.wheels_error) < 0.005
    stored = trip.after.kinetic - trip.before.kinetic
    assert 0.2 < stored / trip.counters["engine_work"] < 0.9
