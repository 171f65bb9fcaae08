"""The ledger of energies closes, and shows a wrong force."""

import numpy as np
import pytest

from iits_mj.parameters import TruckParameters, shipped_trucks
from iits_mj.truck import Truck
from iits_mj.validation.longitudinal import energy_audit
from iits_mj.validation.longitudinal.energy_audit import Ledger
from iits_mj.validation.longitudinal.hills import hills

NEUTRAL = 1.0
PARTS = ("air", "rolling", "slip", "tire_damping", "suspension")


def roll(payload=0.0, timestep=0.002, duration=4.0, believed=None, **command):
    """Rolls over a hill; returns the losses of the ledger and of the truck [J], among others."""
    truck = Truck.load(payload, route=hills(), timestep=timestep, visuals=False)
    truck.reset(station=200.0, speed=20.0)
    truck.command(**command)
    truck.step(round(0.5 / timestep))
    if believed is not None:
        truck.parameters = believed(truck.parameters)
    ledger = Ledger(truck)
    before, work = ledger.stored(), truck.read("brake_work")
    ledger.step(round(duration / timestep))
    lost = before.total - ledger.stored().total + ledger.losses.shaft
    brakes = truck.read("brake_work") - work
    found = brakes + sum(getattr(ledger.losses, name) for name in PARTS)
    return truck, ledger, brakes, found, lost


@pytest.mark.parametrize("payload", [0.0, 36_000.0])
def test_energy_loss_of_a_rolling_truck_is_the_work_of_road_and_air(payload):
    _, _, brakes, found, lost = roll(payload, transmission_mode=NEUTRAL)
    assert found == pytest.approx(lost, rel=0.005)
    assert brakes == 0.0


def test_energy_of_a_braked_truck_goes_into_the_brakes():
    _, ledger, brakes, found, lost = roll(transmission_mode=NEUTRAL, xbr_mode=2.0, xbr_demand=-2.0)
    assert found == pytest.approx(lost, rel=0.005)
    assert brakes > 0.8 * lost
    assert ledger.losses.brakes == pytest.approx(brakes, rel=0.005)


@pytest.mark.parametrize(
    "overlay",
    [{"aerodynamics": {"drag_area": 7.0}}, {"tires": {"*": {"rolling_resistance": 0.0066}}}],
    ids=["air", "tires"],
)
def test_a_tenth_too_much_of_a_force_leaves_a_gap(overlay):
    def believed(_):
        return TruckParameters.load(overlay=overlay)

    *_, found, lost = roll(transmission_mode=NEUTRAL, believed=believed)
    assert found > 1.02 * lost


def test_contact_of_the_ledger_gives_the_load_of_the_tires():
    truck, ledger, *_ = roll(36_000.0, duration=1.0)
    truck.observe()
    names = [f"{a.name}_{s}_tire_force" for a in truck.parameters.axles for s in ("left", "right")]
    read = np.array([truck.read(name, 2) for name in names])
    np.testing.assert_allclose(ledger.tire_loads(), read, rtol=1e-4)


@pytest.mark.parametrize("name", shipped_trucks())
def test_energy_of_a_short_trip_is_found_within_half_a_percent(name):
    trip = energy_audit.drive(TruckParameters.load(name), 0.0, 0.005, length=300.0)
    assert trip.counters["engine_work"] > 1e6
    assert abs(trip.error) < 0.005
    assert abs(trip.driveline_error) < 0.005
    assert abs(trip.wheels_error) < 0.005
    stored = trip.after.kinetic - trip.before.kinetic
    assert 0.2 < stored / trip.counters["engine_work"] < 0.9
