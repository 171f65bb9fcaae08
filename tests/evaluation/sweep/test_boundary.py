"""Adaptive designs find known boundaries with fewer points than a grid."""

import numpy as np
import pytest

from iits_mj.evaluation.sweep.boundary import Boundary


def located(outcome, counts, limit):
    """The boundary after at most `limit` points, and the number of rounds."""
    boundary, rounds = Boundary(counts), 0
    while nodes := boundary.ask(limit - len(boundary.found)):
        rounds += 1
        assert len(set(nodes)) == len(nodes)
        assert not set(nodes) & set(boundary.found)
        boundary.found |= {node: outcome(*boundary.share(node)) for node in nodes}
    assert len(boundary.found) <= limit
    return boundary, rounds


def three_classes(x, y):
    if (x - 0.2) ** 2 + (y - 0.1) ** 2 < 0.2:
        return "collision"
    return "near miss" if y < 0.9 - 0.5 * x else "comfortable"


PLACES = np.random.default_rng(1).random((4000, 2))


def wrong(boundary, outcome=three_classes, places=PLACES):
    """Share of places whose outcome is predicted wrongly."""
    true = [outcome(*place) for place in places]
    return np.mean([a != b for a, b in zip(boundary.predicted(places), true, strict=True)])


def wrong_of_grid(n):
    return np.mean([
        three_classes(*(np.round(place * (n - 1)) / (n - 1))) != three_classes(*place)
        for place in PLACES
    ])  # fmt: skip


def test_one_axis_is_bisected():
    boundary, _ = located(lambda x: "a" if x < 0.618 else "b", (5,), 12)
    (width,) = boundary.widths()
    assert width <= 0.25 / 2**6
    assert boundary.equal_grid() == round(1 / width) + 1 >= 257


def test_the_first_points_are_those_of_the_grid():
    boundary = Boundary((3, 4))
    shares = [boundary.share(node) for node in boundary.ask(1)]
    assert sorted(shares) == [(x / 2, y / 3) for x in range(3) for y in range(4)]


def test_a_hundred_points_show_the_boundaries_as_well_as_a_grid_of_more_than_five_hundred():
    boundary, rounds = located(three_classes, (5, 5), 100)
    assert wrong(boundary) < wrong_of_grid(23)  # 529 points
    assert boundary.equal_grid() > 250
    assert rounds <= 15


def test_more_points_locate_the_boundaries_better():
    errors = [wrong(located(three_classes, (5, 5), n)[0]) for n in (30, 60, 120, 240)]
    assert sorted(errors, reverse=True) == errors
    assert errors[-1] < 0.25 * errors[0]


def test_the_points_are_the_same_each_time():
    first, second = (list(located(three_classes, (4, 5), 90)[0].found) for _ in range(2))
    assert first == second


def test_an_island_between_the_first_points_is_found_with_time():
    def island(x, y):
        return "collision" if abs(x - 0.13) < 0.06 and abs(y - 0.62) < 0.06 else "comfortable"

    assert located(island, (5, 5), 25)[0].widths() == ()
    assert "collision" in located(island, (5, 5), 120)[0].found.values()


def test_points_without_an_outcome_make_no_boundary():
    boundary, _ = located(lambda x, y: None if x > 0.6 else "a", (3, 3), 40)
    assert boundary.widths() == ()
    assert set(boundary.predicted(np.array([[0.2, 0.2]]))) == {"a"}


def test_three_axes_are_refined():
    def outcome(x, y, z):
        return "a" if x + 0.5 * y * y + 0.3 * z < 0.9 else "b"

    coarse, fine = (located(outcome, (3, 3, 3), n)[0] for n in (27, 240))
    assert coarse.equal_grid() == 27
    assert fine.equal_grid() > 3 * 240
    # Each bracket has the surface between its ends.
    for middle, axis, length in fine.brackets():
        ends = [list(fine.share(middle)) for _ in range(2)]
        ends[0][axis] -= 0.5 * length
        ends[1][axis] += 0.5 * length
        assert outcome(*ends[0]) != outcome(*ends[1])


@pytest.mark.parametrize("counts", [(2,), (2, 2), (2, 3, 2)])
def test_a_design_without_budget_asks_for_nothing_more(counts):
    boundary = Boundary(counts)
    boundary.found |= dict.fromkeys(boundary.ask(0), "a")
    assert boundary.ask(0) == []
