"""The C++ mutants: where they are, that one library holds them, and the areas of the kernels."""

from __future__ import annotations

import ctypes
import re
import shutil
from pathlib import Path

import pytest

pytest.importorskip("clang.cindex", reason="libclang is installed by 'make mutants'")

import cpp_mutations
import mutants_cpp
from cpp_mutations import KERNELS, PLUGIN
from mutants_cpp import TESTS

KERNEL = """#include <algorithm>
extern "C" __attribute__((visibility("default"))) double iits_test(double a, double b) {
  return std::min(a, b) - 2.0;
}
"""


@pytest.fixture
def source(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The only source of a package."""
    monkeypatch.setattr(cpp_mutations, "PACKAGE", tmp_path)
    monkeypatch.setattr(mutants_cpp, "PACKAGE", tmp_path)
    path = tmp_path / "kernels" / "test.cc"
    path.parent.mkdir()
    path.write_text(KERNEL)
    return path


@pytest.mark.skipif(shutil.which("c++") is None, reason="needs a compiler")
def test_the_library_of_a_kernel_computes_each_mutant_and_the_original(
    source: Path, tmp_path: Path
) -> None:
    assert KERNELS.sources() == [source]
    mutants = cpp_mutations.number(cpp_mutations.find(source, KERNELS))
    built, broken = mutants_cpp.build(KERNELS, mutants, tmp_path / "build")
    assert not broken
    library = ctypes.CDLL(str(built))
    library.iits_test.restype = ctypes.c_double
    library.iits_test.argtypes = [ctypes.c_double] * 2
    switch = ctypes.c_int.in_dll(library, "iits_mutant")

    def result(number: int) -> float:
        switch.value = number
        return float(library.iits_test(5.0, 3.0))

    assert result(0) == 1.0
    assert {mutant.mutant: result(mutant.number) for mutant in mutants} == {
        "std::min(a, b) + 2.0": 5.0,
        "a": 3.0,
        "b": 1.0,
        "std::max(a, b)": 3.0,
        "3": 0.0,
    }
    assert {mutant.file for mutant in mutants} == {"kernels/test.cc"}


def test_a_new_number_of_a_mutant_compiles_the_library_again(source: Path, tmp_path: Path) -> None:
    """Both libraries share the numbers, so those of the second follow from the first."""
    mutants = cpp_mutations.number(cpp_mutations.find(source, KERNELS))
    stamp = tmp_path / "build" / "stamp.json"
    stamps = []
    for chosen in (mutants, mutants[1:]):
        mutants_cpp.build(KERNELS, chosen, tmp_path / "build")
        stamps.append(stamp.read_text())
    assert stamps[0] != stamps[1]


def test_every_kernel_has_an_area_and_every_area_has_tests() -> None:
    patterns = mutants_cpp.TEST_FILES[KERNELS]
    found = [str(p.relative_to(TESTS)) for pattern in patterns for p in TESTS.glob(pattern)]
    for path in KERNELS.sources():
        area, tests = mutants_cpp.area_of(f"kernels/{path.name}")
        assert area != PLUGIN.folder, path
        assert any(re.match(tests, name) for name in found), tests


def test_listed_equivalent_mutants_exist() -> None:
    found = {
        mutant.key
        for library in (PLUGIN, KERNELS)
        for path in library.sources()
        for mutant in cpp_mutations.find(path, library)
    }
    assert not set(mutants_cpp.equivalent()) - found
