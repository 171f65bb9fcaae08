import csv

import numpy as np
import pytest

from iits_mj import cli
from iits_mj.core.errors import InputError
from iits_mj.evaluation.controlled_drive import follow
from iits_mj.evaluation.parameter_uncertainty import (
    FIGURES,
    NOMINAL,
    MonteCarloConfig,
    Sample,
    SampleTask,
    drawn_truck,
    measure,
    sample_code,
    summarize,
    tasks_of,
    write_samples,
)
from iits_mj.parameters import TruckParameters, label_of
from iits_mj.parameters.randomization import Spread
from iits_mj.scale.shards import Shards, in_shards
from iits_mj.validation.handling.rollover import tilt_table
from tests.paths import ROOT

CONFIG = MonteCarloConfig(samples=60)


def sample(task, **changes):
    """An artificial sample whose figures depend on the brakes alone."""
    factors = drawn_truck(Spread.load(), task.seed).factors
    figures = {
        "rollover_threshold": 0.36,
        "rearward_amplification": 1.2,
        "yaw_fit": 92.0,
        "stop_distance": 24.0 / factors["brake_torque"],
        "deceleration": 7.5 * factors["brake_torque"],
        "fuel": 34.0,
        "path_error": 0.0,
        "speed_error": 0.0,
        "completed": 0,
        "wall_time": 1.0,
        "code": sample_code(),
    }
    return Sample(**vars(task), **{**figures, **changes})


@pytest.fixture(scope="module")
def rows():
    return [sample(task) for task in tasks_of(CONFIG)]


def test_the_shipped_truck_is_first_and_seeds_differ_between_sets():
    first, second = tasks_of(CONFIG), tasks_of(MonteCarloConfig(samples=60, seed=1))
    assert first[0].seed == second[0].seed == NOMINAL
    assert not {t.seed for t in first[1:]} & {t.seed for t in second[1:]}
    assert len(first) == 61


def test_quantiles_and_correlations_agree_with_the_rows(rows):
    results = summarize(CONFIG, rows)
    named = {check.name: check for check in results.checks}
    stops = np.array([row.stop_distance for row in rows[1:]])
    median = named["full stop from 60 km/h: median"]
    assert median.value == pytest.approx(np.median(stops))
    assert median.reference == 24.0
    low = named["full stop from 60 km/h: 5 % of the trucks below"].value
    assert np.mean(stops < low) == pytest.approx(0.05, abs=0.02)
    strongest = next(note for note in results.notes if note.startswith("full stop"))
    assert "brake_torque -1.00" in strongest
    assert results.ok
    assert set(results.figures) == {title for _, title, _ in FIGURES}


def test_trucks_that_miss_a_standard_are_counted(rows):
    changed = [
        sample(row.task, stop_distance=40.0, deceleration=4.5) if row.seed in (3, 4, 5) else row
        for row in rows
    ]
    short = [check for check in summarize(CONFIG, changed).checks if not check.ok]
    assert [check.value for check in short] == [pytest.approx(95.0), pytest.approx(95.0)]


def test_distribution_needs_the_shipped_truck_and_two_drawn_trucks(rows):
    for some in (rows[1:], rows[:2]):
        with pytest.raises(InputError, match="at least two drawn"):
            summarize(CONFIG, some)


def test_samples_are_written_with_their_factors(rows, tmp_path):
    write_samples(tmp_path / "samples.csv", CONFIG, rows[::-1])
    with (tmp_path / "samples.csv").open() as stream:
        table = list(csv.DictReader(stream))
    assert [int(row["seed"]) for row in table] == [row.seed for row in rows]
    assert table[0]["factor_brake_torque"] == "1.0"
    drawn = float(table[5]["factor_brake_torque"])
    assert float(table[5]["stop_distance"]) == pytest.approx(24.0 / drawn)


def test_shipped_truck_has_the_figures_of_the_validation():
    found = measure(SampleTask(NOMINAL, label_of(None), 36_000.0, 0.002, "", ""))
    assert found.rollover_threshold == tilt_table(TruckParameters.load(), 36_000.0, 0.002).threshold
    assert 1.0 < found.rearward_amplification < 1.5
    assert 90.0 < found.yaw_fit < 100.0
    assert found.deceleration > 5.0
    assert 25.0 < found.fuel < 45.0


def test_incomplete_shard_is_not_read(tmp_path, rows):
    shards = Shards(tmp_path / "kept", Sample, "samples")
    assert shards.rows() == []
    parts = in_shards(rows, 25)
    assert [len(part) for part in parts] == [25, 25, 11]
    for part in parts:
        shards.keep([row.task for row in part], part)
    # A partly written file of a killed process is not a shard.
    (tmp_path / "kept" / "shard-0.part").write_text("seed,payl")
    assert sorted(shards.rows(), key=lambda row: row.seed) == rows
    before = {path: path.read_bytes() for path in shards.files()}
    shards.keep([row.task for row in parts[0]], parts[0])
    assert {path: path.read_bytes() for path in shards.files()} == before
    (tmp_path / "kept" / "shard-0.part").unlink()
    shards.clear()
    assert not shards.folder.exists()


def test_unusable_flags_are_refused(tmp_path, capsys):
    assert cli.main(["montecarlo", "--samples", "1"]) == 2
    assert "samples 1 is not allowed" in capsys.readouterr().err
    assert cli.main(["montecarlo", "--spread", str(tmp_path / "none.toml")]) == 2
    assert "none.toml" in capsys.readouterr().err


class Straight:
    """A steering controller that does not steer."""

    def reset(self):
        pass

    def steer(self, ego, trajectory):
        return 0.0


def test_the_drive_tells_a_controller_that_follows_the_lane_from_one_that_does_not():
    parameters = TruckParameters.load(None)
    stanley = f"{ROOT}/examples/own_lateral.py:Stanley"
    good = follow(parameters, 36_000.0, 0.005, stanley, None)
    assert good.completed == 1
    assert good.path_error < 0.5
    assert good.speed_error < 1.0
    bad = follow(parameters, 36_000.0, 0.005, Straight, None)
    assert bad.completed == 0
    assert 2.0 < bad.path_error < 20.0


def test_figures_of_the_drive_are_shown_and_written_only_with_own_controllers(tmp_path):
    config = MonteCarloConfig(samples=60, lateral=f"{ROOT}/examples/own_lateral.py:Stanley")
    tasks = tasks_of(config)
    assert "own_lateral.py:Stanley@" in tasks[0].controllers
    driven = [sample(t, path_error=0.1 + 0.001 * t.seed, completed=int(t.seed != 7)) for t in tasks]
    results = summarize(config, driven)
    named = {check.name: check for check in results.checks}
    share = named["trucks that complete the drive"]
    assert share.value == pytest.approx(100.0 * 59 / 60)
    assert not share.ok
    median = named["distance from the lane's middle, greatest: median"]
    assert median.value == pytest.approx(0.1 + 0.001 * 29.5)
    for rows_of, own, there in (
        (driven, config, True),
        ([sample(t) for t in tasks_of(CONFIG)], CONFIG, False),
    ):
        write_samples(tmp_path / "samples.csv", own, rows_of)
        columns = (tmp_path / "samples.csv").read_text().splitlines()[0].split(",")
        assert ("path_error" in columns) == there
        assert ("controllers" in columns) == there
    with pytest.raises(InputError, match="the sample has controllers"):
        measure(tasks[0])
