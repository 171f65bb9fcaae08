"""The policy's network in numpy, its file, and the policy as a decision maker."""

import dataclasses
import json

import numpy as np
import pytest

from controllers.decision import make
from controllers.decision.fast_world.env import HighwayEnv
from controllers.decision.observation import OBSERVATION_SIZE
from controllers.decision.policy import LAYERS, SHIPPED, GreedyPolicy, QNetwork
from controllers.decision.trip import TripConfig, cell_trip
from iits_mj.core.errors import InputError
from iits_mj.core.messages import Decision


def network(seed=0):
    return QNetwork.random(np.random.default_rng(seed))


def rewrite(path, **changes):
    """Rewrites a file with other arrays; None removes one."""
    with np.load(path) as content:
        arrays = {name: content[name] for name in content.files}
    arrays.update(changes)
    np.savez(path, **{name: value for name, value in arrays.items() if value is not None})


@pytest.fixture
def saved(tmp_path):
    path = tmp_path / "weights.npz"
    network().save(path, command="a test")
    return path


def test_layers_are_the_papers():
    assert LAYERS == (216, 256, 512, 256, 3)


def test_values_in_numpy_and_torch_agree_to_1e_5():
    torch = pytest.importorskip("torch", reason="torch is not installed (the train extra)")
    from controllers.decision.learning.ddqn import DoubleDqn, LearnerConfig

    learner = DoubleDqn(LearnerConfig(), seed=3)
    batch = np.random.default_rng(1).uniform(-1.0, 1.0, (50, OBSERVATION_SIZE)).astype(np.float32)
    with torch.no_grad():
        wanted = learner.online(torch.from_numpy(batch)).numpy()
    assert np.abs(learner.network().values(batch) - wanted).max() < 1e-5


def test_one_observation_gives_the_values_of_its_row_in_a_batch():
    batch = np.random.default_rng(1).uniform(-1.0, 1.0, (4, OBSERVATION_SIZE))
    rows = network().values(batch)
    assert network().values(batch[2]) == pytest.approx(rows[2], abs=1e-5)


def test_a_network_and_its_metadata_survive_saving_and_loading(saved):
    loaded = QNetwork.load(saved)
    assert loaded.metadata["command"] == "a test"
    for mine, theirs in zip(network().weights, loaded.weights, strict=True):
        assert np.array_equal(mine, theirs)


def test_the_shipped_file_is_small_and_records_its_training():
    assert SHIPPED.stat().st_size < 2 * 2**20
    metadata = QNetwork.load(SHIPPED).metadata
    assert metadata["command"].startswith("iits-mj train")
    assert metadata["validation"]["collisions"] == 0.0


def test_wrong_shape_is_refused(saved):
    rewrite(saved, w1=np.zeros((512, 255), np.float32))
    with pytest.raises(InputError, match=r"shape .*512, 255"):
        QNetwork.load(saved)


def test_a_missing_layer_is_refused(saved):
    rewrite(saved, b2=None)
    with pytest.raises(InputError, match="lacks b2"):
        QNetwork.load(saved)


def test_numbers_that_are_not_finite_are_refused(saved):
    rewrite(saved, b3=np.array([0.0, np.nan, 0.0], np.float32))
    with pytest.raises(InputError, match="not finite"):
        QNetwork.load(saved)


def test_another_version_of_the_observation_is_refused(saved):
    header = {"format": "iits_mj.q_network.1", "observation_version": 99}
    rewrite(saved, metadata=np.array(json.dumps(header)))
    with pytest.raises(InputError, match="version 99 of the observation"):
        QNetwork.load(saved)


def test_a_file_without_metadata_is_refused(saved):
    rewrite(saved, metadata=None)
    with pytest.raises(InputError, match="metadata"):
        QNetwork.load(saved)


@pytest.mark.parametrize("where", [0, 100, 3000])
def test_damaged_files_are_refused(saved, where):
    content = bytearray(saved.read_bytes())
    content[where : where + 2000] = b"\x00" * 2000
    saved.write_bytes(bytes(content))
    with pytest.raises(InputError, match="weights file"):
        QNetwork.load(saved)


@pytest.mark.parametrize("content", [b"", b"hello", b"PK\x03\x04"])
def test_files_other_than_npz_are_refused(tmp_path, content):
    path = tmp_path / "other.npz"
    path.write_bytes(content)
    with pytest.raises(InputError, match="weights file"):
        QNetwork.load(path)


def test_pickled_objects_are_refused(tmp_path):
    path = tmp_path / "pickle.npz"
    np.savez(path, metadata=np.array([{"a": 1}], dtype=object))
    with pytest.raises(InputError, match="weights file"):
        QNetwork.load(path)


def test_a_missing_file_is_refused(tmp_path):
    with pytest.raises(InputError, match="does not exist"):
        make("ddqn", str(tmp_path / "none.npz"))


def test_nan_in_an_observation_names_the_feature():
    observation = np.zeros(OBSERVATION_SIZE)
    # Second frame (54 numbers a frame), row "behind2" (6 a row), feature "relative_speed".
    observation[54 + 2 * 6 + 3] = np.nan
    with pytest.raises(InputError, match="relative_speed of row behind2, 1 s ago, is nan"):
        network().values(observation)


def test_an_observation_of_wrong_length_is_refused():
    with pytest.raises(InputError, match="shape"):
        network().values(np.zeros(215))


@pytest.mark.parametrize(("action", "wanted"), [(0, -1), (1, 0), (2, 1)])
def test_greedy_decision_has_the_greatest_value(action, wanted):
    biases = [np.zeros(n, np.float32) for n in LAYERS[1:]]
    biases[-1][action] = 1.0
    weights = [np.zeros_like(w) for w in network().weights]
    flat = QNetwork(tuple(weights), tuple(biases))
    assert flat.greedy(np.zeros(OBSERVATION_SIZE)) is Decision(wanted)


def test_policy_keeps_its_lane_if_the_other_one_does_not_exist():
    env = HighwayEnv()
    env.reset(np.random.default_rng(0), cell_trip("sparse", 15.0, TripConfig()))
    biases = [np.zeros(n, np.float32) for n in LAYERS[1:]]
    biases[-1][2] = 1.0  # always right, from the right lane
    policy = GreedyPolicy(
        QNetwork(tuple(np.zeros_like(w) for w in network().weights), tuple(biases))
    )
    assert policy.decide(env.context()) is Decision.KEEP


def test_a_change_must_exceed_the_value_of_keeping_by_the_margin(tmp_path):
    layers = network()
    biases = [np.zeros_like(bias) for bias in layers.biases]
    weights = [np.zeros_like(weight) for weight in layers.weights]
    biases[-1][:] = (1.0, 0.5, 0.2)  # left, keep, right, whatever is observed
    observation = np.zeros(OBSERVATION_SIZE, np.float32)
    for margin, decision in ((0.0, Decision.LEFT), (0.4, Decision.LEFT), (0.6, Decision.KEEP)):
        made = QNetwork(tuple(weights), tuple(biases), margin=margin)
        made.save(tmp_path / "policy.npz")
        loaded = QNetwork.load(tmp_path / "policy.npz")
        assert made.greedy(observation) is loaded.greedy(observation) is decision


@pytest.mark.parametrize("margin", [-0.1, np.nan, np.inf, "0.1", None, True])
def test_an_invalid_margin_is_refused(margin):
    with pytest.raises(InputError, match="margin"):
        dataclasses.replace(network(), margin=margin)
