"""`iits-mj import-trajectories` at the command line."""

import pytest

from iits_mj.cli import main
from tests.traffic_bridge.datasets import synthetic_sets as sets
from traffic_bridge import Recording


def test_import_trajectories_writes_a_recording_and_reports_it(tmp_path, capsys):
    table = sets.write_ngsim(tmp_path / "table.csv")
    out, fcd = tmp_path / "deep" / "imported.npz", tmp_path / "imported.xml"
    words = ["import-trajectories", str(table), "--file", str(out), "--start-station", "2900"]
    words += ["--fcd", str(fcd)]
    assert main([*words, "--begin", "5", "--filter-noise"]) == 0
    assert "4 vehicles in 15.0 s" in capsys.readouterr().out
    assert len(Recording.load(out).ids) == 4
    assert fcd.read_text().count("<timestep") == 151
    assert main([*words, "--lanes", "1:0, 0:1"]) == 0
    assert set(Recording.load(out).lane.tolist()) == {0, 1}


@pytest.mark.parametrize(
    ("flags", "words"),
    [
        ((), "its lane 2 becomes lane 2"),
        (("--lanes", "a"), "--lanes 'a': must read as in 0:1,1:2"),
        (("--lanes", "0:1,0:2"), "each lane of the set once"),
        (("--begin", "100"), "nothing is left; the set has times from 0 to 20 s"),
        (("--begin", "nan"), "is not a finite number"),
        (("--direction", "1"), "no option direction"),
        (("--units", "yd"), "use one of: ft, m"),
        (("--main-lanes", "0"), "1 to 30"),
        (("--start-station", "1e9"), "is not allowed"),
        (("--map", "/nowhere.xodr"), "/nowhere.xodr"),
        (("--fcd", "."), "--fcd '.' is a folder; name a file"),
        (("--file", "/"), "recording /: cannot be written: / is a folder; name a file"),
        (("--file", "/proc/x.npz"), "--file '/proc/x.npz' cannot be written"),
    ],
)
def test_wrong_use_is_one_line_and_exit_code_2(tmp_path, capsys, flags, words):
    table, out = sets.write_ngsim(tmp_path / "table.csv"), tmp_path / "imported.npz"
    assert main(["import-trajectories", str(table), "--file", str(out), *flags]) == 2
    shown = capsys.readouterr().err
    assert words in shown
    assert shown.count("\n") == 1
    assert not out.exists()
