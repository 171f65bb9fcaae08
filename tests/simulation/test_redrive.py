"""A recorded drive is repeated from its commands, bit for bit or with the first difference."""

from __future__ import annotations

import dataclasses
import json
import math
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from iits_mj import cli
from iits_mj.core.errors import InputError
from iits_mj.simulation import DriveConfig, DriveFrame, Observer, Simulation
from iits_mj.simulation import drive_log as drive_log_module
from iits_mj.simulation.drive_log import check_options
from iits_mj.simulation.parts import load_map
from iits_mj.simulation.redrive import RedriveError, redrive
from traffic_bridge import PureSim, Recorder, Recording, RepSim, TrafficConfig

# A cruise uses the accelerator from the start.
CONFIG = DriveConfig(
    duration=4.0, density="dense", start_station=2500.0, seed=3, speed_planner="cruise"
)


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    with Simulation(CONFIG, record=True, visuals=False) as simulation:
        simulation.run()
        return simulation.save_recording(tmp_path_factory.mktemp("drive") / "drive")


def edited(path: Path, **changes: Any) -> Recording:
    """Returns the recording with other arrays or entries of its meta."""
    recording = Recording.load(path)
    meta = recording.meta | changes.pop("meta", {})
    return dataclasses.replace(recording, meta=meta, **changes)


def test_recording_holds_every_command_and_the_truck_at_every_frame(recorded: Path) -> None:
    recording = Recording.load(recorded)
    assert len(recording) == len(recording.truck_hash) == 41
    assert len(set(recording.truck_hash.tolist())) == 41
    np.testing.assert_allclose(recording.command_time, 0.02 * np.arange(200), atol=1e-12)
    assert recording.command_at(7).accelerator_pedal > 0.0
    ego = recording.ego_at(40)
    assert ego is not None
    assert ego.brake_pressures[0] > 0.0 or ego.engine_speed > 50.0
    assert recording.meta["drive"]["options"]["seed"] == 3


