"""User values are refused with their name, value, unit and the allowed range."""

import math

import numpy as np
import pytest

from iits_mj.core.checks import in_range, one_of, positive, read_action
from iits_mj.core.errors import InputError


def test_actions_of_any_number_type_keep_their_values():
    assert read_action([1, -0.5], (2,)).tolist() == [1.0, -0.5]
    assert read_action(np.float32([0.25]), (1,)).tolist() == [0.25]


@pytest.mark.parametrize(
    "action", [[0.0], [0.0, 0.0, 0.0], [[0.0, 0.0]], [math.nan, 0.0], [0.0, math.inf], "left", None]
)
def test_an_unusable_action_is_refused_by_name(action):
    with pytest.raises(InputError, match=r"^throttle .*; use finite numbers of shape \(2,\)"):
        read_action(action, (2,), "throttle")


def test_numpy_numbers_pass_and_become_floats():
    assert in_range("speed", np.float64(3.0), 0.0, 40.0, "m/s") == 3.0
    assert type(positive("step", np.int64(2))) is float


@pytest.mark.parametrize("value", [-1.0, 41, math.nan, True, "3", None])
def test_a_number_out_of_range_is_refused_with_its_unit(value):
    with pytest.raises(InputError, match=r"^speed = .* m/s: allowed is 0 to 40 m/s$"):
        in_range("speed", value, 0.0, 40.0, "m/s")


@pytest.mark.parametrize("value", [0.0, -2.0, math.inf, False, "1"])
def test_a_number_that_is_not_positive_is_refused(value):
    with pytest.raises(InputError, match=r"^step is .* s: a finite number of more than zero"):
        positive("step", value, "s")


def test_zero_passes_on_request_and_negative_numbers_never():
    assert positive("stiffness", 0.0, zero=True) == 0.0
    with pytest.raises(InputError, match="a finite number of zero or more"):
        positive("stiffness", -1.0, zero=True)


def test_an_unknown_choice_is_refused_with_the_known_ones():
    assert one_of("camera", "side", ("chase", "side")) == "side"
    with pytest.raises(InputError, match="camera 'roof' is not known; use one of: chase, side"):
        one_of("camera", "roof", ("chase", "side"))
