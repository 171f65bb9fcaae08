"""The rolling cruise as a speed reference of the stack."""

from dataclasses import replace

import numpy as np
import pytest

from controllers.pcc.rolling import RollingReference
from iits_mj.core.errors import InputError
from iits_mj.core.messages import EgoState, Scene
from iits_mj.road.measured import Lanes, measured_route
from iits_mj.validation.planning.closed_loop import DriveTask, drive

STATION = np.arange(0.0, 3_001.0, 10.0)


def route(grade):
    """A straight road: level for 500 m, then 1 km with a grade, then level."""
    height = grade * np.clip(STATION - 500.0, 0.0, 1_000.0)
    return measured_route(STATION, height, lanes=Lanes(speed_limit=40.0), name="road")


def scene(station, speed, mass=55_000.0):
    return Scene(0.0, EgoState(station=station, speed=speed, mass=mass), ())


def profile(reference, station, speed):
    return reference.update(scene(station, speed), lambda: None)


def test_reference_is_the_set_speed_where_the_truck_does_not_roll():
    for grade, station, speed in ((0.04, 600.0, 17.0), (0.04, 600.0, 20.0), (-0.04, 0.0, 15.0)):
        found = profile(RollingReference(route(grade), 20.0, 25.0), station, speed)
        near = found.station < station + 400.0
        assert found.speed[near] == pytest.approx(20.0, abs=1e-6)


def test_reference_downhill_rises_from_the_trucks_speed_to_the_top():
    reference = RollingReference(route(-0.04), 20.0, 25.0)
    found = profile(reference, 600.0, 21.0)
    assert found.speed[0] == pytest.approx(21.0)
    assert (np.diff(found.speed) > -1e-9).all()
    assert found.speed.max() == pytest.approx(25.0)
    assert reference.at(600.0) == pytest.approx(21.0)
    assert reference.free(600.0) == 20.0


def test_reference_on_the_level_falls_as_the_truck_coasts():
    found = profile(RollingReference(route(-0.04), 20.0, 25.0), 1_600.0, 24.0)
    slowing = np.diff(found.speed**2) / 20.0
    assert (slowing < 0.0).all()
    # Rolling, air and overrun at 55 t: about 0.15 m/s2.
    assert slowing[0] == pytest.approx(-0.15, abs=0.05)


def test_a_top_below_the_set_speed_and_a_bad_state_are_refused():
    with pytest.raises(InputError, match="top"):
        RollingReference(route(0.0), 20.0, 19.0)
    reference = RollingReference(route(0.0), 20.0, 25.0)
    for bad in ({"speed": np.nan}, {"station": np.inf}, {"mass": np.nan}):
        with pytest.raises(InputError, match=next(iter(bad))):
            reference.update(Scene(0.0, replace(EgoState(), **bad), ()), lambda: None)


@pytest.mark.slow
def test_the_truck_rolls_downhill_nearly_without_fuel_and_is_faster_than_the_braking_cruise():
    task = DriveTask(route(-0.03), 100.0, 2_500.0, 20.0, 20.0, top=25.0, timestep=0.005)
    rolling, braking = drive(task), drive(replace(task, top=None))
    assert 24.5 < rolling["speed"].max() < 25.5
    assert braking["speed"].max() < 20.5
    above = rolling["speed"] > 21.0
    burnt = np.gradient(rolling["fuel_used"])
    assert burnt[above].sum() < 0.03 * burnt.sum()
    assert rolling.table[-1, 0] < braking.table[-1, 0] - 5.0
    # What the braking cruise loses in its brakes, the rolling one coasts on.
    assert rolling["fuel_used"][-1] < 0.9 * braking["fuel_used"][-1]
