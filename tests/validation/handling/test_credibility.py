import numpy as np
import pytest

from iits_mj.parameters import TruckParameters
from iits_mj.parameters.randomization import Spread
from iits_mj.validation.handling import credibility


@pytest.fixture(scope="module")
def trucks():
    spread = Spread.load(None, None)
    drawn = [spread.draw(np.random.default_rng(seed)).overlay for seed in (0, 1)]
    return [
        TruckParameters.load(None),
        *(TruckParameters.load(None, overlay) for overlay in drawn),
    ]


def figures(found):
    return {check.name.partition(": ")[2]: check for check in found.checks}


def test_a_step_steer_of_the_empty_truck_is_rated_excellent(trucks):
    found = credibility._step(trucks, 0.0, 0.005)
    checks = figures(found)
    assert checks["yaw rate of the tractor: rating by ISO/TS 18571"].value > 0.94
    assert checks["yaw rate of the tractor: rating by ISO/TS 18571"].reference == "excellent"
    own = checks["yaw rate of the tractor: end value"]
    low = checks["yaw rate of the tractor: end value: least of the drawn trucks"].value
    high = checks["yaw rate of the tractor: end value: greatest of the drawn trucks"].value
    assert low < high
    # Uncertain tires move the gain by far more than the model's own error.
    assert high - low > 3.0 * abs(own.value - own.reference)
    panel = found.panels[0]
    assert [line.label for line in panel.lines] == [
        "yaw-roll model",
        "truck",
        "lowest of 2 drawn trucks",
        "highest",
    ]


def test_the_circle_lies_in_the_envelope_of_wider_draws(trucks, monkeypatch):
    monkeypatch.setattr(credibility, "_SPEEDS", (6.0, 9.0, 12.0))
    checks = figures(credibility._circle(trucks, 0.0, 0.005))
    gradient = checks["understeer gradient"]
    assert gradient.value == pytest.approx(gradient.reference, rel=0.1)
    low = checks["understeer gradient: least of the drawn trucks"].value
    high = checks["understeer gradient: greatest of the drawn trucks"].value
    assert 0.5 < low < high < 6.0
