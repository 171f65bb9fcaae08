"""Pictures of recorded drives, without physics."""

from __future__ import annotations

import copy
import dataclasses
import math

import mujoco
import numpy as np
import pytest
from PIL import Image

from iits_mj import cli
from iits_mj.core.errors import InputError
from iits_mj.render.recorded import Record, RecordedDrive, times_of
from iits_mj.render.video import Pictures
from iits_mj.simulation import DriveConfig, Observer, Simulation
from iits_mj.simulation.redrive import recorded_config
from tests.render.scenes import standing
from traffic_bridge import Recording

pytestmark = pytest.mark.usefixtures("opengl")

SIZE = (320, 180)
CONFIG = DriveConfig(duration=2.0, start_station=900.0, seed=3)
TIMES = (0.0, 0.55, 1.0, 1.75)


def places_of(model, data):
    """Places of the bodies by name [m]."""
    return {model.body(body).name: data.xpos[body].copy() for body in range(model.nbody)}


class Live(Observer):
    """Keeps pictures, bodies and states of the drive as it goes on."""

    period = 0.05

    def __init__(self, pictures):
        self._pictures = pictures
        self.shown, self.places, self.states = {}, {}, {}

    def observe(self, simulation, frame):
        time, truck = round(frame.time, 2), simulation.truck
        # As in the process of a film, at the places of this instant.
        data = copy.copy(truck.data)
        mujoco.mj_kinematics(truck.model, data)
        mujoco.mj_camlight(truck.model, data)
        picture = self._pictures.draw(data, frame)
        if time in TIMES:
            self.shown[time] = picture.astype(int)
            self.places[time] = places_of(truck.model, data)
            self.states[time] = frame.ego


@pytest.fixture(scope="module")
def live(tmp_path_factory):
    path = tmp_path_factory.mktemp("drive") / "drive.npz"
    with Simulation(CONFIG, record=True) as simulation:
        with Pictures(simulation.truck, SIZE, overlay=False, plan=False) as pictures:
            kept = Live(pictures)
            simulation.run([kept])
        simulation.save_recording(path)
    return path, kept


def test_recorded_drive_looks_as_it_did_live(live):
    path, kept = live
    recording = Recording.load(path)
    config = recorded_config(recording, "recording", None, None)
    drive = RecordedDrive(Record.of_recording(recording, config))
    with Pictures(drive.truck, SIZE, overlay=False, plan=False) as pictures:
        times = np.arange(0.0, 1.8, 0.05).round(2)
        again, places = {}, {}
        for time in times:
            again[time] = pictures.draw(drive.data, drive.at(time))
            places[time] = places_of(drive.truck.model, drive.data)
    for time in TIMES:
        apart = np.abs(again[time].astype(int) - kept.shown[time]).max(axis=-1)
        assert apart.mean() < 3.0
        assert np.mean(apart > 25) < 0.03
        # Units and traffic are where they were; axles hang at rest.
        # The recording's pool has slots for road users that the drive cannot have, and parks its
        # free vehicles elsewhere under the ground.
        seen = {name: place for name, place in kept.places[time].items() if place[2] > -100.0}
        assert set(kept.places[time]) <= set(places[time])
        assert len(seen) > 20
        for name, place in seen.items():
            assert np.abs(places[time][name] - place).max() < 0.12, name


def test_state_between_two_records_is_between_them(live):
    path, kept = live
    recording = Recording.load(path)
    config = recorded_config(recording, "recording", None, None)
    drive = RecordedDrive(Record.of_recording(recording, config))
    frame = drive.at(0.55)
    then = kept.states[0.55]
    assert frame.ego.station == pytest.approx(then.station, abs=0.005)
    assert frame.ego.yaw == pytest.approx(then.yaw, abs=1e-3)
    assert frame.ego.engine_speed == pytest.approx(then.engine_speed, rel=0.02)
    assert frame.scene.time == pytest.approx(0.5)


def test_angles_turn_the_short_way():
    drive = standing(700.0, duration=1.0)
    states = [
        dataclasses.replace(drive.at(0.0).ego, time=time, yaw=yaw)
        for time, yaw in ((0.0, math.pi - 0.01), (1.0, -math.pi + 0.01))
    ]
    scene = drive.at(0.0).scene
    turned = RecordedDrive(Record(DriveConfig(), states, [scene])).at(0.5).ego.yaw
    assert abs(abs(turned) - math.pi) < 1e-6


def test_time_outside_the_recording_is_refused():
    drive = standing(700.0, duration=1.0)
    with pytest.raises(InputError, match="use 0 to 1 s"):
        drive.at(1.5)
    with pytest.raises(InputError, match="no states"):
        RecordedDrive(Record(DriveConfig(), [], []))


def test_times_are_whole_steps_of_the_physics():
    times = times_of(1.0, 2.0, 0.05)
    assert len(times) == 21
    np.testing.assert_allclose(times, 1.0 + 0.05 * np.arange(21), atol=1e-9)


def test_command_draws_a_film_and_a_picture(live, tmp_path, capsys):
    path, _ = live
    size = ("--size", "160x120", "--weather", "night")
    film, still = tmp_path / "film.mp4", tmp_path / "still.jpg"
    command = ["render", str(path), *size]
    assert cli.main([*command, "--out", str(film), "--end", "0.5", "--fps", "10"]) == 0
    assert film.stat().st_size > 1000
    assert cli.main([*command, "--out", str(still), "--start", "1", "--camera", "chase,top"]) == 0
    assert Image.open(still).size == (160, 120)
    assert capsys.readouterr().out == f"film: {film}\npicture: {still}\n"


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--out", "film.gif"], "must end in .mp4"),
        (["--start", "3"], "use 0 to 2 s"),
        (["--camera", "drone"], "chase"),
        (["--weather", "hail"], "low-sun"),
    ],
)
def test_wrong_use_is_one_line(live, tmp_path, monkeypatch, capsys, arguments, message):
    monkeypatch.chdir(tmp_path)
    assert cli.main(["render", str(live[0]), *arguments]) == 2
    error = capsys.readouterr().err
    assert message in error
    assert error.count("\n") == 1
    assert not list(tmp_path.glob("*.mp4"))
