"""Parts of the user's own: named in text, checked, made, and called behind a guard."""

from __future__ import annotations

import copy
import functools
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

import pytest

from iits_mj.core.errors import InputError, TrafficError
from iits_mj.core.own_parts import Guard, Kind, is_own, part_name, source_digest


@runtime_checkable
class Horn(Protocol):
    def reset(self) -> None: ...

    def blow(self, loudness: float, duration: float) -> float: ...


HORN = Kind("horn", Horn, ("soft", "loud"))


class HornGuard(Guard):
    kind = HORN


TEXT = """
import helper

class Brass:
    def __init__(self, route, pitch=440.0, tone="a"):
        self.route, self.pitch, self.tone = route, pitch, tone
    def reset(self): pass
    def blow(self, loudness, duration): return self.pitch

class Inner:
    class Tin(Brass): pass

ready = Brass("no road")
def make(route): return Brass(route, pitch=helper.PITCH)
class Reed:
    def reset(self): pass
    def blows(self, loudness, duration): return 1.0
class Short:
    def reset(self): pass
    def blow(self, loudness): return 1.0
"""


class Trumpet:
    def __init__(self, value: Any = 1.0) -> None:
        self.value = value

    def reset(self) -> None:
        pass

    def blow(self, loudness: float, duration: float) -> Any:
        if isinstance(self.value, Exception):
            raise self.value
        return self.value


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr(sys, "path", [*sys.path])
    monkeypatch.setattr(sys, "modules", {**sys.modules})
    monkeypatch.chdir(tmp_path)
    (tmp_path / "horns.py").write_text(TEXT, encoding="utf-8")
    (tmp_path / "helper.py").write_text("PITCH = 220.0", encoding="utf-8")
    return tmp_path


@pytest.mark.parametrize(
    ("text", "pitch"),
    [
        ("horns.py:Brass", 440.0),
        ("horns.py:Brass:pitch=3:tone=b flat", 3),
        ("./horns.py:Inner.Tin", 440.0),
        ("horns:Brass:pitch=2.5", 2.5),
        ("horns.py:make", 220.0),
        ("horns.py:ready", 440.0),
    ],
)
def test_text_leads_to_a_class_a_function_or_an_object(text: str, pitch: float) -> None:
    HORN.check(text)
    made = HORN.make(text, route="road", seed=3)
    assert made.pitch == pitch
    assert made.route == ("no road" if text.endswith("ready") else "road")


def test_shipped_names_are_not_the_users_own() -> None:
    HORN.check("soft")
    assert HORN.make("soft") is None
    assert not HORN.is_own("loud")
    assert HORN.is_own(Trumpet())


@pytest.mark.parametrize(
    ("text", "value"),
    [("true", True), ("0", 0), ("1e-3", 1e-3), ("[1, 2]", [1, 2]), ('"7"', "7"), ("a=b", "a=b")],
)
def test_options_are_read_as_in_toml(text: str, value: Any) -> None:
    assert HORN.make(f"horns.py:Brass:tone={text}", route=None).tone == value


@dataclass(frozen=True)
class Bell:
    size: float = 1.0
    tone: str = "c"

    def __post_init__(self) -> None:
        if self.size <= 0.0:
            raise InputError(f"size is {self.size}: a number above zero is needed")

    def blow(self, force: float) -> str:
        return f"{self.tone} {self.size:g}"


BELLS = Kind("bell", Horn, ("small", "fixed"), {"small": Bell}.get)


@pytest.mark.parametrize(
    "text", ["small:tone=d:size=2", "small:size=2,tone=d", "small:size=2.0:tone=d"]
)
def test_a_shipped_part_takes_options_and_has_one_normal_name(text: str) -> None:
    assert BELLS.make(text) == Bell(2.0, "d")
    assert BELLS.normal_name(text) == "small:size=2:tone=d"
    BELLS.check(text)


def test_the_normal_name_leaves_out_defaults_and_own_parts_as_they_are() -> None:
    assert BELLS.normal_name("small:size=1") == BELLS.normal_name("small") == "small"
    assert BELLS.normal_name("horns.py:Brass:pitch=2") == "horns.py:Brass:pitch=2"
    assert BELLS.make("small") is None


@pytest.mark.parametrize(
    ("value", "message"),
    [
        ("fixed:size=2", "^bell 'fixed:size=2': 'fixed' is a shipped one, without options$"),
        (
            "small:sise=2",
            r"bell small has no argument 'sise' \(did you mean size\?\); it has size, t",
        ),
        ("small:size=-1", "^bell 'small:size=-1': size is -1: a number above zero is needed$"),
        ("small:size=2:size=3", "^bell 'small:size=2:size=3': option 'size' is given twice$"),
        ("small:", "option '' must be KEY=VALUE"),
    ],
)
def test_options_that_a_shipped_part_cannot_use_are_refused(value: str, message: str) -> None:
    for use in (BELLS.check, BELLS.make, BELLS.normal_name):
        with pytest.raises(InputError, match=message):
            use(value)


