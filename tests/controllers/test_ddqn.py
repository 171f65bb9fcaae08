"""The learner: double-Q target, target network, replay, n-step returns, training and resuming."""

import numpy as np
import pytest

from controllers.decision.observation import OBSERVATION_SIZE
from controllers.decision.replay import Batch, Replay, Returns, Transition
from iits_mj.errors import InputError

torch = pytest.importorskip("torch", reason="torch is not installed (the train extra)")

from controllers.decision.ddqn import DoubleDqn, LearnerConfig, double_q_target  # noqa: E402
from controllers.decision.training import TrainConfig, sample_trip, train  # noqa: E402


@pytest.fixture(autouse=True)
def one_thread():
    """As training does: threads that wait for each other's cores take ten times as long."""
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(threads)


def transition(reward=0.0, discount=0.5, action=1, mark=0.0):
    first = np.full(OBSERVATION_SIZE, mark, np.float32)
    return Transition(first, action, reward, discount, first + 0.5)


def batch(count=64, seed=0, discount=0.9):
    random = np.random.default_rng(seed)
    shape = (count, OBSERVATION_SIZE)
    return Batch(
        random.uniform(-1.0, 1.0, shape).astype(np.float32),
        random.integers(0, 3, count),
        random.normal(size=count).astype(np.float32),
        np.full(count, discount, np.float32),
        random.uniform(-1.0, 1.0, shape).astype(np.float32),
    )


def test_double_q_target_by_hand():
    # Online prefers actions 2 and 0; the target net values them 5 and 7, its own best are 9 and 8.
    online = torch.tensor([[1.0, 2.0, 3.0], [4.0, 0.0, 1.0]])
    target = torch.tensor([[9.0, 0.0, 5.0], [7.0, 8.0, 0.0]])
    reward = torch.tensor([1.0, -1.0])
    wanted = double_q_target(reward, torch.tensor([0.5, 0.0]), online, target)
    assert wanted.tolist() == [1.0 + 0.5 * 5.0, -1.0]


def test_target_network_is_separate_and_is_renewed_on_time():
    learner = DoubleDqn(LearnerConfig(target_interval=3), seed=0)
    start = learner.target[0].weight.clone()
    assert learner.target[0].weight.data_ptr() != learner.online[0].weight.data_ptr()
    learner.update(batch())
    learner.update(batch())
    assert torch.equal(learner.target[0].weight, start)
    assert not torch.equal(learner.online[0].weight, start)
    learner.update(batch())
    assert torch.equal(learner.target[0].weight, learner.online[0].weight)
    assert not torch.equal(learner.target[0].weight, start)


def test_update_moves_values_towards_the_target():
    learner = DoubleDqn(LearnerConfig(target_interval=10_000, reward_scale=1.0), seed=0)
    data = batch(discount=0.0)
    losses = [learner.update(data) for _ in range(150)]
    assert losses[-1] < 0.1 * losses[0]


def test_learner_is_restored_to_the_bit():
    learner, other = DoubleDqn(LearnerConfig(), seed=0), DoubleDqn(LearnerConfig(), seed=1)
    for seed in range(3):
        learner.update(batch(seed=seed))
    other.restore(learner.state())
    assert learner.update(batch(seed=9)) == other.update(batch(seed=9))
    assert torch.equal(learner.online[0].weight, other.online[0].weight)


def test_n_step_return_by_hand():
    returns = Returns(3)
    assert returns.add(transition(1.0, 0.5, mark=0.1), over=False) == []
    assert returns.add(transition(2.0, 0.25, mark=0.2), over=False) == []
    (joined,) = returns.add(transition(4.0, 0.5, mark=0.3), over=False)
    assert joined.reward == 1.0 + 0.5 * 2.0 + 0.125 * 4.0
    assert joined.discount == 0.5 * 0.25 * 0.5
    assert joined.observation[0] == np.float32(0.1)
    assert joined.following[0] == np.float32(0.8)


def test_end_of_an_episode_releases_the_rest():
    returns = Returns(3)
    returns.add(transition(1.0), over=False)
    joined = returns.add(transition(2.0, discount=0.0), over=True)
    assert [t.reward for t in joined] == [1.0 + 0.5 * 2.0, 2.0]
    assert [t.discount for t in joined] == [0.0, 0.0]


def test_truncation_keeps_the_value_of_what_follows():
    returns = Returns(3)
    (joined,) = returns.add(transition(1.0, discount=0.99), over=True)
    assert joined.discount == 0.99


def test_replay_forgets_the_oldest_and_draws_by_the_generator():
    replay = Replay(3, OBSERVATION_SIZE)
    for reward in (1.0, 2.0, 3.0, 4.0):
        replay.add(transition(reward))
    assert len(replay) == 3
    drawn = replay.sample(200, np.random.default_rng(0))
    assert set(drawn.reward.tolist()) == {2.0, 3.0, 4.0}
    again = replay.sample(200, np.random.default_rng(0))
    assert np.array_equal(drawn.reward, again.reward)


def test_an_empty_replay_says_so():
    with pytest.raises(InputError, match="empty"):
        Replay(3, OBSERVATION_SIZE).sample(1, np.random.default_rng(0))


def test_training_trips_mix_the_six_cells_with_randomized_traffic():
    random = np.random.default_rng(0)
    trips = [sample_trip(TrainConfig(), random).traffic for _ in range(200)]
    cells = {(t.spawn_probability, t.traffic_speed) for t in trips if t.traffic_speed in (12.5, 15)}
    assert len(cells) == 6
    assert len({t.spawn_probability for t in trips}) > 40


SMALL = {
    "warm_up": 50,
    "trip_duration": 20.0,
    "evaluate_interval": 100,
    "checkpoint_interval": 60,
    "validation_trips": 1,
    "epsilon_decisions": 100,
}


def test_training_leaves_weights_log_and_checkpoint_and_resumes(tmp_path):
    first = train(TrainConfig(decisions=100, **SMALL), tmp_path, command="iits-mj train")
    assert first.decisions >= 100
    assert (tmp_path / "checkpoint.pt").is_file()
    second = train(TrainConfig(decisions=220, resume=True, **SMALL), tmp_path)
    assert second.decisions >= 220
    rows = (tmp_path / "training.csv").read_text().splitlines()
    done = [int(row.split(",")[0]) for row in rows[1:]]
    assert done == sorted(done)
    assert len(done) >= 2


def test_training_repeats_itself_to_the_bit(tmp_path):
    logs = []
    for name in ("a", "b"):
        train(TrainConfig(decisions=90, **SMALL), tmp_path / name)
        row = (tmp_path / name / "training.csv").read_text().splitlines()[-1].split(",")
        logs.append([row[0], *row[2:]])  # without the wall time
    assert logs[0] == logs[1]


def test_resuming_without_or_with_a_damaged_checkpoint_is_refused(tmp_path):
    with pytest.raises(InputError, match="no checkpoint"):
        train(TrainConfig(decisions=10, resume=True), tmp_path)
    (tmp_path / "checkpoint.pt").write_bytes(b"nonsense")
    with pytest.raises(InputError, match="not usable"):
        train(TrainConfig(decisions=10, resume=True), tmp_path)


@pytest.mark.parametrize(
    "change",
    [{"decisions": 0}, {"epsilon_end": 2.0}, {"warm_up": 10**9}, {"learning_rate": np.nan}],
)
def test_bad_settings_are_refused_by_name(change):
    with pytest.raises(InputError, match=next(iter(change))):
        TrainConfig(**change)
