from __future__ import annotations

import importlib
import json
from pathlib import Path

import pytest

import iits_mj
from iits_mj import cli
from iits_mj.commands import arguments, doctor
from iits_mj.commands.config_file import rules_of
from iits_mj.core.options import GROUPS

BOMB = """<?xml version="1.0"?>
<!DOCTYPE OpenDRIVE [<!ENTITY a "aaaaaaaaaa"><!ENTITY b "&a;&a;&a;&a;&a;&a;&a;&a;&a;&a;">
<!ENTITY c "&b;&b;&b;&b;&b;&b;&b;&b;&b;&b;"><!ENTITY d "&c;&c;&c;&c;&c;&c;&c;&c;&c;&c;">]>
<OpenDRIVE><road name="&d;"/></OpenDRIVE>
"""
MAPS = {
    "empty": b"",
    "binary": bytes(range(256)) * 40,
    "cut off": b"<OpenDRIVE><road id='1' length='100'>",
    "bomb": BOMB.encode(),
    "another language": b"<svg xmlns='http://www.w3.org/2000/svg'><path d='M0 0'/></svg>",
    "no roads": b"<OpenDRIVE><header revMajor='1' revMinor='6'/></OpenDRIVE>",
    "nan": b"<OpenDRIVE><header revMajor='1' revMinor='6'/><road id='1' length='nan' junction='-1'>"
    b"<planView><geometry s='0' x='0' y='0' hdg='0' length='nan'><line/></geometry></planView>"
    b"</road></OpenDRIVE>",
}


def fails(capsys: pytest.CaptureFixture[str], *words: str, code: int = 2) -> str:
    """Runs a command line that must fail; returns its one line of error."""
    assert cli.main(list(words)) == code
    captured = capsys.readouterr()
    lines = captured.err.strip().splitlines()
    assert len(lines) == 1, captured.err
    assert lines[0].startswith("iits-mj: ")
    assert "Traceback" not in captured.err
    assert captured.out == ""
    return lines[0]


def test_version_is_that_of_the_package(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["--version"]) == 0
    assert capsys.readouterr().out == f"iits-mj {iits_mj.__version__}\n"


def test_help_names_every_command(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["--help"]) == 0
    shown = capsys.readouterr().out
    assert all(f"  {name} " in shown for name in cli.COMMANDS)
    assert "\x1b" not in shown


