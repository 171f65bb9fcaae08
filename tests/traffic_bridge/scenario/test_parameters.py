"""Parameters of scenarios: declared in files, used by events, assigned from outside."""

import re

import pytest

from iits_mj.core.errors import InputError
from iits_mj.road import RoadMap
from iits_mj.simulation import DriveConfig
from iits_mj.simulation.parts import configured_events
from tests.traffic_bridge.scenario.test_openscenario import SCENARIO, play, written
from traffic_bridge import TrafficConfig
from traffic_bridge.scenario.openscenario import read_scenario
from traffic_bridge.scenario.openscenario_parameters import (
    declared_parameters,
    read_distribution,
)
from traffic_bridge.scenario.parameters import assignments, evaluate
from traffic_bridge.scenario.reading import read_events, read_parameters

EVENTS = """
[parameters]
gap = {default = 15.0, unit = "m", low = 2.0, high = 60.0}
lane = 1
kind = "car"
seen = true

[[events]]
event = "place_vehicle"
name = "car"
gap = "-$gap"
relative_lane = "$lane"
type = "$kind"
reactive = "$seen"

[[events]]
event = "cut_in"
actor = "car"
when = [{measure = "ahead", to = "car", above = "${$gap / 2 - 3}"}]
"""


@pytest.fixture
def file(tmp_path):
    path = tmp_path / "events.toml"
    path.write_text(EVENTS)
    return path


def test_events_use_the_defaults_of_the_parameters(file):
    place, cut_in = read_events(file)
    assert (place.gap, place.relative_lane, place.type, place.reactive) == (-15.0, 1, "car", True)
    assert cut_in.when[0][0].above == 4.5


def test_a_given_value_replaces_a_default_also_in_conditions_and_expressions(file):
    given = {"gap": "20", "lane": "-2", "kind": "van", "seen": "false"}
    place, cut_in = read_events(file, given)
    assert (place.gap, place.relative_lane, place.type, place.reactive) == (-20.0, -2, "van", False)
    assert isinstance(place.relative_lane, int)
    assert cut_in.when[0][0].above == 7.0


def test_an_expression_of_whole_parameters_with_a_whole_value_is_whole(tmp_path):
    path = tmp_path / "e.toml"
    path.write_text(
        '[parameters]\nlane = 1\n[[events]]\nevent = "place_vehicle"\ngap = 5.0\nname = "a"\n'
        'relative_lane = "${$lane + 1}"\n'
    )
    assert read_events(path)[0].relative_lane == 2


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"gop": "1"}, "there is no parameter 'gop' (did you mean gap?); it has gap, lane, kind"),
        ({"gap": "61"}, "parameter gap = 61 m: allowed is >= 2.0 and <= 60.0 m"),
        ({"gap": "nan"}, "gap = 'nan' is not a finite number"),
        ({"gap": "inf"}, "gap = 'inf' is not a finite number"),
        ({"gap": "wide"}, "gap = 'wide' is not a finite number"),
        ({"lane": "1.5"}, "lane = '1.5' is not a whole number: its default 1 is one"),
        ({"seen": "1"}, "seen = '1' is not true or false"),
        ({"kind": "tram"}, "'tram'"),
    ],
)
def test_a_value_that_is_not_allowed_is_refused(file, given, words):
    # The type of a vehicle is checked where the traffic is made.
    with pytest.raises(InputError, match=re.escape(words)):
        TrafficConfig(events=read_events(file, given))


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        (
            '{default = 15.0, unit = "m", low',
            '{unit = "m", low',
            "parameter gap: default is missing",
        ),
        ("default = 15.0", "default = nan", "parameter gap: default = nan: a number, text or flag"),
        ("default = 15.0", "default = 1.0", "gap = 1.0 m: allowed is >= 2.0"),
        ("low = 2.0", "least = 2.0", "parameter gap: 'least' is unknown"),
        ("low = 2.0", 'low = "a"', "parameter gap: low = 'a': only numbers"),
        ('"-$gap"', '"-$gop"', "event 1: parameter $gop is not declared (did you mean gap?)"),
        ('"-$gap"', '"$gap + 1"', "event 1: '$gap + 1': write an expression of parameters as ${"),
        ("${$gap / 2 - 3}", "${__import__(1)}", "event 2: '__import__(1)' is no expression"),
        ("${$gap / 2 - 3}", "${$gap / 0}", "'$gap / 0' is no expression of numbers"),
        ("${$gap / 2 - 3}", "${pow(10, 400)}", "is no expression of numbers"),
        ('type = "$kind"', 'type = "car"', 'no event uses the parameter kind: write "$kind"'),
        ("lane = 1", '"a b" = 1', "parameter 'a b': a name has letters, digits and underscores"),
        ("[parameters]", "[[parameters]]", "'parameters' must be a table [parameters]"),
        ("lane = 1\n", "lane = 1\nlane = 2\n", "it is not TOML"),
    ],
)
def test_a_wrong_file_is_refused_with_the_place(file, old, new, words):
    assert old in EVENTS
    file.write_text(EVENTS.replace(old, new, 1))
    with pytest.raises(InputError, match=re.escape(words)) as raised:
        read_events(file)
    assert "events.toml" in str(raised.value)


