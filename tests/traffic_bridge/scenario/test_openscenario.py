"""Scenarios of OpenSCENARIO files: their stories, and what is refused."""

import itertools
import math
import re
from pathlib import Path

import pytest

from iits_mj.commands.drive import Options
from iits_mj.core.errors import InputError
from iits_mj.core.messages import EgoFootprint
from iits_mj.road import RoadMap
from iits_mj.road.elements import DEFAULT_FRICTION
from iits_mj.simulation import DriveConfig
from iits_mj.simulation.parts import with_scenario
from tests.paths import ROOT
from tests.traffic_bridge.scripted_truck import ego_at
from traffic_bridge import EventSim, TrafficConfig
from traffic_bridge.scenario.openscenario import read_scenario

FILES = ROOT / "../shared/data/xosc/xosc"
TRUCK = EgoFootprint()
STEP = 0.1
STORIES = {
    # file: truck's lane and speed, {vehicle: front at the start and speed}, and
    # (event, earliest and latest time): with a truck at constant speed in its lane.
    "alks_cut-in": ((0, 20.0), {"TargetCutIn": (53.97, 17.0)}, [("CutInEvent", 2.1, 2.3)]),
    "alks_decelerate": (
        (0, 20.0),
        {"TargetDecelerate": (63.97, 20.0)},
        [("DecelerateEvent", 2.1, 2.1)],
    ),
    "alks_r157_cut_in_quick_brake": (
        (0, 20.0),
        {"Target": (83.97, 15.0)},
        [("LaneChange1Event", 2.1, 2.1), ("TargetreduceSpeedEvent", 4.1, 4.1)],
    ),
    # 25 m behind; it loses 4 m before it drives 6 m/s faster than the truck, to 12 m ahead.
    "cut-in": (
        (1, 30.0),
        {"OverTaker": (28.97, 0.0)},
        [("OverTakerStartSpeedEvent", 0.1, 0.1), ("CutInEvent", 6.9, 7.2)],
    ),
    # 20 m behind with 5 m/s more; then 8 m and 20 m free ahead.
    "cut-in_simple": (
        (0, 20.0),
        {"OverTaker": (33.97, 25.0)},
        [("CutInEvent", 6.6, 6.8), ("BrakeEvent", 9.0, 9.2)],
    ),
    "slow-lead-vehicle": ((0, 30.0), {"Lead": (203.97, 1.0)}, []),
}


def path_of(name: str) -> Path:
    path = FILES / f"{name}.xosc"
    if not path.exists():
        pytest.skip("the scenarios are not here")
    return path


def play(path: Path, duration: float, truck_speed: float | None = None, ego: str | None = None):
    """Runs a scenario around a truck at constant speed; returns start, frames and records."""
    scenario = read_scenario(path, ego)
    route = RoadMap.from_opendrive(scenario.map).route(along=scenario.route)
    start = scenario.start(route, TRUCK)
    speed = start.speed if truck_speed is None else truck_speed
    frames = []
    with EventSim(route, TrafficConfig(events=scenario.events(route))) as traffic:
        for k in range(round(duration / STEP) + 1):
            station = start.station + k * STEP * speed
            offset = float(route.lane_offset(start.lane, station))
            ego = ego_at(route, k * STEP, station, speed, offset)
            frames.append(traffic.step(ego) if k else traffic.reset(ego))
        return start, frames, {r.event.title: r for r in traffic.running_scenario().records}


@pytest.mark.parametrize("name", STORIES)
def test_the_story_of_a_published_scenario_takes_place(name):
    (lane, speed), vehicles, events = STORIES[name]
    start, frames, records = play(path_of(name), 12.0)
    assert (start.lane, start.speed) == (lane, pytest.approx(speed))
    for vehicle, (front, its_speed) in vehicles.items():
        row = frames[0].find(vehicle)
        assert row.station + 0.5 * row.length == pytest.approx(front, abs=0.05)
        assert row.speed == its_speed
        assert (row.length, row.width) == (5.04, 2.0)
    for event, first, last in events:
        assert first - 1e-6 <= records[event].begun <= last + 1e-6
    # The acts and the end of the drive begin, too; nothing else does.
    assert {n for n in records if n.endswith("Event")} == {event for event, *_ in events} | (
        {"OvertakerBrakeEvent"} if name == "cut-in" else set()
    )


def test_a_cut_in_from_the_opposite_lane_ends_in_the_trucks_lane():
    _, frames, records = play(path_of("alks_cut-in"), 8.0)
    car = [frame.find("TargetCutIn") for frame in frames]
    assert car[0].offset > 0.0
    assert car[0].lane == -1
    assert car[round(records["CutInEvent"].begun / STEP) + 41].lane == 0
    assert {row.speed for row in car} == {17.0}


def test_a_linear_change_of_speed_has_the_rate_of_the_file():
    _, frames, records = play(path_of("alks_decelerate"), 6.0)
    begun = round(records["DecelerateEvent"].begun / STEP)
    speeds = [frame.find("TargetDecelerate").speed for frame in frames]
    assert speeds[begun] == 20.0
    assert speeds[begun + 10] == pytest.approx(13.0, abs=1e-6)
    assert speeds[begun + 30] == 0.0


def test_a_continuous_speed_follows_the_truck():
    _, frames, _ = play(path_of("cut-in"), 2.0, truck_speed=20.0)
    assert frames[-1].find("OverTaker").speed == pytest.approx(24.0)


def test_an_entity_that_is_to_be_the_truck_must_be_named():
    with pytest.raises(InputError, match="no entity is named Ego or Hero; choose one of Car"):
        read_scenario(path_of("lane-change_trajectory_wp"))


