"""The sanitizers' tool: reading of reports, and reports of deliberate faults in a plugin."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest
import sanitize

from iits_mj import kernels
from iits_mj.plugin import library_path

LEAKS = f"""
=================================================================
==7==ERROR: LeakSanitizer: detected memory leaks

Direct leak of 952 byte(s) in 17 object(s) allocated from:
    #0 0x1 in __interceptor_malloc asan_malloc_linux.cpp:69
    #1 0x2 in gc_alloc Modules/gcmodule.c:2283

Direct leak of 48 byte(s) in 2 object(s) allocated from:
    #0 0x1 in operator new(unsigned long) asan_new_delete.cpp:95
    #1 0x2 in iits::Tire::Bind {sanitize.PLUGIN}/tire.cc:80

SUMMARY: AddressSanitizer: 1000 byte(s) leaked in 19 allocation(s).
"""
UNDEFINED = """
/src/laws/gears.h:22:19: runtime error: signed integer overflow: 1 + 2147483647
    #0 0x1 in Compute
"""
RACE = """
==================
WARNING: ThreadSanitizer: data race (pid=7)
  Write of size 4 at 0x1 by thread T2:
"""


@pytest.mark.parametrize("sources", sanitize.LIBRARIES.values(), ids=lambda path: path.name)
def test_leaks_of_other_libraries_are_dropped_and_those_of_this_package_kept(sources: Path) -> None:
    (report,) = sanitize.read_reports(LEAKS.replace(str(sanitize.PLUGIN), str(sources)))
    assert "tire.cc:80" in report
    assert "gcmodule" not in report


@pytest.mark.parametrize("text", [UNDEFINED, RACE])
def test_other_reports_are_kept_wherever_they_come_from(text: str) -> None:
    assert len(sanitize.read_reports(text * 2)) == 2


def test_output_without_reports_has_none() -> None:
    assert sanitize.read_reports("WARNING: Nan, Inf or huge value in CTRL at ACTUATOR 1.\n") == []


def test_a_process_with_the_released_plugin_or_other_kernels_is_refused(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    with pytest.raises(RuntimeError, match=r"plugin\.so, .*expected a build in"):
        sanitize.check_libraries()
    folder = library_path().parent
    monkeypatch.setattr(sanitize, "BUILD", folder)
    sanitize.check_libraries()
    monkeypatch.setenv(kernels.LIBRARY_VARIABLE, str(tmp_path / kernels.LIBRARY_NAME))
    with pytest.raises(RuntimeError, match=r"kernels\.so, .*expected a build in"):
        sanitize.check_libraries()


@pytest.mark.slow
@pytest.mark.skipif(shutil.which("g++") is None, reason="needs g++")
@pytest.mark.parametrize("kind", sanitize.KINDS)
def test_deliberate_faults_are_reported_and_the_same_program_without_them_is_clean(
    kind: str,
) -> None:
    assert sanitize.main(["--only", kind, "--self-check"]) == 0


@pytest.mark.slow
@pytest.mark.skipif(shutil.which("g++") is None, reason="needs g++")
def test_two_threads_have_no_data_race() -> None:
    assert sanitize.main(["--only", "thread"]) == 0
