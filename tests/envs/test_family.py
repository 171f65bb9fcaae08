"""Environments draw their truck from a family with their own generator."""

import gymnasium
import numpy as np
import pytest

import iits_mj.envs  # noqa: F401 - registers the environments
from iits_mj.core.errors import InputError
from iits_mj.envs.family import Family
from iits_mj.parameters import TruckParameters, shipped_trucks

LIGHT = TruckParameters.load(overlay={"units": {"trailer": {"payload": {"mass_max": 20_000.0}}}})
TRUCKS = (shipped_trucks()[0], LIGHT)


def test_a_family_draws_all_members_and_a_single_truck_needs_no_draw():
    family, generator = Family(TRUCKS), np.random.default_rng(0)
    assert {family.draw(generator) for _ in range(30)} == {0, 1}
    before = generator.bit_generator.state
    assert Family(None).draw(generator) == 0
    assert generator.bit_generator.state == before


@pytest.mark.parametrize(
    ("truck", "payload", "message"),
    [
        ("nowhere", None, "shipped trucks"),
        (["nowhere"], None, "shipped trucks"),
        ([], None, "empty"),
        (7, None, "shipped trucks"),
        (TRUCKS, 30_000.0, "allowed is 0 to 20000 kg"),
    ],
)
def test_unusable_families_are_refused(truck, payload, message):
    with pytest.raises(InputError, match=message):
        Family(truck, payload)


@pytest.mark.parametrize("name", ["Cruise", "HighwayFast"])
def test_episodes_drive_the_trucks_that_the_seed_draws(name):
    with gymnasium.make(f"iits_mj/{name}-v0", truck=TRUCKS) as environment:
        masses = []
        for seed in (0, 1, 2, 3, 0):
            _, info = environment.reset(seed=seed)
            inner = environment.unwrapped
            masses.append(inner.family.members[inner._number].payload_max)
            assert info["truck"] == LIGHT.name
    assert set(masses) == {36_000.0, 20_000.0}
    assert masses[0] == masses[-1]


def test_members_of_a_vector_drive_as_they_do_alone():
    many = gymnasium.make_vec("iits_mj/Cruise-v0", num_envs=3, threads=2, truck=TRUCKS)
    many.reset(seed=5)
    actions = np.full((3, 1), 0.4, np.float32)
    together = [many.step(actions)[0] for _ in range(3)][-1]
    many.close()
    for number in range(3):
        with gymnasium.make("iits_mj/Cruise-v0", truck=TRUCKS) as alone:
            alone.reset(seed=5 + number)
            for _ in range(3):
                seen = alone.step(actions[number])[0]
        np.testing.assert_array_equal(seen, together[number])