ROAD = """<OpenDRIVE><header revMajor="1" revMinor="6"/>
<road id="1" length="1000" junction="-1"><planView>
<geometry s="0" x="0" y="0" hdg="0" length="1000"><line/></geometry></planView>
<lanes><laneSection s="0"><center><lane id="0" type="none"/></center><right>
<lane id="-1" type="driving"><width sOffset="0" a="4" b="0" c="0" d="0"/></lane>
<lane id="-2" type="driving"><width sOffset="0" a="4" b="0" c="0" d="0"/></lane>
</right></laneSection></lanes></road></OpenDRIVE>"""
BODY = """<BoundingBox><Center x="1.5" y="0" z="1"/>
<Dimensions length="5" width="2" height="1.5"/></BoundingBox>"""
SCENARIO = """<OpenSCENARIO><FileHeader revMajor="1" revMinor="2"/>
<ParameterDeclarations><ParameterDeclaration name="V" value="20"/>
<ParameterDeclaration name="W" value="${$V / 2 - 1}"/></ParameterDeclarations>
<RoadNetwork><LogicFile filepath="road.xodr"/></RoadNetwork><Entities>
<ScenarioObject name="Hero"><Vehicle vehicleCategory="truck">BODY<TrailerHitch dx="0"/>
</Vehicle></ScenarioObject>
<ScenarioObject name="car"><Vehicle vehicleCategory="car">BODY</Vehicle></ScenarioObject>
</Entities><Storyboard><Init><Actions>
<GlobalAction><EnvironmentAction><Environment name="wet">
<RoadCondition frictionScaleFactor="0.5"/></Environment></EnvironmentAction></GlobalAction>
<Private entityRef="Hero"><PrivateAction><TeleportAction><Position>
<LanePosition roadId="1" laneId="-2" s="100"/></Position></TeleportAction></PrivateAction>
<PrivateAction><LongitudinalAction><SpeedAction><SpeedActionTarget>
<AbsoluteTargetSpeed value="$V"/></SpeedActionTarget></SpeedAction></LongitudinalAction>
</PrivateAction></Private><Private entityRef="car"><PrivateAction><TeleportAction><Position>
<RelativeLanePosition entityRef="Hero" dLane="1" ds="30"/></Position></TeleportAction>
</PrivateAction><PrivateAction><LongitudinalAction><SpeedAction><SpeedActionTarget>
<AbsoluteTargetSpeed value="$W"/></SpeedActionTarget></SpeedAction></LongitudinalAction>
</PrivateAction></Private></Actions></Init>
<Story name="s"><Act name="a"><ManeuverGroup name="g"><Actors><EntityRef entityRef="car"/></Actors>
<Maneuver name="m"><Event name="aside" priority="overwrite"><Action name="x"><PrivateAction>
<LateralAction><LaneOffsetAction><LaneOffsetActionDynamics dynamicsShape="sinusoidal"
maxLateralAcc="2"/><LaneOffsetTarget><AbsoluteTargetLaneOffset value="1.5"/></LaneOffsetTarget>
</LaneOffsetAction></LateralAction></PrivateAction></Action></Event></Maneuver></ManeuverGroup>
<StartTrigger><ConditionGroup><Condition name="c" conditionEdge="none" delay="0">
<ByValueCondition><SimulationTimeCondition value="1" rule="greaterThan"/></ByValueCondition>
</Condition></ConditionGroup></StartTrigger></Act></Story></Storyboard></OpenSCENARIO>
""".replace("BODY", BODY)


def written(folder: Path, text: str = SCENARIO) -> Path:
    (folder / "road.xodr").write_text(ROAD)
    path = folder / "own.xosc"
    path.write_text(text)
    return path


def test_parameters_relative_lanes_friction_and_lane_offset_are_read(tmp_path):
    start, frames, records = play(written(tmp_path), 6.0)
    assert (start.lane, start.speed) == (0, 20.0)
    assert start.station + TRUCK.front_overhang == pytest.approx(100.0 + 1.5 + 2.5)
    car = [frame.find("car") for frame in frames]
    assert car[0].lane == 1
    assert car[0].speed == 9.0
    assert records["friction"].event.friction == pytest.approx(0.5 * DEFAULT_FRICTION)
    assert records["aside"].begun == pytest.approx(1.1)
    assert car[-1].offset - car[0].offset == pytest.approx(1.5, abs=1e-6)
    # The greatest lateral acceleration is that of the file.
    offsets = [row.offset for row in car]
    bends = [a - 2.0 * b + c for a, b, c in zip(offsets, offsets[1:], offsets[2:], strict=False)]
    assert max(bends) / STEP**2 == pytest.approx(2.0, rel=0.1)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("$V / 2 - 1", "$X / 2", "line 3: <ParameterDeclaration>: parameter $X is not declared"),
        ("$V / 2 - 1", "__import__(1)", "is no expression of numbers"),
        ("$V / 2 - 1", "9 / 0", "is no expression of numbers"),
        ('ds="30"', 'ds="nan"', "ds = nan: allowed is -1e+08 to 1e+08"),
        ('dLane="1"', 'dLane="2"', "no such lane on the route"),
        ('entityRef="Hero" dLane', 'entityRef="car" dLane', "refers to itself"),
        ('entityRef="Hero" dLane', 'entityRef="Herro" dLane', "did you mean Hero"),
        ('revMinor="2"', 'revMinor="9"', "is OpenSCENARIO 1.9"),
        ('"overwrite"', '"skip"', "priority must be one of"),
        ("SimulationTimeCondition", "TimeOfDayCondition", "<TimeOfDayCondition>: this element is"),
        ("</OpenSCENARIO>", "", "is not well-formed XML"),
        (
            '<SpeedAction><SpeedActionTarget>\n<AbsoluteTargetSpeed value="$W"',
            '<SpeedAction><SpeedActionDynamics dynamicsShape="Step"/><SpeedActionTarget>'
            '<AbsoluteTargetSpeed value="$W"',
            "dynamicsShape 'Step': allowed are sinusoidal, cubic, linear, step",
        ),
        (
            'name="V" value="20"/>',
            'name="V" parameterType="double" value="20"><ConstraintGroup>'
            '<ValueConstraint rule="lessThan" value="10"/></ConstraintGroup>'
            "</ParameterDeclaration>",
            "line 2: <ParameterDeclaration>: V = 20.0: allowed is < 10",
        ),
    ],
)
def test_a_wrong_scenario_is_refused_with_its_place(tmp_path, old, new, words):
    with pytest.raises(InputError, match=re.escape(words)):
        play(written(tmp_path, SCENARIO.replace(old, new)), 0.1)


