"""Checks and results: one shape for people and machines."""

import json

import numpy as np
import pytest

from iits_mj.core.errors import InputError
from iits_mj.core.results import Check, Results


@pytest.mark.parametrize(
    ("value", "must", "ok"),
    [
        (97.0, ">= 97", True),
        (96.9, ">= 97", False),
        (0.35, "0.33 .. 0.40", True),
        (0.41, "0.33 .. 0.40", False),
        (5.0, "", True),
        (np.nan, "", False),
        (np.inf, ">= 1", False),
    ],
)
def test_bound_is_held_or_not(value, must, ok):
    assert Check("figure", value, "%", must=must).ok is ok


def test_bound_that_cannot_be_read_is_refused():
    with pytest.raises(InputError, match="about 3"):
        _ = Check("figure", 3.0, "", must="about 3").ok


def test_json_is_strict_and_complete():
    results = Results("validate", seed=3, checks=[Check("a", np.nan, "m", 1.0, "<= 1")])
    tree = json.loads(results.to_json("1.2.3"))
    assert tree == {
        "command": "validate",
        "version": "1.2.3",
        "seed": 3,
        "checks": [
            {"name": "a", "value": None, "unit": "m", "reference": 1.0, "must": "<= 1", "ok": False}
        ],
    }
    assert not results.ok
    assert "FALLS SHORT" in results.to_table()
