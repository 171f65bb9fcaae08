"""The atlas of savings: its roads, its cells, and that a stopped one continues."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from iits_mj.commands.pcc import Options
from iits_mj.core.errors import InputError
from iits_mj.parameters import TruckParameters
from iits_mj.validation.harness.config import PAPER_ROAD, ValidateConfig
from iits_mj.validation.planning import pcc_atlas
from iits_mj.validation.planning.atlas_page import page_text, write_page
from iits_mj.validation.planning.pcc_atlas import (
    Atlas,
    AtlasRow,
    DrivenRow,
    atlas_results,
    atlas_roads,
    cells,
    compute_atlas,
    drive_cell,
    made_roads,
    measure_cell,
    read_long_haul,
)

DRIVEN = DrivenRow("flat", "rolling", 2.0, 2.1, 3.0, 2.9, 0.05, 2, 6, 10.0)
ROW = AtlasRow("flat", 40e3, 80.0, 65.0, 90.0, 0.0, 1.0, 2.0, 1.5, 2.5, 3.0, 4.0, 50.0, 2, 6, 10.0)


def test_made_roads_have_their_grades_and_are_the_same_each_time():
    roads, again = made_roads(), made_roads()
    assert len(roads) == 7
    for name, road in roads.items():
        assert road.length == 15_000.0
        assert np.array_equal(road.height, again[name].height)
    assert np.abs(roads["flat"].grade).max() == 0.0
    assert np.abs(roads["rolling"].grade).max() == pytest.approx(0.02, rel=0.01)
    assert np.sqrt(np.mean(roads["upland"].grade ** 2)) == pytest.approx(0.018, rel=0.02)
    assert roads["mountain pass"].grade.max() == pytest.approx(0.04)


def test_missing_roads_are_named(tmp_path):
    roads, notes = atlas_roads(ValidateConfig())
    assert len(roads) == 8
    assert any(PAPER_ROAD in note for note in notes)
    assert len(notes) == 4


def test_long_haul_is_read_by_its_grades(tmp_path):
    path = tmp_path / "long_haul_cycle.csv"
    distance = np.arange(0, 40_001, 100)
    lines = "".join(f"{d},84,{1.0 if d < 25_000 else -1.0},0\n" for d in distance)
    path.write_text("distance_m,target_speed_kph,grade_percent,stop_s\n" + lines)
    road = read_long_haul(path)
    assert road.length == 40_000.0
    assert road.grade[:499] == pytest.approx(0.01)
    assert road.grade[501:] == pytest.approx(-0.01)


def test_middle_cell_is_the_first_and_others_differ_in_one_thing():
    few = cells(every=False)
    assert len(few) == 7
    assert len(cells(every=True)) == 27
    assert all(sum(a != b for a, b in zip(c, few[0], strict=True)) == 1 for c in few[1:])


def test_savings_of_a_cell_are_in_order():
    road = made_roads()["rolling"].part(0, 100)
    row = measure_cell(road, "rolling", cells(False)[0], TruckParameters.load())
    assert 0.0 < row.alone < row.joint < row.bound
    assert row.low <= row.joint <= row.high
    assert row.braking > row.alone


def test_head_wind_costs_fuel_and_leaves_less_to_save_by_rolling():
    road = made_roads()["rolling"].part(0, 100)
    mass, band, _ = cells(False)[0]
    config = pcc_atlas.PccConfig(*(v / 3.6 for v in band), head_wind=0.0)
    calm, ahead, behind = (
        pcc_atlas.plan(road, None, mass, replace(config, head_wind=wind))
        for wind in (0.0, 6.0, -6.0)
    )
    fuels = [found.baseline.map_fuel.sum() for found in (behind, calm, ahead)]
    assert fuels == sorted(fuels)
    # At the set speed the air drag is that of the sum of both speeds.
    v, k = config.v_ref, calm.task.vehicle.drag
    forces = [f.task.vehicle.level_force + f.task.vehicle.drag * v**2 for f in (calm, ahead)]
    assert forces[1] - forces[0] == pytest.approx(k * ((v + 6.0) ** 2 - v**2), rel=1e-9)


@pytest.fixture
def asked(monkeypatch):
    """Replaces the computation of cells and drives; returns the names of those asked for."""
    names = []

    def measure(road, name, cell, parameters):
        names.append(name)
        mass, (v_ref, v_min, v_max), wind = cell
        return replace(
            ROW, road=name, mass=mass, v_ref=v_ref, v_min=v_min, v_max=v_max, head_wind=wind
        )

    def drive(road, name, *, rolls, folder):
        names.append(name)
        return replace(DRIVEN, road=name, cruise="rolling" if rolls else "braking")

    monkeypatch.setattr(pcc_atlas, "measure_cell", measure)
    monkeypatch.setattr(pcc_atlas, "drive_cell", drive)
    return names


def test_finished_cells_are_read_and_the_results_show_them(tmp_path, asked):
    config = ValidateConfig(runs=tmp_path)
    first = atlas_results(compute_atlas(config))
    assert len(asked) == 8 * (7 + 2)
    again = atlas_results(compute_atlas(config))
    assert len(asked) == 8 * (7 + 2)
    assert [c.as_dict() for c in again.checks] == [c.as_dict() for c in first.checks]
    (panels,) = first.figures.values()
    assert [len(line.x) for line in panels[0].lines] == 4 * [8]


def test_atlas_out_of_time_keeps_what_is_finished_and_counts_the_rest(tmp_path, asked):
    config = ValidateConfig(runs=tmp_path)
    atlas = compute_atlas(config, minutes=-1.0)
    assert not atlas.rows
    assert not asked
    assert any("72 of 72 cells and drives are left" in note for note in atlas.notes)
    compute_atlas(config)
    whole = compute_atlas(config, minutes=-1.0)
    assert (len(whole.rows), len(whole.driven)) == (8 * 7, 8 * 2)


def test_page_has_a_row_for_each_road_and_its_drives(tmp_path, asked):
    atlas = compute_atlas(ValidateConfig())
    path = tmp_path / "atlas.md"
    write_page(atlas, path)
    text = path.read_text()
    assert text.count("| rolling |") == 2
    assert "2.0 (expected 2.1)" in text
    assert "within 0.5 points of each other in 16 of 16 comparisons" in text
    assert len(path.with_suffix(".csv").read_text().splitlines()) == 1 + 8 * 7
    assert path.with_suffix(".png").read_bytes().startswith(b"\x89PNG")


def test_page_without_drives_leaves_their_cells_empty(tmp_path):
    names = ("flat", "rolling")
    rows = [
        replace(ROW, road=name, mass=mass, v_ref=band[0], v_min=band[1], v_max=band[2])
        for name in names
        for mass, band, _ in cells(every=False)[:1]
    ]
    text = page_text(Atlas(rows, [], []), "a.png", "a.csv", "a_driven.csv")
    assert text.count("| - | - |") >= len(names)
    assert "points of each other" not in text


@pytest.mark.slow
def test_driven_saving_on_waves_is_near_the_expected():
    row = drive_cell(made_roads()["rolling"], "rolling", rolls=True)
    assert row.saving == pytest.approx(row.expected, abs=0.5)
    assert abs(row.late) < 0.5
    assert row.plan_fuel < row.cruise_fuel


def test_flags_of_the_atlas_need_it():
    with pytest.raises(InputError, match="--atlas"):
        Options(every=True)
    with pytest.raises(InputError, match="--atlas"):
        Options(minutes=5.0)
    with pytest.raises(InputError, match=r"FILE\.md"):
        Options(atlas=True, page=Path("atlas.html"))
