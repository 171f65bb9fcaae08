"""The tutorial for an own truck works as printed."""

import re

import pytest

from iits_mj import cli
from iits_mj.parameters import TruckParameters
from tests.paths import ROOT

PAGE = (ROOT / "docs" / "tutorials" / "own_truck.md").read_text(encoding="utf-8")
FILES = (
    *("my_truck/full_load.csv", "my_truck/gears.csv", "my_truck/truck.toml"),
    "geared/truck.toml",
)
DRIVES = ("drive", "drive", "compare")
# A short drive without pictures stands for the video.
SHORT = ["--duration", "1", "--no-video", "--traffic-mode", "none"]


def test_files_and_commands_of_the_page_work(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    for folder in ("my_truck", "geared"):
        (tmp_path / folder).mkdir()
    texts = re.findall(r"```(?:csv|toml)\n(.*?)```", PAGE, re.DOTALL)
    for name, text in zip(FILES, texts, strict=True):
        assert f"`{name}`" in PAGE
        (tmp_path / name).write_text(text, encoding="utf-8")
    lines = "\n".join(re.findall(r"```console\n(.*?)```", PAGE, re.DOTALL)).split("\n")
    commands = [line.split(">")[0].split()[1:] for line in lines if line.startswith("iits-mj ")]
    assert [words[0] for words in commands] == [*["truck"] * 4, "drive", "truck", *DRIVES]
    for words in commands:
        capsys.readouterr()
        if words[0] == "drive":
            place = words.index("--duration")
            words = words[:place] + words[place + 2 :] + SHORT
        assert cli.main(words) == 0, capsys.readouterr().err
    assert (tmp_path / "my_truck.html").is_file()
    assert (tmp_path / "driven" / "report.html").is_file()
    examples = re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL)
    capsys.readouterr()
    for example in examples:
        exec(compile(example, "own_truck.md", "exec"), {})
    assert float(capsys.readouterr().out.split()[0]) > 30.0
    truck = TruckParameters.load("my_truck")
    assert truck.engine.full_load_power == pytest.approx(360e3, rel=0.002)
    assert truck.gross_mass(truck.payload_max) == 40_000.0
    assert TruckParameters.load("geared").gearbox.final_drive == 3.08
