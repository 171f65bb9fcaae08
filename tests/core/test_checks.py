"""What a learner hands in is refused at the boundary when it is not numbers of the right shape."""

import math

import numpy as np
import pytest

from iits_mj.core.checks import read_action
from iits_mj.core.errors import InputError


def test_numbers_of_any_kind_are_read_as_they_are():
    assert read_action([1, -0.5], (2,)).tolist() == [1.0, -0.5]
    assert read_action(np.float32([0.25]), (1,)).tolist() == [0.25]


@pytest.mark.parametrize(
    "action", [[0.0], [0.0, 0.0, 0.0], [[0.0, 0.0]], [math.nan, 0.0], [0.0, math.inf], "left", None]
)
def test_what_is_no_action_is_refused_and_named(action):
    with pytest.raises(InputError, match=r"^throttle .*; use finite numbers of shape \(2,\)"):
        read_action(action, (2,), "throttle")
