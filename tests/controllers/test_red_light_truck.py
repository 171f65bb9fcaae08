"""The MuJoCo truck stops before the line of a red light and stays there until it is green."""

import math

import pytest

from iits_mj.validation.planning.stops import cases, drive_to_red

QUICK = [
    (16.67, 36_000.0, -0.06, False),
    (16.67, 0.0, -0.06, False),
    (16.67, 36_000.0, 0.0, True),
]


def judge(speed, payload, grade, known, *, braking):
    drive = drive_to_red(speed, payload, grade, known=known)
    assert not drive.ran_red
    assert drive.braking < braking
    # It continues on green.
    assert math.isfinite(drive.crossed)
    if known:
        assert drive.record["speed"].min() > 1.0 or 0.0 < drive.place < 1.5
    else:
        assert 0.0 < drive.place < 1.5


@pytest.mark.parametrize(("speed", "payload", "grade", "known"), QUICK)
def test_the_truck_crosses_no_red_line_brakes_gently_and_stands_before_it(
    speed, payload, grade, known
):
    judge(speed, payload, grade, known, braking=2.0)


@pytest.mark.parametrize(("speed", "grade", "sight"), [(8.0, -0.06, 60.0), (12.0, 0.0, 100.0)])
def test_an_empty_truck_brakes_no_harder_where_its_engine_brake_fades(speed, grade, sight):
    drive = drive_to_red(speed, 0.0, grade, known=False, green=2.8 * sight / speed, sight=sight)
    assert not drive.ran_red
    assert drive.braking < 2.0
    assert 0.0 < drive.place < 1.5


@pytest.mark.slow
@pytest.mark.parametrize(("speed", "payload", "grade", "known"), cases(quick=False))
def test_at_every_speed_load_and_grade_the_line_is_respected(speed, payload, grade, known):
    # The plan's own limit outside emergencies, 3.5 m/s2.
    judge(speed, payload, grade, known, braking=3.6)