@pytest.mark.parametrize(
    ("texts", "words"),
    [
        (("gap=1", "gap=2"), "param gap is given twice: 1 and 2"),
        (("gap",), "param 'gap': use NAME=VALUE"),
        (("=1",), "use NAME=VALUE"),
        (("gap=",), "use NAME=VALUE"),
        ("gap=1", "a sequence of texts"),
    ],
)
def test_assignments_of_another_form_are_refused(texts, words):
    with pytest.raises(InputError, match=re.escape(words)):
        assignments(texts)
    with pytest.raises(InputError, match=re.escape(words)):
        DriveConfig(events="e.toml", param=texts)


def test_a_parameter_needs_a_scenario():
    with pytest.raises(InputError, match="param sets a parameter of events or a scenario"):
        DriveConfig(param=("gap=1",))


def test_expressions_are_those_of_openscenario():
    assert evaluate("-$a + 2 * pow($b, 2) % 5", {"a": 1.0, "b": 2}) == 2.0
    assert evaluate("floor(sqrt(10)) + ceil(0.2) - round(1.6)", {}) == 2.0


# --- OpenSCENARIO -----------------------------------------------------------------------------

DECLARED = SCENARIO.replace(
    '<ParameterDeclaration name="V" value="20"/>',
    """<ParameterDeclaration name="V" parameterType="double" value="20"><ConstraintGroup>
<ValueConstraint rule="greaterThan" value="0"/><ValueConstraint rule="lessOrEqual" value="40"/>
</ConstraintGroup><ConstraintGroup><ValueConstraint rule="equalTo" value="50"/></ConstraintGroup>
</ParameterDeclaration>""",
)


def test_a_parameter_of_an_openscenario_file_moves_its_vehicles(tmp_path):
    path = written(tmp_path, DECLARED)
    _, frames, _ = play(path, 0.1)
    scenario = read_scenario(path, None, {"V": "30"})
    before = frames[0].find("car").speed
    route = scenario.map
    assert before == 9.0  # V / 2 - 1
    assert route.name == "road.xodr"
    road = RoadMap.from_opendrive(route).route()
    placed = {e.name: e for e in scenario.events(road) if e.kind == "place_vehicle"}
    assert placed["car"].speed == 14.0


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"V": "41"}, "parameter V = 41: allowed is > 0.0 and <= 40.0, or = 50.0"),
        ({"V": "fast"}, "parameter V = 'fast' is not a finite number"),
        ({"X": "1"}, "there is no parameter 'X'"),
    ],
)
def test_values_outside_the_constraints_of_a_declaration_are_refused(tmp_path, given, words):
    path = written(tmp_path, DECLARED)
    assert read_scenario(path, None, {"V": "50"}).ego == "Hero"
    with pytest.raises(InputError, match=re.escape(words)):
        read_scenario(path, None, given)


def test_the_types_of_declarations_are_kept(tmp_path):
    path = written(
        tmp_path,
        SCENARIO.replace(
            '<ParameterDeclaration name="V" value="20"/>',
            '<ParameterDeclaration name="V" parameterType="integer" value="20"/>'
            '<ParameterDeclaration name="on" parameterType="boolean" value="true"/>',
        ),
    )
    found = declared_parameters(path)
    assert {name: p.default for name, p in found.items()} == {"V": 20, "on": True, "W": "9.0"}


DISTRIBUTION = """<OpenSCENARIO><FileHeader revMajor="1" revMinor="2"/>
<ParameterValueDistribution><ScenarioFile filepath="a.xosc"/><Deterministic>
<DeterministicSingleParameterDistribution parameterName="V"><DistributionRange stepWidth="0.1">
<Range lowerLimit="0.1" upperLimit="0.7"/></DistributionRange>
</DeterministicSingleParameterDistribution>
<DeterministicSingleParameterDistribution parameterName="W"><DistributionSet>
<Element value="1"/><Element value="4"/></DistributionSet>
</DeterministicSingleParameterDistribution>
<DeterministicMultiParameterDistribution><ValueSetDistribution>
<ParameterValueSet><ParameterAssignment parameterRef="A" value="1"/>
<ParameterAssignment parameterRef="B" value="x"/></ParameterValueSet>
<ParameterValueSet><ParameterAssignment parameterRef="A" value="2"/>
<ParameterAssignment parameterRef="B" value="y"/></ParameterValueSet>
</ValueSetDistribution></DeterministicMultiParameterDistribution>
</Deterministic></ParameterValueDistribution></OpenSCENARIO>"""


