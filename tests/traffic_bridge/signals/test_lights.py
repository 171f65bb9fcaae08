import pytest

from iits_mj.core.errors import InputError, TrafficError
from iits_mj.road import RoadMap
from tests.paths import outside
from traffic_bridge import LightOverride, LightPhase, LightProgramRun, PureSim, TrafficConfig

STOP_LINE = 104.75  # [m]: 9.5 m before the junction, clear of trucks that turn left into this road
POLE = 109.0  # [m], of the light in the map


@pytest.fixture(scope="module")
def junction():
    path = outside("xodr/esmini_fabriksgatan_traffic_lights.xodr")
    return RoadMap.from_opendrive(path).route()


@pytest.fixture
def traffic(junction):
    with PureSim(junction, TrafficConfig(density="empty")) as running:
        running.reset()
        yield running


def run(traffic, seconds):
    for _ in range(round(10 * seconds)):
        traffic.step()


def test_the_light_ahead_has_its_stop_line_and_the_time_to_its_change(traffic):
    signals = traffic.signals
    (light,) = signals.lights()
    ahead = signals.light_ahead(20.0)
    assert (ahead.name, ahead.letter, ahead.is_open) == (light, "r", False)
    assert ahead.station == pytest.approx(STOP_LINE, abs=0.5)
    assert ahead.station < POLE
    assert signals.state(light)[ahead.link] == "r"
    # The change has the predicted time and letter.
    run(traffic, ahead.next_switch - 0.2)
    assert signals.light_ahead(20.0).letter == "r"
    run(traffic, 0.3)
    found = signals.light_ahead(20.0)
    assert found.letter == ahead.next_letter
    assert found.is_open
    assert signals.light_ahead(STOP_LINE + 1.0) is None


def test_a_new_program_runs_through_its_phases(traffic):
    signals = traffic.signals
    (light,) = signals.lights()
    links = len(signals.state(light))
    former = signals.programs(light)
    phases = [LightPhase(4.0, "r" * links), LightPhase(2.0, "G" * links)]
    signals.define_program(light, "mine", phases)
    assert signals.programs(light) == (*former, "mine")
    assert signals.traffic_lights.program(light) == former[0]
    signals.run_program(light, "mine")
    assert signals.phases(light) == tuple(phases)
    seen = []
    for _ in range(120):
        traffic.step()
        seen.append(signals.light_ahead(0.0).letter)
    assert "".join(seen).replace("G" * 20, "+").replace("r" * 40, "-") == "-+-+"
    signals.run_program(light, former[0])
    assert signals.phases(light) == signals.phases(light, former[0])


def test_a_phase_can_be_selected_and_extended(traffic):
    signals = traffic.signals
    (light,) = signals.lights()
    signals.traffic_lights.set_phase(light, 2, duration=7.0)
    assert signals.phase(light) == 2
    assert signals.light_ahead(0.0).next_switch == pytest.approx(7.0)
    run(traffic, 6.8)
    assert signals.phase(light) == 2
    run(traffic, 0.4)
    assert signals.phase(light) == 3


def test_a_light_set_by_hand_has_no_predicted_change(traffic):
    signals = traffic.signals
    (light,) = signals.lights()
    signals.set_state(light, "G")
    ahead = signals.light_ahead(0.0)
    assert (ahead.letter, ahead.next_switch, ahead.next_letter) == ("G", None, None)
    assert signals.traffic_lights.program(light) is None
    with pytest.raises(InputError, match="was set by hand"):
        signals.phases(light)
    run(traffic, 100.0)
    assert signals.light_ahead(0.0).letter == "G"


