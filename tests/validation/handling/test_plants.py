"""The planar plants stay within the published errors of `iits-mj validate plant`."""

import pytest

from iits_mj.validation.handling.plants import Maneuver, compare, maneuvers

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
