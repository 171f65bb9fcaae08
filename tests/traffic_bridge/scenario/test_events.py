import dataclasses
import json
import math

import pytest

from iits_mj.core.errors import InputError
from tests.paths import ROOT
from traffic_bridge import (
    ActivateDriver,
    Brake,
    BrakeLeak,
    ChangeLane,
    ChangeSpeed,
    CrossRoad,
    CutIn,
    Drift,
    EndDrive,
    FollowPath,
    FollowSpeeds,
    FrictionChange,
    KeepDistance,
    LoseCargo,
    Milestone,
    PlaceVehicle,
    Puncture,
    RemoveVehicle,
    SetValue,
    StuckSpeedSensor,
    Swarm,
    Swerve,
    Synchronize,
    Teleport,
    TrafficConfig,
    Wind,
    read_events,
)
from traffic_bridge.scenario.actions import SCENARIO_EVENTS
from traffic_bridge.scenario.reading import EVENTS, event_of
from traffic_bridge.signals.events import Event

SWARM = {
    "name": "s", "count": 9, "inner": 5.0, "half_length": 50.0, "half_width": 9.0, "speed": 20.0
}  # fmt: skip
ONE_OF_EACH = (
    PlaceVehicle(name="a", gap=20.0, relative_lane=1),
    CutIn(actor="a", when={"measure": "gap", "to": "a", "below": 15.0}),
    ChangeLane(actor="leader", relative_lane=-1),
    ChangeSpeed(actor="a", speed=10.0),
    FollowSpeeds(actor="a", speeds=[(1.0, 5.0), (2.5, 10.0)]),
    Brake(actor="a", duration=3.0),
    Swerve(actor="a", offset=-1.0),
    Drift(actor="a", offset=1.5),
    LoseCargo(actor="a", name="box"),
    CrossRoad(name="walker", gap=50.0),
    FollowPath(actor="a", points=[[0.0, 1.0], [5, 2]], times=[0, 2.0]),
    KeepDistance(actor="a", time_gap=1.5),
    ActivateDriver(actor="a", active=False),
    Teleport(actor="a", station=300.0, lane=1),
    RemoveVehicle(actor="a"),
    Synchronize(actor="a", station=500.0, to_station=480.0, speed=10.0),
    SetValue(variable="light", value="green"),
    Swarm(**SWARM),
    Milestone(name="later"),
    EndDrive(),
    FrictionChange(friction=0.3, start=100.0, end=200.0),
    Wind(speed=20.0),
    Puncture(wheel="tractor_axle1_left"),
    BrakeLeak(circuit="front"),
    StuckSpeedSensor(wheel="tractor_axle1_left"),
)


def test_every_event_survives_a_json_file():
    assert {type(event) for event in ONE_OF_EACH} == set(SCENARIO_EVENTS)
    config = TrafficConfig(density="empty", events=ONE_OF_EACH)
    stored = json.loads(json.dumps(config.as_dict(), allow_nan=False))
    assert TrafficConfig.from_dict(stored).events == ONE_OF_EACH


def test_every_motion_to_the_side_takes_3_s_without_another_measure():
    for event in ONE_OF_EACH:
        if isinstance(event, (CutIn, ChangeLane, Swerve)):
            assert event.duration == 3.0
    assert ChangeLane(actor="a", lane=1, distance=50.0).duration is None


def test_every_event_takes_conditions_and_refuses_two_beginnings():
    when = {"measure": "time", "above": 1.0}
    for event in ONE_OF_EACH:
        plain = {n: v for n, v in event.as_dict().items() if n != "when"}
        assert event_of(plain | {"when": when}).when[0][0].above == 1.0
        with pytest.raises(InputError, match="give at_time or when, not both"):
            event_of(plain | {"when": when, "at_time": 1.0})