ACTION = """<LateralAction><LaneOffsetAction><LaneOffsetActionDynamics dynamicsShape="sinusoidal"
maxLateralAcc="2"/><LaneOffsetTarget><AbsoluteTargetLaneOffset value="1.5"/></LaneOffsetTarget>
</LaneOffsetAction></LateralAction>"""
VERTICES = """<Vertex time="0"><Position><WorldPosition x="140" y="-6"/></Position></Vertex>
<Vertex time="4"><Position><WorldPosition x="180" y="-6"/></Position></Vertex>
<Vertex time="6"><Position><LanePosition roadId="1" laneId="-1" s="220"/></Position></Vertex>"""


def following(shape: str, timing: str = "<None/>", more: str = "") -> str:
    """The scenario in which the car follows a trajectory at 1 s."""
    action = f"""<RoutingAction><FollowTrajectoryAction {more}><TrajectoryRef><Trajectory name="t"
closed="false"><Shape>{shape}</Shape></Trajectory></TrajectoryRef>
<TimeReference>{timing}</TimeReference><TrajectoryFollowingMode followingMode="position"/>
</FollowTrajectoryAction></RoutingAction>"""
    assert ACTION in SCENARIO
    return SCENARIO.replace(ACTION, action)


# A quarter of a circle of 20 m to the left, exactly: L. Piegl, W. Tiller, "The NURBS Book", 7.1.
NURBS = (
    '<Nurbs order="3">'
    + "".join(
        f'<ControlPoint time="{time}" weight="{weight}"><Position><WorldPosition x="{x}" y="{y}"/>'
        "</Position></ControlPoint>"
        for time, weight, x, y in (
            (0, 1, 140.0, -6.0),
            (2, math.sqrt(0.5), 160.0, -6.0),
            (4, 1, 160.0, 14.0),
        )
    )
    + "".join(f'<Knot value="{value}"/>' for value in (0, 0, 0, 1, 1))
    + '<Knot value="1"/></Nurbs>'
)
CLOTHOID = """<Clothoid curvature="0.05" curvatureDot="0" length="31.4159" startTime="0"
stopTime="4"><Position><WorldPosition x="140" y="-6" h="0"/></Position></Clothoid>"""


@pytest.mark.parametrize("shape", [NURBS, CLOTHOID])
def test_a_curved_trajectory_is_a_quarter_of_a_circle(tmp_path, shape):
    timing = '<Timing domainAbsoluteRelative="relative" scale="1" offset="0"/>'
    _, frames, records = play(written(tmp_path, following(shape, timing)), 8.0)
    begun = round(records["aside"].begun / STEP)
    for row in (frame.find("car") for frame in frames[begun + 1 : begun + 40]):
        reference = row.x - 1.5 * math.cos(row.yaw), row.y - 1.5 * math.sin(row.yaw)
        # The body's heading is that of the chord between its ends.
        assert math.dist(reference, (140.0, 14.0)) == pytest.approx(20.0, abs=0.15)
    assert records["aside"].ended == pytest.approx(records["aside"].begun + 4.0, abs=0.11)


@pytest.mark.parametrize("scale", [1.0, 2.0])
def test_a_trajectory_with_times_has_the_reference_point_at_its_vertices(tmp_path, scale):
    timing = f'<Timing domainAbsoluteRelative="relative" scale="{scale}" offset="0.5"/>'
    text = following(f"<Polyline>{VERTICES}</Polyline>", timing)
    _, frames, records = play(written(tmp_path, text), 16.0)
    begun = records["aside"].begun
    for time, x, y in ((0.0, 140.0, -6.0), (4.0, 180.0, -6.0), (6.0, 220.0, -2.0)):
        row = frames[round((begun + 0.5 + scale * time) / STEP)].find("car")
        # The center is 1.5 m before the reference point.
        reference = row.x - 1.5 * math.cos(row.yaw), row.y - 1.5 * math.sin(row.yaw)
        assert reference == pytest.approx((x, y), abs=0.25)
    assert records["aside"].ended == pytest.approx(begun + 0.5 + 6.0 * scale, abs=0.11)


def test_a_trajectory_without_times_is_driven_at_the_vehicles_speed(tmp_path):
    _, frames, records = play(
        written(tmp_path, following(f"<Polyline>{VERTICES}</Polyline>")), 14.0
    )
    rows = [frame.find("car") for frame in frames]
    assert {row.speed for row in rows} == {9.0}
    assert records["aside"].ended is not None
    # It drives on in the lane where the trajectory ends.
    assert rows[-1].lane == 1
    assert rows[-1].offset == pytest.approx(-2.0, abs=0.05)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (following("<Clothoid/>"), "<Clothoid>: has no Position"),
        (following("<Splines/>"), "<Splines>: has no Position"),
        (following(NURBS.replace('<Knot value="1"/>', "")), "6 knots that do not fall, and there"),
        (
            following(f"<Polyline>{VERTICES}</Polyline>", more='initialDistanceOffset="3"'),
            "initialDistanceOffset is not read",
        ),
        (
            following(
                f"<Polyline>{VERTICES}</Polyline>",
                '<Timing domainAbsoluteRelative="absolute" scale="1" offset="0"/>',
            ),
            "<Timing>: absolute times are read in Init only",
        ),
        (
            SCENARIO.replace(ACTION, "<RoutingAction><RandomRouteAction/></RoutingAction>"),
            "<RandomRouteAction>: this element is not supported",
        ),
        (
            SCENARIO.replace(
                ACTION,
                "<RoutingAction><AcquirePositionAction><Position><LanePosition roadId='9' "
                "laneId='-1' s='5'/></Position></AcquirePositionAction></RoutingAction>",
            ),
            "<LanePosition>: the map has no road '9'",
        ),
    ],
)
def test_what_a_scenario_has_beyond_the_subset_is_refused_with_its_line(tmp_path, text, words):
    with pytest.raises(InputError, match=re.escape(words)) as raised:
        play(written(tmp_path, text), 0.1)
    assert re.search(r"own.xosc: line \d+: <", str(raised.value))