@pytest.mark.parametrize(
    ("value", "message"),
    [
        (
            "sof",
            r"horn 'sof' is not known \(did you mean soft\?\); use one of: soft, loud; or",
        ),
        ("soft:pitch=2", "'soft' is a shipped one, without options"),
        ("horn.py:Brass", r"file 'horn.py' cannot be read: No such file .*mean horns.py\?"),
        ("horns.py:Bras", r"horns.py has no 'Bras' \(did you mean Brass\?\)"),
        ("horns.py:Inner.Tim", r"horns.py.Inner has no 'Tim' \(did you mean Tin\?\)"),
        ("horns.py:", "horns.py has no ''"),
        ("loudd:pitch=2", r"there is no module 'loudd' \(did you mean loud\?\)"),
        ("horn:Brass", r"there is no module 'horn' \(did you mean horns.py\?\)"),
        ("no.such:Brass", "there is no module 'no'"),
        ("a b:Brass", "'a b' is not the name of a module, nor a file that ends in .py"),
        ("horns.py:ready.pitch.nothing", "horns.py.ready has no .nothing."),
        ("horns\0.py:Brass", "is not the name of a file or module"),
        ("horns.py:Brass:pich=2", r"has no argument 'pich' \(did you mean pitch\?\); it has route"),
        ("horns.py:Brass:pitch", "option 'pitch' must be KEY=VALUE"),
        ("horns.py:ready:pitch=2", "is an object: it takes no options"),
        (
            "horns.py:Reed",
            r"horn horns.py:Reed lacks blow\(loudness, duration\) \(did you mean",
        ),
        ("horns.py:Short", r"Short: blow\(self, loudness\) must take \(loudness, duration\)"),
        (7, r"horn builtins:int lacks reset\(\) and blow\(loudness, duration\)"),
        (Horn, "lacks reset"),
    ],
)
def test_what_does_not_fit_is_refused_with_the_reason(value: Any, message: str) -> None:
    with pytest.raises(InputError, match=message):
        HORN.check(value)


@pytest.mark.parametrize(
    ("code", "message"),
    [
        ("class Brass(:", r"cannot be imported: SyntaxError: .*\(line 1\)"),
        ("\n1 / 0", r"cannot be imported: ZeroDivisionError: division by zero \(line 2\)"),
        ("import sys; sys.exit(3)", "cannot be imported: SystemExit: 3"),
        ("import no_such_library", "cannot be imported: ModuleNotFoundError: No module named"),
    ],
)
def test_a_file_that_cannot_be_imported_is_refused(folder: Path, code: str, message: str) -> None:
    (folder / "broken.py").write_text(code, encoding="utf-8")
    for place in ("broken.py", "broken"):
        with pytest.raises(InputError, match=f"horn '{place}:Brass': {place} {message}"):
            HORN.check(f"{place}:Brass")


def test_an_argument_that_nobody_offers_must_be_an_option() -> None:
    with pytest.raises(InputError, match=r"needs an argument 'route'.*Brass:route=VALUE; offered"):
        HORN.make("horns.py:Brass", seed=1)
    assert HORN.make("horns.py:Brass:route=here", seed=1).route == "here"


def test_a_changed_file_is_read_again(folder: Path) -> None:
    first = HORN.make("horns.py:make", route=1)
    assert type(HORN.make("horns.py:make", route=1)) is type(first)
    changed = TEXT.replace("helper.PITCH", "110.0")
    (folder / "horns.py").write_text(changed, encoding="utf-8")
    assert HORN.make("horns.py:make", route=1).pitch == 110.0
    assert not (folder / "__pycache__" / "horns.cpython.pyc").exists()


def test_the_name_of_an_object_is_the_text_that_leads_to_its_class(folder: Path) -> None:
    made = HORN.make("horns.py:Inner.Tin", route=1)
    assert part_name(made) == part_name(type(made)) == "horns.py:Inner.Tin"
    assert part_name(functools.partial(type(made), 1)) == "horns.py:Inner.Tin"
    assert part_name("horns.py:Brass:pitch=1") == "horns.py:Brass:pitch=1"
    assert part_name(Trumpet(1.0)) == f"{__name__}:Trumpet"
    HORN.check(part_name(made))


def test_the_digest_is_of_the_file_that_was_read(folder: Path) -> None:
    HORN.check("horns.py:Brass")
    before = source_digest("horns.py:Brass")
    assert source_digest(HORN.make("horns.py:ready")) == before
    (folder / "horns.py").write_text("Brass = 1", encoding="utf-8")
    assert source_digest("horns.py:Brass") == before
    assert len(before) == len(source_digest(Trumpet())) == 12
    assert source_digest("soft") == source_digest(7) == ""


def test_the_guard_names_part_method_and_line_of_a_fault() -> None:
    title = f"horn {__name__}:Trumpet"
    for value in (float("nan"), None, "loud", [1.0], True):
        with pytest.raises(InputError, match=f"{title}: blow returned .*, must return a finite"):
            HornGuard(Trumpet(value)).number("blow", 1.0, 2.0)
    with pytest.raises(InputError, match=r"blow failed: KeyError: 'x' \(test_own_parts.py, line"):
        HornGuard(Trumpet(KeyError("x"))).number("blow", 1.0, 2.0)
    with pytest.raises(TrafficError, match="SUMO"):
        HornGuard(Trumpet(TrafficError("SUMO"))).call("blow", 1.0, 2.0)
    with pytest.raises(InputError, match="object lacks reset"):
        HornGuard(object())


def test_a_guard_has_the_other_attributes_of_its_part_and_can_be_copied() -> None:
    guard = HornGuard(Trumpet(3.0))
    assert guard.value == 3.0
    assert copy.deepcopy(guard).number("blow", 1.0, 2.0) == 3.0
    assert is_own(guard.part)
    assert not is_own(HORN)
