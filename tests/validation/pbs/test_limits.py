import pytest

from iits_mj.core.errors import InputError
from iits_mj.validation.pbs.limits import STANDARDS, reached


@pytest.mark.parametrize("name", STANDARDS)
def test_higher_levels_never_ask_for_more(name):
    standard = STANDARDS[name]
    assert list(standard.limits) == sorted(standard.limits, reverse=standard.least)
    assert standard.level(standard.limits[0]) == 1
    worst = standard.limits[3]
    assert standard.level(worst - 1e-6 if standard.least else worst + 1e-6) is None


def test_combination_reaches_the_level_of_its_worst_measure():
    values = {"swept_path": 8.0, "startability": 16.0, "tail_swing": 0.32}
    levels, overall = reached(values)
    assert levels == {"swept_path": 2, "startability": 1, "tail_swing": 2}
    assert overall == 2
    assert reached({**values, "rollover": 0.34})[1] is None
    assert STANDARDS["swept_path"].must(2) == "<= 8.7"


def test_unknown_measures_and_missing_values_are_refused():
    with pytest.raises(InputError, match="none of"):
        reached({"comfort": 1.0})
    with pytest.raises(InputError, match="not a number"):
        reached({"rollover": float("nan")})
