"""Trucks without trailer or with several: what a drive of them shows, and their overlays."""

import dataclasses

import pytest

from iits_mj.identification import from_frames, identify, overlay, write_toml
from iits_mj.identification.log import with_grade
from iits_mj.parameters import TruckParameters
from tests.combinations import load
from tests.identification.synthetic_drives import LONGITUDINAL, drive, frames
from tests.identification.truck_drives import hidden_truck, hill_drive, hills


def recorded(parameters, hidden, payload=0.0, duration=200.0):
    """The log of a drive over hills with a truck like `parameters`, with `hidden` values."""
    station, grade, route = hills()
    rows = drive(
        hidden_truck(payload, hidden, route, station=80.0, speed=12.0), hill_drive(), duration
    )
    log = from_frames(frames(rows, parameters, LONGITUDINAL), parameters)
    return with_grade(log, station, grade)


@pytest.fixture(scope="module")
def alone():
    parameters = load("alone")
    hidden = dataclasses.replace(
        parameters, aerodynamics=dataclasses.replace(parameters.aerodynamics, drag_area=6.6)
    )
    return parameters, identify(recorded(parameters, hidden), parameters)


def test_a_tractor_alone_shows_its_mass_and_drag(alone):
    parameters, found = alone
    assert found["mass"].value == pytest.approx(parameters.gross_mass(0.0), rel=0.05)
    assert found["drag_area"].value == pytest.approx(6.6, rel=0.1)
    assert found["drive_dead_time"].value == pytest.approx(0.07, abs=0.02)


def test_a_tractor_alone_has_no_estimates_of_a_trailer(alone):
    _, found = alone
    names = {estimate.name for estimate in found.estimates}
    assert not [name for name in names if "trailer" in name]
    assert {"brake_gain_front", "brake_gain_drive", "front_dead_time"} <= names
    assert "cornering_coefficient_steer" in names


def test_the_overlay_of_a_tractor_alone_loads_with_it(alone, tmp_path):
    _, found = alone
    assert set(overlay(found)["units"]) == {"tractor"}
    path = tmp_path / "identified.toml"
    write_toml(found, path)
    base = tmp_path / "truck.toml"
    base.write_text('extends = "tractor_semitrailer_6x4"\nremove = ["units.trailer"]\n')
    truck = TruckParameters.load(base, overlay=path)
    assert truck.aerodynamics.drag_area == pytest.approx(found["drag_area"].value, rel=1e-6)


def test_a_train_of_units_shows_its_mass_and_payloads_in_proportion():
    parameters, payload = load("b_double"), 30_000.0
    found = identify(recorded(parameters, parameters, payload), parameters)
    assert found["mass"].value == pytest.approx(parameters.gross_mass(payload), rel=0.05)
    cornering = found["cornering_coefficient_trailer"]
    assert not cornering.identifiable
    units = overlay(found)["units"]
    loads = [units[name]["payload"]["mass_max"] for name in ("trailer", "second")]
    assert loads[0] == pytest.approx(loads[1])
    assert sum(loads) == pytest.approx(found.mass - parameters.gross_mass(0.0))


def test_auxiliaries_take_their_power_from_the_engine(alone):
    parameters, _ = alone
    engine = dataclasses.replace(parameters.engine, auxiliaries={"fan": 12e3, "air": 3e3})
    hidden = dataclasses.replace(parameters, engine=engine)
    log = recorded(hidden, hidden)
    right, wrong = identify(log, hidden), identify(log, parameters)
    assert right["mass"].value == pytest.approx(parameters.gross_mass(0.0), rel=0.05)
    # Unknown auxiliaries take 15 kW that the fit can only count as resistance.
    rolling = [found["rolling_resistance"].value for found in (right, wrong)]
    assert rolling[1] > 2.0 * rolling[0]
