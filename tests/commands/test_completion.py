from __future__ import annotations

import os
import pty
import select
import shlex
import shutil
import subprocess
import time
from pathlib import Path

import pytest

from iits_mj.commands import COMMANDS, completion
from iits_mj.parameters import shipped_trucks


@pytest.fixture(scope="module")
def scripts(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    folder = tmp_path_factory.mktemp("completion")
    paths = {shell: folder / f"script.{shell}" for shell in completion.SHELLS}
    for shell, path in paths.items():
        path.write_text(completion.script(shell))
    return paths


def run(shell: str, *words: str, folder: Path | None = None) -> str:
    if shutil.which(shell) is None:
        pytest.skip(f"{shell} is not installed")
    done = subprocess.run(
        [shell, *words], capture_output=True, text=True, timeout=60, cwd=folder, check=False
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.mark.parametrize("shell", completion.SHELLS)
def test_the_shell_accepts_the_script(shell: str, scripts: dict[str, Path]) -> None:
    run(shell, "-n", str(scripts[shell]))


def complete(scripts: dict[str, Path], shell: str, line: str, folder: Path) -> set[str]:
    """The words that a shell offers for the last one of a command line."""
    if shell == "fish":
        text = f"source {scripts[shell]}; complete --do-complete {shlex.quote(line)}"
        found = run("fish", "-c", text, folder=folder).splitlines()
        return {row.split("\t")[0] for row in found}
    words = [*shlex.split(line), *([""] if line.endswith(" ") else [])]
    text = f"""source {scripts[shell]}
    COMP_WORDS=({shlex.join(words)}); COMP_CWORD={len(words) - 1}; COMP_LINE={shlex.quote(line)}
    COMP_POINT=${{#COMP_LINE}}
    function=$(complete -p iits-mj | sed 's/.*-F \\([^ ]*\\).*/\\1/')
    $function iits-mj {shlex.quote(words[-1])} {shlex.quote(words[-2])}
    printf '%s\\n' "${{COMPREPLY[@]}}" """
    return set(run("bash", "-c", text, folder=folder).split())


def typed_in_zsh(script: Path, line: str, folder: Path) -> str:
    """The command line after Tab at its end, in a zsh on a terminal."""
    if shutil.which("zsh") is None:
        pytest.skip("zsh is not installed")
    shutil.copy(script, folder / "_iits-mj")
    # The widget replaces Enter: it prints the line instead of running it.
    (folder / ".zshrc").write_text(
        "PS1=; unsetopt zle_bracketed_paste; fpath=($PWD $fpath)\n"
        "autoload -Uz compinit; compinit -Du\n"
        "show() { print -r -- \"<$BUFFER>\"; exit }; zle -N show; bindkey '^M' show '^J' show\n"
        "print ready\n"
    )
    ours, theirs = pty.openpty()
    environment = {**os.environ, "ZDOTDIR": str(folder), "TERM": "dumb"}
    shell = subprocess.Popen(
        ["zsh", "-i"], cwd=folder, env=environment, stdin=theirs, stdout=theirs, stderr=theirs,
        start_new_session=True,
    )  # fmt: skip
    os.close(theirs)
    seen, deadline = b"", time.monotonic() + 60.0

    def until(sign: bytes) -> None:
        nonlocal seen
        while sign not in seen:
            assert time.monotonic() < deadline, seen
            if select.select([ours], [], [], 1.0)[0]:
                seen += os.read(ours, 4096)

    try:
        until(b"ready")
        os.write(ours, f"{line}\t\r".encode())
        until(b">")
    finally:
        shell.kill()
        shell.wait()
        os.close(ours)
    return seen.rpartition(b"<")[2].partition(b">")[0].decode().strip()


@pytest.mark.parametrize(
    ("line", "whole"),
    [
        ("iits-mj do", "iits-mj doctor"),
        ("iits-mj drive --densi", "iits-mj drive --density"),
        ("iits-mj drive --density spa", "iits-mj drive --density sparse"),
        ("iits-mj drive --truck a_", "iits-mj drive --truck a_double"),
        ("iits-mj validate long", "iits-mj validate longitudinal"),
        ("iits-mj drive --map my", "iits-mj drive --map my.xodr"),
    ],
)
def test_tab_in_zsh_completes_the_line(
    line: str, whole: str, scripts: dict[str, Path], tmp_path: Path
) -> None:
    (tmp_path / "my.xodr").write_text("")
    assert typed_in_zsh(scripts["zsh"], line, tmp_path) == whole


@pytest.mark.parametrize("shell", ["bash", "fish"])
@pytest.mark.parametrize(
    ("line", "offered"),
    [
        ("iits-mj do", {"doctor"}),
        ("iits-mj help dri", {"drive"}),
        ("iits-mj drive --densi", {"--density"}),
        ("iits-mj drive --density ", {"dense", "medium", "sparse", "empty", *"ABCDEF"}),
        ("iits-mj drive --quiet --seed 3 --decision look", {"lookahead"}),
        ("iits-mj drive --truck a_", {"a_double"}),
        ("iits-mj validate long", {"longitudinal"}),
        ("iits-mj truck sh", {"show"}),
        ("iits-mj truck check a_", {"a_double"}),
        ("iits-mj completion fi", {"fish"}),
        ("iits-mj drive --camera cha", {"chase"}),
        ("iits-mj view --web --env iits_mj/Do", {"iits_mj/Dock-v0"}),
        ("iits-mj drive --map my", {"my.xodr"}),
        ("iits-mj drive --config my", {"my.xodr"}),
    ],
)
def test_the_last_word_is_completed(
    shell: str, line: str, offered: set[str], scripts: dict[str, Path], tmp_path: Path
) -> None:
    (tmp_path / "my.xodr").write_text("")
    assert complete(scripts, shell, line, tmp_path) == offered


def test_zsh_loads_the_script_and_it_knows_every_command_and_the_trucks(
    scripts: dict[str, Path], tmp_path: Path
) -> None:
    text = scripts["zsh"].read_text()
    assert all(f"\n    {name}:'" in text for name in COMMANDS)
    assert " ".join(shipped_trucks()) in text
    shutil.copy(scripts["zsh"], tmp_path / "_iits-mj")
    code = "fpath=($PWD $fpath); autoload -Uz compinit; compinit -Du; print $_comps[iits-mj]"
    assert run("zsh", "-fc", code, folder=tmp_path) == "_iits-mj\n"
