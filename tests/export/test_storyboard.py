import math
import re
from pathlib import Path
from xml.etree import ElementTree

import pytest

from iits_mj.cli import main
from iits_mj.core.errors import InputError
from iits_mj.simulation import DriveConfig, Simulation
from iits_mj.simulation.parts import with_scenario
from tests.export.checker import checked

EXAMPLES = Path(__file__).parents[2] / "examples"
EVERY, MORE = (Path(__file__).with_name(f"{name}_events.toml") for name in ("every", "more"))
# The drive of an exported file has the file's start as its reference speed.
SPEED, STATION, DURATION = 15.0, 300.0, 32.0
FLAGS = ("--start-station", "300", "--speed", "15", "--duration", "32")


def driven(**options):
    """Places of truck and road users by frame, and the first begin of each event by its name."""
    config = DriveConfig(
        traffic_mode="none", plant="yaw-sideslip", speed=SPEED, duration=DURATION, **options
    )
    frames, begun = [], {}
    with Simulation(with_scenario(config), visuals=False) as simulation:
        while not simulation.ended:
            ego = simulation.cycle().ego
            frames.append({"truck": (ego.x, ego.y)})
            vehicles = simulation.vehicles
            frames[-1] |= {name: (v.x, v.y) for name in vehicles.ids if (v := vehicles.find(name))}
        for record in simulation.traffic.running_scenario().records:
            begun.setdefault(record.event.title, record.begun)
    return frames, begun


def exported(events, folder, *flags):
    path = folder / f"{events.stem}.xosc"
    assert main(["export", str(events), "--xosc", str(path), *FLAGS, *flags]) == 0
    return path


@pytest.mark.parametrize(
    ("events", "bound"), [(EXAMPLES / "cut_in.toml", 1e-6), (EVERY, 0.2), (MORE, 0.5)]
)
def test_a_drive_of_the_exported_file_is_the_drive_of_the_events(events, bound, tmp_path):
    # A pedestrian stands one step later, which is 0.15 m; the rest of both drives is the same.
    path = exported(events, tmp_path)
    assert checked(path) == []
    ours, when = driven(events=events, start_station=STATION)
    theirs, again = driven(scenario=path)
    assert {name: again[name] for name in when} == when
    assert len(ours) == len(theirs)
    for before, after in zip(ours, theirs, strict=True):
        assert set(before) == set(after)
        assert all(math.dist(before[n], after[n]) < bound for n in before)
        assert math.dist(before["truck"], after["truck"]) < 1e-6


def test_the_tutorials_near_miss_is_the_same_drive(tmp_path):
    page = Path(__file__).parents[2] / "docs" / "tutorials" / "near_miss.md"
    text = re.search(r"```toml\n(.*?)```", page.read_text(), re.DOTALL)[1]
    (tmp_path / "near_miss.toml").write_text(text)
    path = exported(tmp_path / "near_miss.toml", tmp_path, "--param", "gap=20")
    assert checked(path) == []
    param = ("gap=20",)
    ours, when = driven(events=tmp_path / "near_miss.toml", start_station=STATION, param=param)
    theirs, again = driven(scenario=path)
    assert {name: again[name] for name in when} == when
    assert all(
        math.dist(a[name], b[name]) < 1e-6 for a, b in zip(ours, theirs, strict=True) for name in a
    )


def test_parameters_of_the_events_are_parameters_of_the_file(tmp_path):
    path = exported(EXAMPLES / "cut_in.toml", tmp_path)
    param = ("gap=9.5", "dv=-4", "deceleration=6.5")
    ours, when = driven(events=EXAMPLES / "cut_in.toml", start_station=STATION, param=param)
    theirs, again = driven(scenario=path, param=param)
    assert {name: again[name] for name in when} == when
    assert all(
        math.dist(a[name], b[name]) < 1e-6 for a, b in zip(ours, theirs, strict=True) for name in a
    )
    with pytest.raises(InputError, match="gap = 300"):
        driven(scenario=path, param=("gap=300",))


def test_a_parameter_without_linear_numbers_is_written_with_its_value(tmp_path, capsys):
    path = exported(EXAMPLES / "regulations" / "r157_braking.toml", tmp_path)
    said = capsys.readouterr().err
    # The gap is the product of both.
    assert "parameter time_gap is written with its value 1.5" in said
    names = [each.get("name") for each in ElementTree.parse(path).iter("ParameterDeclaration")]
    assert names == ["speed", "deceleration", "begins"]
    gaps = {each.get("s") for each in ElementTree.parse(path).iter("LanePosition")}
    assert any(text.startswith("${1.5 * $speed") for text in gaps)
    assert checked(path) == []