def test_lights_follow_events_and_return_to_their_program(junction):
    red = LightOverride(light="4", state="r", at_time=2.0, until=5.0)
    mine = LightProgramRun(
        light="4", program="short", phases=((1.0, "G" * 12), (1.0, "y" * 12)), at_time=7.0
    )
    seen = ""
    with PureSim(junction, TrafficConfig(density="empty", events=(red, mine))) as traffic:
        traffic.reset()
        programs = []
        for _ in range(100):
            traffic.step()
            programs.append(traffic.signals.traffic_lights.program("4"))
            seen += traffic.signals.state("4")[0]
    assert programs == ["0"] * 20 + [None] * 30 + ["0"] * 20 + ["short"] * 30
    assert {seen[k] for k in range(20, 50)} == {"r"}
    assert {seen[k] for k in range(70, 100)} == {"G", "y"}


def test_vehicles_stop_before_the_stop_line_of_a_red_light(junction):
    config = TrafficConfig(
        density=0.2, speed_limit=10.0, events=(LightOverride(light="4", state="r"),)
    )
    with PureSim(junction, config, seed=1) as traffic:
        traffic.reset()
        for _ in range(400):
            vehicles = traffic.step()
            line = traffic.signals.light_ahead(0.0).station
        front = max(v.station + 0.5 * v.length for v in vehicles if v.speed < 0.1)
    assert line - 3.0 < front <= line


@pytest.mark.parametrize(
    ("event", "text"),
    [
        (LightOverride(light="9", state="r"), "event light_state: no traffic light '9' in the net"),
        (LightOverride(light="4", state="rr"), "state 'rr' of traffic light '4': 1 or 12 letters"),
        (LightProgramRun(light="4", program="night"), "program 'night' of traffic light '4'"),
    ],
)
def test_events_of_missing_lights_are_refused(junction, event, text):
    with (
        PureSim(junction, TrafficConfig(density="empty", events=(event,))) as traffic,
        pytest.raises(InputError, match=text),
    ):
        traffic.reset()


def test_wrong_use_of_a_light_is_refused_with_what_is_allowed(traffic):
    lights = traffic.signals.traffic_lights
    for wrong, text in [
        (lambda: lights.set_state("4", "xy"), "12 letters of"),
        (lambda: lights.set_phase("4", 9), "phase 9 .*: allowed is 0 to 3"),
        (lambda: lights.run_program("4", "9"), "program '9' .*: there are 0"),
        (lambda: lights.define_program("4", "0", [LightPhase(1.0, "r" * 12)]), "has a program"),
        (lambda: lights.define_program("4", "a", []), "has no phase"),
        (lambda: lights.define_program("4", "a", [LightPhase(1.0, "r")]), "12 letters"),
        (lambda: LightPhase(float("nan"), "r"), "nan: allowed is 0.1 to 3600"),
        (lambda: LightPhase(1.0, "z"), "letters of"),
        (lambda: lights.ahead(float("inf")), "must be a finite number"),
    ]:
        with pytest.raises(InputError, match=text):
            wrong()


def test_a_route_without_lights_has_none_ahead(straight):
    with PureSim(straight, TrafficConfig(density="empty")) as running:
        running.reset()
        assert running.signals.lights() == ()
        assert running.signals.light_ahead(0.0) is None


def test_a_light_held_by_two_events_shows_the_newer_one_and_ends_with_its_program(junction):
    nested = (
        LightOverride(light="4", state="G", at_time=0.5, until=1.0),
        LightOverride(light="4", state="y", at_time=0.6, until=0.8),
    )
    events = (
        *nested,
        LightOverride(light="4", state="r", at_time=2.0, until=4.0),
        LightOverride(light="4", state="G", at_time=3.0, until=6.0),
        LightProgramRun(
            light="4", program="short", phases=((1.0, "o" * 12),), at_time=5.0, until=7.0
        ),
        LightOverride(light="4", state="u", at_time=6.5, until=8.0),
    )
    with PureSim(junction, TrafficConfig(density="empty", events=events)) as traffic:
        traffic.reset()
        lights = traffic.signals.traffic_lights
        seen = ""
        for _ in range(90):
            traffic.step()
            seen += "-" if lights.program("4") == "0" else lights.state("4")[0]
    early = "-----GyyGG" + 10 * "-"
    assert seen == early + 10 * "r" + 20 * "G" + 15 * "o" + 15 * "u" + 10 * "-"


