"""Compares the digests of the package's results before and after a change of the code.

    python tools/digests.py write digests.json          # before the change
    python tools/digests.py compare digests.json        # after it; exit code 1 where bits differ
    python tools/digests.py compare digests.json --only drives,records

The jobs cover drives (both payloads, three densities, every decision maker, PCC and constant
speed, an OpenDRIVE map), the quick form of every validation group, a training run, recordings,
bags, CAN logs, the environments and the model. A digest covers a file or a value without what
depends on the clock or on the version of the code.
"""

from __future__ import annotations

import argparse
import concurrent.futures
import hashlib
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

Digests = dict[str, str]

# Keys whose values depend on the clock, the machine or the version of the code.
UNSTABLE = ("wall", "solve_p", "real_time", "version", "provenance", "digest", "code", "per_s")
# Parts of the names of checks whose value is a time on this machine.
TIMES = ("set-up and solve", "CPU time", "one call of", "and engine map")

MAP = """<?xml version="1.0"?>
<OpenDRIVE><header revMajor="1" revMinor="6" name="digests"/>
<road name="bends" length="1500" id="1" junction="-1">
<type s="0" type="rural"><speed max="25" unit="m/s"/></type>
<planView>
<geometry s="0" x="0" y="0" hdg="0" length="400"><line/></geometry>
<geometry s="400" x="400" y="0" hdg="0" length="100">
<spiral curvStart="0" curvEnd="0.002"/></geometry>
<geometry s="500" x="499.90003" y="3.33286" hdg="0.1" length="1000">
<arc curvature="0.002"/></geometry>
</planView>
<elevationProfile><elevation s="0" a="0" b="0" c="0" d="0"/>
<elevation s="300" a="0" b="0" c="0.0001" d="0"/>
<elevation s="500" a="4" b="0.04" c="-0.00005" d="0"/></elevationProfile>
<lanes><laneSection s="0">
<left><lane id="1" type="driving"><width sOffset="0" a="3.5" b="0" c="0" d="0"/></lane></left>
<center><lane id="0" type="none"/></center>
<right><lane id="-1" type="driving"><width sOffset="0" a="3.75" b="0" c="0" d="0"/></lane>
<lane id="-2" type="driving"><width sOffset="0" a="3.75" b="0" c="0" d="0"/></lane></right>
</laneSection></lanes>
</road></OpenDRIVE>
"""

DRIVES = {
    "laden_dense_ddqn": "--density dense --decision ddqn",
    "laden_dense_aggressive": "--density dense --decision aggressive --seed 3",
    "laden_medium_lookahead": "--density medium --decision lookahead --traffic-speed 15",
    "laden_sparse_mobil": "--density sparse --decision mobil --speed-planner cruise",
    "empty_dense_conservative": "--payload 0 --density dense --decision conservative",
    "empty_medium_neutral": "--payload 0 --density medium --decision neutral --lane-change mobil",
    "empty_keep_j1939": "--payload 0 --density medium --decision keep --commands j1939",
    "half_map": "--payload 12000 --map bends.xodr --start-speed 12 --decision ddqn",
    "pure_free": "--traffic-mode pure --lane-discipline free --decision ddqn --seed 5",
}
DURATION = 25
GROUPS = ("lateral", "longitudinal", "standards", "step-size", "traffic", "planning")
ENVIRONMENTS = (
    *("Cruise", "Stop", "HillStart", "LaneKeep", "LaneChange", "TightTurn", "Dock"),
    *("Highway", "HighwayFast", "SpeedPlanning"),
)


def output(name: str, words: list[str], folder: Path, codes: tuple[int, ...] = (0,)) -> str:
    """Runs Python with the words in the folder; returns its output on stdout."""
    done = subprocess.run([sys.executable, *words], cwd=folder, capture_output=True, text=True)
    if done.returncode not in codes:
        raise SystemExit(f"{name} failed:\n{done.stderr[-2000:]}")
    return done.stdout


def run(arguments: str, folder: Path, codes: tuple[int, ...] = (0, 1)) -> str:
    """Runs `iits-mj` with the arguments in the folder; returns its output on stdout."""
    words = ["-m", "iits_mj.cli", *arguments.split()]
    return output(f"'iits-mj {arguments}'", words, folder, codes)


def sha(data: bytes) -> str:
    """Sixteen hexadecimal digits of the data's SHA-256."""
    return hashlib.sha256(data).hexdigest()[:16]


def of_json(text: str) -> str:
    """Digest of a JSON text without its unstable keys, for any order of the keys."""

    def stable(value: Any) -> Any:
        if isinstance(value, dict):
            kept = {k: v for k, v in value.items() if not any(u in k for u in UNSTABLE)}
            if any(u in str(kept.get("name", "")) for u in TIMES):
                kept.pop("value", None)
                kept.pop("ok", None)
            return {k: stable(v) for k, v in kept.items()}
        return [stable(v) for v in value] if isinstance(value, list) else value

    return sha(json.dumps(stable(json.loads(text)), sort_keys=True).encode())


