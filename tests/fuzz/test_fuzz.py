"""The short form of the fuzzing; `make fuzz` is the long one."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import pytest

from tests.fuzz.harness import MEMORY_MAX, memory, trial
from tests.fuzz.targets import Target, make_targets

INPUTS = 80
NAMES = (
    *("map", "design", "overlay", "spread", "events", "types", "recording", "weights", "trials"),
    *("log", "table", "drive", "profile", "trajectories", "highd", "bag", "checkpoint"),
    *("bus", "plugin", "command line"),
)


@pytest.fixture(scope="module")
def targets(tmp_path_factory: pytest.TempPathFactory) -> Mapping[str, Target]:
    return make_targets(tmp_path_factory.mktemp("fuzz"))


def test_every_target_is_fuzzed(targets: Mapping[str, Target]) -> None:
    assert tuple(targets) == NAMES


@pytest.mark.parametrize("name", NAMES)
def test_samples_are_taken_and_mutants_are_refused_with_errors_of_ours(
    name: str, targets: Mapping[str, Target], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.chdir(tmp_path)
    target = targets[name]
    for sample in target.samples:
        target.take(sample)
    before = memory()
    found = [trial(target, (0, index)) for index in range(INPUTS)]
    assert [result[0] for result in found if result is not None] == []
    assert memory() - before < MEMORY_MAX