def test_a_light_set_by_hand_stays_when_an_event_before_it_ends(traffic):
    lights = traffic.signals.traffic_lights
    end = lights.hold_state("4", "r")
    lights.set_state("4", "G")
    end()
    assert lights.state("4") == "G" * 12


def test_a_selected_phase_is_followed_by_the_next_one(traffic):
    signals = traffic.signals
    phases = signals.phases("4")
    for number, phase in enumerate(phases):
        signals.set_phase("4", number, duration=0.4)
        assert (signals.phase("4"), signals.state("4")) == (number, phase.state)
        run(traffic, 0.5)
        assert signals.phase("4") == (number + 1) % len(phases)
    signals.set_state("4", "r")
    with pytest.raises(InputError, match="set by hand"):
        signals.phase("4")


@pytest.mark.parametrize("lane", ["a", 0.5, -1, True])
def test_light_ahead_refuses_an_impossible_lane(traffic, lane):
    with pytest.raises(InputError, match="must be a whole number from 0"):
        traffic.signals.light_ahead(0.0, lane=lane)


def test_lights_of_an_ended_run_can_be_neither_read_nor_set(junction):
    with PureSim(junction, TrafficConfig(density="empty")) as traffic:
        traffic.reset()
        signals = traffic.signals
        end = signals.traffic_lights.hold_state("4", "r")
        traffic.reset()
        for call in (
            end,
            lambda: signals.state("4"),
            lambda: signals.set_state("4", "r"),
            lambda: signals.phases("4"),
            lambda: signals.set_phase("4", 2),
            lambda: signals.run_program("4"),
            lambda: signals.light_ahead(0.0),
        ):
            with pytest.raises(TrafficError, match="belongs to a simulation that has ended"):
                call()
        assert traffic.signals.phase("4") == 0


def test_a_signal_shows_the_letter_of_its_way_and_people_walk_at_red(traffic):
    signals = traffic.signals
    (light,) = signals.lights()
    for letters, car, person in (
        ("r" * 12, "r", "G"),
        ("G" * 12, "G", "r"),
        ("y" * 12, "y", "r"),
    ):
        signals.set_state(light, letters)
        # 1 is the light beside the truck's lane, 2 and 3 are those of the crossing of its road.
        assert dict(signals.lamps()) == {"1": car, "2": person, "3": person}
        assert signals.light_ahead(20.0).letter == car
    # A turn that may go keeps people from walking; the light itself shows the way straight on.
    left = 8
    signals.set_state(light, "".join("g" if link == left else "r" for link in range(12)))
    assert dict(signals.lamps()) == {"1": "r", "2": "r", "3": "r"}
    assert signals.lamps() is signals.lamps()


def test_a_road_without_lights_has_no_lamps():
    with PureSim(RoadMap.builtin().route(), TrafficConfig(density="empty")) as running:
        running.reset()
        assert running.signals.lamps() == ()


def test_each_signal_shows_the_letter_of_the_lane_that_it_faces():
    path = outside("xosc/xodr/multi_intersections.xodr")
    route = RoadMap.from_opendrive(path).route()
    with PureSim(route, TrafficConfig(density="empty", scope="map")) as running:
        running.reset()
        signals = running.signals
        # Lights stand at the five junctions, not where two roads meet.
        assert len(signals.lights()) == 5
        for letter in "rG":
            for light in signals.lights():
                signals.set_state(light, letter)
            shown = dict(signals.lamps())
            # All four arms of the first junction: netconvert names the signals of two of them.
            for name in ("290", "291", "286", "281", "294", "295", "287", "288"):
                assert shown[name] == letter
