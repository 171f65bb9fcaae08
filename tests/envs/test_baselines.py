import itertools

import gymnasium
import numpy as np
import pytest

from iits_mj.core.errors import InputError
from iits_mj.envs import ENVIRONMENTS, baselines
from iits_mj.envs.baselines import Policy, load_baseline


def _policy(activation="tanh", head="clip"):
    generator = np.random.default_rng(0)
    sizes = (3, 4, 2)
    weights = tuple(
        generator.normal(size=(m, n)).astype(np.float32) for n, m in itertools.pairwise(sizes)
    )
    return Policy(weights, tuple(np.ones(len(w), np.float32) for w in weights), activation, head)


def test_a_policy_is_its_layers_one_after_the_other():
    policy, x = _policy(), np.array([0.1, -0.2, 0.3])
    (first, second), (bias, last) = policy.weights, policy.biases
    expected = np.clip(second @ np.tanh(first @ x + bias) + last, -1.0, 1.0)
    np.testing.assert_allclose(policy(x), expected, rtol=1e-6)
    assert policy(x).dtype == np.float32
    values = second @ np.maximum(first @ x + bias, 0.0) + last
    assert _policy("relu", "argmax")(x) == np.argmax(values)
    assert np.all(np.abs(_policy("relu", "tanh")(100.0 * x)) <= 1.0)


def test_a_policy_survives_its_file(tmp_path):
    policy = _policy("relu", "tanh")
    policy.save(tmp_path / "policy.npz", seed=3)
    again = Policy.load(tmp_path / "policy.npz")
    assert again.metadata["seed"] == 3
    np.testing.assert_array_equal(again(np.ones(3)), policy(np.ones(3)))


def test_unusable_policies_and_observations_are_refused(tmp_path, monkeypatch):
    policy = _policy()
    with pytest.raises(InputError, match=r"shape \(2,\)"):
        policy(np.ones(2))
    with pytest.raises(InputError, match="activation 'sin'"):
        _policy("sin")
    with pytest.raises(InputError, match="layers of shape"):
        Policy(policy.weights[::-1], policy.biases, "tanh", "clip")
    with pytest.raises(InputError, match="not finite"):
        Policy(policy.weights, tuple(b * np.nan for b in policy.biases), "tanh", "clip")
    np.savez(tmp_path / "other.npz", metadata=np.array("{}"))
    with pytest.raises(InputError, match="metadata"):
        Policy.load(tmp_path / "other.npz")
    monkeypatch.setattr(baselines, "FOLDER", tmp_path)
    with pytest.raises(InputError, match="no policy Cruise-v0-ppo; shipped are: other"):
        load_baseline("iits_mj:iits_mj/Cruise-v0", "ppo")


def test_every_shipped_policy_fits_its_environment():
    for path in baselines.FOLDER.glob("*.npz"):
        name, _, algorithm = path.stem.rpartition("-")
        assert f"iits_mj/{name}" in ENVIRONMENTS
        policy = load_baseline(name, algorithm)
        assert policy.metadata["environment"] == f"iits_mj/{name}"
        with gymnasium.make(f"iits_mj/{name}") as environment:
            action = policy(np.zeros(environment.observation_space.shape))
            assert environment.action_space.contains(action)
