"""What is fuzzed: readers of files, the bus, the plugin's controls and state, the command line.

A target makes its samples once, in a folder, and takes one mutant: it returns, or raises an error
of ours. Everything else is a finding.
"""

from __future__ import annotations

import hashlib
import io
import struct
import zipfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np

from controllers.decision.policy import QNetwork, load_policy
from controllers.planning.speed_reference import read_profile
from iits_mj import cli
from iits_mj.core.messages import VehicleCommand
from iits_mj.evaluation.trials import read_trials
from iits_mj.identification import log as identification_log
from iits_mj.j1939 import CommandReceiver, Frame, command_to_frames
from iits_mj.j1939.log_files import LogWriter, read_log
from iits_mj.parameters import TruckParameters
from iits_mj.parameters.randomization import Spread
from iits_mj.road.design import Design
from iits_mj.simulation import DriveConfig, Simulation
from iits_mj.simulation.drive_table import DriveTable
from iits_mj.simulation.parts import load_map
from iits_mj.truck import Truck
from tests.fuzz.mutation import mutate
from tests.paths import ROOT
from tests.road.opendrive_text import document, road
from tests.traffic_bridge.datasets.synthetic_sets import write_highd, write_ngsim, write_pairs
from traffic_bridge.datasets.read import read_trajectories
from traffic_bridge.recording.recording import Recording
from traffic_bridge.scenario.reading import read_events
from traffic_bridge.vehicles.types import read_types

EVENTS = b"""[[events]]
event = "lane_closure"
lane = 0
start = 900.0
end = 1100.0
at_time = 20.0
until = 120.0
"""
OVERLAY = b"""remove = ["units.trailer.axles.axle3"]
[units.tractor]
mass = { value = 7.5, unit = "t" }
[units.trailer.axles.axle4]
like = "axle2"
position = 9.5
[tires."*"]
rolling_resistance = 0.005
"""
TYPES = b"""[bus]
like = "truck"
length = 12.0
width = 2.5
height = 3.2
"""
LINES = (
    b"drive --seed 3 --payload 0 --duration 2 --density dense --no-video --speed 20",
    b"record r.npz --traffic-speed 12.5 --start-lane 1 --speed-planner pcc --lane-change sl2015",
    b"evaluate --world fast --seeds 3 --jobs 2 --json",
    b"pcc --payload 36000 --length 5000 --speed 22.2",
    b"serve udp --seed 3 --steps 100 --on-silence stop",
    b"train --out out --steps 2000 --seed 4",
    b"validate --quick --json --seed 1 --only handling",
    b"replay-can log.asc --speed 15",
)


@dataclass(frozen=True)
class Target:
    """One thing under attack.

    Attributes:
      samples: valid inputs.
      take: uses one input; may raise errors of ours.
    """

    samples: tuple[bytes, ...]
    take: Callable[[bytes], object]


def file_target(
    folder: Path, name: str, samples: tuple[bytes, ...], read: Callable[[Path], object]
) -> Target:
    """A target that reads a file of that name."""
    path = folder / name

    def take(content: bytes) -> None:
        path.parent.mkdir(exist_ok=True)
        path.write_bytes(content)
        read(path)

    return Target(samples, take)


