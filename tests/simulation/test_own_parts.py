"""Drives with parts of the user's own: given as text, class or object; recorded and repeated."""

from __future__ import annotations

import dataclasses
import importlib
import json
import math
import pickle
import sys
from pathlib import Path
from typing import Any

import pytest

from controllers.own_parts import PlannerGuard
from iits_mj import cli
from iits_mj.core import options
from iits_mj.core.errors import InputError
from iits_mj.core.messages import Decision
from iits_mj.simulation import DriveConfig, Simulation
from iits_mj.simulation.config import PARTS
from iits_mj.simulation.drive_log import stored_options
from iits_mj.simulation.redrive import redrive
from tests.paths import ROOT
from traffic_bridge import InterSim, OwnTraffic, Recording

# Option, file and name of the example, and an option of its constructor.
EXAMPLES = [
    ("decision", "own_decision", "Impatient", "room"),
    ("planner", "own_planner", "RightLane", "gap"),
    ("lateral", "own_lateral", "Stanley", "gain"),
    ("longitudinal", "own_longitudinal", "Proportional", "gain"),
    ("speed_planner", "own_speed", "Hills", "slower"),
    ("traffic_mode", "own_traffic", "Wave", "swing"),
]
ALONE: dict[str, Any] = {
    "traffic_mode": "none",
    "decision": "keep",
    "speed_planner": "cruise",
    "duration": 2.0,
}


@pytest.fixture(autouse=True)
def folder(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(ROOT)
    monkeypatch.setattr(sys, "path", [*sys.path, str(ROOT / "examples")])


def end_of(config: DriveConfig) -> Any:
    """State of the truck at the end of a drive that is done twice."""
    with Simulation(config, visuals=False) as drive:
        drive.run()
        first = drive.frame.ego
        drive.reset()
        drive.run()
        assert drive.frame.ego == first
        return first


def test_there_is_an_example_of_every_part() -> None:
    assert [option for option, *_ in EXAMPLES] == list(PARTS)


@pytest.mark.parametrize(("option", "file", "name", "_argument"), EXAMPLES)
def test_text_class_and_object_give_the_same_drive_again_and_again(
    option: str, file: str, name: str, _argument: str
) -> None:
    made_by = getattr(importlib.import_module(file), name)
    forms: list[Any] = [f"examples/{file}.py:{name}", f"{file}:{name}", made_by]
    configs = [DriveConfig(**{**ALONE, option: form}) for form in forms]
    ends = [end_of(config) for config in configs]
    assert ends[0] == ends[1] == ends[2]
    if option == "decision":
        assert end_of(DriveConfig(**{**ALONE, option: made_by()})) == ends[0]


@pytest.mark.parametrize(("option", "file", "name", "argument"), EXAMPLES)
def test_options_reach_the_constructor(option: str, file: str, name: str, argument: str) -> None:
    config = DriveConfig(**{**ALONE, option: f"examples/{file}.py:{name}:{argument}=0.5"})
    with Simulation(config, visuals=False) as drive:
        stack = drive.stack
        part = {
            "decision": stack.decision_maker,
            "planner": stack.planner,
            "lateral": stack.tracker.lateral,
            "longitudinal": stack.tracker.longitudinal,
            "speed_planner": stack.reference,
            "traffic_mode": drive.traffic,
        }[option].part
        assert type(part).__name__ == name
        assert getattr(part, argument, 0.5) == 0.5


@pytest.mark.parametrize("option", list(PARTS))
def test_a_wrong_part_is_refused_by_the_configuration(option: str) -> None:
    kind = PARTS[option]
    for wrong in (object(), object, "nowhere.py:Part", "no_name", 3):
        with pytest.raises(InputError, match=kind.name):
            DriveConfig(**{option: wrong})


def test_a_number_that_is_not_finite_ends_the_drive_with_the_name_of_the_part() -> None:
    class Lost:
        def reset(self) -> None: ...

        def steer(self, ego: Any, trajectory: Any) -> float:
            return math.nan if ego.time > 0.5 else 0.0

    with (
        Simulation(DriveConfig(**ALONE, lateral=Lost), visuals=False) as drive,
        pytest.raises(InputError, match=r"lateral controller .*Lost: steer returned nan"),
    ):
        drive.run()
    assert drive.time == pytest.approx(0.51, abs=0.02)


def test_the_seed_reaches_a_decision_maker() -> None:
    class Dice:
        def __init__(self, seed: int) -> None:
            self.seed = seed

        def reset(self) -> None: ...

        def decide(self, context: Any) -> Decision:
            return Decision.KEEP

    with Simulation(DriveConfig(**ALONE | {"decision": Dice, "seed": 7}), visuals=False) as drive:
        assert drive.stack.decision_maker.part.seed == 7  # type: ignore[attr-defined]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"events": Path("examples/traffic_events.toml")}, "only SUMO traffic has events"),
        ({"recording": Path("any.npz")}, "a recording is a traffic, too"),
    ],
)
def test_options_that_do_not_go_with_own_traffic_are_refused(
    options: dict[str, Any], message: str
) -> None:
    config = DriveConfig(**{**ALONE, "traffic_mode": "own_traffic:Wave", **options})
    with pytest.raises(InputError, match=message):
        Simulation(config, visuals=False)


def test_options_that_do_not_go_with_an_own_speed_are_refused() -> None:
    config = DriveConfig(**{**ALONE, "speed_planner": "own_speed:Hills", "speed_min": 10.0})
    with pytest.raises(InputError, match="a speed-planner of your own uses neither speed-min"):
        Simulation(config, visuals=False)