def test_an_ego_off_the_driving_lanes_is_refused_with_the_name_of_the_scenario(tmp_path):
    path = written(tmp_path, SCENARIO.replace('laneId="-2" s="100"', 'laneId="-3" s="100"'))
    with pytest.raises(
        InputError, match=r"own.xosc: road of Hero: .* no driving lane -3"
    ) as raised:
        with_scenario(DriveConfig(scenario=path))
    # The line in the middle is no lane.
    assert "it has -2, -1" in str(raised.value)


def test_the_ego_can_be_named(tmp_path):
    path = written(tmp_path)
    assert read_scenario(path).ego == "Hero"
    with pytest.raises(InputError, match=r"there is no entity 'cart' .did you mean car"):
        read_scenario(path, "cart")


RELATIVE = '<RelativeLanePosition entityRef="Hero" dLane="1" ds="30"/>'
TURNED = RELATIVE.replace("/>", '><Orientation type="relative" h="TURN"/></RelativeLanePosition>')


@pytest.mark.parametrize(("turn", "way"), [(0.1, 9.0), (3.1, -9.0)])
def test_a_vehicle_moves_where_its_orientation_leads_along_its_lane(tmp_path, turn, way):
    text = SCENARIO.replace(RELATIVE, TURNED.replace("TURN", str(turn)))
    car = [frame.find("car") for frame in play(written(tmp_path, text), 1.0)[1]]
    # There is no lane in the other direction: it goes against this one.
    assert car[-1].x - car[0].x == pytest.approx(way, abs=0.01)
    assert {row.lane for row in car} == ({1} if turn < 1.0 else {-1})
    assert [row.y for row in car] == pytest.approx([-2.0] * len(car), abs=0.07)


TRAILER = '<Trailer><TrailerRef entityRef="car"/></Trailer><TrailerHitch dx="0"/>'


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        (
            f'"car">{BODY}</Vehicle>',
            f'"car">{BODY}<TrailerCoupler dx="1"/>{TRAILER}</Vehicle>',
            "tows more than 10 trailers, or itself",
        ),
        (
            '<AbsoluteTargetSpeed value="$W"/>',
            '<RelativeTargetSpeed entityRef="car" value="1" speedTargetValueType="delta"/>',
            "the speed refers to itself",
        ),
    ],
)
def test_what_refers_to_itself_is_refused(tmp_path, old, new, words):
    assert old in SCENARIO
    with pytest.raises(InputError, match=words):
        play(written(tmp_path, SCENARIO.replace(old, new)), 0.1)


HERO_TOO = '<EntityRef entityRef="car"/><EntityRef entityRef="Hero"/>'


def test_options_that_a_user_gave_are_kept_and_notes_are_said_once(tmp_path, capsys):
    # The truck's part of the story is its own driver's.
    path = written(tmp_path, SCENARIO.replace('<EntityRef entityRef="car"/>', HERO_TOO))
    plain = with_scenario(DriveConfig(scenario=path))
    assert (plain.start_speed, plain.traffic_mode) == (20.0, "none")
    assert with_scenario(plain) == plain
    default = DriveConfig().start_speed
    given = frozenset({"start_speed"})
    options = with_scenario(Options(scenario=path, start_speed=default, given=given))
    assert (options.start_speed, options.start_lane) == (default, 0)
    assert with_scenario(options) == options
    said = capsys.readouterr().err
    notes = read_scenario(path).notes
    assert notes
    assert [said.count(note) for note in notes] == [2] * len(notes)


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ({"traffic_mode": "inter"}, "traffic-mode = 'inter': a scenario has its own road users"),
        ({"traffic_mode": "pure"}, "traffic-mode = 'pure': a scenario has its own"),
        ({"reactive": True}, "reactive is of SUMO traffic"),
    ],
)
def test_sumo_traffic_beside_a_scenario_is_refused(values, words, tmp_path):
    options = Options(scenario=written(tmp_path), **values, given=frozenset(values))
    with pytest.raises(InputError, match=re.escape(words)):
        with_scenario(options)


LANE_CHANGE = """<LateralAction><LaneChangeAction><LaneChangeActionDynamics
dynamicsShape="SHAPE" value="VALUE" dynamicsDimension="DIMENSION"/><LaneChangeTarget>
<RelativeTargetLane entityRef="Hero" value="0"/></LaneChangeTarget></LaneChangeAction>
</LateralAction>"""


@pytest.mark.parametrize(
    ("shape", "dimension", "value", "duration"),
    [
        # 4 m to the side: the greatest lateral speed, the way at 9 m/s, and the time.
        ("sinusoidal", "rate", 2.0, 0.5 * math.pi * 4.0 / 2.0),
        ("linear", "rate", 1.0, 4.0),
        ("cubic", "distance", 27.0, 3.0),
        ("sinusoidal", "time", 2.5, 2.5),
    ],
)
def test_a_lane_change_lasts_as_its_dimension_says(tmp_path, shape, dimension, value, duration):
    change = LANE_CHANGE.replace("SHAPE", shape).replace("DIMENSION", dimension)
    text = SCENARIO.replace(ACTION, change.replace("VALUE", str(value)))
    _, frames, records = play(written(tmp_path, text), 8.0)
    record = records["aside"]
    assert record.ended - record.begun == pytest.approx(duration, abs=0.11)
    rows = [frame.find("car") for frame in frames]
    assert rows[-1].offset - rows[0].offset == pytest.approx(-4.0, abs=0.01)
    if dimension == "rate":
        steps = [b.offset - a.offset for a, b in itertools.pairwise(rows)]
        assert -min(steps) / STEP == pytest.approx(value, rel=0.02)


