"""Worlds for the tests of training; picklable by name and without torch, like the workers."""

import os
import sys

from controllers.decision.fast_world.env import HighwayEnv


class FlatWorld(HighwayEnv):
    """A fast world on a flat road, as another world for the second stage."""

    def __init__(self):
        super().__init__(grade_max=0.0)


class TorchlessWorld(FlatWorld):
    """Fails in a process that has torch or several threads."""

    def __init__(self):
        super().__init__()
        assert "torch" not in sys.modules, "torch is imported"
        assert os.environ["OMP_NUM_THREADS"] == "1"


class FailingWorld(FlatWorld):
    """Fails in the second step of a trip."""

    def step(self, decision):
        if self.summary.decisions == 1:
            raise ValueError("the trailer is gone")
        return super().step(decision)


class DyingWorld(FlatWorld):
    """Ends its process."""

    def reset(self, generator, trip=None):
        os._exit(9)


class BlindWorld(FlatWorld):
    """Observes NaN after the first step."""

    def step(self, decision):
        step = super().step(decision)
        step.observation[3] = float("nan")
        return step