def make_targets(folder: Path) -> Mapping[str, Target]:
    """All targets; their files lie in `folder`."""
    samples = folder / "samples"
    samples.mkdir()
    made = _make_files(samples)
    parameters = TruckParameters.load()

    def reads(name: str, of: str, read: Callable[[Path], object], *more: bytes) -> Target:
        return file_target(folder, name, (*((made[of],) if of else ()), *more), read)

    logs = tuple(made[f"frames.{kind}"] for kind in ("log", "asc", "trc", "csv", "blf"))
    maps = (document(road()).encode(), (ROOT / "iits_mj/road/maps/highway.xodr").read_bytes())
    return {
        "map": reads("map.xodr", "", load_map, *maps),
        "design": reads("d.toml", "", Design.load, (ROOT / "tools/highway.toml").read_bytes()),
        "overlay": reads("o.toml", "", lambda p: TruckParameters.load(overlay=p), OVERLAY),
        "spread": reads("s.toml", "", Spread.load, (ROOT / "mjcf/spread.toml").read_bytes()),
        "events": reads("e.toml", "", read_events, EVENTS),
        "types": reads("t.toml", "", read_types, TYPES),
        "recording": reads("r.npz", "drive.npz", Recording.load),
        "weights": reads("w.npz", "policy.npz", QNetwork.load),
        "trials": reads("trials.csv", "", lambda p: read_trials(p, str), made["evaluate.csv"]),
        "log": reads("frames.log", "", lambda p: sum(1 for _ in read_log(p)), *logs),
        "table": reads("t.csv", "telemetry.csv", lambda p: identification_log.read(p, parameters)),
        "drive": reads("d.csv", "telemetry.csv", DriveTable.read),
        "profile": reads("p.csv", "", read_profile, b"station_m,speed_mps\n0,20\n50,21\n900,20\n"),
        "trajectories": reads(
            "t.any", "", read_trajectories, made["ngsim.csv"], made["pairs.parquet"], made["fcd"]
        ),
        "highd": _highd(folder, made),
        "bag": _bag(folder, made),
        "checkpoint": _checkpoint(folder),
        "bus": Target((_frames(),), _take_frames),
        "plugin": Target((bytes(64),), _Physics()),
        "command line": Target(LINES, _take_line),
    }


def _make_files(folder: Path) -> dict[str, bytes]:
    """Valid files by name, written by the project itself."""
    config = DriveConfig(duration=6.0, density="sparse", seed=1)
    from iits_mj.bag.mcap_file import BagWriter
    from iits_mj.simulation.telemetry import Telemetry

    with (
        Simulation(config, record=True, visuals=False) as simulation,
        Telemetry(folder / "telemetry.csv") as telemetry,
        BagWriter(folder / "bag", simulation) as bag,
    ):
        simulation.run([telemetry, bag])
        simulation.save_recording(folder / "drive.npz")
    load_policy().network.save(folder / "policy.npz")
    frames = [
        frame for k in range(20) for frame in command_to_frames(VehicleCommand(), k, 0.02 * k)
    ]
    for kind in ("log", "asc", "trc", "csv", "blf"):
        with LogWriter(folder / f"frames.{kind}") as writer:
            for frame in frames:
                writer.write(frame)
    write_ngsim(folder / "ngsim.csv")
    write_pairs(folder / "pairs.parquet")
    (folder / "highd").mkdir()
    write_highd(folder / "highd")
    table = (ROOT / "docs/validation/evaluate.csv").read_bytes()
    (folder / "evaluate.csv").write_bytes(b"".join(table.splitlines(keepends=True)[:20]))
    (folder / "fcd").write_text(
        '<fcd-export><timestep time="0.0"><vehicle id="a" x="1" y="2" angle="90" type="t" '
        'speed="3" pos="4" lane="e_0"/></timestep><timestep time="0.1"><vehicle id="a" x="1.3" '
        'y="2" angle="90" type="t" speed="3" pos="4.3" lane="e_0"/></timestep></fcd-export>'
    )
    return {
        str(path.relative_to(folder)): path.read_bytes()
        for path in sorted(folder.rglob("*"))
        if path.is_file()
    }


def _highd(folder: Path, made: dict[str, bytes]) -> Target:
    tables = folder / "highd"
    tables.mkdir()
    files = {Path(name).name: made[name] for name in made if name.startswith("highd/")}
    marks = {content.splitlines()[0][:30]: name for name, content in files.items()}

    def take(content: bytes) -> None:
        changed = marks.get(content.splitlines()[0][:30] if content else b"", "01_tracks.csv")
        for name, original in files.items():
            (tables / name).write_bytes(content if name == changed else original)
        read_trajectories(tables / "01_tracks.csv")

    return Target(tuple(files.values()), take)