SPEED = """<LongitudinalAction><SpeedAction><SpeedActionDynamics dynamicsShape="linear"
value="VALUE" dynamicsDimension="DIMENSION"/><SpeedActionTarget><AbsoluteTargetSpeed value="15"/>
</SpeedActionTarget></SpeedAction></LongitudinalAction>"""


def test_a_change_of_speed_over_a_distance_ends_there(tmp_path):
    text = SCENARIO.replace(ACTION, SPEED.replace("VALUE", "48").replace("DIMENSION", "distance"))
    _, frames, records = play(written(tmp_path, text), 8.0)
    record = records["aside"]
    first, last = (frames[round(t / STEP)].find("car") for t in (record.begun, record.ended))
    assert (first.speed, last.speed) == (pytest.approx(9.0), pytest.approx(15.0))
    assert last.x - first.x == pytest.approx(48.0, abs=1.5)


def test_a_change_of_speed_at_no_rate_changes_nothing(tmp_path):
    text = SCENARIO.replace(ACTION, SPEED.replace("VALUE", "0.0").replace("DIMENSION", "rate"))
    _, frames, records = play(written(tmp_path, text), 4.0)
    assert records["aside"].ended is None
    assert {frame.find("car").speed for frame in frames} == {9.0}


@pytest.mark.parametrize(
    ("position", "x", "y"),
    [
        ('<RelativeObjectPosition entityRef="Hero" dx="30" dy="4"/>', 130.0, -2.0),
        ('<RelativeWorldPosition entityRef="Hero" dx="25" dy="4"/>', 125.0, -2.0),
        ('<RelativeLanePosition entityRef="Hero" dLane="1" dsLane="20"/>', 120.0, -2.0),
    ],
)
def test_a_place_beside_an_entity(tmp_path, position, x, y):
    _, frames, _ = play(written(tmp_path, SCENARIO.replace(RELATIVE, position)), 1.0)
    car = frames[0].find("car")
    # Its center is 1.5 m before the reference point.
    assert (car.x, car.y) == pytest.approx((x + 1.5, y), abs=0.01)
    assert frames[-1].find("car").lane == 1


@pytest.mark.parametrize("tag", ["RelativeObjectPosition", "RelativeWorldPosition"])
def test_a_place_beside_itself_is_refused(tmp_path, tag):
    text = SCENARIO.replace(RELATIVE, f'<{tag} entityRef="car" dx="30" dy="4"/>')
    with pytest.raises(InputError, match="the position refers to itself"):
        play(written(tmp_path, text), 0.1)


def test_a_selection_of_entities_acts_and_triggers(tmp_path):
    text = SCENARIO.replace(
        "</Entities>",
        '<EntitySelection name="all"><Members><EntityRef entityRef="car"/></Members>'
        "</EntitySelection></Entities>",
    )
    text = text.replace(
        '<Actors><EntityRef entityRef="car"/>', '<Actors><EntityRef entityRef="all"/>'
    )
    text = text.replace('<Private entityRef="car">', '<Private entityRef="all">')
    _, frames, _ = play(written(tmp_path, text), 6.0)
    car = [frame.find("car") for frame in frames]
    assert car[-1].offset - car[0].offset == pytest.approx(1.5, abs=1e-6)


def test_what_has_no_effect_is_said_and_other_events_go_on(tmp_path):
    hidden = '<VisibilityAction graphics="false" traffic="true" sensors="false"/>'
    text = SCENARIO.replace(
        "</Event>",
        '</Event><Event name="hide" priority="parallel"><Action name="y"><PrivateAction>'
        f"{hidden}</PrivateAction></Action></Event>",
    )
    text = text.replace(
        "</PrivateAction></Private></Actions>",
        "</PrivateAction><PrivateAction><ControllerAction/></PrivateAction></Private></Actions>",
    )
    text = text.replace(
        "</RoadNetwork>",
        "<TrafficSignals><TrafficSignalController/></TrafficSignals></RoadNetwork>",
    )
    path = written(tmp_path, text)
    notes = "; ".join(read_scenario(path).notes)
    assert "ControllerAction of car, VisibilityAction of car" in notes
    assert "TrafficSignals" in notes
    _, _, records = play(path, 3.0)
    assert records["aside"].begun == pytest.approx(1.1)
    assert records["hide"].ended is not None


CATALOG = """<OpenSCENARIO><FileHeader revMajor="1" revMinor="0"/><Catalog name="Cars">
<Vehicle name="long" vehicleCategory="car"><ParameterDeclarations>
<ParameterDeclaration name="long" value="5"/></ParameterDeclarations>
<BoundingBox><Center x="1.5" y="0" z="1"/><Dimensions length="$long" width="2" height="1.5"/>
</BoundingBox></Vehicle></Catalog></OpenSCENARIO>"""