def of_checks(text: str) -> Iterator[tuple[str, str]]:
    """Name and digest of each check of a command's JSON."""
    for check in json.loads(text)["checks"]:
        yield check["name"], of_json(json.dumps(check))


def of_arrays(path: Path) -> Iterator[tuple[str, str]]:
    """Name and digest of each array of an npz file."""
    with np.load(path, allow_pickle=False) as arrays:
        for name in arrays.files:
            array = arrays[name]
            if array.dtype.kind == "U" and array.ndim == 0:
                yield name, of_json(str(array))
            else:
                yield name, sha(f"{array.dtype}{array.shape}".encode() + array.tobytes())


def of_table(path: Path, unstable: tuple[str, ...] = UNSTABLE) -> str:
    """Digest of a CSV table without its unstable columns."""
    rows = [line.split(",") for line in path.read_text().splitlines()]
    kept = [i for i, name in enumerate(rows[0]) if not any(u in name for u in unstable)]
    return sha("\n".join(",".join(row[i] for i in kept) for row in rows).encode())


def of_bag(path: Path) -> Iterator[tuple[str, str]]:
    """Topic and digest of its messages, their times included."""
    from mcap.reader import make_reader

    topics: dict[str, Any] = {}
    with path.open("rb") as stream:
        for _, channel, message in make_reader(stream).iter_messages():
            digest = topics.setdefault(channel.topic, hashlib.sha256())
            digest.update(message.log_time.to_bytes(8, "little") + message.data)
    for topic, digest in sorted(topics.items()):
        yield topic, digest.hexdigest()[:16]


def drive(name: str) -> Callable[[Path], Digests]:
    """A drive with telemetry, CAN log and bag."""

    def job(folder: Path) -> Digests:
        (folder / "bends.xodr").write_text(MAP)
        run(
            f"drive --no-video --duration {DURATION} {DRIVES[name]} --out out "
            "--can-log out/can.log --bag out/bag",
            folder,
        )
        out = folder / "out"
        digests = {
            "telemetry": sha((out / "telemetry.csv").read_bytes()),
            "can_log": sha((out / "can.log").read_bytes()),
            "summary": of_json((out / "summary.json").read_text()),
        }
        bag = next((out / "bag").glob("*.mcap"))
        return digests | {f"bag {topic}": digest for topic, digest in of_bag(bag)}

    return job


def record(name: str) -> Callable[[Path], Digests]:
    """A recording of the same drive: every state of truck and traffic in full precision."""

    def job(folder: Path) -> Digests:
        (folder / "bends.xodr").write_text(MAP)
        run(f"record --duration {DURATION} {DRIVES[name]} r.npz", folder)
        return {
            member: digest for member, digest in of_arrays(folder / "r.npz") if member != "meta"
        }

    return job


def replay(folder: Path) -> Digests:
    """A recording replayed, verified and driven in."""
    run("record --duration 15 --density medium r.npz", folder)
    run("replay r.npz --verify --drive", folder, codes=(0,))
    run("replay r.npz --no-video --duration 12 --reactive --out out", folder)
    return {"telemetry": sha((folder / "out" / "telemetry.csv").read_bytes())}


def validate(group: str) -> Callable[[Path], Digests]:
    """The quick form of a validation group."""
    # Exit code 2: without --data the traffic group reports that recorded traffic is missing.
    return lambda folder: dict(
        of_checks(run(f"validate {group} --quick --json", folder, codes=(0, 1, 2)))
    )


def pcc(folder: Path) -> Digests:
    """Predictive cruise control against its comparators, as one command."""
    return dict(of_checks(run("pcc --json", folder)))


def train(folder: Path) -> Digests:
    """A training run of 20 000 decisions."""
    run(
        "train --decisions 20000 --out t --evaluate-interval 8000 --validation-trips 1 "
        "--validation-duration 300 --json",
        folder,
    )
    weights = sorted((folder / "t").rglob("*.npz"))
    digests = {
        f"{path.name} {name}": digest
        for path in weights
        for name, digest in of_arrays(path)
        if name not in ("meta", "metadata")
    }
    return digests | {"training.csv": of_table(folder / "t" / "training.csv")}


def evaluate(folder: Path) -> Digests:
    """Trips of every decision maker in the fast world, and one in the full chain."""
    run(
        "evaluate --world fast --trials 1 --duration 300 --cells dense-12.5,medium-15 "
        "--file fast.csv",
        folder,
    )
    run(
        "evaluate --trials 1 --timestep 0.005 --duration 60 --cells medium-12.5 "
        "--methods ddqn,lookahead --file full.csv",
        folder,
    )
    return {name: of_table(folder / name) for name in ("fast.csv", "full.csv")}