@pytest.mark.parametrize(
    ("kind", "values", "words"),
    [
        ("place_vehicle", {"gap": 20.0}, "name = None"),
        ("place_vehicle", {"name": "a"}, "give gap or station"),
        ("place_vehicle", {"name": "a", "gap": math.nan}, "gap = nan"),
        ("place_vehicle", {"name": "a", "gap": 1.0, "lane": 0, "relative_lane": 1}, "not both"),
        ("place_vehicle", {"name": "a", "gap": 1.0, "lane": 1.5}, "lane = 1.5"),
        ("place_vehicle", {"name": "a", "gap": 1.0, "reactive": 1}, "true and false"),
        ("cut_in", {}, "actor is missing"),
        ("cut_in", {"actor": "a", "gap": -3.0}, "gap = -3.0: allowed is 0 to 500"),
        ("cut_in", {"actor": "a", "duration": 0.0}, "duration = 0 s: must be positive"),
        ("cut_in", {"actor": "a", "shape": "cosine"}, "use one of: sinusoidal, cubic, linear"),
        ("cut_in", {"actor": "a", "until": 3.0}, "has no until"),
        ("cut_in", {"actor": "a", "gapp": 3.0}, "did you mean gap"),
        ("change_lane", {"actor": "a"}, "give relative_lane or lane"),
        ("change_speed", {"actor": "a", "speed": 1.0, "speed_difference": 1.0}, "not both"),
        ("brake", {"actor": "a", "deceleration": 20.0}, "allowed is 0.05 to 15"),
        ("swerve", {"actor": "a"}, "offset is missing"),
        ("drift", {"actor": "a", "offset": 1.0, "duration": 1.0}, "has no duration"),
        ("lose_cargo", {"actor": "a"}, "name = None"),
        ("cross_road", {"name": "a", "gap": 3.0, "side": "front"}, "use one of: left, right"),
        ("friction", {"friction": 3.0}, "allowed is 0 to 2"),
        ("friction", {"friction": 1.0, "start": 5.0, "end": 4.0}, "must be before"),
        ("wind", {"speed": 1.0, "until": 9.0}, "a gust has a duration"),
        ("puncture", {"wheel": "x", "duration": 1.0}, "has no duration"),
        ("place_vehicle", {"name": "a", "points": [[0, 0]]}, "give a list of 2 to 10000 points"),
        ("place_vehicle", {"name": "a", "points": [[0, 0], [0, math.nan]]}, "each must be a num"),
        ("place_vehicle", {"name": "a", "points": [[0, 0], [0, 0]]}, "two equal points"),
        ("place_vehicle", {"name": "a", "gap": 5.0, "along": "turns:1"}, "needs station and lane"),
        ("place_vehicle", {"name": "a", "gap": 5.0, "points": [[0, 0], [1, 0]]}, "not both"),
        ("follow_path", {"actor": "a"}, "give points or along"),
        ("follow_path", {"actor": "a", "along": "turns:left,up"}, "'up' is no turn"),
        ("follow_path", {"actor": "a", "points": [[0, 0], [1, 0, 2]]}, "have a height, or none"),
        ("follow_path", {"actor": "a", "points": [[0, 0], [1, 0]], "times": [1, 1]}, "rising"),
        ("follow_path", {"actor": "a", "points": [[0, 0], [1, 0]], "times": [1, 2, 3]}, "not more"),
        ("follow_path", {"actor": "a", "points": [[0, 0], [1, 0]], "frame": "lane"}, "map, route"),
        ("follow_speeds", {"actor": "a"}, "speeds: must be 1 to 10000 rows of a time and a speed"),
        ("follow_speeds", {"actor": "a", "speeds": [[1, 5], [1, 6]]}, "time 1 s after 1 s"),
        ("follow_speeds", {"actor": "a", "speeds": [[1, -5]]}, "speed = -5.0 m/s: allowed is 0 to"),
        ("follow_speeds", {"actor": "a", "speeds": [[1, math.nan]]}, "each must be a number"),
        ("keep_distance", {"actor": "a"}, "give gap or time_gap"),
        ("synchronize", {"actor": "a", "station": 1.0, "to_station": -1.0}, "to_station = -1.0"),
        ("set_value", {"variable": "a", "value": None}, "a number or a text"),
        ("swarm", SWARM | {"count": 0}, "count = 0"),
        ("swarm", SWARM | {"mix": {"car": -1.0}}, "give types with their weights"),
        ("swarm", SWARM | {"mix": {"car": 0.0}}, "one weight must be positive"),
        ("cutin", {}, "did you mean cut_in"),
    ],
)
def test_a_wrong_value_is_refused_with_what_is_allowed(kind, values, words):
    with pytest.raises(InputError) as raised:
        event_of({"event": kind} | values)
    assert words in str(raised.value)


@pytest.mark.parametrize(
    ("events", "words"),
    [
        ((Brake(actor="a", when={"event": "cutin"}), CutIn(actor="a")), "did you mean cut_in"),
        (
            (CutIn(actor="a"), CutIn(actor="b"), Brake(actor="a", when={"event": "cut_in"})),
            "several events have this name",
        ),
        ((PlaceVehicle(name="a", gap=1.0), Brake(name="a", actor="a")), "have the name 'a'"),
        ((PlaceVehicle(name="leader", gap=1.0),), "'leader' has another meaning"),
        ((PlaceVehicle(name="a", gap=1.0, type="tram"),), "the types are car, van"),
        ((Swarm(**SWARM, mix={"tram": 1.0}),), "'tram': the types are car, van"),
    ],
)
def test_events_refer_to_events_and_types_that_exist(events, words):
    with pytest.raises(InputError) as raised:
        TrafficConfig(events=events)
    assert words in str(raised.value)


def test_the_example_is_read_from_its_file(tmp_path):
    place, cut_in, brake = read_events(ROOT / "examples/cut_in.toml")
    assert place.name == "car"
    assert (cut_in.gap, cut_in.speed_difference) == (15.0, -2.0)
    assert read_events(ROOT / "examples/cut_in.toml", {"gap": "9"})[1].gap == 9.0
    assert brake.when[0][0].event == "cut_in"
    path = tmp_path / "wrong.toml"
    path.write_text(
        '[[events]]\nevent = "cut_in"\nactor = "a"\nwhen = {measure = "tt", below = 1}\n'
    )
    with pytest.raises(InputError, match=r"wrong.toml: event 1: cut_in: when: measure 'tt'"):
        read_events(path)


def test_the_kinds_of_events_differ_and_have_no_abstract_ones():
    assert len(EVENTS) == 7 + len(SCENARIO_EVENTS)
    assert all(
        dataclasses.is_dataclass(event) and event.kind == kind for kind, event in EVENTS.items()
    )


@pytest.mark.parametrize("kind", EVENTS)
def test_the_manual_has_every_event_with_its_fields(kind):
    rows = (ROOT / "docs" / "traffic.md").read_text().splitlines()
    (row,) = [row for row in rows if row.startswith("| `") and f"`{kind}` (`" in row]
    common = {field.name for field in dataclasses.fields(Event)}
    own = {field.name for field in dataclasses.fields(EVENTS[kind])} - common
    assert {name for name in own if f"`{name}`" not in row} == set()
