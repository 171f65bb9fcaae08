"""Types of arrays."""

import typing

import numpy as np

from iits_mj.core import arrays


def test_the_type_of_a_field_shows_that_it_is_an_array():
    """Files of trucks and their schema are read by the types of fields, with any numpy."""
    for name in ("BoolArray", "FloatArray", "IntArray", "IndexArray"):
        assert typing.get_origin(getattr(arrays, name)) is np.ndarray, name