def montecarlo(folder: Path) -> Digests:
    """Two trucks drawn from the uncertainty of their parameters."""
    run("montecarlo --samples 2 --folder m --json", folder)
    # The column "spread" is a digest of the settings' text.
    return {"samples.csv": of_table(folder / "m" / "samples.csv", (*UNSTABLE, "spread"))}


def environment(name: str) -> Callable[[Path], Digests]:
    """Observations and rewards of forty steps with actions of a seed."""

    def job(folder: Path) -> Digests:
        code = (
            "import gymnasium, numpy as np, hashlib, iits_mj.envs\n"
            f"env = gymnasium.make('iits_mj/{name}-v0')\n"
            "env.action_space.seed(1)\n"
            "digest = hashlib.sha256()\n"
            "observation, _ = env.reset(seed=1)\n"
            "for _ in range(40):\n"
            "    out = env.step(env.action_space.sample())\n"
            "    leaves = out[0].values() if isinstance(out[0], dict) else [out[0]]\n"
            "    for leaf in leaves: digest.update(np.asarray(leaf).tobytes())\n"
            "    digest.update(np.float64(out[1]).tobytes())\n"
            "    if out[2] or out[3]: env.reset()\n"
            "env.close()\n"
            "print(digest.hexdigest()[:16])\n"
        )
        return {"steps": output(f"environment {name}", ["-c", code], folder).split()[-1]}

    return job


def model(folder: Path) -> Digests:
    """The compiled model of the truck and of the truck on a road; names of sensors included."""
    code = (
        "import hashlib, mujoco, numpy as np, iits_mj\n"
        "from iits_mj import Truck\n"
        "def digest(m):\n"
        "    digest = hashlib.sha256(m.names)\n"
        "    for name in sorted(dir(m)):\n"
        "        value = None if name[0] == '_' or 'path' in name else getattr(m, name)\n"
        "        if isinstance(value, np.ndarray): digest.update(value.tobytes())\n"
        "    return digest.hexdigest()[:16]\n"
        "for name in ('truck.xml', 'scene.xml'):\n"
        "    m = mujoco.MjModel.from_xml_path(str(iits_mj.mjcf_path(name)))\n"
        "    print(name, digest(m))\n"
        "for payload in (0, 36000):\n"
        "    print(payload, digest(Truck.load(payload=payload).model))\n"
    )
    return dict(line.split() for line in output("the model", ["-c", code], folder).splitlines())


JOBS: dict[str, Callable[[Path], Digests]] = {
    **{f"validate/{group}": validate(group) for group in GROUPS},
    "train": train,
    "evaluate": evaluate,
    "montecarlo": montecarlo,
    "pcc": pcc,
    **{f"drives/{name}": drive(name) for name in DRIVES},
    **{f"records/{name}": record(name) for name in DRIVES},
    "replay": replay,
    "model": model,
    **{f"environments/{name}": environment(name) for name in ENVIRONMENTS},
}


def measure(only: list[str], jobs: int) -> dict[str, Digests]:
    """Digests of the jobs whose names begin with one of `only`, all when it is empty."""
    chosen = [n for n in JOBS if not only or any(n.startswith(start) for start in only)]

    def one(name: str) -> Digests:
        begin = time.monotonic()
        with tempfile.TemporaryDirectory(prefix="digests_") as folder:
            found = JOBS[name](Path(folder))
        print(f"{name}: {len(found)} digests, {time.monotonic() - begin:.0f} s", file=sys.stderr)
        return found

    with concurrent.futures.ThreadPoolExecutor(jobs) as pool:
        return dict(zip(chosen, pool.map(one, chosen), strict=True))


def main() -> int:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("action", choices=("write", "compare"))
    parser.add_argument("file", type=Path, help="JSON file with the digests")
    parser.add_argument("--only", default="", help="beginnings of jobs' names, comma separated")
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1)
    options = parser.parse_args()
    only = [name for name in options.only.split(",") if name]
    now = measure(only, options.jobs)
    if options.action == "write":
        options.file.write_text(json.dumps(now, indent=1) + "\n")
        return 0
    before = json.loads(options.file.read_text())
    differing = [
        f"{job}: {name}"
        for job, digests in now.items()
        for name in sorted({*digests, *before.get(job, {})})
        if digests.get(name) != before.get(job, {}).get(name)
    ]
    print("\n".join(differing) or f"{sum(map(len, now.values()))} digests are equal")
    return 1 if differing else 0


if __name__ == "__main__":
    sys.exit(main())
