import math

import numpy as np
import pytest

from iits_mj.bag.mcap_file import BagWriter, read_bag
from iits_mj.core.errors import InputError
from iits_mj.core.messages import EgoFootprint
from iits_mj.parameters import shipped_trucks
from iits_mj.render.recorded import Record
from iits_mj.simulation import DriveConfig, Observer, Simulation
from iits_mj.simulation.frame import read_signals
from iits_mj.web.track import Puppet, Track, TrackObserver, read_track
from tests.paths import outside
from traffic_bridge import Recording, RepSim


class Bodies(Observer):
    """Keeps the places of the truck's bodies."""

    def __init__(self, names):
        self.names, self.places = names, []

    def observe(self, simulation, frame):
        data = simulation.truck.data
        rows = [(data.body(n).xpos.copy(), data.body(n).xquat.copy()) for n in self.names]
        self.places.append(rows)


@pytest.fixture(scope="module")
def drive(tmp_path_factory):
    """A recording, a bag, the track and the bodies' places of one drive."""
    folder = tmp_path_factory.mktemp("drive")
    config = DriveConfig(duration=6.0, start_station=400.0, truck="a_double", density="sparse")
    with Simulation(config, record=True, visuals=False) as simulation:
        names = [unit.name for unit in simulation.truck.parameters.units]
        track, bodies = TrackObserver(simulation), Bodies(names)
        with BagWriter(folder / "bag", simulation) as bag:
            simulation.run([track, bodies, bag])
        simulation.save_recording(folder / "drive.npz")
    return folder, track.track, bodies


def test_recording_and_bag_give_the_track_of_the_drive(drive):
    folder, track, _ = drive
    assert track.duration == pytest.approx(6.0)
    for found in (
        Track.of(Recording.load(folder / "drive.npz")),
        Track.of(read_bag(folder / "bag")),
        read_track(folder / "drive.npz"),
        read_track(folder / "bag"),
    ):
        count = len(found.states)
        assert count >= 60
        assert found.states == track.states[:count]
        assert found.vehicles == track.vehicles[:count]
        assert found.payload == track.payload
        assert found.parameters.digest() == track.parameters.digest()


def test_a_recorded_drive_shows_the_lights_of_the_live_one(tmp_path):
    path = outside("xodr/esmini_fabriksgatan_traffic_lights.xodr")
    config = DriveConfig(map=path, duration=46.0, density="empty", start_speed=0.0)
    with Simulation(config, record=True, visuals=False, timestep=0.005) as simulation:
        live = TrackObserver(simulation)
        simulation.run([live])
        simulation.save_recording(tmp_path / "drive.npz")
    recording = Recording.load(tmp_path / "drive.npz")
    track = Track.of(recording, map_path=path)
    scenes = Record.of_recording(recording, config).scenes
    seen = set()
    for index in range(len(track.states)):
        own, found = live.track.scene(index).signals, track.scene(index).signals
        assert scenes[index].signals == found
        assert found.lamps == own.lamps
        assert (found.light.station, found.light.state) == (own.light.station, own.light.state)
        seen.add(own.light.state)
    assert own.lamps
    assert len(seen) > 1
    # A truck that drives among the recorded vehicles shows them, too.
    traffic = RepSim(simulation.route, recording)
    traffic.reset()
    for index in range(len(track.states) - 1):
        shown = read_signals(traffic, track.states[index], simulation.route, EgoFootprint())
        assert shown.lamps == track.signals[index].lamps
        assert shown.light is None
        traffic.step()


def test_every_unit_is_placed_where_it_drove(drive):
    _, track, bodies = drive
    puppet = Puppet(track)
    for index in (0, 20, len(track.states) - 1):
        data = puppet.place(index)
        for name, (place, quaternion) in zip(bodies.names, bodies.places[index], strict=True):
            body = data.body(name)
            # Springs move by centimeters; each coupling adds some.
            assert np.linalg.norm(body.xpos - place) < 0.12
            assert 2.0 * math.acos(min(abs(float(body.xquat @ quaternion)), 1.0)) < 0.02


def test_the_other_vehicles_are_placed_where_they_were(drive):
    _, track, _ = drive
    puppet = Puppet(track)
    data = puppet.place(30)
    x, y = track.vehicles[30].columns("x", "y")
    for k in range(len(x)):
        away = np.hypot(data.mocap_pos[:, 0] - x[k], data.mocap_pos[:, 1] - y[k])
        near = math.hypot(x[k] - track.states[30].x, y[k] - track.states[30].y) < 200.0
        assert not near or away.min() < 8.0  # a truck's bodies are not at its middle


def test_the_wheels_turn_with_the_distance(drive):
    _, track, _ = drive
    puppet = Puppet(track)
    model = puppet.truck.model
    spin = int(model.joint("tractor_axle1_left_spin").qposadr[0])
    first, second = (float(puppet.place(k).qpos[spin]) for k in (10, 11))
    radius = track.parameters.tires[track.parameters.axles[0].tire].rolling_radius
    assert math.remainder(
        second - first - 0.1 * track.states[10].speed / radius, 2.0 * math.pi
    ) == (pytest.approx(0.0, abs=0.05))


def test_another_map_is_refused(drive, tmp_path):
    with pytest.raises(InputError, match="built-in map"):
        read_track(drive[0] / "drive.npz", tmp_path / "other.xodr")


def test_another_truck_is_refused(drive):
    other = next(name for name in shipped_trucks() if name != "a_double")
    with pytest.raises(InputError, match="a_double"):
        read_track(drive[0] / "drive.npz", truck=other)


def test_a_track_without_states_is_refused(drive):
    _, track, _ = drive
    with pytest.raises(InputError, match="fewer than two"):
        Track("nothing", track.route, track.parameters, track.payload).check()
