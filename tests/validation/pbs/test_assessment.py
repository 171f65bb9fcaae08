import dataclasses

import numpy as np
import pytest

from iits_mj.core.results import Results
from iits_mj.core.units import KMH
from iits_mj.parameters import TruckParameters
from iits_mj.validation import COMMANDS, ValidateConfig
from iits_mj.validation.handling.lane_change import follow_path
from iits_mj.validation.pbs import measures
from iits_mj.validation.pbs.assessment import Assessment, amplifications
from iits_mj.validation.pbs.maneuvers import LaneChange
from iits_mj.validation.pbs.straight import straight_path

STEP = 0.004
TRUCK = TruckParameters.load()
B_DOUBLE, A_DOUBLE = TruckParameters.load("b_double"), TruckParameters.load("a_double")


def amplification(truck):
    change = follow_path(truck, truck.payload_max, LaneChange.speed, STEP)
    return amplifications(truck, truck.payload_max, change), change.off_tracking()


def test_a_double_amplifies_more_than_a_b_double_of_which_all_units_roll_together():
    (b_together, b_last), b_track = amplification(B_DOUBLE)
    (a_together, a_last), a_track = amplification(A_DOUBLE)
    # Public figures: 1.2 to 1.4 for B-doubles and 2 or more for A-doubles, of the last unit.
    assert 1.2 <= b_last <= 1.45
    assert 2.0 <= a_last <= 3.0
    # The units of a B-double swing one after the other and hold each other upright.
    assert b_together < 1.0 < a_together
    assert b_track < a_track


def test_only_units_behind_a_drawbar_roll_together():
    sides = np.array([[1.0, 2.0, 30.0, 30.0], [0.0, 0.0, 0.0, 0.0]])
    payload = A_DOUBLE.payload_max
    assert measures.roll_coupled_acceleration(A_DOUBLE, payload, sides)[0] == pytest.approx(30.0)
    together = measures.roll_coupled_acceleration(B_DOUBLE, 0.0, sides[:, :3])[0]
    assert 1.0 < together < 30.0


def test_truck_follows_the_rough_straight_and_needs_more_width_than_its_body():
    drive = straight_path(TRUCK, TRUCK.payload_max, STEP)
    width = measures.tracking_ability(drive.points)
    assert TRUCK.last.width + 0.1 < width < 2.9
    assert np.max(np.abs(drive.steer_axle)) < 0.2
    assert np.min(drive.speed) > 88.0 * KMH


def test_longer_combination_needs_more_width():
    widths = [
        measures.tracking_ability(straight_path(truck, truck.payload_max, STEP).points)
        for truck in (dataclasses.replace(A_DOUBLE, units=A_DOUBLE.units[:2]), A_DOUBLE)
    ]
    assert widths[0] < widths[1]


def test_assessors_table_shows_limits_and_levels():
    truck = Assessment("mine", {"swept_path": 8.0, "rollover": 0.4}, {"rollover": 0.41}, (), [])
    head, *rows = truck.rows()
    assert truck.level == 2
    assert head[4:] == ("level 1", "level 2", "level 3", "level 4", "level")
    assert rows[0] == (
        *("low-speed swept path", "8", "m", "", "<= 7.4", "<= 8.7", "<= 10.6", "<= 13.7", "2"),
    )
    assert rows[1][3] == "0.41"


def test_tables_are_shown_before_the_notes():
    results = Results("validate pbs", tables={"mine": [("a", "b"), ("1", "22")]}, notes=["note"])
    assert results.to_table().splitlines() == ["", "mine", "a  b", "1  22", "note"]


@pytest.mark.slow
def test_tractor_with_semitrailer_reaches_a_level_and_others_are_compared():
    results = COMMANDS["pbs"](ValidateConfig(truck="vecto_40t"))
    assert list(results.tables) == ["vecto_40t: level 1"]
    assert results.ok
    assert list(results.figures) == ["vecto_40t"]
