"""Files appear only when complete; a killed process leaves nothing for longer than one start."""

from __future__ import annotations

import resource
import signal
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest

from iits_mj.core.errors import InputError
from iits_mj.core.output_files import OutputFile, TemporaryFolder, write_whole

KILLED = """
import os, signal, sys, tempfile
from pathlib import Path
from iits_mj.core.output_files import OutputFile, TemporaryFolder
tempfile.tempdir = sys.argv[1]
folder = TemporaryFolder("test")
(folder.path / "content.txt").write_text("x")
output = OutputFile(Path(sys.argv[1]) / "table.csv", "table")
output.partial.write_text("half a ro")
print(len(os.listdir(sys.argv[1])), flush=True)
os.kill(os.getpid(), signal.SIGKILL)
"""


def test_an_older_file_stays_until_the_new_one_is_complete(tmp_path: Path) -> None:
    path = tmp_path / "table.csv"
    path.write_text("old")

    def fail() -> None:
        with OutputFile(path, "table") as partial:
            partial.write_text("half a ro")
            assert path.read_text() == "old"
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        fail()
    assert [p.name for p in tmp_path.iterdir()] == ["table.csv"]
    write_whole(path, b"new", "table")
    assert path.read_text() == "new"
    assert [p.name for p in tmp_path.iterdir()] == ["table.csv"]


def test_two_writers_of_one_file_do_not_mix(tmp_path: Path) -> None:
    path = tmp_path / "table.csv"
    with OutputFile(path, "table") as partial:
        partial.write_text("first")
        with pytest.raises(InputError, match=r"table .*table.csv.*another process is writing it"):
            write_whole(path, b"second", "table")
    assert path.read_text() == "first"


def test_what_a_killed_process_left_goes_at_the_next_start(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    done = subprocess.run(
        [sys.executable, "-c", KILLED, str(tmp_path)], capture_output=True, text=True, check=False
    )
    assert (done.returncode, done.stdout.strip()) == (-signal.SIGKILL, "2")
    (tmp_path / "mine.csv").write_text("keep me")
    assert len(list(tmp_path.iterdir())) == 3
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    with TemporaryFolder("test") as own:
        write_whole(tmp_path / "other.csv", b"x", "table")
        found = sorted(tmp_path.iterdir())
        assert found == sorted([own, tmp_path / "mine.csv", tmp_path / "other.csv"])
        with TemporaryFolder("second"):
            assert own.is_dir()  # its owner lives
    assert sorted(p.name for p in tmp_path.iterdir()) == ["mine.csv", "other.csv"]


def test_a_file_beyond_the_size_limit_is_named_and_leaves_nothing(tmp_path: Path) -> None:
    path = tmp_path / "table.csv"
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (1000, before[1]))
    try:
        with pytest.raises(InputError, match=r"table .*table.csv' cannot be written: File too"):
            write_whole(path, b"x" * 5000, "table")
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert list(tmp_path.iterdir()) == []
