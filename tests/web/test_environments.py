import numpy as np
import pytest

from iits_mj.core.errors import InputError
from iits_mj.web.environments import names, open_world
from iits_mj.web.manual import Hands

UNSEEN = ("iits_mj/HighwayFast-v0", "iits_mj/Hoel2020-v0")
SHOWN = [name for name in names() if name not in UNSEEN]


@pytest.mark.parametrize("name", SHOWN)
def test_every_environment_is_driven_by_script_chance_and_hand(name):
    world = open_world(name)
    try:
        world.reset(3)
        generator = np.random.default_rng(0)
        start = world.truck().data.time
        actions = (
            world.scripted,
            lambda: world.random(generator),
            lambda: world.manual(Hands(pedal=0.5, steer=0.2)),
        )
        for action in actions:
            step = world.step(action())
            assert np.isfinite(step.reward)
        assert world.truck().data.time > start
        # The suite's highway and the decision environments step a whole drive.
        assert (world.drive() is not None) == any(w in name.lower() for w in ("highway", "speed"))
    finally:
        world.close()


def test_names_that_cannot_be_shown_are_errors():
    with pytest.raises(InputError, match="use one of: cruise, stop"):
        open_world("parking")
    for name in UNSEEN:
        with pytest.raises(InputError, match="Highway-v0"):
            open_world(name)


def test_an_episode_repeats_with_its_seed():
    places = []
    for _ in range(2):
        world = open_world("dock")
        world.reset(11)
        for _ in range(5):
            world.step(world.scripted())
        places.append(world.truck().data.qpos.copy())
        world.close()
    assert np.array_equal(*places)
