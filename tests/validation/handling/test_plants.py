"""The planar plants stay within the published errors of `iits-mj validate plant`."""

import numpy as np
import pytest

from iits_mj.validation.handling.plants import Maneuver, Trace, compare, maneuvers

MANEUVERS = {maneuver.name.split(",")[0]: maneuver for maneuver in maneuvers(quick=True)}


@pytest.mark.parametrize("name", ["step steer 40 deg", "lane change 0.4 Hz", "braking 3 m/s2"])
def test_a_planar_plant_moves_nearly_as_the_full_truck(name: str) -> None:
    found = compare(MANEUVERS[name])
    short = [check.shortfall() for check in found.checks if not check.ok]
    assert not short
    # Both plants are measured, and none exceeds its limits here.
    assert {check.name.split(": ")[1].split(",")[0] for check in found.checks} == {
        "yaw-roll",
        "yaw-sideslip",
    }


def test_a_wheel_that_lifts_falls_short() -> None:
    fast = Maneuver(**{**vars(MANEUVERS["step steer 40 deg"]), "speed": 27.0, "duration": 5.0})
    short = [check.name for check in compare(fast).checks if not check.ok]
    assert any("limits exceeded" in name for name in short)


def at_20_meters_a_second(gears: list[tuple[float, float]]) -> Trace:
    """A minute at a steady speed; gears from a time on [s]."""
    time = np.arange(0.0, 60.0, 0.01)
    gear = np.full(time.size, 12.0)
    for begin, number in gears:
        gear[time >= begin] = number
    zeros = np.zeros(time.size)
    return Trace(time, 20.0 * time, 20.0 + zeros, zeros, zeros, time, gear, zeros[None])


def test_a_trace_is_resampled_at_places_of_the_road() -> None:
    trace = at_20_meters_a_second([(30.0, 11.0)]).at(np.array([0.0, 599.0, 601.0, 5000.0]))
    assert trace.time == pytest.approx([0.0, 29.95, 30.05, 59.99])
    assert trace.gear.tolist() == [12, 12, 11, 11]
    assert trace.articulation.shape == (1, 4)


@pytest.mark.parametrize(("late", "uneven"), [(0.1, 0.1), (0.6, 30.6)])
def test_speeds_are_uneven_for_half_a_minute_after_a_late_gear_change(late, uneven) -> None:
    early, other = ([(10.0 + by, 11.0)] for by in (0.0, late))
    settled = at_20_meters_a_second(early).settled(at_20_meters_a_second(other))
    assert np.count_nonzero(~settled) * 0.01 == pytest.approx(uneven, abs=0.02)
