"""Settings of sweeps: ranges, lists, samples, options of a drive, and what is refused."""

import re
from pathlib import Path

import numpy as np
import pytest

from iits_mj.core.errors import InputError
from iits_mj.evaluation.sweep.design import Sweep, SweepConfig, axes_of
from tests.paths import ROOT
from tests.traffic_bridge.scenario.test_openscenario import SCENARIO, written
from tests.traffic_bridge.scenario.test_parameters import DISTRIBUTION

CUT_IN = ROOT / "examples/cut_in.toml"


def sweep(*param, scenario=CUT_IN, **options):
    return Sweep.of(SweepConfig(scenario=scenario, param=param, **options))


def test_a_grid_has_all_combinations_and_the_last_parameter_changes_first():
    points = sweep("gap=5:60:12", "dv=-4,-2.5").grid()
    assert len(points) == 24
    assert points[:3] == [
        (("gap", "5"), ("dv", "-4")),
        (("gap", "5"), ("dv", "-2.5")),
        (("gap", "10"), ("dv", "-4")),
    ]
    assert points[-1] == (("gap", "60"), ("dv", "-2.5"))


def test_options_of_a_drive_are_swept_by_their_names():
    made = sweep("payload=0:20000:2", "gap=12", "start-lane=0,1", "commands=direct,j1939", seed=3)
    assert tuple(made.swept) == ("payload", "gap", "start_lane", "commands")
    drive = made.asked(made.grid()[-1])
    assert (drive.payload, drive.start_lane, drive.commands) == (20000.0, 1, "j1939")
    assert (drive.param, drive.events, drive.scenario) == (("gap=12",), CUT_IN, None)
    assert made.command(made.grid()[-1]) == (
        f"iits-mj drive --events {CUT_IN} --seed 3 --payload 20000 --param gap=12 --start-lane 1 "
        "--commands j1939"
    )


def test_a_sample_has_one_point_in_each_part_of_every_range():
    made = sweep("gap=10:50", "dv=-10:0", "start_lane=0,1", samples=40)
    points = made.sample(40, seed=1)
    gaps = np.sort([float(dict(p)["gap"]) for p in points])
    speeds = np.sort([float(dict(p)["dv"]) for p in points])
    assert np.all(np.floor(gaps - 10.0) == np.arange(40))
    assert np.all(np.floor((speeds + 10.0) * 4.0) == np.arange(40))
    assert sorted(dict(p)["start_lane"] for p in points) == ["0"] * 20 + ["1"] * 20
    assert points == made.sample(40, seed=1) != made.sample(40, seed=2)


def test_whole_numbers_are_sampled_as_such():
    points = sweep("seed=0:100", samples=20).sample(20, 0)
    assert all(text.isdecimal() for point in points for _, text in point)


@pytest.mark.parametrize(
    ("param", "words"),
    [
        ("gap=5:60:0", "0 values; use 2 to 10000"),
        ("gap=5:60:1", "1 values; use 2 to 10000"),
        ("gap=5:60:-3", "-3 values"),
        ("gap=5:60:2.5", "use LOW:HIGH:COUNT, LOW:HIGH or A,B,C"),
        ("gap=5:60:3:4", "use LOW:HIGH:COUNT, LOW:HIGH or A,B,C"),
        ("gap=60:5:3", "the lower end must be below the upper one"),
        ("gap=5:5:3", "the lower end must be below the upper one"),
        ("gap=nan:60:3", "use LOW:HIGH:COUNT"),
        ("gap=5:inf:3", "use LOW:HIGH:COUNT"),
        ("gap=5:wide:3", "use LOW:HIGH:COUNT"),
        ("gap=5,5", "a value is empty or there twice"),
        ("gap=5,,6", "a value is empty or there twice"),
        ("gap=nan", "gap = 'nan' is not a finite number"),
        ("gap=5,x", "gap = 'x' is not a finite number"),
        ("gap=0.5:20:3", "gap = 0.5 m: allowed is >= 1.0 and <= 200.0 m"),
        ("gap=5:60", "param gap=5:60: a grid needs a number of values: gap=5:60:12"),
        ("gop=5:60:3", "neither a parameter of the scenario nor an option (did you mean gap?); it"),
        ("payload=a,b", "payload = 'a' is not a finite number"),
        ("payload=nan,1", "payload = 'nan' is not a finite number"),
        ("seed=0:1:3", "seed = '0.5' is not a whole number"),
        ("commands=radio,direct", "commands 'radio' is not known"),
        ("start-speed=10:50:3", "start-speed 50 is not allowed; use 0 to 30 m/s"),
        ("reactive=yes,no", "reactive = 'yes' is not true or false"),
        ("events=a,b", "param events: --events is given, too"),
        ("scenario=a,b", "param scenario: neither a parameter"),
    ],
)
def test_a_wrong_value_is_refused_before_any_drive(param, words):
    with pytest.raises(InputError, match=re.escape(words)):
        sweep(param)


