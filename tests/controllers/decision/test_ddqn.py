"""The learner: double-Q target, target network, dueling heads, restoring."""

import itertools

import numpy as np
import pytest

from controllers.decision import make
from controllers.decision.fast_world.env import HighwayEnv
from controllers.decision.learning.replay import Batch
from controllers.decision.observation import FEATURES, OBSERVATION_SIZE, ROWS, usual_and_spread
from controllers.decision.policy import LAYERS
from controllers.decision.trip import cell_trip
from iits_mj.core.errors import Error

torch = pytest.importorskip("torch", reason="torch is not installed (the train extra)")

from controllers.decision.learning.ddqn import (  # noqa: E402
    DoubleDqn,
    LearnerConfig,
    ValueNetwork,
    double_q_target,
    shortfall,
)


def plain(**settings):
    """Returns settings of the paper's learner, with some changes."""
    options = {"dueling": False, "standardized": False, "gap": 0.0, "average_rate": 0.0}
    return LearnerConfig(**{**options, **settings})


@pytest.fixture(autouse=True)
def one_thread():
    """Uses one thread, as training does: several threads take ten times as long."""
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(threads)


def batch(count=64, seed=0, discount=0.9):
    random = np.random.default_rng(seed)
    shape = (count, OBSERVATION_SIZE)
    return Batch(
        random.uniform(-1.0, 1.0, shape).astype(np.float32),
        random.integers(0, 3, count),
        random.normal(size=count).astype(np.float32),
        np.full(count, discount, np.float32),
        random.uniform(-1.0, 1.0, shape).astype(np.float32),
        np.zeros(count, bool),
    )


def test_double_q_target_equals_a_hand_calculation():
    # Online prefers actions 2 and 0 with target values 5 and 7; the best target values are 9 and 8.
    online = torch.tensor([[1.0, 2.0, 3.0], [4.0, 0.0, 1.0]])
    target = torch.tensor([[9.0, 0.0, 5.0], [7.0, 8.0, 0.0]])
    reward = torch.tensor([1.0, -1.0])
    wanted = double_q_target(reward, torch.tensor([0.5, 0.0]), online, target)
    assert wanted.tolist() == [1.0 + 0.5 * 5.0, -1.0]


def test_shortfall_equals_a_hand_calculation():
    values = torch.tensor([[2.0, 4.0, 3.0]]).expand(3, 3)
    assert shortfall(values, torch.tensor([0, 1, 2])).tolist() == [2.0, 0.0, 1.0]


def test_advantage_learning_widens_the_gap_and_keeps_the_best_value():
    # One state, rewards -1, 0 and -0.5 of the actions, a discount of 0.5: the values are -1, 0 and
    # -0.5. With half of the shortfall charged, the lower values are twice as far below.
    def learned(gap):
        learner = DoubleDqn(
            plain(gap=gap, reward_scale=1.0, learning_rate=1e-3, target_interval=20), seed=0
        )
        rewards = np.array([-1.0, 0.0, -0.5], np.float32)
        state = np.full((3, OBSERVATION_SIZE), 0.1, np.float32)
        alike = np.full(3, 0.5, np.float32)
        for _ in range(400):
            learner.update(Batch(state, np.arange(3), rewards, alike, state, np.zeros(3, bool)))
        return learner.network().values(state[0])

    assert learned(0.0) == pytest.approx([-1.0, 0.0, -0.5], abs=0.03)
    assert learned(0.5) == pytest.approx([-2.0, 0.0, -1.0], abs=0.05)


def test_advantage_head_does_not_change_the_mean_value():
    network = ValueNetwork(dueling=True)
    data = torch.from_numpy(batch(5).observation)
    with torch.no_grad():
        before = network(data).mean(dim=1)
        network.advantage.bias += 3.0
        network.advantage.weight *= 2.0
        assert torch.allclose(network(data).mean(dim=1), before, atol=1e-6)
        network.value.bias += 3.0
        assert torch.allclose(network(data).mean(dim=1), before + 3.0, atol=1e-6)


@pytest.mark.parametrize("dueling", [False, True])
def test_exported_network_gives_the_values_of_torch(dueling):
    learner = DoubleDqn(plain(dueling=dueling), seed=3)
    for seed in range(3):
        learner.update(batch(seed=seed))
    data = batch(50, seed=9).observation
    with torch.no_grad():
        wanted = learner.online(torch.from_numpy(data)).numpy()
    shipped = learner.network()
    assert [w.shape for w in shipped.weights] == [(n, m) for m, n in itertools.pairwise(LAYERS)]
    assert np.abs(shipped.values(data) - wanted).max() < 1e-6


