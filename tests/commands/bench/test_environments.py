import math

import pytest

from iits_mj.commands.bench.environments import environments, import_time


@pytest.mark.parametrize(
    ("measure", "count"),
    [
        (lambda: environments(rounds=1), 4),
        (lambda: import_time(rounds=1), 1),
    ],
)
def test_every_figure_is_a_positive_number(measure, count):
    checks = measure().checks
    assert len({check.name for check in checks}) == count
    assert all(math.isfinite(check.value) and check.value > 0.0 for check in checks)
