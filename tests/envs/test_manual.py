import re

import environment_manual as manual
import gymnasium
import numpy as np
import pytest

from controllers.decision.observation import FEATURES, SCALE
from iits_mj import suite
from iits_mj.envs import ENVIRONMENTS
from iits_mj.envs.platoon import PlatoonEnv
from iits_mj.suite.tasks import DRIVING_TASKS


def test_the_manual_pages_match_the_code():
    for name, page in manual.pages().items():
        assert (manual.FOLDER / name).read_text(encoding="utf-8") == page, (
            f"{name} is not what the code makes: python tools/environment_manual.py"
        )
    assert {path.name for path in manual.FOLDER.glob("*.md")} == set(manual.pages())


def test_every_environment_and_task_has_its_page():
    index = (manual.FOLDER / "README.md").read_text(encoding="utf-8")
    assert all(f"`{name}`" in index for name in ENVIRONMENTS)
    assert all(f"`{domain}`, `{task}`" in index for domain, task in suite.ALL_TASKS)


@pytest.mark.parametrize("task", [*DRIVING_TASKS, "highway"])
def test_observations_rewards_and_actions_of_a_task_match_its_page(task):
    if task == "highway":
        pytest.importorskip("libsumo")
    environment = suite.load("truck", task, task_kwargs={"random": 0, "visuals": False})
    kind = environment.task
    seen = environment.reset().observation
    assert list(seen) == list(kind.observed)
    assert [len(values) for values in seen.values()] == [t.size for t in kind.observed.values()]
    assert set(kind.reward_terms(environment.physics)) == set(kind.terms)
    assert environment.action_spec().shape == (len(kind.actions),)
    environment.close()


def test_pages_list_every_feature_of_the_decision_observation():
    for name in ("highway.md", "highway_fast.md"):
        page = manual.pages()[name]
        rows = [line for line in page.splitlines() if re.match(r"\| \d \| `", line)][
            : len(FEATURES)
        ]
        cells = [[cell.strip() for cell in row.strip("|").split("|")] for row in rows]
        assert [cell[1] for cell in cells] == [f"`{feature}`" for feature in FEATURES]
        assert [float(cell[-1].split()[0]) for cell in cells] == SCALE.tolist()


def test_the_model_has_the_documented_names():
    environment = suite.load("truck", "lane_keep", task_kwargs={"visuals": False})
    model = environment.physics.model
    names = {
        "sensor": {model.sensor(k).name for k in range(model.nsensor)},
        "body": {model.body(k).name for k in range(model.nbody)},
        "site": {model.site(k).name for k in range(model.nsite)},
    }
    for kind in DRIVING_TASKS.values():
        for entry in kind.observed.values():
            what, _, rest = entry.source.partition(" ")
            if what in names and rest.startswith("`"):
                assert rest.split("`")[1] in names[what], entry
    for control in ("accelerator_pedal", "xbr_demand", "xbr_mode", "steering_wheel_angle"):
        assert model.actuator(control).id >= 0
    environment.close()


def test_observations_have_their_names_in_gymnasium():
    environment = gymnasium.make("iits_mj/LaneKeep-v0").unwrapped
    assert environment.observation_names[-1] == "curvature_ahead[3]"
    assert len(environment.observation_names) == 16
    environment.close()
    with PlatoonEnv((0.0, 0.0)) as platoon:
        platoon.reset(seed=0)
        assert (
            platoon.seen("truck1").keys()
            == {name.split("[")[0]: None for name in platoon.observation_names}.keys()
        )
        assert np.isfinite(platoon.state()).all()
