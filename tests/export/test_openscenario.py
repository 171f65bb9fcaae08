import math
import re
from xml.etree import ElementTree

import numpy as np
import pytest

from iits_mj.cli import main
from iits_mj.core.errors import InputError
from iits_mj.export.openscenario import XoscLog, write_recording
from iits_mj.parameters import TruckParameters, shipped_trucks
from iits_mj.road import RoadMap
from iits_mj.simulation import DriveConfig, Simulation
from tests.export.checker import checked
from traffic_bridge import EventSim, Recording, TrafficConfig
from traffic_bridge.scenario.openscenario import read_scenario


@pytest.fixture(scope="module")
def scenario(drive, tmp_path_factory):
    path = tmp_path_factory.mktemp("scenario") / "braking.xosc"
    assert main(["export", str(drive), "--xosc", str(path)]) == 0
    return path


def places(recording, name):
    """x and y of a vehicle by frame."""
    return {
        k: (vehicle.x, vehicle.y)
        for k, frame in enumerate(recording.frames)
        if (vehicle := frame.find(name)) is not None
    }


def test_asams_checker_finds_no_issue_in_a_drive(scenario):
    assert checked(scenario) == []


def test_asams_checker_finds_a_wrong_reference(scenario, tmp_path):
    text = scenario.read_text().replace('Private entityRef="car"', 'Private entityRef="cart"')
    (tmp_path / "wrong.xosc").write_text(text)
    assert checked(tmp_path / "wrong.xosc")


def test_the_map_is_beside_the_scenario_byte_for_byte(scenario):
    named = ElementTree.parse(scenario).find("RoadNetwork/LogicFile").get("filepath")
    assert (scenario.parent / named).read_bytes() == RoadMap.builtin().path.read_bytes()


def test_the_same_recording_gives_the_same_file_but_for_its_date(drive, scenario, tmp_path):
    assert main(["export", str(drive), "--xosc", str(tmp_path / "braking.xosc")]) == 0
    without = [re.sub(r' date="[^"]*"', "", p.read_text()) for p in (
        scenario, tmp_path / "braking.xosc"
    )]  # fmt: skip
    assert without[0] == without[1]


def test_a_drive_in_the_exported_scenario_meets_the_same_car(drive, scenario, tmp_path):
    recorded = Recording.load(drive)
    config = DriveConfig(traffic_mode="none", scenario=scenario, duration=4.0)
    from iits_mj.simulation.parts import with_scenario

    with Simulation(with_scenario(config), record=True, visuals=False) as simulation:
        simulation.run()
        again = Recording.load(simulation.save_recording(tmp_path / "again.npz"))
    ours, theirs = places(recorded, "car"), places(again, "car")
    assert set(ours) == set(theirs) == set(range(41))
    assert max(math.dist(ours[k], theirs[k]) for k in ours) < 0.03
    # The truck starts where and as fast as it did.
    first, second = recorded.ego_at(0), again.ego_at(0)
    assert second.station == pytest.approx(first.station, abs=0.01)
    assert second.speed == pytest.approx(first.speed, abs=0.01)


def test_the_truck_has_its_trailer_on_its_hitch(scenario):
    root, units = ElementTree.parse(scenario), TruckParameters.load(None).units
    vehicles = {each.get("name"): each[0] for each in root.iter("ScenarioObject")}
    ego, trailer = vehicles["Ego"], vehicles["Ego trailer 1"]
    assert ego.find("Trailer/TrailerRef").get("entityRef") == "Ego trailer 1"
    assert trailer.get("vehicleCategory") == "semitrailer"
    # From the middle of the rear axles to the fifth wheel, and from the kingpin to the bogie.
    rear = np.mean([axle.position for axle in units[0].axles[1:]])
    hitch = float(ego.find("TrailerHitch").get("dx"))
    assert hitch == pytest.approx(rear - units[1].coupling.position, abs=1e-6)
    coupler = float(trailer.find("TrailerCoupler").get("dx"))
    assert coupler == pytest.approx(np.mean([a.position for a in units[1].axles]), abs=1e-6)


