"""Every command that drives or measures takes --truck, and refuses a wrong one in one line."""

import dataclasses

import pytest

from iits_mj import cli
from iits_mj.commands import (
    bench,
    drive,
    evaluate,
    identify,
    montecarlo,
    pcc,
    record,
    replay,
    replay_can,
    replay_stage,
    serve,
    train,
    view,
)
from iits_mj.commands.arguments import build_parser, parse
from iits_mj.parameters import label_of, shipped_trucks

COMMANDS = (
    *(bench, drive, evaluate, identify, montecarlo, pcc, record, replay),
    *(replay_can, replay_stage, serve, train, view),
)
NAMES = [module.__name__.rpartition(".")[2] for module in COMMANDS]


def words(kind):
    """A file for each required argument without a flag."""
    required = [f for f in dataclasses.fields(kind) if f.default is dataclasses.MISSING]
    return ["file"] * sum(f.default_factory is dataclasses.MISSING for f in required)


@pytest.fixture
def heavy(tmp_path):
    """A truck file that carries 30 t."""
    folder = tmp_path / "heavy"
    folder.mkdir()
    (folder / "truck.toml").write_text(
        f'extends = "{shipped_trucks()[0]}"\n[units.trailer.payload]\nmass_max = 30000.0\n'
    )
    return folder


@pytest.mark.parametrize("module", COMMANDS, ids=NAMES)
def test_a_truck_is_given_by_name_or_file(module, heavy):
    for truck in ("vecto_40t", str(heavy), str(heavy / "truck.toml")):
        given = [*words(module.Options), "--truck", truck]
        assert parse(module.Options, given, "iits-mj", "").truck == truck


@pytest.mark.parametrize("module", COMMANDS, ids=NAMES)
def test_help_names_the_shipped_trucks(module):
    text = " ".join(build_parser(module.Options, "iits-mj", "").format_help().split())
    for name in shipped_trucks():
        assert name in text


@pytest.mark.parametrize("name", NAMES)
def test_an_unknown_truck_is_one_line_that_names_the_shipped_ones(name, capsys):
    module = COMMANDS[NAMES.index(name)]
    command = name.replace("_", "-")
    assert cli.main([command, *words(module.Options), "--truck", "nowhere"]) == 2
    (said,) = capsys.readouterr().err.strip().splitlines()
    assert "truck 'nowhere'" in said
    assert shipped_trucks()[0] in said


@pytest.mark.parametrize("command", ["drive", "evaluate", "montecarlo", "bench", "serve"])
def test_the_truck_bounds_the_payload(command, heavy, capsys):
    assert cli.main([command, "--truck", str(heavy), "--payload", "31000"]) == 2
    said = capsys.readouterr().err
    assert "truck 'heavy': payload = 31000.0 kg: allowed is 0 to 30000 kg" in said


def test_results_of_different_trucks_have_different_labels(heavy):
    assert label_of(None) == label_of(shipped_trucks()[0]) == shipped_trucks()[0]
    before = label_of(heavy)
    assert before.startswith("heavy:")
    file = heavy / "truck.toml"
    file.write_text(file.read_text().replace("30000", "29000"))
    assert label_of(heavy) != before


def test_trials_of_different_trucks_are_different_tasks(heavy):
    config = evaluate.Options(trials=1, methods="mobil", cells="dense-12.5")
    tasks = evaluate.evaluate.tasks_of(config)
    others = evaluate.evaluate.tasks_of(dataclasses.replace(config, truck=heavy))
    assert {task.truck for task in tasks} == {label_of(None)}
    assert {task.truck for task in others} == {label_of(heavy)}
    assert not set(tasks) & set(others)
