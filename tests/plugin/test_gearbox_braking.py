"""Gear choice while the engine brakes."""

import numpy as np
import pytest

from tests.plugin.driveline_rig import CONTROLS, PARAMETERS, Case, constant, drive, shifts
from tests.plugin.vehicle_sled import KMH

ENGINE, SHIFTING = PARAMETERS.engine, PARAMETERS.gearbox.shifting
BRAKE = CONTROLS.index("engine_brake")


def braked(cases, shares, seconds, **options):
    """Returns runs with the pedal released and the engine brake at constant shares."""
    controls = constant(len(cases), seconds, np.zeros(len(cases)))
    controls[:, :, BRAKE] = np.asarray(shares)[:, np.newaxis]
    return drive(cases, controls, **options)


def test_engine_brake_shifts_down_into_its_speed_range():
    cases = [Case(55_000.0, -0.035, speed * KMH) for speed in (40, 55, 70, 85)]
    traces = braked(cases, np.ones(4), 12.0)
    settled = traces["engine_speed"][:, round(8.0 / 0.005)]
    # One gear lower would exceed the range: gear steps are 1.27 to 1.31.
    assert settled.min() > SHIFTING.braking_speed_high * ENGINE.engine_brake_speed / 1.33
    assert settled.max() < ENGINE.engine_brake_speed
    assert np.all(traces["gear"][:, -1] < traces["gear"][:, 0])


def test_engine_turns_faster_with_more_engine_brake():
    shares = np.array([0.1, 0.5, 1.0])
    cases = [Case(37_000.0, -0.02, 75 * KMH)] * 3
    traces = braked(cases, shares, 8.0)
    turns = traces["engine_speed"][:, -1]
    assert turns[1] > 1.15 * turns[0]
    assert turns[2] > 1.15 * turns[1]
    assert np.all(np.diff(traces["speed"][:, -1]) < 0)


def test_braking_engine_shifts_up_only_at_its_overspeed():
    """The engine brake cannot hold this descent; the gear stays up to the engine's speed limit."""
    traces = braked([Case(55_000.0, -0.08, 40 * KMH)], [1.0], 40.0)
    gear, turns = traces["gear"][0], traces["engine_speed"][0]
    upshifts = [round(time / 0.005) for time, before, after in shifts(gear) if after > before]
    assert upshifts
    limit = SHIFTING.overspeed_braking * ENGINE.engine_brake_speed
    assert turns[upshifts[0] - 1] == pytest.approx(limit, rel=0.005)
    assert turns.max() < 1.03 * limit


def test_downshifts_for_the_engine_brake_never_overspeed_the_engine():
    cases = [Case(mass, -0.06, 60 * KMH) for mass in (19_000.0, 37_000.0, 55_000.0)]
    traces = braked(cases, np.ones(3), 10.0)
    for i in range(3):
        for time, _, _ in shifts(traces["gear"][i]):
            begin = round(time / 0.005)
            assert traces["engine_speed"][i, begin : begin + 250].max() < ENGINE.engine_brake_speed


def test_engine_brake_causes_no_downshift_while_a_climb_slows_the_truck():
    """A climb of 9 % slows the truck by 0.9 m/s2, as friction brakes would."""
    cases = [Case(37_000.0, 0.09, 70 * KMH)] * 2
    traces = braked(cases, [0.0, 1.0], 6.0)
    without, with_brake = ([c[1:] for c in shifts(gear)] for gear in traces["gear"])
    assert len(with_brake) <= len(without) + 1
    assert traces["engine_speed"][1].max() < 0.8 * ENGINE.engine_brake_speed
    assert traces["speed"][1, -1] < traces["speed"][0, -1]


def test_gear_is_kept_when_the_engine_brake_is_released_on_the_descent():
    controls = constant(1, 20.0, [0.0])
    controls[:, :2000, BRAKE] = 1.0
    traces = drive([Case(37_000.0, -0.02, 70 * KMH)], controls)
    gear = traces["gear"][0]
    assert gear[1990] < gear[0]
    assert np.all(gear[2000:2800] == gear[1999])
