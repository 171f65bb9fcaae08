import math

import pytest

from iits_mj.commands.bench.environments import environments, import_time, scaling


@pytest.mark.parametrize(
    ("measure", "count"),
    [
        (lambda: environments(rounds=1), 4),
        (lambda: import_time(rounds=1), 1),
        (lambda: scaling(counts=(2,), threads=(1, 2), steps=1), 3),
    ],
)
def test_every_figure_is_a_positive_number(measure, count):
    checks = measure().checks
    assert len({check.name for check in checks}) == count
    assert all(math.isfinite(check.value) and check.value > 0.0 for check in checks)