def test_no_words_show_the_help_as_wrong_use(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main([]) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err == cli.usage() + "\n"


def test_help_of_a_command_is_that_of_its_flag(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["help", "record"]) == 0
    shown = capsys.readouterr().out
    assert cli.main(["record", "--help"]) == 0
    assert capsys.readouterr().out == shown
    assert "did you mean drive" in fails(capsys, "help", "drvie")


def test_help_groups_options_by_subject(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["drive", "--help"]) == 0
    sections = {
        part.splitlines()[0]: part for part in capsys.readouterr().out.split("\n\n") if part
    }
    for title, flag in (
        ("truck:", "--payload KG"),
        ("road and start:", "--map FILE.xodr"),
        ("traffic:", "--density NAME"),
        ("decisions and speed:", "--decision NAME"),
        ("run:", "--seed N"),
        ("output:", "--out DIR"),
        ("configuration and messages:", "--config FILE.toml"),
    ):
        assert f"  {flag}" in sections[title]
    assert "other options:" not in sections


@pytest.mark.parametrize("command", cli.COMMANDS)
def test_every_option_has_a_known_subject(command: str) -> None:
    module = importlib.import_module(f"iits_mj.commands.{command.replace('-', '_')}")
    rules = {name: rule for name, (rule, _) in rules_of(module.Options).items()}
    general = set(rules_of(arguments.General))
    assert not general & set(rules)
    assert all(rule.positional or rule.group in GROUPS for rule in rules.values())


@pytest.mark.parametrize("command", cli.COMMANDS)
def test_every_command_explains_its_flags(command: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main([command, "--help"]) == 0
    shown = capsys.readouterr().out
    assert f"usage: iits-mj {command}" in shown
    assert "--" in shown


@pytest.mark.parametrize(
    ("words", "reported"),
    [
        (("fly",), "command 'fly' is not known; use one of: drive"),
        (("drvie",), "(did you mean drive?)"),
        (("drive", "--warp", "9"), "unrecognized arguments: --warp 9"),
        (("drive", "--densty=dense"), "(did you mean --density?)"),
        (("drive", "--no-vidio"), "(did you mean --no-video?)"),
        (("drive", "--density", "Dence"), "(did you mean dense?)"),
        (("drive", "--truck", "a_doubel"), "(did you mean a_double?)"),
        (("drive", "--decision", "lokahead"), "(did you mean lookahead?)"),
        (("drive", "--camera", "chase,tpo"), "(did you mean top?)"),
        (("view", "--web", "--env", "iits_mj/Dok-v0"), "(did you mean iits_mj/Dock-v0?)"),
        (("evaluate", "--methods", "ddqn,neutrl"), "(did you mean neutral?)"),
        (("completion", "fsh"), "(did you mean fish?)"),
        (("drive", "--config", "/nowhere.toml"), "/nowhere.toml"),
        (("drive", "--config"), "argument --config: expected one argument"),
        (("drive", "--save-config", "/"), "is a folder"),
        (("drive", "--payload"), "--payload"),
        (("drive", "--payload", "heavy"), "'heavy' is not a number"),
        (("drive", "--payload", "nan"), "nan is not a finite number"),
        (("drive", "--payload", "36001"), "allowed is 0 to 36000 kg"),
        (("drive", "--payload", "-1"), "use 0 kg or more"),
        (("drive", "--payload-height", "5"), "payload_height = 5.0 m: allowed is 1.3 to 3 m"),
        (("drive", "--density", "jammed"), "use one of: dense, medium, sparse"),
        (("drive", "--decision", "oracle"), "use one of: keep"),
        (("drive", "--camera", "moon"), "use one of: chase"),
        (("drive", "--duration", "0"), "duration 0 is not allowed"),
        (("drive", "--duration", "inf"), "not a finite number"),
        (("drive", "--seed", "-1"), "seed -1 is not allowed"),
        (("drive", "--seed", "1.5"), "not a whole number"),
        (("drive", "--size", "10x10"), "size '10x10'"),
        (("drive", "--size", "1e9x3"), "size '1e9x3'"),
        (("drive", "--traffic-speed", "1e99"), "use 3 to 40 m/s"),
        (("drive", "--map", "/nowhere/road.xodr"), "/nowhere/road.xodr"),
        (("drive", "--map", "/"), "/: is not a regular file"),
        (("replay",), "required: FILE.npz"),
        (("replay", "/nowhere.npz"), "/nowhere.npz"),
        (("identify", "/nowhere.csv"), "/nowhere.csv"),
        (("validate", "everything"), "use one of: all"),
        (("bench", "--threads", "0"), "use 1 to 256"),
    ],
)
def test_wrong_use_is_one_line_and_exit_code_2(
    words: tuple[str, ...],
    reported: str,
    capsys: pytest.CaptureFixture[str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    assert reported in fails(capsys, *words)


@pytest.mark.parametrize("kind", MAPS)
def test_unusable_map_is_one_line_and_exit_code_2(
    kind: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "road.xodr"
    path.write_bytes(MAPS[kind])
    out = tmp_path / "out"
    assert "road.xodr" in fails(capsys, "drive", "--map", str(path), "--out", str(out))
    assert list(out.iterdir()) == []


def test_huge_map_is_refused_before_it_fills_the_memory(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "huge.xodr"
    with path.open("wb") as file:
        file.truncate(3_000_000_000)
    assert "huge.xodr" in fails(capsys, "drive", "--map", str(path), "--out", str(tmp_path / "out"))


@pytest.mark.parametrize("command", ["drive", "record"])
def test_unwritable_output_is_refused_before_driving(
    command: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(
        "iits_mj.simulation.Simulation.__init__", lambda *_, **__: pytest.fail("it was driven")
    )
    blocker = tmp_path / "file"
    blocker.write_text("mine")
    place = blocker / "out"
    words = {"drive": ["--out", str(place)], "record": [str(place / "traffic.npz")]}
    assert "cannot be written" in fails(capsys, command, *words[command])
    assert blocker.read_text() == "mine"


def test_unwritable_report_is_refused_before_measuring(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "file").write_text("")
    reported = fails(capsys, "bench", "--report", str(tmp_path / "file" / "x"))
    assert "--report" in reported
    assert "cannot be written" in reported


def test_view_without_a_display_says_so(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    assert "no display" in fails(capsys, "view")


def test_fault_of_the_program_is_one_line_and_exit_code_70(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(doctor, "run", lambda options: 1 / 0)
    assert "ZeroDivisionError" in fails(capsys, "doctor", code=cli.EXIT_FAULT)


def test_interrupt_is_exit_code_130(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupt(options: object) -> int:
        raise KeyboardInterrupt

    monkeypatch.setattr(doctor, "run", interrupt)
    fails(capsys, "doctor", code=130)


def test_doctor_exits_1_and_names_a_remedy_when_something_needed_is_missing(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    well = doctor.Finding("this", True, "1.0")
    optional = doctor.Finding("that", False, "none", "install that", needed=False)
    needed = doctor.Finding("it", False, "gone", "install it")
    monkeypatch.setattr(doctor, "PROBES", (lambda: well, lambda: optional))
    assert cli.main(["doctor"]) == 0
    monkeypatch.setattr(doctor, "PROBES", (lambda: well, lambda: needed))
    capsys.readouterr()
    assert cli.main(["doctor"]) == 1
    assert "remedy: install it" in capsys.readouterr().out


def test_doctor_accepts_this_installation(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["doctor", "--json"]) == 0
    report = json.loads(capsys.readouterr().out)
    assert report["ok"] is True
    assert {"engine plugin", "SUMO (libsumo)", "netconvert", "OpenGL"} <= {
        finding["name"] for finding in report["findings"]
    }


@pytest.mark.parametrize("words", [(), ("pc" + "." * 2000 + "c",), ("drive", "--seed", "x")])
def test_a_wrong_command_line_is_not_understood(words: tuple[str, ...]) -> None:
    assert not cli.understood(words)
    assert cli.understood(("drive", "--seed", "3"))
