"""Worlds for the tests of training; picklable by name, and without torch, as workers are."""

import os
import sys

from controllers.decision.fast_world.env import HighwayEnv, HighwaySettings


class FlatWorld(HighwayEnv):
    """Another world than the fast one, as quick."""

    def __init__(self):
        super().__init__(HighwaySettings(grade_max=0.0))


class TorchlessWorld(FlatWorld):
    """Refuses to be where torch is."""

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
    """Takes its process with it."""

    def reset(self, generator, trip=None):
        os._exit(9)


class BlindWorld(FlatWorld):
    """Sees NaN after the first step."""

    def step(self, decision):
        step = super().step(decision)
        step.observation[3] = float("nan")
        return step