def test_drive_is_repeated_bit_for_bit_in_another_process(recorded: Path) -> None:
    done = subprocess.run(
        [sys.executable, "-m", "iits_mj.cli", "replay", str(recorded), "--verify", "--drive"],
        env=dict(os.environ, PYTHONHASHSEED="11"),
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    recording = Recording.load(recorded)
    assert f"hash of poses {recording.meta['digest'][:12]}" in done.stdout
    assert f"200 commands, hash of states {int(recording.truck_hash[-1]):016x}"[:-4] in done.stdout


def test_drive_over_j1939_is_repeated_from_the_commands_that_reached_the_truck(
    tmp_path: Path,
) -> None:
    config = dataclasses.replace(CONFIG, commands="j1939", duration=1.0)
    with Simulation(config, record=True, visuals=False) as simulation:
        simulation.run()
        path = simulation.save_recording(tmp_path / "bus")
    same = redrive(Recording.load(path), "bus", None)
    assert (same.frames, same.commands) == (11, 50)


def test_one_changed_command_is_found(recorded: Path) -> None:
    recording = Recording.load(recorded)
    commands = recording.commands.copy()
    commands[60, 0] = 0.0
    with pytest.raises(RedriveError, match=r"the truck differs first at t = 1\.30 s: "):
        redrive(edited(recorded, commands=commands), "drive", None)


def test_a_changed_state_that_the_truck_does_not_report_is_found(recorded: Path) -> None:
    hashes = Recording.load(recorded).truck_hash.copy()
    hashes[12] ^= np.uint64(1)
    with pytest.raises(RedriveError, match=r"t = 1\.20 s, in a state that it does not report"):
        redrive(edited(recorded, truck_hash=hashes), "drive", None)


def test_missing_commands_are_reported(recorded: Path) -> None:
    recording = Recording.load(recorded)
    short = edited(
        recorded, command_time=recording.command_time[:30], commands=recording.commands[:30]
    )
    with pytest.raises(RedriveError, match=r"no command of t = 0\.60 s"):
        redrive(short, "drive", None)


@pytest.mark.parametrize("name", ["mujoco", "engine plugin of hash", "truck parameters of hash"])
def test_another_version_of_the_truck_is_refused(recorded: Path, name: str) -> None:
    drive = Recording.load(recorded).meta["drive"]
    drive = drive | {"versions": drive["versions"] | {name: "old"}}
    with pytest.raises(InputError, match=f"made with {name} old, here is"):
        redrive(edited(recorded, meta={"drive": drive}), "drive", None)


def test_truck_parameters_are_hashed_to_the_last_digit() -> None:
    from iits_mj.parameters import TruckParameters

    shipped = TruckParameters.load()
    mass = shipped.lead.mass
    heavier = TruckParameters.load(
        overlay={"units": {"tractor": {"mass": float(np.nextafter(mass, 1e9))}}}
    )
    one, two = (drive_log_module.truck_versions(p) for p in (shipped, heavier))
    assert one["truck parameters of hash"] != two["truck parameters of hash"]
    assert one["mujoco"] == two["mujoco"]


def test_another_map_is_refused(recorded: Path, tmp_path: Path) -> None:
    from iits_mj.road import RoadMap

    path = tmp_path / "other.xodr"
    path.write_bytes(RoadMap.builtin().path.read_bytes() + b"<!-- changed -->\n")
    with pytest.raises(InputError, match="made on map"):
        redrive(Recording.load(recorded), "drive", path)


def test_given_options_must_equal_the_recorded_options(recorded: Path) -> None:
    recording = Recording.load(recorded)
    check_options(recording, "drive", DriveConfig(), ())
    check_options(recording, "drive", CONFIG, [f.name for f in dataclasses.fields(DriveConfig)])
    with pytest.raises(
        InputError, match="made with density dense, not sparse; leave --density out"
    ):
        check_options(recording, "drive", DriveConfig(density="sparse"), ["density"])
    with pytest.raises(InputError, match="made with seed 3, not 0; leave --seed out"):
        check_options(recording, "drive", DriveConfig(seed=0), ["seed"])


def test_given_events_must_equal_the_recorded_events(recorded: Path, tmp_path: Path) -> None:
    closure = '[[events]]\nevent = "lane_closure"\nlane = 0\nstart = 2700.0\nend = {}\n'
    first, other = tmp_path / "first.toml", tmp_path / "other.toml"
    first.write_text(closure.format(2750.0))
    other.write_text(closure.format(2760.0))
    with pytest.raises(
        InputError, match=r"drive: made with no events, not with .*other\.toml; leave"
    ):
        check_options(Recording.load(recorded), "drive", DriveConfig(events=other), {"events"})
    with Simulation(
        dataclasses.replace(CONFIG, events=first, duration=1.0), record=True, visuals=False
    ) as simulation:
        simulation.run()
        recording = Recording.load(simulation.save_recording(tmp_path / "works"))
    check_options(recording, "works", DriveConfig(events=first), {"events"})
    with pytest.raises(InputError, match=r"made with other events than .*other\.toml; leave"):
        check_options(recording, "works", DriveConfig(events=other), {"events"})


def test_recording_of_traffic_alone_has_only_options_of_traffic(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    route = load_map(None).route()
    with Recorder(
        PureSim(route, TrafficConfig(density="sparse", fill_ahead=500.0), seed=4)
    ) as traffic:
        traffic.reset()
        path = str(traffic.save(tmp_path / "traffic.npz"))
    words = ["--density", "sparse", "--seed", "4", "--traffic-mode", "pure"]
    assert cli.main(["replay", path, "--verify", *words]) == 0
    for flag, value, said in (
        ("--seed", "0", "made with seed 4, not 0"),
        ("--payload", "36000", "has no payload; leave --payload out"),
    ):
        assert cli.main(["replay", path, "--verify", flag, value]) == 2
        assert said in capsys.readouterr().err


@pytest.mark.parametrize(
    ("option", "value"),
    [
        ("payload", "heavy"),
        ("payload", 1e9),
        ("start_lane", 0.5),
        ("reactive", "yes"),
        ("decision", 7),
        ("payload_height", "high"),
    ],
)
def test_a_stored_option_of_another_type_is_one_clear_error(
    recorded: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], option: str, value: Any
) -> None:
    drive = Recording.load(recorded).meta["drive"]
    drive = drive | {"options": drive["options"] | {option: value}}
    path = edited(recorded, meta={"drive": drive}).save(tmp_path / "edited.npz")
    assert cli.main(["replay", str(path), "--verify", "--drive"]) == 2
    said = capsys.readouterr().err
    assert "edited.npz: a stored option is not usable: " in said
    assert option.replace("_", "-") in said


@pytest.mark.parametrize("versions", [None, [], "old", {"mujoco": 3}])
def test_stored_versions_of_another_type_are_refused(recorded: Path, versions: Any) -> None:
    drive = Recording.load(recorded).meta["drive"] | {"versions": versions}
    with pytest.raises(InputError, match=r"drive: made with mujoco (unknown|3), here is"):
        redrive(edited(recorded, meta={"drive": drive}), "drive", None)


def test_error_in_stored_settings_names_the_file(
    recorded: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    config = Recording.load(recorded).meta["config"]
    for k, wrong in enumerate(({"density": "huge"}, {"wind": 1}, {"types": 3})):
        path = edited(recorded, meta={"config": config | wrong}).save(tmp_path / f"odd{k}.npz")
        assert cli.main(["replay", str(path), "--verify"]) == 2
        assert f"odd{k}.npz: " in capsys.readouterr().err


@pytest.mark.parametrize("there", ["d1", "d1.npz"])
def test_a_folder_in_the_place_of_a_recording_is_refused_before_the_drive(
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    there: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / there).mkdir()
    assert cli.main(["record", "d1", "--duration", "86400"]) == 2
    assert (
        f"recording d1: cannot be written: {there} is a folder; name a file"
        in capsys.readouterr().err
    )
    assert [path.name for path in tmp_path.iterdir()] == [there]


def test_error_names_an_unwritable_recording_as_given(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "file").write_text("")
    path = tmp_path / "file" / "x.npz"
    assert cli.main(["record", str(path), "--duration", "86400"]) == 2
    assert f"FILE '{path}' cannot be written" in (said := capsys.readouterr().err)
    assert "--FILE" not in said


def test_recorded_options_that_no_longer_exist_are_refused(recorded: Path) -> None:
    drive = Recording.load(recorded).meta["drive"]
    drive = drive | {"options": drive["options"] | {"wind": 3.0}}
    with pytest.raises(InputError, match="other options than today's: wind"):
        redrive(edited(recorded, meta={"drive": drive}), "drive", None)


def test_recording_of_traffic_alone_has_no_truck_to_repeat(recorded: Path) -> None:
    recording = Recording.load(recorded)
    meta = {name: value for name, value in recording.meta.items() if name != "drive"}
    with pytest.raises(InputError, match="without a drive"):
        redrive(dataclasses.replace(recording, meta=meta), "drive", None)


def test_recorded_traffic_is_the_same_for_another_driver(recorded: Path) -> None:
    config = DriveConfig(recording=recorded, duration=1.0, start_station=2600.0, decision="neutral")
    recording = Recording.load(recorded)
    with Simulation(config, visuals=False) as simulation:
        assert isinstance(simulation.traffic, RepSim)
        for k in range(1, 11):
            simulation.cycle()
            assert simulation.vehicles == recording.frames[k]


def test_reactive_adds_sumo_traffic_to_the_recorded_traffic(recorded: Path) -> None:
    config = DriveConfig(
        recording=recorded, reactive=True, duration=1.0, start_station=2500.0, density="dense"
    )
    recording = Recording.load(recorded)
    with Simulation(config, visuals=False) as simulation:
        simulation.cycle()
        live = [v for v in simulation.vehicles if v.id.startswith("live.")]
        others = [v for v in simulation.vehicles if not v.id.startswith("live.")]
        assert live
        # The recording has the same range of view.
        assert others == [v for v in recording.frames[1] if v in others]
        assert others


@pytest.mark.parametrize(
    ("words", "reason"),
    [
        (["--drive"], "--verify --drive"),
        (["--reactive", "--traffic-mode", "none", "--out", "out"], "use traffic-mode inter"),
        (["--verify", "--density", "sparse"], "made with density dense"),
        (["--verify", "--drive", "--payload", "1000"], "made with payload 36000.0, not 1000.0"),
        # Flags with their default values.
        (["--verify", "--seed", "0"], "made with seed 3, not 0"),
        (["--verify", "--drive", "--duration", "120"], "made with duration 4.0, not 120"),
        (["--verify", "--events", "missing.toml"], "missing.toml' cannot be read"),
        (["--verify", "--drive", "--events", "missing.toml"], "missing.toml' cannot be read"),
        (["--verify", "--reactive"], "made with reactive False"),
        (["--verify", "--out", "out"], "--out has no effect with --verify"),
        (["--density", "dense"], "--density has no effect on recorded traffic"),
        (["--lane-change", "mobil"], "--lane-change has no effect on recorded traffic"),
        (["--seed", "0"], "--seed has no effect on recorded traffic"),
        (["--traffic-mode", "inter"], "--traffic-mode has no effect on recorded traffic"),
    ],
)
def test_wrong_use_is_one_line(
    recorded: Path,
    words: list[str],
    reason: str,
    capsys: pytest.CaptureFixture[str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    assert cli.main(["replay", str(recorded), *words]) == 2
    said = capsys.readouterr().err.strip().splitlines()
    assert len(said) == 1
    assert reason in said[0]


def test_a_recording_that_differs_exits_with_1_and_names_the_difference(
    recorded: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    recording = Recording.load(recorded)
    columns = recording.columns.copy()
    columns[0, recording.start[3]] += 1e-9
    path = dataclasses.replace(recording, columns=columns).save(tmp_path / "moved")
    assert cli.main(["replay", str(path), "--verify"]) == 1
    assert "first at t = 0.30 s, where x of vehicle" in capsys.readouterr().out


def test_options_are_stored_as_plain_values(recorded: Path) -> None:
    options = drive_log_module.stored_options(
        dataclasses.replace(CONFIG, map=Path("/somewhere/road.xodr"))
    )
    assert options["map"] == "road.xodr"
    assert json.loads(json.dumps(options)) == options


def test_bodies_of_replayed_vehicles_follow_the_replay_between_frames(recorded: Path) -> None:
    config = DriveConfig(recording=recorded, duration=1.0, start_station=2500.0)
    apart: list[float] = []

    class Watch(Observer):
        period = 0.02

        def observe(self, simulation: Simulation, frame: DriveFrame) -> None:
            assert isinstance(simulation.traffic, RepSim)
            vehicles = simulation.traffic.at(frame.time)
            for name in simulation.mirror.shown:
                vehicle, bodies = vehicles.find(name), simulation.mirror.bodies_of(name)
                if vehicle is not None and len(bodies) == 1:
                    body = simulation.truck.model.body(bodies[0])
                    place = simulation.truck.data.mocap_pos[body.mocapid[0]]
                    apart.append(math.dist(place, (vehicle.x, vehicle.y, vehicle.z)))

    with Simulation(config, visuals=False) as simulation:
        simulation.run([Watch()])
    assert len(apart) > 100
    assert max(apart) < 1e-9


def test_a_recording_names_its_truck_and_refuses_another(
    recorded: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    drive = Recording.load(recorded).meta["drive"]
    assert drive["options"]["truck"] == "tractor_semitrailer_6x4"
    assert cli.main(["replay", str(recorded), "--verify", "--drive", "--truck", "vecto_40t"]) == 2
    assert "made with truck tractor_semitrailer_6x4, not vecto_40t" in capsys.readouterr().err
    # The recorded truck comes from a file of the user.
    drive = drive | {"options": drive["options"] | {"truck": "mine"}}
    path = edited(recorded, meta={"drive": drive}).save(tmp_path / "mine.npz")
    assert cli.main(["replay", str(path), "--verify", "--drive"]) == 2
    assert "which is not shipped: name its file by --truck" in capsys.readouterr().err