def test_a_deterministic_distribution_is_read(tmp_path):
    path = tmp_path / "d.xosc"
    path.write_text(DISTRIBUTION)
    found = read_distribution(path)
    assert found.scenario == tmp_path / "a.xosc"
    ranged, listed, several = found.choices
    assert [each["V"] for each in ranged] == ["0.1", "0.2", "0.3", "0.4", "0.5", "0.6", "0.7"]
    assert listed == ({"W": "1"}, {"W": "4"})
    assert several == ({"A": "1", "B": "x"}, {"A": "2", "B": "y"})


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ('stepWidth="0.1"', 'stepWidth="0"', "needs a positive stepWidth"),
        ('lowerLimit="0.1"', 'lowerLimit="0.9"', "lowerLimit 0.9 <= upperLimit 0.7"),
        ('stepWidth="0.1"', 'stepWidth="1e-8"', "values: allowed are 1 to 10000"),
        ("DistributionSet>", "UserDefinedDistribution>", "this element is not supported"),
        ('<Element value="1"/><Element value="4"/>', "", "has 0 values"),
    ],
)
def test_other_distributions_are_refused_with_their_line(tmp_path, old, new, words):
    path = tmp_path / "d.xosc"
    assert old in DISTRIBUTION
    path.write_text(DISTRIBUTION.replace(old, new))
    with pytest.raises(InputError, match=re.escape(words)) as raised:
        read_distribution(path)
    assert "d.xosc: line " in str(raised.value)


STOCHASTIC = """<OpenSCENARIO><FileHeader revMajor="1" revMinor="2"/>
<ParameterValueDistribution><ScenarioFile filepath="a.xosc"/>
<Stochastic numberOfTestRuns="4000" randomSeed="7">
<StochasticDistribution parameterName="N"><NormalDistribution expectedValue="10" variance="4">
<Range lowerLimit="6" upperLimit="14"/></NormalDistribution></StochasticDistribution>
<StochasticDistribution parameterName="U"><UniformDistribution>
<Range lowerLimit="1" upperLimit="2"/></UniformDistribution></StochasticDistribution>
<StochasticDistribution parameterName="P"><PoissonDistribution expectedValue="3"/>
</StochasticDistribution>
<StochasticDistribution parameterName="S"><ProbabilityDistributionSet>
<Element value="a" weight="1"/><Element value="b" weight="3"/></ProbabilityDistributionSet>
</StochasticDistribution>
<StochasticDistribution parameterName="H"><Histogram>
<Bin weight="1"><Range lowerLimit="0" upperLimit="1"/></Bin>
<Bin weight="1"><Range lowerLimit="5" upperLimit="6"/></Bin></Histogram>
</StochasticDistribution></Stochastic></ParameterValueDistribution></OpenSCENARIO>"""


def test_a_stochastic_distribution_is_drawn_with_its_seed(tmp_path):
    path = tmp_path / "d.xosc"
    path.write_text(STOCHASTIC)
    (rows,) = read_distribution(path).choices
    assert rows == read_distribution(path).choices[0]
    assert len(rows) == 4000
    number = {name: [float(row[name]) for row in rows] for name in "NUPH"}
    mean = {name: sum(values) / len(rows) for name, values in number.items()}
    # Within four standard errors; the normal one has 0.95 of its variance within its range.
    assert mean["N"] == pytest.approx(10.0, abs=4 * 2 / 4000**0.5)
    assert mean["U"] == pytest.approx(1.5, abs=4 * 0.29 / 4000**0.5)
    assert mean["P"] == pytest.approx(3.0, abs=4 * 3**0.5 / 4000**0.5)
    assert 6.0 <= min(number["N"]) < 7.0 < 13.0 < max(number["N"]) <= 14.0
    assert {value.is_integer() for value in number["P"]} == {True}
    assert sum(row["S"] == "b" for row in rows) / 4000 == pytest.approx(0.75, abs=0.03)
    assert not any(1.0 < value < 5.0 for value in number["H"])
    path.write_text(STOCHASTIC.replace('randomSeed="7"', 'randomSeed="8"'))
    assert read_distribution(path).choices[0] != rows


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("NormalDistribution", "BetaDistribution", "<BetaDistribution>: this element is not sup"),
        ('lowerLimit="6"', 'lowerLimit="13.99999"', "has hardly any values from 14 to 14"),
        ('variance="4"', 'variance="-1"', "variance = -1: allowed is 0"),
        ('numberOfTestRuns="4000"', 'numberOfTestRuns="1e9"', "allowed is 1 to 10000"),
        ('weight="3"', 'weight="nan"', "weight = nan: allowed"),
    ],
)
def test_a_wrong_stochastic_distribution_is_refused(tmp_path, old, new, words):
    path = tmp_path / "d.xosc"
    assert old in STOCHASTIC
    path.write_text(STOCHASTIC.replace(old, new))
    with pytest.raises(InputError, match=re.escape(words)):
        read_distribution(path)


def test_a_scenario_has_no_distribution(tmp_path):
    assert read_distribution(written(tmp_path, SCENARIO)) is None


def test_a_file_of_events_beside_a_scenario_gets_the_parameters_that_it_declares(tmp_path, file):
    path = written(tmp_path, DECLARED)
    both = DriveConfig(events=file, scenario=path, param=("gap=20", "V=30"))
    assert configured_events(both)[0].gap == -20.0
    with pytest.raises(InputError, match="there is no parameter 'Z'"):
        configured_events(DriveConfig(events=file, scenario=path, param=("Z=1",)))
    assert list(read_parameters(file)) == ["gap", "lane", "kind", "seen"]