@pytest.mark.parametrize("dueling", [False, True])
def test_exported_network_includes_the_scaling_of_the_inputs(dueling):
    config = plain(standardized=True, dueling=dueling)
    learner = DoubleDqn(config, seed=3)
    data = batch(50, seed=9).observation
    shipped = learner.network().values(data)
    with torch.no_grad():
        wanted = learner.online(torch.from_numpy(data)).numpy()
    assert np.abs(shipped - wanted).max() < 1e-4 * np.abs(wanted).max()
    other = DoubleDqn(plain(dueling=dueling), seed=3).network().values(data)
    assert np.abs(shipped - other).max() > 0.1 * np.abs(wanted).max()


def test_standardized_inputs_of_a_drive_have_similar_sizes():
    env, maker, seen = HighwayEnv(), make("mobil"), []
    env.reset(np.random.default_rng(0), cell_trip("dense", 12.5))
    for _ in range(300):
        seen.append(env.step(maker.decide(env.context())).observation)
    usual, spread = usual_and_spread()
    inputs = ((np.array(seen) - usual) / spread).reshape(-1, len(ROWS), len(FEATURES))
    raw = np.array(seen).reshape(inputs.shape)
    present = raw[:, 1:, FEATURES.index("presence")].astype(bool)
    sizes = np.sqrt((inputs[:, 1:][present] ** 2).mean(axis=0))
    assert (sizes > 0.3).all()
    assert (sizes < 3.0).all()
    assert np.sqrt((raw[:, 1:][present] ** 2).mean(axis=0)).min() < 0.01


def test_target_network_is_separate_and_copied_at_its_interval():
    learner = DoubleDqn(plain(target_interval=3), seed=0)
    online, target = learner.online.trunk[0].weight, learner.target.trunk[0].weight
    start = target.clone()
    assert target.data_ptr() != online.data_ptr()
    learner.update(batch())
    learner.update(batch())
    assert torch.equal(target, start)
    assert not torch.equal(online, start)
    learner.update(batch())
    assert torch.equal(target, online)
    assert not torch.equal(target, start)


def test_the_policy_is_the_mean_of_the_networks_and_then_their_running_average():
    learner = DoubleDqn(plain(average_rate=0.4), seed=0)
    weights = []
    for _ in range(4):
        learner.update(batch())
        weights.append(learner.online.trunk[0].weight.detach().numpy().copy())
    # Shares 1, 1/2, then 0.4 where 1/3 and 1/4 would be less.
    mean = 0.5 * (weights[0] + weights[1])
    for later in weights[2:]:
        mean += 0.4 * (later - mean)
    assert np.abs(learner.policy().weights[0] - mean).max() < 1e-7
    assert np.array_equal(learner.network().weights[0], weights[-1])
    resumed = DoubleDqn(plain(average_rate=0.4), seed=1)
    resumed.restore(learner.state())
    assert np.array_equal(resumed.policy().weights[0], learner.policy().weights[0])


def test_a_rate_near_zero_stops_learning():
    learner = DoubleDqn(plain(), seed=0)
    learner.set_rate(1e-20)
    start = learner.network().weights[0]
    learner.update(batch())
    assert np.array_equal(learner.network().weights[0], start)


@pytest.mark.parametrize("options", [{}, {"dueling": True}])
def test_update_moves_values_towards_the_return(options):
    config = plain(target_interval=10_000, reward_scale=1.0, **options)
    learner = DoubleDqn(config, seed=0)
    data = batch(discount=0.0)
    errors = [learner.update(data).error for _ in range(150)]
    assert errors[-1] < 0.3 * errors[0]


def test_update_returns_its_errors_and_the_mean_value():
    learner = DoubleDqn(plain(reward_scale=0.5), seed=0)
    data = batch(discount=0.0)
    values = learner.network().values(data.observation)[np.arange(64), data.action]
    update = learner.update(data)
    assert update.error == pytest.approx(np.abs(0.5 * data.reward - values).mean(), abs=1e-5)
    assert update.value == pytest.approx(values.mean(), abs=1e-5)


def test_a_loss_that_is_not_finite_is_refused():
    data = batch()
    data.reward[0] = np.nan
    with pytest.raises(Error, match="diverged: the loss of update 1 is nan"):
        DoubleDqn(plain(), seed=0).update(data)


def test_learner_is_restored_to_the_bit():
    learner, other = DoubleDqn(plain(), seed=0), DoubleDqn(plain(), seed=1)
    for seed in range(3):
        learner.update(batch(seed=seed))
    other.restore(learner.state())
    assert learner.update(batch(seed=9)).loss == other.update(batch(seed=9)).loss
    assert torch.equal(learner.online.trunk[0].weight, other.online.trunk[0].weight)


def test_seeding_the_network_does_not_change_other_random_draws():
    torch.manual_seed(5)
    wanted = torch.rand(3)
    torch.manual_seed(5)
    DoubleDqn(plain(), seed=0)
    assert torch.equal(torch.rand(3), wanted)
