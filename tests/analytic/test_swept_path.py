import dataclasses
import math

import numpy as np
import pytest

from iits_mj.analytic import Kinematic
from iits_mj.analytic.swept_path import (
    Outline,
    frontal_swing,
    outward,
    swept_width,
    tail_swing,
    turn,
    turning_circle,
)
from iits_mj.core.errors import InputError
from iits_mj.parameters import TruckParameters

SHIPPED = Outline.from_parameters(TruckParameters.load())
# A B-double of usual dimensions: fifth wheels ahead of the axle centers.
DOUBLE = Outline(
    Kinematic(L=4.6, hitches=(-0.5, 0.2), lengths=(7.2, 8.8)),
    front=np.array([5.9, 8.3, 9.9]),
    rear=np.array([-1.6, 1.2, -3.8]),
    width=np.array([2.5, 2.5, 2.5]),
    tire=1.2,
)


@pytest.mark.parametrize("outline", [SHIPPED, DOUBLE], ids=["semitrailer", "double"])
def test_long_turn_ends_in_the_steady_off_tracking(outline):
    radius = 20.0
    done = turn(outline, radius, 4.0 * math.pi, guide=0.0)
    center = np.array([0.0, radius])
    end = -1 - round(40.0 / 0.02)
    found = np.linalg.norm(done.poses[end, -1, :2] - center) - radius
    assert found == pytest.approx(outline.kinematic.off_tracking(radius), abs=1e-3)


@pytest.mark.parametrize("outline", [SHIPPED, DOUBLE], ids=["semitrailer", "double"])
def test_wheels_roll_without_side_slip_and_couplings_stay_closed(outline):
    done, kinematic = turn(outline), outline.kinematic
    for unit in range(kinematic.units):
        x, y, heading = done.poses[:, unit].T
        across = -np.diff(x) * np.sin(heading[1:]) + np.diff(y) * np.cos(heading[1:])
        assert np.abs(across).max() < 2e-4
    for k, (hitch, length) in enumerate(zip(kinematic.hitches, kinematic.lengths, strict=True)):
        ends = []
        for unit, ahead in ((k, -hitch), (k + 1, length)):
            x, y, heading = done.poses[:, unit].T
            ends.append([x + ahead * np.cos(heading), y + ahead * np.sin(heading)])
        np.testing.assert_allclose(*ends, atol=1e-9)


def test_guided_point_is_the_outer_wall_of_the_steer_tire():
    done = turn(SHIPPED)
    x, y, heading = done.poses[:, 0].T
    L, tire = SHIPPED.kinematic.L, SHIPPED.tire
    wall = [
        x + L * np.cos(heading) + tire * np.sin(heading),
        y + L * np.sin(heading) - tire * np.cos(heading),
    ]
    np.testing.assert_allclose(np.transpose(wall), done.path, atol=1e-9)
    np.testing.assert_allclose(outward(done.path, done.radius, done.angle), 0.0, atol=1e-9)


def test_longer_trailer_sweeps_more_and_a_double_more_than_a_semitrailer():
    longer = dataclasses.replace(
        SHIPPED,
        kinematic=dataclasses.replace(SHIPPED.kinematic, lengths=(9.0,)),
        front=SHIPPED.front + np.array([0.0, 1.1]),
    )
    widths = [swept_width(turn(outline).sides()) for outline in (SHIPPED, longer, DOUBLE)]
    assert widths == sorted(widths)
    assert 5.0 < widths[0] < 6.5
    # Published assessments of 25 m B-doubles lie between 7.4 m and 8.7 m (PBS levels 1 and 2).
    assert 7.0 < widths[2] < 8.7


def test_swept_width_of_concentric_tracks_is_their_distance():
    angle = np.linspace(0.0, 0.5 * np.pi, 2000)
    tracks = [np.column_stack([r * np.sin(angle), 12.5 - r * np.cos(angle)]) for r in (9.0, 13.1)]
    assert swept_width(np.array(tracks)) == pytest.approx(13.1 - 9.0, abs=1e-6)
    with pytest.raises(InputError, match="no point passes"):
        swept_width(np.array([[-3.0, 0.0]]))


def test_tail_swings_out_only_with_an_overhang_and_more_with_a_longer_one():
    swings = []
    for overhang in (0.0, 2.0, 4.0):
        tail = dataclasses.replace(SHIPPED, rear=np.array([0.0, -overhang]))
        swings.append(tail_swing(turn(tail).tracks()[:, :, 2])[1])
    assert swings[0] == pytest.approx(0.0, abs=1e-9)
    assert 0.0 < swings[1] < swings[2] < 0.5


def test_front_swings_out_with_its_overhang():
    swings = []
    for overhang in (0.0, 1.4):
        front = np.array([SHIPPED.kinematic.L + overhang, SHIPPED.front[1]])
        done = turn(dataclasses.replace(SHIPPED, front=front, width=np.full(2, 2.0 * SHIPPED.tire)))
        swings.append(frontal_swing(done.tracks()[:, :, 1])[0])
    # Without overhang the corner is the guided point itself.
    assert swings[0] == pytest.approx(0.0, abs=1e-9)
    assert 0.3 < swings[1] < 0.8


def test_turning_circle_is_that_of_the_bicycle():
    alone = Outline(Kinematic(4.0, (), ()), np.array([5.4]), np.array([-1.0]), np.array([2.5]), 1.2)
    found = turning_circle(alone, math.atan(4.0 / 6.0))
    assert found.curb == pytest.approx(2.0 * math.hypot(7.2, 4.0))
    assert found.wall == pytest.approx(2.0 * math.hypot(7.25, 5.4))
    assert found.inner == pytest.approx(6.0 - 1.25)
    assert math.isnan(turning_circle(SHIPPED, 0.7).inner)


@pytest.mark.parametrize("value", [0.0, -2.0, float("nan"), float("inf")])
def test_impossible_turns_are_refused(value):
    with pytest.raises(InputError, match="radius"):
        turn(SHIPPED, value)
    with pytest.raises(InputError, match="steer"):
        turning_circle(SHIPPED, value)


def test_radius_below_the_wheelbase_is_refused():
    with pytest.raises(InputError, match="wheelbase"):
        turn(SHIPPED, 3.0)
