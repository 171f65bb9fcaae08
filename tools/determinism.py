"""Runs the same physics, drives and trips in every way they can run; their digests must be equal.

    python tools/determinism.py                    # everything; exit code 1 where digests differ
    python tools/determinism.py --short            # seconds instead of minutes
    python tools/determinism.py --only physics,bus

Within a group all ways must give the same digest:

- physics: a recorded sequence of commands, by `mj_step`, `mujoco.rollout` and `mujoco.batch`, on
  one and two threads, in this process and in a new one.
- direct, bus: a drive in traffic with the commands as values, or as frames on the bus: after a
  reset, and in new processes with one and two threads of the linear algebra.
- video: the telemetry of a drive with and without a video; left out where OpenGL is missing.
- trips, trucks: `evaluate` in the fast world and `montecarlo`, with one and two processes.

A drive over the bus differs from the direct one by the resolution of the signals; the two groups
are not compared.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from digests import of_table, run, sha
from mujoco import rollout
from mujoco.batch import Batch
from numpy.typing import NDArray

FULL = mujoco.mjtState.mjSTATE_FULLPHYSICS
DRIVES = 3  # parallel ones in the group physics
GROUPS = ("physics", "direct", "bus", "video", "trips", "trucks")


@dataclass(frozen=True)
class Way:
    """One way to run: its name in the table and a function that returns a digest."""

    name: str
    digest: Callable[[], str]


# --- physics ----------------------------------------------------------------------------------


def truck() -> tuple[mujoco.MjModel, NDArray[np.float64]]:
    """The laden truck at 15 m/s: model and whole state."""
    from iits_mj.truck import Truck

    made = Truck.load(visuals=False)
    made.reset(speed=15.0)
    return made.model, _state(made.model, made.data)


def _state(model: mujoco.MjModel, data: mujoco.MjData) -> NDArray[np.float64]:
    values = np.zeros(mujoco.mj_stateSize(model, FULL))
    mujoco.mj_getState(model, data, values, FULL)
    return values


def commands(model: mujoco.MjModel, steps: int) -> NDArray[np.float64]:
    """Commands of shape (drives, steps, controls), of a seed, held for 0.1 s each."""
    generator = np.random.default_rng(7)
    low, high = model.actuator_ctrlrange.T
    drawn = generator.uniform(low, high, (DRIVES, -(-steps // 50), model.nu))
    drawn[:, :, model.actuator("steering_wheel_angle").id] *= 0.05
    drawn[:, :, model.actuator("transmission_mode").id] = 0.0
    drawn[:, :, model.actuator("parking_brake").id] = 0.0
    return np.repeat(drawn, 50, axis=1)[:, :steps]


def physics_digest(how: str, threads: int, steps: int) -> str:
    """Digest of the last states of three drives."""
    model, start = truck()
    ctrl = commands(model, steps)
    if how == "mj_step":
        ends = []
        for row in ctrl:
            data = mujoco.MjData(model)
            mujoco.mj_setState(model, data, start, FULL)
            for values in row:
                data.ctrl[:] = values
                mujoco.mj_step(model, data)
            ends.append(_state(model, data))
        return sha(np.array(ends).tobytes())
    if how == "rollout":
        spare = [mujoco.MjData(model) for _ in range(threads)]
        with rollout.Rollout(nthread=threads) as pool:
            states, _ = pool.rollout(model, spare, np.tile(start, (DRIVES, 1)), ctrl)
        return sha(np.ascontiguousarray(states[:, -1]).tobytes())
    batch = Batch(model, nsim=DRIVES, nthread=threads)
    names = ("time", "qpos", "qvel", "act", "plugin_state")
    data = mujoco.MjData(model)
    mujoco.mj_setState(model, data, start, FULL)
    for name in names:
        field = batch.bind(name)
        field[:] = np.reshape(getattr(data, name), field[0].shape)
    found = batch.rollout(steps, ctrl, mujoco.mjtState.mjSTATE_CTRL, record=[int(FULL)])
    return sha(np.ascontiguousarray(found[int(FULL)][:, -1]).tobytes())


def in_new_process(*words: str, threads: int | None = None) -> str:
    """Output of this program in a new process with an action for one way."""
    environment = dict(os.environ)
    if threads is not None:
        environment |= {f"{name}_NUM_THREADS": str(threads) for name in ("OMP", "OPENBLAS")}
    command = [sys.executable, str(Path(__file__).resolve()), *words]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    if done.returncode:
        raise SystemExit(f"{' '.join(words)} failed:\n{done.stderr[-2000:]}")
    return done.stdout.split()[-1]


def physics(short: bool) -> Iterator[Way]:
    """By MuJoCo's three ways to step, on threads, and in a new process."""
    steps = 500 if short else 10_000
    for how, counts in (("mj_step", (1,)), ("rollout", (1, 2)), ("batch", (1, 2))):
        for threads in counts:
            name = f"{how}, {threads} thread{'s' * (threads > 1)}"
            yield Way(name, lambda h=how, t=threads: physics_digest(h, t, steps))  # type: ignore[misc]
    words = ("--way", "physics", "mj_step", "1", str(steps))
    yield Way("mj_step, new process", lambda: in_new_process(*words))


# --- drives -----------------------------------------------------------------------------------


