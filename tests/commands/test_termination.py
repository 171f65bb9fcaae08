"""SIGTERM ends a long command like Ctrl-C: complete outputs, no temporary files, exit code 143."""

from __future__ import annotations

import csv
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from controllers.decision.policy import QNetwork
from iits_mj.core.tables import read_rows
from iits_mj.evaluation.sweep.runs import SweepRun
from tests.paths import ROOT
from traffic_bridge.recording.recording import Recording

LONGEST = 120.0  # [s] for a command to begin and to end; against hanging


def drive_is_complete(folder: Path) -> None:
    summary = json.loads((folder / "out/summary.json").read_text())
    rows = list(csv.reader((folder / "out/telemetry.csv").open()))
    assert summary["summary"]["ended"] == "interrupted"
    assert len(rows) > 20
    assert len({len(row) for row in rows}) == 1
    assert (folder / "out/report.html").stat().st_size > 10_000


def recording_is_complete(folder: Path) -> None:
    assert len(Recording.load(folder / "drive.npz")) > 10


def training_is_complete(folder: Path) -> None:
    pytest.importorskip("torch")
    from controllers.decision.learning import checkpoint

    assert checkpoint.read(folder / "out")
    for weights in (folder / "out").glob("*.npz"):
        QNetwork.load(weights)


def trials_are_complete(folder: Path) -> None:
    lines = (folder / "trials.csv").read_text().splitlines()
    assert len({line.count(",") for line in lines}) == 1


def samples_are_complete(folder: Path) -> None:
    for path in (folder / "trucks").rglob("*.csv"):
        assert len({line.count(",") for line in path.read_text().splitlines()}) == 1


def runs_are_complete(folder: Path) -> None:
    for path in (folder / "out/shards").glob("*.csv"):
        assert len(read_rows(path, SweepRun, "runs")) == 1


COMMANDS: dict[str, tuple[str, str, Callable[[Path], None]]] = {
    "drive": ("--no-video --duration 4000 --out out", "*/.telemetry*", drive_is_complete),
    "record": ("drive.npz --duration 4000", "tmp/iits_mj_sumo*", recording_is_complete),
    "train": (
        "--out out --jobs 2 --decisions 400000 --checkpoint-seconds 1",
        "out/checkpoint*",
        training_is_complete,
    ),
    "evaluate": (
        "--file trials.csv --jobs 2 --duration 400 --trials 9 --methods aggressive --timestep 5e-3",
        "tmp/iits_mj_sumo*",
        trials_are_complete,
    ),
    "montecarlo": (
        "--folder trucks --jobs 2 --timestep 5e-3 --shard 1",
        "trucks/*/*.csv",
        samples_are_complete,
    ),
    "sweep": (
        f"{ROOT / 'examples/cut_in.toml'} --traffic-mode none --plant yaw-sideslip "
        "--param gap=5:60:40 --out out --jobs 2 --shard 1",
        "out/shards/*.csv",
        runs_are_complete,
    ),
}


@pytest.mark.parametrize(
    ("command", "number"),
    [
        *((name, signal.SIGTERM) for name in ("drive", "record", "train")),
        *(
            pytest.param(name, signal.SIGTERM, marks=pytest.mark.slow)
            for name in ("evaluate", "montecarlo", "sweep")
        ),
        *(pytest.param(name, signal.SIGINT, marks=pytest.mark.slow) for name in COMMANDS),
    ],
)
def test_a_signal_completes_the_outputs_and_leaves_nothing_temporary(
    command: str, number: signal.Signals, tmp_path: Path
) -> None:
    error = end(command, number, tmp_path)
    assert b"Traceback" not in error
    assert list((tmp_path / "tmp").glob("iits_mj*")) == []
    assert list(tmp_path.rglob(".*partial*")) == []
    COMMANDS[command][2](tmp_path)


@pytest.mark.slow
@pytest.mark.parametrize("command", ["drive", "record"])
def test_a_killed_command_leaves_no_incomplete_output_and_the_next_one_cleans_up(
    command: str, tmp_path: Path
) -> None:
    end(command, signal.SIGKILL, tmp_path)
    assert not list(tmp_path.glob("out/[!.]*"))
    assert not list(tmp_path.glob("[!.]*.npz"))
    words = COMMANDS[command][0].replace("4000", "5")
    environment = {**os.environ, "TMPDIR": str(tmp_path / "tmp")}
    line = [sys.executable, "-m", "iits_mj.cli", command, *words.split()]
    done = subprocess.run(line, cwd=tmp_path, env=environment, capture_output=True, check=False)
    assert done.returncode == 0, done.stderr.decode()
    assert list((tmp_path / "tmp").glob("iits_mj*")) == []
    assert list(tmp_path.rglob(".*partial*")) == []


def test_a_closed_pipe_ends_a_command_quietly_with_the_code_of_sigpipe() -> None:
    program = "import iits_mj.cli, sys; sys.exit(iits_mj.cli.main(['help']))"
    process = subprocess.Popen(
        [sys.executable, "-c", program], stdout=subprocess.PIPE, stderr=subprocess.PIPE
    )
    assert process.stdout is not None
    process.stdout.close()
    assert process.wait(LONGEST) == 128 + signal.SIGPIPE
    assert process.stderr is not None
    assert process.stderr.read() == b""
    process.stderr.close()


def end(command: str, number: signal.Signals, tmp_path: Path) -> bytes:
    """Runs a command, ends it by a signal when it is well under way, and returns its stderr."""
    if command == "train":
        pytest.importorskip("torch")
    flags, sign, _ = COMMANDS[command]
    temporary = tmp_path / "tmp"
    temporary.mkdir()
    line = [sys.executable, "-m", "iits_mj.cli", command, *flags.split()]
    environment = {**os.environ, "TMPDIR": str(temporary)}
    process = subprocess.Popen(
        line, cwd=tmp_path, env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE
    )
    deadline = time.monotonic() + LONGEST
    while process.poll() is None and not list(tmp_path.glob(sign)):
        assert time.monotonic() < deadline, "the command did not begin"
        time.sleep(0.1)
    time.sleep(3.0)
    process.send_signal(number)
    _, error = process.communicate(timeout=LONGEST)
    codes = {signal.SIGTERM: 143, signal.SIGINT: 130, signal.SIGKILL: -9}
    assert process.returncode == codes[number], error.decode()
    return error


def test_an_interrupt_that_python_drops_in_a_finalizer_is_raised_again():
    program = """
import time
from iits_mj.cli import _termination_as_interrupt

class Lost:
    def __del__(self):
        raise KeyboardInterrupt

with _termination_as_interrupt():
    try:
        Lost()
        time.sleep(60.0)
    except KeyboardInterrupt:
        print("interrupted")
"""
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, timeout=50, check=True
    )
    assert done.stdout == "interrupted\n"
    assert done.stderr == ""
