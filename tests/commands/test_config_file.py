from __future__ import annotations

import tomllib
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType

import pytest

from iits_mj import cli
from iits_mj.commands import COMMANDS, arguments, drive, evaluate, identify, record
from iits_mj.commands.config_file import rules_of, save_config, with_paths
from iits_mj.core import options
from iits_mj.core.errors import InputError
from iits_mj.core.options import option

COMMANDS_HERE = ("example", "other-example")


@dataclass(frozen=True, kw_only=True)
class Example:
    file: Path = option(help="a file", positional=True)
    parts: tuple[str, ...] = option((), help="words", positional=True)
    truck: str | Path | None = option(None, help="a name or file", names=lambda: ("long", "short"))
    start_speed: float = option(10.0, help="a speed", unit="m/s", low=0.0, high=40.0)
    count: int = option(3, help="a count", low=1, group="run")
    kind: str = option("a", help="a kind", choices=("apple", "banana", "a"))
    there: bool = option(True, help="a switch", group="output")
    size: tuple[int, int] = option((64, 64), help="a size")
    log: Path | None = option(None, help="a log")
    given: frozenset[str] = options.given_names()


def read(tmp_path: Path, text: str, *words: str) -> tuple[Example, arguments.General]:
    path = tmp_path / "my.toml"
    path.write_text(text)
    return arguments.read(
        Example, ["--config", str(path), *words], "iits-mj example", "", COMMANDS_HERE
    )


def test_a_file_gives_every_kind_of_value(tmp_path: Path) -> None:
    text = """
    start-speed = 12
    count = 5
    kind = "banana"
    there = false
    size = [640, 480]
    parts = ["x", "y"]
    log = "logs/a.csv"
    truck = "short"
    file = "/data/x.csv"
    quiet = true
    """
    example, general = read(tmp_path, text)
    assert example == Example(
        file=Path("/data/x.csv"),
        parts=("x", "y"),
        truck="short",
        start_speed=12.0,
        count=5,
        kind="banana",
        there=False,
        size=(640, 480),
        log=tmp_path / "logs" / "a.csv",
    )
    assert isinstance(example.start_speed, float)
    assert example.given == set(rules_of(Example))
    assert general.quiet


def test_the_command_line_comes_before_the_table_and_the_table_before_all(tmp_path: Path) -> None:
    text = 'count = 1\nstart_speed = 1.0\nfile = "x"\n[example]\ncount = 2\n[other_example]\nz = 1'
    assert read(tmp_path, text)[0].count == 2
    example, _ = read(tmp_path, text, "--count", "7", "y.csv")
    assert (example.count, example.start_speed, example.file) == (7, 1.0, Path("y.csv"))


def test_a_truck_that_is_no_name_is_a_file_beside_the_configuration(tmp_path: Path) -> None:
    example, _ = read(tmp_path, 'file = "x"\ntruck = "mine/truck.toml"')
    assert example.truck == str(tmp_path / "mine" / "truck.toml")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("start_sped = 3", "start-sped is not an option of 'iits-mj example' (did you mean start-"),
        ("config = 'x'", "config is not an option"),
        ("given = ['x']", "given is not an option"),
        ("[exampel]\ncount = 3", "[exampel] is not a command (did you mean example?)"),
        ("start-speed = 1\nstart_speed = 2", "start-speed is there twice"),
        ("start_speed = '12'", "start-speed = '12' is not allowed; use a number, without quotes"),
        ("start_speed = 41", "start-speed 41 is not allowed; use 0 to 40 m/s"),
        ("start_speed = nan", "start-speed nan is not a finite number"),
        ("start_speed = true", "start-speed = True is not allowed; use a number"),
        ("count = 1.5", "count: '1.5' is not a whole number"),
        ("there = 1", "there = 1 is not allowed; use true or false"),
        ("kind = 'bananna'", "kind 'bananna' is not known (did you mean banana?)"),
        ("size = [640, 481]", "size: size '640x481' is not allowed"),
        ("size = 'large'", "size: size 'large' is not allowed"),
        ("log = 3", "log = 3 is not allowed; use text in quotes"),
        ("log = 2020-01-01", "log = datetime.date"),
        ("count = [1]", "count = [1] is not allowed"),
        ("example = 3", "example is not an option"),
        ("count 3", "it is not TOML"),
    ],
)
def test_a_wrong_file_is_refused_with_its_name_and_the_key(
    text: str, message: str, tmp_path: Path
) -> None:
    with pytest.raises(InputError) as error:
        read(tmp_path, text, "x.csv")
    assert "my.toml" in str(error.value)
    assert message in str(error.value)


def test_a_missing_file_is_refused_with_a_similar_name(tmp_path: Path) -> None:
    (tmp_path / "drive.toml").write_text("")
    with pytest.raises(InputError, match=r"did you mean drive\.toml"):
        arguments.read(Example, ["x", "--config", str(tmp_path / "drivee.toml")], "iits-mj e", "")