def drive_digest(path: str, duration: float, how: str) -> str:
    """Digest of the truck, the commands and the traffic in every cycle of a drive."""
    from iits_mj.simulation import DriveConfig, Observer, Simulation

    class Watch(Observer):
        period = 0.1

        def __init__(self) -> None:
            self.digest = hashlib.sha256()

        def observe(self, simulation: Any, frame: Any) -> None:
            del simulation
            vehicles = [(v.id, v.x, v.y, v.speed) for v in frame.scene.vehicles]
            self.digest.update(repr((frame.ego, frame.command, vehicles)).encode())

    config = DriveConfig(density="dense", seed=2, duration=duration, commands=path)
    with Simulation(config, visuals=False) as simulation:
        watch = Watch()
        simulation.run([watch])
        if how == "reset":
            watch = Watch()
            simulation.reset()
            simulation.run([watch])
    return watch.digest.hexdigest()[:16]


def drives(path: str, short: bool) -> Iterator[Way]:
    """A drive, its repetition, and the same in new processes with one and two threads."""
    duration = 2.0 if short else 30.0
    yield Way("first drive", lambda: drive_digest(path, duration, "plain"))
    yield Way("after a reset", lambda: drive_digest(path, duration, "reset"))
    for threads in (2,) if short else (1, 2):
        words = ("--way", "drive", path, str(duration), "plain")
        yield Way(
            f"new process, {threads} thread{'s' * (threads > 1)}",
            lambda w=words, t=threads: in_new_process(*w, threads=t),  # type: ignore[misc]
        )


def video(short: bool) -> Iterator[Way]:
    """The telemetry of a drive without and with a video."""
    from iits_mj.core.errors import RenderError
    from iits_mj.render import offscreen

    try:
        offscreen.make_context(16, 16).free()
    except RenderError as error:
        print(f"video    left out: {error}")
        return
    line = f"drive --density dense --seed 2 --duration {2 if short else 20} --out out"
    for name, flag in (("without a video", " --no-video"), ("with a video", "")):
        yield Way(name, lambda a=line + flag: of_command(a, "out/telemetry.csv", ()))  # type: ignore[misc]


# --- trips and trucks ---------------------------------------------------------------------------


def of_command(arguments: str, name: str, unstable: tuple[str, ...]) -> str:
    """Digest of the table that a command writes."""
    with tempfile.TemporaryDirectory() as folder:
        run(f"{arguments}", Path(folder))
        return of_table(Path(folder) / name, unstable)


def trips(short: bool) -> Iterator[Way]:
    """`evaluate` in the fast world."""
    words = "--trials 2 --duration 60 --methods mobil" if short else "--trials 4 --duration 600"
    for jobs in (1, 2):
        line = f"evaluate --world fast --cells dense-12.5 {words} --jobs {jobs} --file t.csv"
        yield Way(f"{jobs} job{'s' * (jobs > 1)}", lambda a=line: of_command(a, "t.csv", UNSTABLE))  # type: ignore[misc]


def trucks(short: bool) -> Iterator[Way]:
    """`montecarlo`; the short form has none, as a truck takes half a minute."""
    for jobs in () if short else (1, 2):
        line = f"montecarlo --samples 2 --folder m --json --jobs {jobs}"
        yield Way(
            f"{jobs} job{'s' * (jobs > 1)}",
            lambda a=line: of_command(a, "m/samples.csv", (*UNSTABLE, "spread")),  # type: ignore[misc]
        )


UNSTABLE = ("wall", "solve_p", "real_time", "version", "provenance", "digest", "code", "per_s")


def ways(group: str, short: bool) -> list[Way]:
    """The ways of a group."""
    made = {
        "physics": physics,
        "direct": lambda s: drives("direct", s),
        "bus": lambda s: drives("j1939", s),
        "video": video,
        "trips": trips,
        "trucks": trucks,
    }
    return list(made[group](short))


def compare(groups: list[str], short: bool) -> dict[str, dict[str, str]]:
    """Prints the table; returns the digests by group and way."""
    found: dict[str, dict[str, str]] = {}
    for group in groups:
        digests = found[group] = {}
        for way in ways(group, short):
            digests[way.name] = way.digest()
            first = next(iter(digests.values()))
            verdict = "equal" if digests[way.name] == first else "DIFFERENT"
            verdict = "reference" if len(digests) == 1 else verdict
            print(f"{group:8} {way.name:24} {digests[way.name]} {verdict}", flush=True)
    return found


def main() -> int:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--short", action="store_true", help="seconds instead of minutes")
    parser.add_argument("--only", default=",".join(GROUPS), help="groups, comma separated")
    parser.add_argument("--json", type=Path, help="file for the digests")
    parser.add_argument("--way", nargs="+", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.way:
        kind, *rest = options.way
        if kind == "physics":
            print(physics_digest(rest[0], int(rest[1]), int(rest[2])))
        else:
            print(drive_digest(rest[0], float(rest[1]), rest[2]))
        return 0
    groups = [name for name in options.only.split(",") if name]
    unknown = set(groups) - set(GROUPS)
    if unknown:
        parser.error(f"unknown groups {sorted(unknown)}; there are {', '.join(GROUPS)}")
    found = compare(groups, options.short)
    if options.json:
        options.json.write_text(json.dumps(found, indent=1) + "\n")
    different = [group for group, digests in found.items() if len(set(digests.values())) > 1]
    print(f"different: {', '.join(different)}" if different else "all digests are equal")
    return 1 if different else 0


if __name__ == "__main__":
    sys.exit(main())
