"""RLlib makes the environments by name, in processes that import iits_mj by that name only."""

import os

import pytest

ray = pytest.importorskip("ray")
pytest.importorskip("torch")
ppo = pytest.importorskip("ray.rllib.algorithms.ppo", exc_type=ImportError)


def test_ppo_of_rllib_trains_on_the_highway():
    os.environ["RAY_USAGE_STATS_ENABLED"] = "0"
    ray.init(
        address="local", num_cpus=2, include_dashboard=False, log_to_driver=False,
        object_store_memory=100_000_000,
    )  # fmt: skip
    try:
        config = (
            ppo.PPOConfig()
            .environment("iits_mj:iits_mj/HighwayFast-v0", env_config={"duration": 30.0})
            .env_runners(num_env_runners=1, rollout_fragment_length=64)
            .training(train_batch_size=128, minibatch_size=64, num_epochs=2)
        )
        algorithm = config.build_algo()
        found = algorithm.train()
        assert found["num_env_steps_sampled_lifetime"] == 128
        # At worst every decision is a refused change.
        assert -30.0 * 40.0 < found["env_runners"]["episode_return_mean"] < 0.0
        algorithm.stop()
    finally:
        ray.shutdown()
