"""Double DQN: learner, memory, driving processes, checkpoints; only the learner needs torch."""