@pytest.mark.parametrize(
    ("folder", "reference", "words"),
    [
        ("cars", "Cars long long", None),
        ("cars", "Cars lon long", "catalog 'Cars' has no entry 'lon' (did you mean long?)"),
        ("cars", "Cras long long", "the CatalogLocations have no catalog 'Cras'"),
        ("caars", "Cars long long", "caars of the CatalogLocations does not exist"),
        ("cars", "Cars long size", "there is no parameter 'size'; it has long"),
    ],
)
def test_a_vehicle_of_a_catalog_and_mistyped_ones(tmp_path, folder, reference, words):
    (tmp_path / "cars").mkdir()
    (tmp_path / "cars" / "cars.xosc").write_text(CATALOG)
    catalog, entry, parameter = reference.split()
    text = SCENARIO.replace(
        "<RoadNetwork>",
        f'<CatalogLocations><VehicleCatalog><Directory path="{folder}"/></VehicleCatalog>'
        "</CatalogLocations><RoadNetwork>",
    ).replace(
        f'<Vehicle vehicleCategory="car">{BODY}</Vehicle>',
        f'<CatalogReference catalogName="{catalog}" entryName="{entry}"><ParameterAssignments>'
        f'<ParameterAssignment parameterRef="{parameter}" value="7.5"/></ParameterAssignments>'
        "</CatalogReference>",
    )
    if words is None:
        assert play(written(tmp_path, text), 0.1)[1][0].find("car").length == 7.5
        return
    with pytest.raises(InputError, match=re.escape(words)) as raised:
        play(written(tmp_path, text), 0.1)
    assert "<CatalogReference>" in str(raised.value)


def test_variables_are_modified_and_monitors_set(tmp_path):
    step = (
        '<Action name="n"><GlobalAction><VariableAction variableRef="n"><ModifyAction><Rule>'
        '<{} value="{}"/></Rule></ModifyAction></VariableAction></GlobalAction></Action>'
    )
    text = SCENARIO.replace(
        "<RoadNetwork>",
        '<VariableDeclarations><VariableDeclaration name="n" variableType="double" value="3"/>'
        '</VariableDeclarations><MonitorDeclarations><MonitorDeclaration name="ok" value="false"/>'
        "</MonitorDeclarations><RoadNetwork>",
    )
    # (3 + 1) * 2 = 8.
    when = (
        '<StartTrigger><ConditionGroup><Condition name="v"><ByValueCondition><VariableCondition '
        'variableRef="n" value="{}" rule="equalTo"/></ByValueCondition></Condition>'
        "</ConditionGroup></StartTrigger>"
    )
    events = [
        ("more", step.format("AddValue", 1), ""),
        ("twice", step.format("MultiplyByValue", 2), when.format(4)),
        (
            "seen",
            '<Action name="o"><GlobalAction><SetMonitorAction monitorRef="ok" value="true"/>'
            "</GlobalAction></Action>",
            when.format(8),
        ),
    ]
    made = "".join(
        f'<Event name="{name}" priority="override">{action}{trigger}</Event>'
        for name, action, trigger in events
    )
    _, _, records = play(written(tmp_path, text.replace("</Event>", f"</Event>{made}")), 2.0)
    begun = [records[name].begun for name, *_ in events]
    assert begun == sorted(begun)
    assert records["seen"].event.variable == "monitor ok"


def test_a_distance_to_a_place_that_moves_with_an_entity(tmp_path):
    condition = """<ByEntityCondition><TriggeringEntities triggeringEntitiesRule="any">
<EntityRef entityRef="car"/></TriggeringEntities><EntityCondition><DistanceCondition value="20"
freespace="false" rule="lessThan"><Position><RelativeObjectPosition entityRef="Hero" dx="DX"
dy="0"/></Position></DistanceCondition></EntityCondition></ByEntityCondition>"""
    time = '<ByValueCondition><SimulationTimeCondition value="1" rule="greaterThan"/>'
    text = SCENARIO.replace(f"{time}</ByValueCondition>", condition)
    text = text.replace(f"\n{time}</ByValueCondition>", condition)
    assert "DistanceCondition" in text
    # The truck, 11 m/s faster, comes from 30 m behind.
    _, _, records = play(written(tmp_path, text.replace("DX", "0")), 4.0)
    assert 0.5 < records["aside"].begun < 2.0
    with pytest.raises(InputError, match="moves with an entity is read where the entity is"):
        play(written(tmp_path, text.replace("DX", "5")), 0.1)


def test_a_linear_lane_offset_without_a_bound(tmp_path):
    linear = ACTION.replace('"sinusoidal"\nmaxLateralAcc="2"', '"linear"')
    _, frames, records = play(written(tmp_path, SCENARIO.replace(ACTION, linear)), 8.0)
    rows = [frame.find("car") for frame in frames]
    assert rows[-1].offset - rows[0].offset == pytest.approx(1.5, abs=1e-6)
    steps = {round(b.offset - a.offset, 4) for a, b in itertools.pairwise(rows)}
    assert len(steps - {0.0}) <= 3
    assert records["aside"].ended is not None


STOP = """</StartTrigger><StopTrigger><ConditionGroup><Condition name="c" conditionEdge="none"
delay="0"><ByValueCondition><SimulationTimeCondition value="TIME" rule="greaterThan"/>
</ByValueCondition></Condition></ConditionGroup></StopTrigger></Act>"""
LATER = """<Event name="later" priority="parallel"><Action name="z"><PrivateAction>ACTION
</PrivateAction></Action><StartTrigger><ConditionGroup><Condition name="c" delay="0">
<ByValueCondition><SimulationTimeCondition value="3" rule="greaterThan"/></ByValueCondition>
</Condition></ConditionGroup></StartTrigger></Event></Maneuver>"""


@pytest.mark.parametrize(("time", "begins"), [(2.0, False), (5.0, True)])
def test_events_of_an_act_that_has_stopped_do_not_begin(tmp_path, time, begins):
    text = SCENARIO.replace("</Maneuver>", LATER.replace("ACTION", ACTION))
    text = text.replace("</StartTrigger></Act>", STOP.replace("TIME", str(time)))
    _, _, records = play(written(tmp_path, text), 6.0)
    assert records["aside"].begun == pytest.approx(1.1)
    assert ("later" in records) is begins


