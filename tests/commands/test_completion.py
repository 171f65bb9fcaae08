from __future__ import annotations

import shlex
import shutil
import subprocess
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
