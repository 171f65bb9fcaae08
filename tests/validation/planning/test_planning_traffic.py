"""The table of trips in traffic: pairs, corrections, and the runner of trips."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest

from iits_mj.core.errors import InputError
from iits_mj.core.results import Results
from iits_mj.validation.harness.config import ValidateConfig
from iits_mj.validation.planning import planning_traffic, traffic_trips
from iits_mj.validation.planning.planning_traffic import (
    FIRST_SEED,
    SEEDS,
    main,
    pairs_of,
    run_traffic,
    saving_percent,
    summarize,
)
from iits_mj.validation.planning.traffic_trips import (
    DENSITIES,
    LENGTH,
    PLANNERS,
    TripRow,
    drive_pair,
    read_rows,
    trip_code,
    worth_of_energy,
    write_rows,
)

CRUISE = TripRow(
    "dense",
    FIRST_SEED,
    "cruise",
    LENGTH,
    340.0,
    4.0,
    16.0,
    1,
    0,
    30.0,
    5.0,
    0,
    0,
    math.nan,
    math.nan,
    trip_code(),
)
PCC = replace(
    CRUISE, planner="pcc", time=341.7, fuel=3.6, plans=330, other_plans=10, solve_p50=0.01
)


def rows() -> list[TripRow]:
    return [
        replace(
            row,
            density=density,
            seed=FIRST_SEED + number,
            fuel=row.fuel * (1.0 + 0.01 * number * (row is PCC)),
        )
        for density in DENSITIES
        for number in range(4)
        for row in (CRUISE, PCC)
    ]


def test_saving_counts_kinetic_energy_at_the_end_as_fuel() -> None:
    worth = worth_of_energy()
    # 160 to 200 g/kWh more at the engine for a little more power, 0.93 to the wheels.
    assert 4.7e-8 < worth < 6e-8
    assert saving_percent(CRUISE, PCC, worth) == pytest.approx(10.0)
    faster = replace(PCC, end_speed=18.0)
    energy = 0.5 * 55_000.0 * (18.0**2 - 16.0**2)
    wanted = 10.0 + 100.0 * worth * energy / 4.0
    assert saving_percent(CRUISE, faster, worth) == pytest.approx(wanted)


def test_figures_are_means_of_pairs_with_their_interval() -> None:
    results = Results("test")
    summarize(results, rows())
    found = {check.name: check for check in results.checks}
    saved = found["in traffic, dense: fuel saved, mean of 4"]
    # 3.6 kg times 1, 1.01, 1.02, 1.03 against 4 kg.
    assert saved.value == pytest.approx(100.0 * (1.0 - 0.9 * 1.015))
    assert str(saved.reference).startswith("±1.8")
    late = found["in traffic, dense: trip time, mean over the cruise's"]
    assert late.value == pytest.approx(0.5)
    assert results.ok


def test_failed_trip_is_counted_and_its_pair_has_no_saving() -> None:
    spoiled = [
        replace(r, failed=int(r.seed == FIRST_SEED + 1 and r.planner == "pcc")) for r in rows()
    ]
    results = Results("test")
    summarize(results, spoiled)
    assert not results.ok
    assert any("mean of 3" in check.name for check in results.checks)


def test_a_trip_without_its_partner_is_no_pair() -> None:
    assert len(pairs_of(rows()[:-1], "sparse")) == 3
    assert len(pairs_of(rows(), "sparse")) == 4


def test_table_is_read_back_and_a_cut_last_row_is_driven_again(tmp_path: Path) -> None:
    path = tmp_path / "trips.csv"
    write_rows(path, rows())
    again = read_rows(path)
    assert {row.key for row in again} == {row.key for row in rows()}
    assert again[1].fuel == pytest.approx(3.6)
    text = path.read_text()
    path.write_text(text[: text.rindex(",")])
    assert len(read_rows(path)) == len(rows()) - 1
    assert read_rows(tmp_path / "none.csv") == []


def test_another_table_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "trips.csv"
    path.write_text("a,b\n1,2\n")
    with pytest.raises(InputError, match="not a file of trips"):
        read_rows(path)


def test_runner_does_not_repeat_trips_of_the_table(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "trips.csv"
    write_rows(path, rows())

    def forbidden(*_: object) -> None:
        raise AssertionError("a trip of the table was driven again")

    monkeypatch.setattr(planning_traffic, "drive_pair", forbidden)
    assert main(["--seeds", "4", "--out", str(path)]) == 0
    assert "in traffic, sparse" in capsys.readouterr().out


def driver(drives: list[tuple[str, int, str]]) -> Callable[..., TripRow]:
    """Returns a replacement of `drive_trip` that only records its calls."""

    def drive(density: str, seed: int, planner: str, cruise: TripRow | None = None) -> TripRow:
        assert (planner == "pcc") == (cruise is not None)
        drives.append((density, seed, planner))
        row = PCC if planner == "pcc" else CRUISE
        return replace(row, density=density, seed=seed)

    return drive


def test_kept_pair_is_used_only_for_the_same_code(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    drives: list[tuple[str, int, str]] = []
    monkeypatch.setattr(traffic_trips, "drive_trip", driver(drives))
    first = drive_pair("sparse", 7, tmp_path)
    again = drive_pair("sparse", 7, tmp_path)
    assert len(drives) == 2
    assert [row.key for row in again] == [row.key for row in first]
    monkeypatch.setattr(traffic_trips, "trip_code", lambda: "other")
    drive_pair("sparse", 7, tmp_path)
    assert len(drives) == 4


def test_rows_of_other_code_are_replaced(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "trips.csv"
    write_rows(path, [replace(row, code="old", fuel=99.0) for row in rows()])
    asked: list[tuple[str, int]] = []

    def run_all(jobs, processes, work, keep, describe, what) -> None:
        for density, seed in jobs:
            asked.append((density, seed))
            keep([replace(row, density=density, seed=seed) for row in (CRUISE, PCC)])

    monkeypatch.setattr(planning_traffic, "run_all", run_all)
    assert main(["--seeds", "3", "--out", str(path)]) == 0
    assert "24 trips of the table are of other code" in capsys.readouterr().out
    assert len(asked) == 9
    assert {row.fuel for row in read_rows(path)} == {CRUISE.fuel, PCC.fuel}


def test_quick_form_leaves_traffic_out_and_full_form_drives_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    quick = run_traffic(ValidateConfig(quick=True, runs=tmp_path))
    assert not quick.checks
    assert "left out of the quick form" in quick.notes[0]
    drives: list[tuple[str, int, str]] = []
    monkeypatch.setattr(traffic_trips, "drive_trip", driver(drives))
    full = run_traffic(ValidateConfig(runs=tmp_path))
    assert len(drives) == SEEDS * len(DENSITIES) * len(PLANNERS)
    assert min(seed for _, seed, _ in drives) == FIRST_SEED == 100
    assert any(check.name.startswith("in traffic, medium: fuel") for check in full.checks)
    run_traffic(ValidateConfig(runs=tmp_path))
    assert len(drives) == SEEDS * len(DENSITIES) * len(PLANNERS)


@pytest.mark.parametrize("words", [["--seeds", "0"], ["--jobs", "0"]])
def test_wrong_use_of_the_runner_gives_a_one_line_error(
    words: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main([*words, "--out", str(tmp_path / "t.csv")]) == 2
    assert "1 to" in capsys.readouterr().err