def test_a_sweep_of_nothing_twice_the_same_or_too_much_is_refused():
    with pytest.raises(InputError, match=r"nothing is swept: .* has gap, dv, deceleration"):
        sweep()
    with pytest.raises(InputError, match="param gap is given twice"):
        sweep("gap=5:60:3", "gap=1,2")
    with pytest.raises(InputError, match="the grid has 1000000 points: at most 100000"):
        sweep("gap=5:60:1000", "dv=-5:1:1000").grid()
    with pytest.raises(InputError, match="samples and adaptive are two designs"):
        sweep("gap=5:60", samples=3, adaptive=30)
    with pytest.raises(InputError, match="param payload: --payload is given, too"):
        sweep("payload=0,1", payload=5.0, given=frozenset({"payload"}))
    with pytest.raises(InputError, match=r"cannot be read: No such file.*did you mean cut_in.toml"):
        sweep("gap=1,2", scenario=ROOT / "examples/cutin.toml")


def test_adaptive_needs_ranges_of_real_numbers():
    for param in ("gap=5,6,7", "seed=0:100"):
        with pytest.raises(InputError, match="adaptive needs a range of real numbers"):
            sweep(param, adaptive=30).continuous()
    with pytest.raises(InputError, match="adaptive needs a range"):
        sweep("gap=5", adaptive=30).continuous()
    axes = sweep("gap=5:60:7", "dv=-5:1", "start_lane=0", adaptive=30).continuous()
    assert [(axis.name, len(axis.values)) for axis in axes] == [("gap", 7), ("dv", 0)]


def test_a_value_that_is_a_file_with_a_class_is_no_range():
    (axis,) = axes_of(["decision=examples/own_decision.py:Impatient:room=30,keep"])
    assert axis.values == ("examples/own_decision.py:Impatient:room=30", "keep")


def test_a_parameter_hides_an_option_of_the_same_name(tmp_path):
    path = tmp_path / "e.toml"
    path.write_text(
        '[parameters]\nspeed = 3.0\n[[events]]\nevent = "place_vehicle"\nname = "a"\ngap = 9.0\n'
        'speed = "$speed"\n'
    )
    made = sweep("speed=0:60:2", scenario=path)
    drive = made.asked(made.grid()[-1])
    assert (drive.param, drive.speed) == (("speed=60",), 60.0 / 3.6)


def test_an_openscenario_file_is_swept_by_its_declarations_and_its_distribution(tmp_path):
    path = written(tmp_path, SCENARIO)
    made = sweep("V=10:30:3", scenario=path)
    assert made.asked(made.grid()[1]).param == ("V=20",)
    text = DISTRIBUTION.replace("a.xosc", path.name)
    values = tmp_path / "values.xosc"
    values.write_text(
        re.sub("<DeterministicMulti.*</DeterministicMulti[^>]*>", "", text, flags=re.S)
    )
    made = sweep("payload=0,1000", scenario=values)
    assert tuple(made.swept) == ("V", "W", "payload")
    assert len(made.grid()) == 7 * 2 * 2
    assert made.base.scenario == path
    with pytest.raises(InputError, match=r"param V: .* has its values"):
        sweep("V=1,2", scenario=values)
    with pytest.raises(InputError, match="names its points: give no other design"):
        sweep(scenario=values, samples=4)
    values.write_text(text)
    with pytest.raises(InputError, match="param A: neither a parameter of the scenario nor"):
        sweep(scenario=values)


def test_the_identity_names_files_by_content_and_leaves_swept_options_out(tmp_path):
    path = tmp_path / "e.toml"
    path.write_text(CUT_IN.read_text())
    first = sweep("gap=5:60:3", "payload=0,1", scenario=path).identity()
    assert "payload" not in first
    assert first["events"].startswith("e.toml, SHA-256 ")
    assert first == sweep("gap=5:60:9", "payload=0,1", scenario=path).identity()
    assert first != sweep("gap=5:60:3", scenario=path, payload=5.0).identity()
    path.write_text(path.read_text() + "\n")
    changed = sweep("gap=5:60:3", "payload=0,1", scenario=path).identity()
    assert {name for name in first if first[name] != changed[name]} == {"events"}


def test_the_scenario_is_the_only_file_of_events():
    with pytest.raises(InputError, match="is a file of events: leave --events out"):
        sweep("gap=1,2", events=Path("a.toml"))