def test_saved_options_are_the_same_when_read_from_another_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    words = ("x.csv", 'a "b"\\', "ä\x7f", "--start-speed", "0.1", "--log", "out/a.csv")
    given = arguments.parse(Example, words, "iits-mj example", "")
    (tmp_path / "kept").mkdir()
    path = Path("kept/my.toml")
    save_config(path, "example", given)
    again = arguments.parse(Example, ("--config", str(path)), "iits-mj example", "")
    assert again == given
    assert again.given == given.given
    monkeypatch.chdir(tmp_path / "kept")
    moved = arguments.parse(Example, ("--config", "my.toml"), "iits-mj example", "")
    assert moved.log == Path("../out/a.csv")
    assert "# count = 3" in Path("my.toml").read_text()


def test_own_parts_of_a_file_lie_beside_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    folder = tmp_path / "configs"
    folder.mkdir()
    (folder / "my.py").write_text(
        "class Keep:\n"
        "    def __init__(self, gain=1.0): pass\n"
        "    def decide(self, context): return None\n"
        "    def reset(self): pass\n"
    )
    path = folder / "drive.toml"
    path.write_text('decision = "my.py:Keep:gain=2.0"\ncamera = "chase"\n')
    words = ("--config", "configs/drive.toml")
    given = arguments.parse(drive.Options, words, "iits-mj drive", "")
    assert given.decision == "configs/my.py:Keep:gain=2.0"
    # A saved file leads to the same part, wherever it lies.
    saved = tmp_path / "kept" / "deep" / "drive.toml"
    saved.parent.mkdir(parents=True)
    save_config(saved, "drive", given)
    assert 'decision = "../../configs/my.py:Keep:gain=2.0"' in saved.read_text()
    again = arguments.parse(drive.Options, ("--config", str(saved)), "iits-mj drive", "")
    assert again.decision == str(folder / "my.py") + ":Keep:gain=2.0"
    path.write_text('decision = "other.py:Keep"\n')
    with pytest.raises(InputError, match=r"file 'configs/other\.py' cannot be read"):
        arguments.parse(drive.Options, words, "iits-mj drive", "")


@pytest.mark.parametrize(
    ("command", "key", "text", "expected"),
    [
        (evaluate, "methods", "mobil,my.py:A,ddqn", "mobil,<my.py>:A,ddqn"),
        (evaluate, "methods", "a.py:A:x=1,b/b.py:B", "<a.py>:A:x=1,<b/b.py>:B"),
        (evaluate, "methods", "package.module:B", "package.module:B"),
        (identify, "grade", "road.csv", "<road.csv>"),
        (identify, "grade", "-0.02", "-0.02"),
        (identify, "grade", "1.e-2", "1.e-2"),
        (record, "map", "my.xodr", "<my.xodr>"),
        (drive, "truck", "vecto_40t", "vecto_40t"),
        (drive, "truck", "mine", "<mine>"),
    ],
)
def test_only_the_paths_in_a_value_are_moved(
    command: ModuleType, key: str, text: str, expected: str
) -> None:
    rule, kinds = rules_of(command.Options)[key]
    assert with_paths(text, rule, kinds, lambda path: f"<{path}>") == expected


def test_a_file_of_the_user_is_not_overwritten(tmp_path: Path) -> None:
    path, example = tmp_path / "my.toml", Example(file=Path("x"))
    save_config(path, "example", example)
    save_config(path, "example", example)
    path.write_text("# mine\n")
    with pytest.raises(InputError, match="was not written by iits-mj"):
        save_config(path, "example", example)
    assert path.read_text() == "# mine\n"


def test_the_saved_options_of_a_drive_are_complete_and_those_of_the_demo_are_the_demo(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    path = Path("drive.toml")
    for words in ((), ("--duration", "120"), ("--seed", "3", "--no-video")):
        asked = arguments.parse(drive.Options, words, "iits-mj drive", "")
        final = drive.effective(asked)
        save_config(path, "drive", final)
        unset = {name for name in rules_of(drive.Options) if getattr(final, name) is None}
        assert set(tomllib.loads(path.read_text())["drive"]) | unset == set(rules_of(drive.Options))
        again = arguments.parse(drive.Options, ("--config", str(path)), "iits-mj drive", "")
        assert again == final
        # It is not taken for the demo, and stays what it is.
        assert drive.effective(again) == final


def test_a_saved_drive_drives_again_bit_for_bit(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    config = tmp_path / "configs" / "drive.toml"
    words = ("drive", "--no-video", "--duration", "2", "--speed", "14.7", "--seed", "5")
    assert cli.main([*words, "--out", str(tmp_path / "a"), "--save-config", str(config)]) == 0
    assert cli.main(["drive", "--config", str(config), "--out", str(tmp_path / "b")]) == 0
    first, second = ((tmp_path / out / "telemetry.csv").read_bytes() for out in "ab")
    assert first == second
    assert capsys.readouterr().err == ""


def test_an_error_of_the_whole_names_the_file(tmp_path: Path) -> None:
    path = tmp_path / "my.toml"
    path.write_text("[drive]\npayload = 36001.0\n")
    with pytest.raises(InputError, match=r"my\.toml"):
        arguments.read(drive.Options, ("--config", str(path)), "iits-mj drive", "", COMMANDS)
