from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from iits_mj.commands import arguments
from iits_mj.core import options
from iits_mj.core.errors import InputError
from iits_mj.core.options import option


@dataclass(frozen=True, kw_only=True)
class Example:
    file: Path = option(help="a file", positional=True)
    speed: float = option(10.0, help="a speed", unit="m/s", low=0.0, high=40.0)
    count: int = option(3, help="a count", low=1)
    name: str = option("a", help="a name", choices=("a", "b"))
    there: bool = option(True, help="a switch")
    size: tuple[int, int] = option((64, 64), help="a size")
    log: Path | None = option(None, help="a log")

    def __post_init__(self) -> None:
        options.check(self)


def parse(*words: str) -> Example:
    return arguments.parse(Example, words, "example", "An example.")


def test_defaults_come_from_the_dataclass() -> None:
    assert parse("x.csv") == Example(file=Path("x.csv"))


def test_every_kind_of_value_is_parsed() -> None:
    parsed = parse(
        *("x.csv", "--speed", "2e1", "--count", "7", "--name", "b", "--no-there"),
        *("--size", "640x480", "--log", "out/log"),
    )
    assert parsed == Example(
        file=Path("x.csv"),
        speed=20.0,
        count=7,
        name="b",
        there=False,
        size=(640, 480),
        log=Path("out/log"),
    )


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ((), "required: FILE"),
        (("x", "--speed", "fast"), "--speed: 'fast' is not a number"),
        (("x", "--speed", "nan"), "nan is not a finite number"),
        (("x", "--speed", "inf"), "inf is not a finite number"),
        (("x", "--speed", "-1"), "--speed -1 is not allowed; use 0 to 40 m/s"),
        (("x", "--speed", "41"), "use 0 to 40 m/s"),
        (("x", "--speed"), "--speed"),
        (("x", "--count", "1.5"), "'1.5' is not a whole number"),
        (("x", "--count", "0"), "use 1 or more"),
        (("x", "--name", "c"), "use one of: a, b"),
        (("x", "--nam", "a"), "unrecognized arguments"),
        (("x", "y"), "unrecognized arguments: y"),
        (("x", "--size", "0x0"), "size '0x0'"),
        (("x", "--size", "640"), "WIDTHxHEIGHT"),
        (("x", "--size", "641x480"), "even"),
        (("x", "--size", "99999999x2"), "even numbers from"),
        (("x", "--size", "-64x64"), "size"),
    ],
)
def test_wrong_use_is_reported_in_one_sentence(words: tuple[str, ...], message: str) -> None:
    with pytest.raises(InputError) as error:
        parse(*words)
    assert message in str(error.value)
    assert "\n" not in str(error.value)


def test_python_callers_get_the_same_bounds() -> None:
    with pytest.raises(InputError, match="speed 50 is not allowed"):
        Example(file=Path("x"), speed=50.0)
    with pytest.raises(InputError, match="name 'z'"):
        dataclasses.replace(Example(file=Path("x")), name="z")


def test_help_names_unit_bounds_choices_and_default() -> None:
    text = " ".join(arguments.build_parser(Example, "example", "").format_help().split())
    assert "a speed; 0 to 40 m/s; default 10" in text
    assert "one of a, b; default a" in text
    assert "--there, --no-there" in text


@dataclass(frozen=True, kw_only=True)
class Asked(Example):
    given: frozenset[str] = options.given_names()


def test_an_option_given_with_its_default_value_is_known_as_given() -> None:
    asked = arguments.parse(Asked, ("x", "--speed", "10", "--there"), "example", "")
    assert asked.given == {"file", "speed", "there"}
    assert Asked(file=Path("x")).given == frozenset()


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"speed": "fast"}, "speed 'fast' is not a number"),
        ({"speed": True}, "speed True is not a number"),
        ({"speed": None}, "speed None is not a number"),
        ({"count": 1.5}, "count 1.5 is not a whole number"),
        ({"there": 1}, "there 1 is not on or off"),
        ({"name": 3}, "name 3 is not text"),
    ],
)
def test_a_python_value_of_another_kind_is_refused(values: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError, match=message):
        Example(file=Path("x"), **values)


def test_words_of_a_command_line_give_the_options_again() -> None:
    given = [
        "road.xodr",
        "--speed",
        "22.500000000000004",
        "--no-there",
        "--size",
        "128x64",
        "--log",
        "a b.csv",
    ]
    example = arguments.parse(Example, given, "iits-mj", "")
    assert options.words(example) == given
    assert options.words(Example(file=Path("x"))) == ["x"]
    asked = arguments.parse(Asked, ["x", "--speed", "10"], "iits-mj", "")
    assert options.words(asked) == ["x", "--speed", "10"]


def test_a_python_caller_may_give_a_file_as_text() -> None:
    given: Any = "x.csv"
    assert Example(file=given, log=given) == Example(file=Path("x.csv"), log=Path("x.csv"))
    for wrong in (3, "", b"x"):
        with pytest.raises(InputError, match=r"log .* is not a file or folder"):
            Example(file=Path("x.csv"), log=wrong)  # type: ignore[arg-type]
