"""Decision makers in the published scenario: safe with car following, paired, and as a command."""

import csv
import functools
import json

import numpy as np
import pytest

pytest.importorskip("libsumo")

from controllers import decision
from iits_mj.cli import main
from iits_mj.evaluation import hoel2020
from iits_mj.evaluation.hoel2020 import Episode, PolicyDriver, StackDriver
from traffic_bridge.hoel2020 import ACTIONS


def driver(method):
    return StackDriver(decision.make(method))


@pytest.fixture
def drive():
    yield functools.partial(hoel2020.drive, driver_of=driver)
    hoel2020._world().close()


def test_car_following_alone_never_collides_and_never_changes_lanes(drive):
    for seed in range(8):
        episode = drive(("keep", seed))
        assert episode.steps == 100
        assert not episode.collided
        assert episode.changes == 0
        assert episode.total == pytest.approx(
            episode.speed * 100 / 25.0, abs=10.0 * episode.near_collisions + 1e-6
        )


def test_a_rule_changes_lanes_without_a_collision_and_is_faster(drive):
    seeds = range(8)
    kept, ruled = ([drive((name, seed)) for seed in seeds] for name in ("keep", "mobil"))
    assert not any(episode.collided for episode in ruled)
    assert sum(episode.changes for episode in ruled) > 0
    assert np.mean([e.speed for e in ruled]) > np.mean([e.speed for e in kept])


def test_an_episode_repeats_to_the_bit(drive):
    assert drive(("lookahead", 3)) == drive(("lookahead", 3))


def test_a_policy_acts_on_the_published_observation(drive):
    seen = []

    def brake(observation):
        seen.append(observation.shape)
        return np.int64(ACTIONS.index((-4.0, 0)))

    episode = hoel2020.drive(("brakes", 0), lambda _: PolicyDriver(brake))
    assert set(seen) == {(104,)}
    assert episode.speed < 10.0


def test_the_table_has_means_intervals_and_shares():
    episodes = [
        Episode("a", seed, total, 100, 20.0, 1, 0, 0, collided)
        for seed, (total, collided) in enumerate([(70.0, False), (80.0, True)])
    ]
    results = hoel2020.summarize(episodes)
    values = {check.name: check.value for check in results.checks}
    assert values == {"a: return": 75.0, "a: episodes without collision": 50.0}
    text = results.to_table()
    assert "75.0 (11.5 to 138.5)" in text
    assert "50.0 %" in text


def test_the_command_compares_the_methods_and_keeps_the_episodes(tmp_path, capsys):
    file = tmp_path / "episodes.csv"
    command = ["evaluate", "--scenario", "hoel2020", "--trials", "2", "--methods", "keep,mobil"]
    assert main([*command, "--file", str(file), "--json"]) == 0
    names = [check["name"] for check in json.loads(capsys.readouterr().out)["checks"]]
    assert "keep: return" in names
    with file.open(newline="") as stream:
        rows = list(csv.DictReader(stream))
    assert {row["method"] for row in rows} >= {"keep", "mobil"}
    seeds = [{r["seed"] for r in rows if r["method"] == m} for m in ("keep", "mobil")]
    assert seeds[0] == seeds[1]
    assert len(seeds[0]) == 2


def test_a_flag_of_the_papers_cells_is_refused(capsys):
    assert main(["evaluate", "--scenario", "hoel2020", "--cells", "dense-15"]) == 2
    assert "--cells has no meaning with --scenario hoel2020" in capsys.readouterr().err
