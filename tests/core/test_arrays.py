"""Types of arrays."""

import importlib.util
import typing

import numpy as np
import numpy.typing

from iits_mj.core import arrays

T = typing.TypeVar("T")


class Alias(typing.Generic[T]):
    """Stands for numpy 2.5's `NDArray`, whose origin is not `np.ndarray`."""


def test_the_type_of_a_field_shows_that_it_is_an_array(monkeypatch):
    """Files of trucks and their schema are read by the types of fields, with any numpy."""
    monkeypatch.setattr(numpy.typing, "NDArray", Alias)
    spec = importlib.util.spec_from_file_location("fresh_arrays", arrays.__file__)
    fresh = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(fresh)
    for name in ("BoolArray", "FloatArray", "IntArray", "IndexArray"):
        assert typing.get_origin(getattr(fresh, name)) is np.ndarray, name