def test_the_way_back_to_the_center_lasts_as_long_as_the_way_out(tmp_path):
    back = ACTION.replace('value="1.5"', 'value="0"')
    late = LATER.replace('value="3"', 'value="5"').replace("ACTION", back)
    text = SCENARIO.replace("</Maneuver>", late)
    _, frames, records = play(written(tmp_path, text), 10.0)
    out, home = (records[name].ended - records[name].begun for name in ("aside", "later"))
    assert home == pytest.approx(out, abs=0.11)
    assert out == pytest.approx(math.sqrt(0.5 * math.pi**2 * 1.5 / 2.0), abs=0.11)
    first, last = frames[0].find("car"), frames[-1].find("car")
    assert last.offset == pytest.approx(first.offset, abs=1e-6)


def test_attributes_that_files_leave_out(tmp_path):
    text = SCENARIO.replace(' conditionEdge="none"', "").replace(
        '<Maneuver name="m">', "<Maneuver>"
    )
    text = text.replace('name="V"', 'name="$V"')
    _, _, records = play(written(tmp_path, text), 3.0)
    assert records["aside"].begun == pytest.approx(1.1)


def test_criteria_of_tests_do_not_stop_a_drive(tmp_path):
    criterion = """</Story><StopTrigger><ConditionGroup><Condition name="criteria_CollisionTest"
delay="0" conditionEdge="rising"><ByValueCondition><ParameterCondition parameterRef="" value=""
rule="lessThan"/></ByValueCondition></Condition></ConditionGroup></StopTrigger>"""
    path = written(tmp_path, SCENARIO.replace("</Story>", criterion))
    _, _, records = play(path, 3.0)
    assert "end_drive" not in records
    assert any("criteria_CollisionTest" in note for note in read_scenario(path).notes)


def test_an_environment_changes_in_a_story(tmp_path):
    weather = """<Event name="rain" priority="parallel"><Action name="z"><GlobalAction>
<EnvironmentAction><Environment name="e"><RoadCondition frictionScaleFactor="0.4"/></Environment>
</EnvironmentAction></GlobalAction></Action><StartTrigger><ConditionGroup><Condition name="c"
delay="0"><ByValueCondition><SimulationTimeCondition value="2" rule="greaterThan"/>
</ByValueCondition></Condition></ConditionGroup></StartTrigger></Event></Maneuver>"""
    scenario = read_scenario(written(tmp_path, SCENARIO.replace("</Maneuver>", weather)))
    route = RoadMap.from_opendrive(tmp_path / "road.xodr").route(along=scenario.route)
    frictions = [event for event in scenario.events(route) if event.kind == "friction"]
    assert [event.friction for event in frictions] == pytest.approx(
        [0.5 * DEFAULT_FRICTION, 0.4 * DEFAULT_FRICTION]
    )
    _, _, records = play(written(tmp_path, SCENARIO.replace("</Maneuver>", weather)), 3.0)
    assert records["rain"].begun == pytest.approx(2.1)


@pytest.mark.parametrize(
    ("displacement", "gap"), [("leadingReferencedEntity", 20.0), ("trailingReferencedEntity", 9.0)]
)
def test_a_vehicle_starts_at_its_distance(tmp_path, displacement, gap):
    # A time gap of 1 s of the one behind: the truck at 20 m/s, or the car at 9 m/s.
    action = f"""<PrivateAction><LongitudinalAction><LongitudinalDistanceAction entityRef="Hero"
freespace="true" continuous="false" timeGap="1" displacement="{displacement}"/>
</LongitudinalAction></PrivateAction></Private></Actions>"""
    text = SCENARIO.replace("</Private></Actions>", action)
    start, frames, _ = play(written(tmp_path, text), 0.2)
    car, front = frames[0].find("car"), start.station + TRUCK.front_overhang
    if displacement == "leadingReferencedEntity":
        found = car.station - 0.5 * car.length - front
    else:  # behind the body of the file's ego, 5 m long
        found = front - 5.0 - car.station - 0.5 * car.length
    assert found == pytest.approx(gap, abs=0.02)


def test_an_entity_without_a_place_is_left_out(tmp_path):
    extra = f'<ScenarioObject name="lost"><Vehicle vehicleCategory="car">{BODY}</Vehicle>'
    text = SCENARIO.replace("</Entities>", f"{extra}</ScenarioObject></Entities>")
    path = written(tmp_path, text)
    assert "without a place, and so left out: lost" in read_scenario(path).notes
    _, frames, _ = play(path, 0.5)
    assert frames[-1].find("lost") is None


def test_a_truth_value_that_is_none_is_refused(tmp_path):
    change = (
        SPEED.replace("VALUE", "3")
        .replace("DIMENSION", "time")
        .replace(
            '<AbsoluteTargetSpeed value="15"/>',
            '<RelativeTargetSpeed entityRef="Hero" value="1" continuous="maybe"/>',
        )
    )
    with pytest.raises(InputError, match="continuous = 'maybe' is neither true nor false"):
        play(written(tmp_path, SCENARIO.replace(ACTION, change)), 0.1)


def test_the_ego_may_start_beside_another_entity(tmp_path):
    text = SCENARIO.replace(
        '<LanePosition roadId="1" laneId="-2" s="100"/>',
        '<RelativeLanePosition entityRef="car" dLane="-1" ds="-40"/>',
    ).replace(RELATIVE, '<LanePosition roadId="1" laneId="-1" s="200"/>')
    start, frames, _ = play(written(tmp_path, text), 0.2)
    assert (start.lane, frames[0].find("car").lane) == (0, 1)
    assert start.station + TRUCK.front_overhang == pytest.approx(160.0 + 4.0)


