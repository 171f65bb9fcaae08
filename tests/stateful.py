"""Settings and runner of the stateful tests (hypothesis rule-based state machines).

Usually every machine runs the same rules each time, within seconds. The environment variable
`IITS_MJ_STATEFUL` sets a factor on the number of runs, which are then random:

    IITS_MJ_STATEFUL=50 .venv/bin/pytest -k states
"""

from __future__ import annotations

import os

from hypothesis import HealthCheck, settings
from hypothesis.stateful import RuleBasedStateMachine, run_state_machine_as_test

FACTOR = float(os.environ.get("IITS_MJ_STATEFUL", "1"))
SLOW = 20  # factor of the slow tests


def explore(machine: type[RuleBasedStateMachine], runs: int, rules: int, factor: float = 1.0):
    """Runs a machine.

    Args:
      machine: its class.
      runs: number of runs, times `factor` and the environment variable.
      rules: number of rules in a run.
      factor: other than 1, the runs are random.
    """
    whole = factor * FACTOR
    run_state_machine_as_test(
        machine,
        settings=settings(
            max_examples=max(1, round(runs * whole)),
            stateful_step_count=rules,
            deadline=None,
            derandomize=whole == 1.0,
            database=None,
            suppress_health_check=list(HealthCheck),
        ),
    )
