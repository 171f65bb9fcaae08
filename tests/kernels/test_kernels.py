"""The compiled functions: how they are found, and that their arithmetic is Python's."""

import numpy as np
import pytest

from iits_mj import kernels
from iits_mj.core.errors import PluginError


def test_product_and_sum_are_rounded_one_after_the_other():
    multiply_add = kernels.function("iits_multiply_add", kernels.Real, *3 * [kernels.Real])
    generator = np.random.default_rng(1)
    for a, b, c in generator.normal(size=(1000, 3)).tolist():
        assert multiply_add(a, b, c) == a * b + c


def test_a_missing_function_is_named_with_the_remedy():
    with pytest.raises(PluginError, match="no function iits_none: rebuild it with 'make build'"):
        kernels.function("iits_none", None)


def test_a_missing_library_is_named(monkeypatch):
    monkeypatch.delenv(kernels.LIBRARY_VARIABLE, raising=False)
    monkeypatch.setattr(kernels, "LIBRARY_NAME", "libnone.so")
    with pytest.raises(PluginError, match=r"libnone\.so is not in"):
        kernels.path()


def test_only_contiguous_arrays_have_an_address():
    array = np.zeros((4, 3))
    assert kernels.address(array) == array.ctypes.data
    with pytest.raises(ValueError, match="contiguous"):
        kernels.address(array[:, 1])