def _bag(folder: Path, made: dict[str, bytes]) -> Target:
    from iits_mj.bag.foxglove import LAYOUT
    from iits_mj.bag.mcap_file import read_bag

    bag = folder / "mutant_bag"
    bag.mkdir()
    files = {Path(name).name: made[name] for name in made if name.startswith("bag/")}
    del files[LAYOUT]  # written for Foxglove, never read

    def take(content: bytes) -> None:
        changed = "metadata.yaml" if content[:40].find(b"rosbag2") >= 0 else "bag.mcap"
        for name, original in files.items():
            (bag / name).write_bytes(content if name.endswith(changed[-5:]) else original)
        read_bag(bag)

    return Target(tuple(files.values()), take)


def _checkpoint(folder: Path) -> Target:
    """A training continued from a changed checkpoint with a correct checksum."""
    from controllers.decision.learning import checkpoint
    from controllers.decision.learning.config import TrainConfig
    from controllers.decision.learning.training import Training

    out = folder / "training"
    out.mkdir()
    path = out / checkpoint.CHECKPOINT
    config = TrainConfig(decisions=100, replay_capacity=100, warm_up=50)
    training = Training(config, out, "", None, None)
    training.save()

    def take(content: bytes) -> None:
        digest = hashlib.sha256(content).hexdigest()
        path.write_bytes(f"{checkpoint.FORMAT} {digest}\n".encode() + content)
        training.restore()

    return Target((path.read_bytes().partition(b"\n")[2],), take)


_FRAME = struct.Struct("<Id8s")


def _frames() -> bytes:
    frames = [frame for k in range(5) for frame in command_to_frames(VehicleCommand(), k, 0.02 * k)]
    return b"".join(_FRAME.pack(f.can_id, f.time, f.data.ljust(8, b"\xff")) for f in frames)


def _take_frames(content: bytes) -> None:
    receiver = CommandReceiver()
    whole = content[: len(content) // _FRAME.size * _FRAME.size]
    for can_id, time, data in _FRAME.iter_unpack(whole[: 400 * _FRAME.size]):
        receiver.receive(Frame(can_id & 0x1FFFFFFF, data, time))
        receiver.command(time)


class _Physics:
    """Writes a mutant into the controls and the state of the truck's model, and steps it.

    Numbers that are not finite are MuJoCo's to find: it reports them and resets.
    """

    def __init__(self) -> None:
        self._truck: Truck | None = None

    def __call__(self, content: bytes) -> None:
        truck = self._truck = self._truck or Truck.load(0.0, visuals=False)
        model, data = truck.model, truck.data
        truck.reset(speed=15.0)
        random = np.random.default_rng(np.frombuffer(content.ljust(4, b"\0"), np.uint8))
        numbers = np.frombuffer(content[: len(content) // 8 * 8].ljust(8, b"\0"), dtype="<f8")
        for field in (data.ctrl, data.act, data.plugin_state, data.qpos, data.qvel):
            if not field.size or random.random() < 0.5:
                continue
            for place in random.integers(field.size, size=4):
                scale = 10.0 ** random.uniform(-3.0, 9.0)
                field[place] = random.choice([random.normal() * scale, random.choice(numbers)])
        mujoco.mj_step(model, data, 5)
        mujoco.mj_resetData(model, data)
        data.warning.number[:] = 0


def _take_line(content: bytes) -> None:
    words = content.decode("utf-8", "replace").replace("\0", "").split()
    cli.understood([word for word in words if word not in ("-h", "--help")])


def attack(target: Target, random: np.random.Generator) -> bytes:
    """One mutant of a target's samples."""
    sample = target.samples[int(random.integers(len(target.samples)))]
    if sample.startswith(b"PK") and random.random() < 0.8:
        return _mutate_member(sample, random)
    return mutate(sample, random, target.samples)


def _mutate_member(content: bytes, random: np.random.Generator) -> bytes:
    """A zip file with one changed member and correct checksums."""
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    name = list(members)[int(random.integers(len(members)))]
    members[name] = mutate(members[name], random)
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w") as archive:
        for key, value in members.items():
            archive.writestr(key, value)
    return stream.getvalue()
