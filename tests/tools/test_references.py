"""Each module answers on the inputs of the reference drive as its stored reference does."""

import csv
import itertools
import json
import os
import shutil
import subprocess
import sys

import numpy as np
import pytest
import references
from references import FOLDER, KERNELS, LOG, LOG_COLUMNS, MODULES, Reference

from tests.paths import ROOT

pytest.importorskip("libsumo")


@pytest.fixture(scope="module")
def findings():
    """Findings by module, from a process with the kernels of the references."""
    command = [sys.executable, str(ROOT / "tools" / "references.py"), "check", "--json"]
    environment = {**os.environ, **KERNELS}
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    assert done.stdout, done.stderr
    return {finding["module"]: finding for finding in json.loads(done.stdout)}


@pytest.mark.parametrize("module", MODULES)
def test_a_module_answers_as_its_reference(findings, module):
    found = findings[module]
    assert found["differences"] == [], 'if this is meant: make references REASON="..."'
    if found["bits"]:
        assert found["digest"] == Reference.load(FOLDER / f"{module}.npz").digest


@pytest.mark.parametrize("module", MODULES)
def test_the_newest_reason_belongs_to_the_reference(module):
    with LOG.open() as stream:
        rows = [row for row in csv.DictReader(stream) if row["module"] == module]
    assert list(rows[-1]) == list(LOG_COLUMNS)
    assert rows[-1]["new_digest"] == Reference.load(FOLDER / f"{module}.npz").digest
    assert all(row["reason"].strip() for row in rows)
    for before, after in itertools.pairwise(rows):
        assert after["old_digest"] == before["new_digest"]


def test_references_are_small():
    assert sum(path.stat().st_size for path in FOLDER.iterdir()) < 400_000


def outputs_like(reference):
    """The stored outputs, as those of a replay."""
    return [(reference.times[k], dict(fields)) for k, fields in reference.stored.items()]


def test_a_difference_names_the_field_the_time_and_its_size():
    stored = Reference.load(FOLDER / "tracker.npz")
    outputs = outputs_like(stored)
    same = references.compare("tracker", stored, outputs, bits=True)
    assert same.differences == []
    assert same.digest == stored.digest
    outputs[100][1]["steering_wheel_angle"] = outputs[100][1]["steering_wheel_angle"] + 1e-12
    (found,) = references.compare("tracker", stored, outputs, bits=True).differences
    assert (found.name, found.count) == ("steering_wheel_angle", 1)
    assert found.time == pytest.approx(2.0)
    assert found.largest == pytest.approx(1e-12, rel=1e-3)
    # With a tolerance, where the kernels round differently, this is equal; more is not.
    assert references.compare("tracker", stored, outputs, bits=False).differences == []
    outputs[200][1]["steering_wheel_angle"] = outputs[200][1]["steering_wheel_angle"] + 1e-6
    (found,) = references.compare("tracker", stored, outputs, bits=False).differences
    assert found.time == pytest.approx(4.0)


def test_another_number_of_outputs_is_a_difference():
    stored = Reference.load(FOLDER / "decision.npz")
    (found,) = references.compare("decision", stored, outputs_like(stored)[1:], True).differences
    assert "shape" in found.name


def test_renewing_needs_a_reason_and_stores_it(monkeypatch, tmp_path, capsys):
    folder = tmp_path / "references"
    shutil.copytree(FOLDER, folder)
    stored = Reference.load(folder / "tracker.npz")
    changed = outputs_like(stored)
    changed[5][1]["accelerator_pedal"] = np.array(0.75)
    monkeypatch.setattr(references, "replay", lambda module, inputs: changed)
    words = ["references", "renew", "--only", "tracker", "--folder", str(folder)]
    monkeypatch.setattr(sys, "argv", [*words, "--reason", " "])
    with pytest.raises(SystemExit) as refused:
        references.main()
    assert refused.value.code == 2
    assert "needs a reason" in capsys.readouterr().err
    assert Reference.load(folder / "tracker.npz").digest == stored.digest
    monkeypatch.setattr(sys, "argv", [*words, "--reason", "A softer start, on purpose"])
    assert references.main() == 0
    new = Reference.load(folder / "tracker.npz")
    assert new.digest != stored.digest
    with (folder / LOG.name).open() as stream:
        last = list(csv.DictReader(stream))[-1]
    assert last["module"] == "tracker"
    assert (last["old_digest"], last["new_digest"]) == (stored.digest, new.digest)
    assert last["reason"] == "A softer start, on purpose"
    for name, values in stored.inputs.items():
        assert np.array_equal(values, new.inputs[name])
