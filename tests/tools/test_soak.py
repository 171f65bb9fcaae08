"""The soak tool: its list of chunks, the rule for the cause of a collision, the resume."""

from __future__ import annotations

import dataclasses
import itertools
import os
import subprocess
import sys
import time
from pathlib import Path

import pytest
import soak

from iits_mj.core.errors import Error
from iits_mj.simulation import DriveConfig
from tests.paths import ROOT

CHUNKS = [soak.Chunk.of(number) for number in range(100)]
DONE = soak.Row(simulated_s=1200.0, rss_warm_mb=200.0, rss_end_mb=201.0, growth_mb=1.0)
BEHIND = soak.Contact(
    truck_speed=15.0, ahead=-25.0, length=16.5, truck_changed=False, vehicle_changed=False
)


def test_a_number_always_gives_the_same_chunk_and_no_two_share_a_seed() -> None:
    assert soak.Chunk.of(7) == soak.Chunk.of(7)
    assert len({chunk.seed for chunk in CHUNKS}) == len(CHUNKS)


def test_a_hundred_chunks_have_all_values_of_all_settings() -> None:
    for name, count in {
        "density": 3, "payload": 4, "map": 2, "mode": 6, "traffic_speed": 3, "decision": 5,
        "speed_planner": 2, "commands": 2, "timestep": 2,
    }.items():  # fmt: skip
        assert len({getattr(chunk, name) for chunk in CHUNKS}) == count, name


@pytest.mark.parametrize("mode", sorted({chunk.mode for chunk in CHUNKS}))
def test_every_mode_is_a_valid_drive(mode: str) -> None:
    chunk = next(chunk for chunk in CHUNKS if chunk.mode == mode)
    config = DriveConfig(**chunk.drive_options())
    assert config.seed == chunk.seed
    assert config.duration == soak.CHUNK_DURATION


def test_a_run_continues_with_the_chunks_that_have_no_row(tmp_path: Path) -> None:
    table = tmp_path / "soak.csv"
    first = list(itertools.islice(soak.pending([], 24.0), 3))
    assert [chunk.number for chunk in first] == [0, 1, 2]
    for chunk in (first[0], first[2]):
        soak.append(table, chunk, DONE)
    rows = soak.read_rows(table)
    assert [row["number"] for row in rows] == ["0", "2"]
    left = soak.pending(rows, 1.0)
    assert next(left).number == 1
    rows.append(soak.append(table, first[1], DONE))
    assert list(left) == []
    assert soak.simulated_hours(soak.read_rows(table)) == pytest.approx(1.0)


def test_a_table_with_other_columns_is_refused(tmp_path: Path) -> None:
    table = tmp_path / "soak.csv"
    table.write_text("number,seed\n0,1\n")
    with pytest.raises(Error, match="other columns"):
        soak.read_rows(table)


def test_the_page_has_the_sums_of_the_table() -> None:
    _, table, _ = (ROOT / soak.PAGE).read_text().split(soak.MARK)
    assert table.strip() == soak.summary(soak.read_rows(ROOT / soak.TABLE))


@pytest.mark.parametrize(
    ("changes", "faults"),
    [
        ({}, []),
        ({"warnings": 1}, ["warnings"]),
        ({"growth_mb": 50.0}, ["growth_mb"]),
        ({"collisions": 1, "failed": True}, []),
        ({"collisions": 1, "caused": 1, "failed": True}, ["caused"]),
        ({"failed": True, "ended": "the truck rolled over"}, ["ended"]),
        ({"files": 2, "processes": 1}, ["processes", "files"]),
    ],
)
def test_a_row_names_its_faults(changes: dict[str, object], faults: list[str]) -> None:
    assert dataclasses.replace(DONE, **changes).faults() == faults


@pytest.mark.parametrize(
    ("changes", "caused"),
    [
        ({}, False),
        ({"truck_changed": True}, True),
        ({"ahead": 2.0}, True),
        ({"ahead": 2.0, "vehicle_changed": True}, False),
        ({"ahead": 2.0, "truck_speed": 0.0}, False),
        ({"ahead": -8.0}, False),
        ({"ahead": -8.0, "truck_changed": True, "vehicle_changed": True}, True),
    ],
)
def test_cause_of_a_collision(changes: dict[str, float], caused: bool) -> None:
    assert soak.cause(dataclasses.replace(BEHIND, **changes))[0] is caused


def test_a_chunk_in_its_own_process_leaves_nothing_behind() -> None:
    chunk = next(chunk for chunk in CHUNKS if chunk.mode == "inter" and chunk.map == "hills")
    row = soak.run_chunk(chunk, duration=3.0)
    assert row.faults() == []
    assert row.simulated_s == pytest.approx(3.0)
    assert row.ended == "reached the end of the time"


def test_a_terminated_run_ends_its_chunk_and_removes_its_folder(tmp_path: Path) -> None:
    process = subprocess.Popen(
        [sys.executable, soak.__file__, "--table", str(tmp_path / "soak.csv")],
        env=os.environ | {"TMPDIR": str(tmp_path)},
        start_new_session=True,
    )
    deadline = time.monotonic() + 60.0
    while not (found := list(tmp_path.glob("soak_*/work"))) and time.monotonic() < deadline:
        time.sleep(0.1)
    assert found
    children = Path(f"/proc/{process.pid}/task/{process.pid}/children")
    chunks = children.read_text().split()
    process.terminate()
    assert process.wait(timeout=60.0) == 143
    assert not list(tmp_path.glob("soak_*"))
    # A process that has ended stays in /proc until its new parent asks for it.
    deadline = time.monotonic() + 30.0
    while left := [chunk for chunk in chunks if Path(f"/proc/{chunk}").exists()]:
        assert time.monotonic() < deadline, left
        time.sleep(0.1)