def test_a_vehicle_is_placed_elsewhere_in_a_story(tmp_path):
    place = '<TeleportAction><Position><LanePosition roadId="1" laneId="-2" s="400" offset="0.5"/>'
    text = SCENARIO.replace(ACTION, f"{place}</Position></TeleportAction>")
    _, frames, records = play(written(tmp_path, text), 3.0)
    begun = round(records["aside"].begun / STEP)
    before, after, last = (frames[k].find("car") for k in (begun - 1, begun, -1))
    assert (before.lane, after.lane) == (1, 0)
    # Its center is 1.5 m before the reference point; it drives on as fast as before.
    assert (after.x, after.y) == pytest.approx((401.5, -5.5), abs=0.01)
    assert last.x - after.x == pytest.approx(9.0 * STEP * (len(frames) - 1 - begun), abs=0.01)
    with pytest.raises(InputError, match="LanePosition>: road '1' has no lane 3"):
        play(written(tmp_path, text.replace('laneId="-2" s="400"', 'laneId="3" s="400"')), 0.1)


def test_an_event_begins_where_two_entities_touch(tmp_path):
    condition = """<ByEntityCondition><TriggeringEntities triggeringEntitiesRule="any">
<EntityRef entityRef="car"/></TriggeringEntities><EntityCondition><CollisionCondition>
<EntityRef entityRef="Hero"/></CollisionCondition></EntityCondition></ByEntityCondition>"""
    time = """<ByValueCondition><SimulationTimeCondition value="1" rule="greaterThan"/>
</ByValueCondition>"""
    time = next(t for t in (time, time.replace("\n", "")) if t in SCENARIO)
    text = SCENARIO.replace(time, condition).replace('dLane="1" ds="30"', 'dLane="0" ds="30"')
    _, _, records = play(written(tmp_path, text), 4.0)
    # 25 m between the truck at 20 m/s and the car at 9 m/s, which have the same lane.
    assert records["aside"].begun == pytest.approx(25.0 / 11.0, abs=0.11)


PROFILE = """<LongitudinalAction><SpeedProfileAction followingMode="follow" entityRef="Hero">
<DynamicConstraints maxAcceleration="2" maxDeceleration="4" maxAccelerationRate="10"/>
<SpeedProfileEntry speed="-5"/></SpeedProfileAction></LongitudinalAction>"""


def test_a_speed_profile_has_the_limits_of_the_file(tmp_path):
    _, frames, records = play(written(tmp_path, SCENARIO.replace(ACTION, PROFILE)), 8.0)
    speeds = [frame.find("car").speed for frame in frames]
    assert speeds[-1] == pytest.approx(15.0)
    steps = [(b - a) / STEP for a, b in itertools.pairwise(speeds)]
    assert max(steps) == pytest.approx(2.0, abs=0.01)
    assert max(abs(b - a) / STEP for a, b in itertools.pairwise(steps)) < 10.0 + 1e-6
    # 6 m/s at 2 m/s2, and 0.2 s until the acceleration is reached.
    record = records["aside"]
    assert record.ended - record.begun == pytest.approx(3.2, abs=0.21)


@pytest.mark.parametrize("mode", ["follow", "position"])
@pytest.mark.parametrize("base", [0.0, 20.0])
def test_a_speed_profile_of_several_entries_is_followed_by_time(tmp_path, mode, base):
    entries = "".join(
        f'<SpeedProfileEntry speed="{speed - base:g}" time="{time:g}"/>'
        for speed, time in ((15.0, 2.0), (15.0, 1.0), (5.0, 2.5))
    )
    # Differences are to the speed of the truck, 20 m/s.
    text = PROFILE.replace('<SpeedProfileEntry speed="-5"/>', entries).replace("follow", mode)
    text = text.replace("followingMode", "followingMode", 1)
    text = text if base else text.replace(' entityRef="Hero"', "")
    _, frames, records = play(written(tmp_path, SCENARIO.replace(ACTION, text)), 9.0)
    record = records["aside"]
    assert record.ended - record.begun == pytest.approx(5.5, abs=0.11)
    first = round(record.begun / STEP)
    for after, speed in (
        (0.0, 9.0),
        (1.0, 12.0),
        (2.0, 15.0),
        (3.0, 15.0),
        (4.0, 11.0),
        (6.0, 5.0),
    ):
        assert frames[first + round(after / STEP)].find("car").speed == pytest.approx(
            speed, abs=0.61
        )
    assert frames[-1].find("car").speed == pytest.approx(5.0)


def test_a_speed_profile_without_a_time_in_each_of_its_entries_is_refused(tmp_path):
    extra = '<SpeedProfileEntry speed="3" time="1"/></SpeedProfileAction>'
    text = PROFILE.replace("</SpeedProfileAction>", extra)
    with pytest.raises(InputError, match="a time in each of several entries"):
        play(written(tmp_path, SCENARIO.replace(ACTION, text)), 0.1)


COMMAND = '<Action name="x"><UserDefinedAction><CustomCommandAction type="TYPE">TEXT'


@pytest.mark.parametrize(
    ("kind", "text", "found"),
    [
        ("iits_mj", '{"event": "swerve", "actor": "car", "offset": 1.0}', "swerve"),
        ("iits_mj", '{"event": "speed_limit", "limit": 9.0}', None),
        ("another", "anything", None),
        ("iits_mj", "anything", "is no table of an event as JSON"),
        ("iits_mj", '{"event": "swerve", "actor": "car"}', "swerve: offset is missing"),
    ],
)
def test_commands_of_the_package_are_events(tmp_path, kind, text, found):
    command = COMMAND.replace("TYPE", kind).replace("TEXT", text.replace('"', "&quot;"))
    action = f"{command}</CustomCommandAction></UserDefinedAction></Action>"
    old = f'<Action name="x"><PrivateAction>\n{ACTION}</PrivateAction></Action>'
    assert old in SCENARIO
    path = written(tmp_path, SCENARIO.replace(old, action))
    if found is not None and found != "swerve":
        with pytest.raises(InputError, match=f"<CustomCommandAction>|<UserDefined.*: {found}"):
            play(path, 2.0)
        return
    _, _, records = play(path, 2.0)
    assert ("aside" in records) is (found is not None)
    noted = "CustomCommandAction of aside" in "; ".join(read_scenario(path).notes)
    assert noted is (found is None)