def test_a_traffic_derived_from_sumos_keeps_its_events() -> None:
    class Mine(InterSim):
        pass

    events = Path("examples/traffic_events.toml")
    config = DriveConfig(**{**ALONE, "traffic_mode": Mine, "events": events, "duration": 1.0})
    with Simulation(config, visuals=False) as drive:
        assert isinstance(drive.traffic, OwnTraffic)
        assert drive.traffic.signal_controller() is not None
        drive.run()
        assert len(drive.vehicles) > 0


def test_an_own_planner_starts_at_a_speed_for_the_bends() -> None:
    with Simulation(DriveConfig(**ALONE, planner="own_planner:RightLane"), visuals=False) as drive:
        assert isinstance(drive.stack.planner, PlannerGuard)
        assert drive.frame.ego.speed > 10.0


def test_settings_name_a_part_by_text_that_leads_to_it() -> None:
    made_by = importlib.import_module("own_decision").Impatient
    for given in (made_by, made_by(room=30.0)):
        config = DriveConfig(decision=given)
        assert stored_options(config)["decision"] == "own_decision:Impatient"
        assert options.words(config) == ["--decision", "own_decision:Impatient"]
        field = next(f for f in dataclasses.fields(config) if f.name == "decision")
        rule = options.of(field)
        assert rule is not None
        assert rule.text(given) == "own_decision:Impatient"


def test_a_configuration_with_text_goes_to_another_process() -> None:
    config = DriveConfig(decision="examples/own_decision.py:Impatient:room=30")
    assert pickle.loads(pickle.dumps(config)) == config


def test_a_recorded_drive_is_repeated_without_its_parts(tmp_path: Path) -> None:
    part = tmp_path / "my.py"
    part.write_text((ROOT / "examples/own_longitudinal.py").read_text())
    config = DriveConfig(
        **ALONE | {"traffic_mode": "inter", "density": "sparse"},
        longitudinal=f"{part}:Proportional",
    )
    with Simulation(config, record=True, visuals=False) as drive:
        drive.run()
        path = drive.save_recording(tmp_path / "drive.npz")
    part.unlink()
    recording = Recording.load(path)
    assert recording.meta["drive"]["options"]["longitudinal"] == f"{part}:Proportional"
    assert redrive(recording, "drive", None).commands == 100


def test_a_drive_in_own_traffic_is_recorded_and_run_again_if_it_is_named(
    tmp_path: Path,
) -> None:
    config = DriveConfig(**{**ALONE, "traffic_mode": "own_traffic:Wave"})
    with Simulation(config, record=True, visuals=False) as drive:
        drive.run()
        path = drive.save_recording(tmp_path / "drive.npz")
        seen = drive.vehicles
    with Simulation(DriveConfig(**{**ALONE, "recording": path}), visuals=False) as again:
        again.run()
        assert again.vehicles == seen
    recording = Recording.load(path)
    with pytest.raises(
        InputError, match="made in your own traffic; add --traffic-mode own_traffic"
    ):
        redrive(recording, "drive", None)
    again = redrive(recording, "drive", None, traffic_mode="own_traffic:Wave")
    assert again.frames == len(recording)
    assert again.pose_hash == recording.meta["digest"]
    with pytest.raises(InputError, match="made in traffic 'own_traffic:Wave', not 'own_traffic:W"):
        redrive(recording, "drive", None, traffic_mode="own_traffic:Wave:swing=1")
    recording.meta["drive"]["versions"]["own traffic of hash"] = "0" * 12
    with pytest.raises(InputError, match="made with own traffic of hash 000000000000, here is"):
        redrive(recording, "drive", None, traffic_mode="own_traffic:Wave")


def test_own_traffic_that_does_not_repeat_is_found_by_verify(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("mine.py").write_text(
        "import itertools\n"
        "from traffic_bridge import vehicle_on\n"
        "calls = itertools.count()\n"
        "class Steady:\n"
        "    far = 200.0\n"
        "    def __init__(self, route): self.route = route\n"
        "    def reset(self, ego): return self.step(ego)\n"
        "    def step(self, ego): return [vehicle_on(self.route, 'a', self.far)]\n"
        "class Drifting(Steady):\n"
        "    @property\n"
        "    def far(self): return 200.0 + 1e-6 * next(calls)\n"
    )
    for name, code in (("Steady", 0), ("Drifting", 1)):
        part = f"mine.py:{name}"
        words = ("record", "a.npz", "--traffic-mode", part, "--duration", "1")
        assert cli.main(words) == 0
        assert cli.main(("replay", "a.npz", "--verify", "--traffic-mode", part)) == code
    assert "differs from the recording: first at t = 0.00 s" in capsys.readouterr().out
    assert cli.main(("replay", "a.npz", "--verify")) == 2
    assert "add --traffic-mode mine.py:Drifting" in capsys.readouterr().err


def test_the_command_names_the_part_in_its_summary(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    text = "examples/own_decision.py:Impatient:room=30"
    words = f"drive --no-video --duration 1 --traffic-mode none --out {tmp_path} --decision {text}"
    assert cli.main(words.split()) == 0
    found = json.loads((tmp_path / "summary.json").read_text())
    assert found["settings"]["decision"] == text
    assert found["provenance"]["own_parts"]["decision"]["part"] == text
    assert len(found["provenance"]["own_parts"]["decision"]["file_sha256"]) == 12
    assert f"--decision {text}" in found["provenance"]["command_line"]
    assert text in (tmp_path / "report.html").read_text()
    capsys.readouterr()
    words = words.replace("room=30", "rom=30")
    assert cli.main(words.split()) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert "has no argument 'rom' (did you mean room?)" in error
    monkeypatch.setenv("IITS_MJ_TRACEBACK", "1")
    assert cli.main(words.split()) == 2
    assert "Traceback" in capsys.readouterr().err