def test_sumos_events_are_entities_or_named_commands(tmp_path, capsys):
    path = exported(EXAMPLES / "traffic_events.toml", tmp_path)
    assert checked(path) == []
    said = capsys.readouterr().err
    assert "speed_limit (speed_limit) is a command" in said
    assert "vehicle_change (vehicle_change) is a command" in said
    frames, begun = driven(scenario=path)
    assert begun["lane_closure 1"] == pytest.approx(5.0)
    assert "stopped_vehicle" in frames[-1]


def test_an_event_waits_for_the_closure_of_a_lane(tmp_path):
    (tmp_path / "works.toml").write_text(
        '[[events]]\nevent = "lane_closure"\nlane = 1\nstart = 900.0\nend = 1100.0\n'
        'at_time = 1.0\nuntil = 3.0\n[[events]]\nevent = "milestone"\nname = "open"\n'
        'when = {event = "lane_closure"}\n[[events]]\nevent = "milestone"\nname = "closed"\n'
        'when = {event = "lane_closure", state = "begun"}\n'
    )
    path = exported(tmp_path / "works.toml", tmp_path)
    assert checked(path) == []
    root = ElementTree.parse(path)
    names = [each.get("name") for each in root.iter("ScenarioObject")]
    # A safety truck each 80 m, from its length of 9 m behind the start on.
    assert [name for name in names if "closure" in name] == [f"lane_closure {k}" for k in (1, 2, 3)]
    _, begun = driven(scenario=path)
    assert (begun["closed"], begun["open"]) == (pytest.approx(1.0), pytest.approx(3.0))


def test_triggers_and_actions_are_those_of_the_standard(tmp_path):
    root = ElementTree.parse(exported(EXAMPLES / "cut_in.toml", tmp_path))
    assert root.find(".//LongitudinalDistanceAction").get("displacement") == (
        "leadingReferencedEntity"
    )
    assert root.find(".//LaneChangeAction//RelativeTargetLane").get("entityRef") == "Ego"
    assert {
        each.tag for each in root.find(".//Story").iter() if each.tag.endswith("Condition")
    } == {
        *("Condition", "EntityCondition", "ByEntityCondition", "ByValueCondition"),
        *("SimulationTimeCondition", "StoryboardElementStateCondition"),
        *("TimeHeadwayCondition", "RelativeDistanceCondition"),
    }
    assert root.find(".//FollowTrajectoryAction") is None


CAR = '[[events]]\nevent = "place_vehicle"\nname = "car"\ngap = 30.0\n'


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            '[[events]]\nevent = "brake"\nactor = "leader"',
            "brake.*role 'leader' has no counterpart",
        ),
        ('[[events]]\nevent = "brake"\nactor = "truck"', "truck, which has its own driver"),
        ('[[events]]\nevent = "brake"\nactor = "bus"', "'bus' is no vehicle of an event before it"),
        (
            f'{CAR}[[events]]\nevent = "brake"\nactor = "car"\nwhen = {{event = "car"}}',
            "event 'car' never ends",
        ),
        (
            f'{CAR}[[events]]\nevent = "brake"\nactor = "car"\n'
            "when = {measure = 'ttc', to = 'car', below = 2.0, lasting = 1.0}",
            "lasting is written for speeds below",
        ),
        (
            f'{CAR}[[events]]\nevent = "change_lane"\nactor = "car"\nrelative_lane = 1\n'
            "lateral_acceleration = 1.0",
            "lateral_acceleration has no counterpart: give duration",
        ),
    ],
)
def test_what_openscenario_lacks_is_refused_by_name(text, message, tmp_path, capsys):
    (tmp_path / "events.toml").write_text(text)
    arguments = [str(tmp_path / "events.toml"), "--xosc", str(tmp_path / "a.xosc")]
    assert main(["export", *arguments]) == 2
    assert re.search(message, capsys.readouterr().err)
    assert not (tmp_path / "a.xosc").exists()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["events.toml"], "is a scenario: give --xosc"),
        (["events.toml", "--osi", "a.mcap", "--xosc", "a.xosc"], "osi is of a recorded drive"),
        (
            ["drive.npz", "--speed", "20", "--xosc", "a.xosc"],
            "speed is of a scenario, and drive.npz",
        ),
        (["events.toml", "--xosc", "a.xosc", "--start-station", "99999"], "not on the route"),
    ],
)
def test_wrong_use_is_one_clear_line(arguments, message, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "events.toml").write_text(CAR)
    assert main(["export", *arguments]) == 2
    assert re.search(message, capsys.readouterr().err)
