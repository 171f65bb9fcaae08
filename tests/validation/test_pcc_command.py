"""What `iits-mj pcc` shows."""

import numpy as np
import pytest

from iits_mj.errors import InputError
from iits_mj.validation.pcc import PccCommandConfig, load_profile, run


@pytest.fixture
def profile(tmp_path):
    station = np.arange(0, 6001, 10)
    height = 10.0 * np.sin(2.0 * np.pi * station / 2000.0)
    path = tmp_path / "road.csv"
    np.savetxt(path, np.column_stack([station, height]), "%.4f", ",", header="s_m,z_m", comments="")
    return path


def test_checks_hold_and_the_papers_four_panels_are_there(profile):
    results = run(PccCommandConfig(road=profile))
    assert [c.name for c in results.checks if not c.ok and "time" not in c.name] == []
    (panels,) = results.figures.values()
    assert [p.title for p in panels] == ["Road", "Speed", "Engine power", "Accumulated fuel"]
    cruise, plan = panels[3].lines
    assert plan.y[-1] < cruise.y[-1]
    assert {cruise.role, plan.role} == {"reference", "simulation"}


def test_profile_file_holds_the_plan_with_units(profile, tmp_path):
    out = tmp_path / "speed.csv"
    run(PccCommandConfig(road=profile, profile=out))
    header, *rows = out.read_text().splitlines()
    assert header == "station_m,height_m,speed_mps,cruise_speed_mps"
    assert len(rows) == 121


def test_the_built_in_highway_is_the_default_road_with_its_limits():
    road = load_profile(PccCommandConfig(length=5_000.0))
    assert road.intervals == 100
    assert np.isfinite(road.v_limit).all()
    assert 0.0 < np.abs(road.grade).max() < 0.07


def test_an_unwritable_profile_file_is_refused(profile, tmp_path):
    with pytest.raises(InputError, match="cannot be written"):
        run(PccCommandConfig(road=profile, profile=tmp_path / "none" / "speed.csv"))


def test_a_band_without_the_set_speed_is_refused(profile):
    with pytest.raises(InputError, match="band"):
        run(PccCommandConfig(road=profile, v_ref=100.0))
