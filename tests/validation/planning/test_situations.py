"""The planner's situations as `iits-mj validate planning` shows them."""

import pytest

from iits_mj.core.results import Results
from iits_mj.validation.harness.config import ValidateConfig
from iits_mj.validation.planning.situations import run_situations


@pytest.fixture(scope="module")
def quick() -> Results:
    return run_situations(ValidateConfig(quick=True))


def test_every_situation_is_mastered(quick):
    assert [check.name for check in quick.checks if not check.ok] == []


def test_the_paper_s_three_situations_are_drawn_from_above(quick):
    panels = quick.figures["lane change, seen from above"]
    assert [panel.title[:3] for panel in panels] == ["(a)", "(b)", "(c)"]
    for panel in panels:
        assert any(line.label == "planned path" for line in panel.lines)
        assert all(line.x.shape == line.y.shape for line in panel.lines)


def test_the_reasons_are_told_in_words(quick):
    assert any("there is no lane to the right" in note for note in quick.notes)
    assert any("beside the truck" in note for note in quick.notes)
    assert any("aiming for the gap" in note for note in quick.notes)
