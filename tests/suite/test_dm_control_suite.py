"""dm_control's own tests of its suite, run on the truck's suite."""

import importlib.util
import sys
import types
import unittest.mock
from pathlib import Path

import dm_control
import dm_control.suite
import pytest

from iits_mj import suite

_made = []


def _load(*args, **settings):
    _made.append(suite.load(*args, **settings))
    return _made[-1]


@pytest.fixture(autouse=True)
def _no_sumo_left_behind():
    yield
    while _made:
        _made.pop().close()


def _theirs(name, tasks):
    """Returns a test module of dm_control in which `suite` is the truck's, with some tasks."""
    chosen = types.SimpleNamespace(**{n: getattr(suite, n) for n in suite.__all__})
    chosen.ALL_TASKS = tasks
    chosen.load = _load
    chosen.REWARD_VIZ = tuple(task for task in suite.REWARD_VIZ if task in tasks)
    chosen.TASKS_BY_DOMAIN = {"truck": tuple(task for _, task in tasks)}
    path = Path(dm_control.suite.__file__).with_name(f"{name}.py")
    spec = importlib.util.spec_from_file_location(f"iits_mj_{name}", path)
    module = importlib.util.module_from_spec(spec)
    with (
        unittest.mock.patch.object(dm_control, "suite", chosen),
        unittest.mock.patch.dict(sys.modules, {"mock": unittest.mock}),
    ):
        spec.loader.exec_module(module)
    assert module.suite is chosen
    return module


# The task with SUMO takes as long as all other tasks together.
_SUMO = tuple(task for task in suite.ALL_TASKS if task == ("truck", "highway"))
_OTHERS = tuple(task for task in suite.ALL_TASKS if task not in _SUMO)
# In a dictionary, because pytest collects every TestCase in a module's namespace.
_BASES = {
    "others": _theirs("suite_test", _OTHERS).SuiteTest,
    "sumo": _theirs("suite_test", _SUMO).SuiteTest,
    "constants": _theirs("loader_test", suite.ALL_TASKS).LoaderConstantsTest,
}


class TestSuite(_BASES["others"]):
    pass


@pytest.mark.slow
class TestHighway(_BASES["sumo"]):
    pass


class TestLoaderConstants(_BASES["constants"]):
    pass


def test_every_task_is_tested():
    assert set(_OTHERS) | set(_SUMO) == set(suite.ALL_TASKS)
    assert len(_SUMO) == 1
    tested = [name for name in dir(TestSuite) if name.startswith("test_task_conforms_to_spec")]
    assert len(tested) == len(_OTHERS)