@pytest.mark.parametrize("name", shipped_trucks())
def test_every_shipped_truck_is_a_valid_entity(name, highway, tmp_path, comings_and_goings):
    parameters = TruckParameters.load(name)
    with_truck = _with_ego(comings_and_goings, highway, parameters)
    path, _ = write_recording(tmp_path / "truck.xosc", with_truck, parameters, highway)
    assert checked(path) == []
    names = [each.get("name") for each in ElementTree.parse(path).iter("ScenarioObject")]
    trailers = [f"Ego trailer {k}" for k in range(1, len(parameters.units))]
    assert names[: len(parameters.units)] == [*trailers, "Ego"]


def _with_ego(recording, route, parameters):
    import dataclasses

    from iits_mj.core.messages import EgoState
    from traffic_bridge.recording.rows import ego_row

    rear = len(parameters.units) - 2
    extra = (0.0,) * max(rear, 0)
    rows = []
    for time in recording.time.tolist():
        station = 300.0 + 20.0 * time
        point = route.evaluate(station, 0.0)
        rows.append(
            ego_row(
                EgoState(
                    time=time,
                    x=float(point.x),
                    y=float(point.y),
                    z=float(point.z),
                    yaw=float(point.heading),
                    speed=20.0,
                    station=station,
                    rear_articulations=extra,
                    rear_articulation_rates=extra,
                )
            )
        )
    return dataclasses.replace(recording, ego=np.array(rows))


def test_vehicles_come_and_leave_when_they_did(comings_and_goings, highway, tmp_path):
    path, _ = write_recording(tmp_path / "c.xosc", comings_and_goings, None, highway)
    assert checked(path) == []
    scenario = read_scenario(path, "lead")
    assert scenario.ego == "lead"
    events = [event for event in scenario.events(highway) if event.kind != "end_drive"]
    with EventSim(highway, TrafficConfig(density="empty", events=events)) as traffic:
        seen = {"van": [], "van 2": []}
        for step in range(101):
            vehicles = traffic.step(None) if step else traffic.reset(None)
            for name in seen:
                if (van := vehicles.find(name)) is not None:
                    seen[name].append(step)
                    assert van.kind == "van"
                    assert van.station == pytest.approx(450.0 + 2.5 * step, abs=0.05)
    assert seen["van"] == list(range(10, 31))
    assert seen["van 2"] == list(range(60, 101))


def test_a_vehicle_that_stands_is_read_back_where_it_stood(comings_and_goings, highway, tmp_path):
    path, _ = write_recording(tmp_path / "c.xosc", comings_and_goings, None, highway)
    scenario = read_scenario(path, "lead")
    (way,) = [e for e in scenario.events(highway) if e.kind == "follow_path" and e.actor == "car"]
    assert way.times[-1] == pytest.approx(10.0)
    assert math.dist(way.points[way.goal][:2], way.points[way.goal - 1][:2]) < 0.01


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--xosc", "a.xml"], "a.xml.*must end with .xosc"),
        (["--osi", "a.osi"], "a.osi.*must end with .mcap"),
        ([], "nothing to write: give --xosc FILE.xosc, --osi FILE.mcap, or both"),
        (["--xosc", "a.xosc", "--truck", "b_double"], "made with truck"),
        (["--xosc", "a.xosc", "--map", "missing.xodr"], "missing.xodr"),
    ],
)
def test_wrong_use_is_one_clear_line(drive, tmp_path, monkeypatch, capsys, arguments, message):
    monkeypatch.chdir(tmp_path)
    assert main(["export", str(drive), *arguments]) == 2
    assert re.search(message, capsys.readouterr().err)
    assert list(tmp_path.iterdir()) == []


def test_an_empty_recording_is_refused(highway, tmp_path):
    empty = Recording.of_frames({}, np.zeros(0), [])
    with pytest.raises(InputError, match="has 0 frames"):
        write_recording(tmp_path / "a.xosc", empty, None, highway)


def test_a_drive_writes_the_same_file_without_a_recording(drive, scenario, tmp_path):
    events = drive.parent / "events.toml"
    config = DriveConfig(traffic_mode="none", events=events, start_station=300.0, duration=4.0)
    path = tmp_path / "braking.xosc"
    with Simulation(config, visuals=False) as simulation, XoscLog(path, simulation) as log:
        simulation.run([log])
    texts = [re.sub(r' date="[^"]*"', "", p.read_text()) for p in (scenario, path)]
    assert texts[0] == texts[1]
