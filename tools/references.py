"""Process replay: each module alone on the inputs of a reference drive, compared bit for bit.

    python tools/references.py check                    # exit code 1 where outputs differ
    python tools/references.py renew --reason "why"     # after a change that was meant

The folder tests/references has a file for each of decision, planner, tracker and traffic, with the
inputs of the module on a drive that has a leader and a lane change. The inputs are rounded, so that
they fit into a small file, and the reference outputs are those of the module on these rounded
inputs. A file has the digest of all outputs, a checksum of each output and field, and the values of
some of them, from which a difference is measured.

Kernels of NumPy and OpenBLAS round differently on processors with other vector units. This program
therefore starts itself again with the vector units of AVX2 alone, which any recent x86 processor
has. Where platform or libraries are still others than those of the reference, values are compared
with a tolerance instead of the bits; the report says so.
"""

from __future__ import annotations

import argparse
import contextlib
import csv
import dataclasses
import datetime
import hashlib
import importlib
import json
import os
import platform
import sys
import zlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from controllers.decision.base import DecisionContext
from iits_mj.core.messages import (
    Decision,
    EgoFootprint,
    EgoState,
    PlanMode,
    RoadSignals,
    Scene,
    Trajectory,
    VehicleCommand,
)
from iits_mj.core.vehicles import COLUMNS, VehicleFrame
from iits_mj.parameters import TruckParameters
from iits_mj.simulation import DriveConfig, Observer, Simulation
from iits_mj.simulation.parts import load_map, make_stack, make_traffic

# Set before NumPy is loaded: kernels that round as on every processor with AVX2, and one thread.
KERNELS = {
    "NPY_DISABLE_CPU_FEATURES": "X86_V4 AVX512_ICL AVX512_SPR",
    "OPENBLAS_CORETYPE": "Haswell",
    "OPENBLAS_NUM_THREADS": "1",
}
FOLDER = Path(__file__).resolve().parents[1] / "tests" / "references"
LOG = FOLDER / "changes.csv"
LOG_COLUMNS = ("date", "module", "old_digest", "new_digest", "reason")
MODULES = ("decision", "planner", "tracker", "traffic")
# A leader from the eighth second on, and a change to the left lane from the twelfth.
DRIVE = DriveConfig(density="medium", decision="ddqn", seed=1, start_speed=16.0, duration=22.0)
# Inputs are multiples of this [SI units].
STEP = 2.0**-18
# Every so many outputs are stored as values.
STORED = {"decision": 1, "planner": 20, "tracker": 1, "traffic": 5}
# Of the greatest magnitude of a field, where bits cannot be compared.
TOLERANCE = {"float64": 1e-9, "float32": 1e-5}

Fields = dict[str, NDArray[Any]]
Outputs = list[tuple[float, Fields]]


# --- messages as arrays -----------------------------------------------------------------------


def rounded(values: Any) -> NDArray[np.int64]:
    """Numbers as multiples of `STEP`."""
    return np.rint(np.asarray(values, dtype=float) / STEP).astype(np.int64)


def pack(table: NDArray[np.int64], axis: int = 0) -> NDArray[Any]:
    """Second differences along an axis, which compress well."""
    for _ in range(2):
        table = np.diff(table, axis=axis, prepend=0)
    small = np.iinfo(np.int32)
    fits = table.size == 0 or (table.min() >= small.min and table.max() <= small.max)
    return table.astype(np.int32) if fits else table


def unpack(table: NDArray[Any], axis: int = 0) -> NDArray[np.float64]:
    """The numbers of `pack`."""
    table = table.astype(np.int64)
    for _ in range(2):
        table = np.cumsum(table, axis=axis)
    return table * STEP


_EGO = tuple(
    f.name
    for f in dataclasses.fields(EgoState)
    if f.name != "time" and not str(f.type).startswith("tuple")
)
_PATH = tuple(f.name for f in dataclasses.fields(Trajectory))[:10]


def pack_states(states: Sequence[EgoState], name: str) -> Fields:
    """States of the truck as arrays, times exact."""
    rows = [[float(getattr(s, key)) for key in _EGO] + list(s.brake_pressures) for s in states]
    return {f"{name}_time": np.array([s.time for s in states]), name: pack(rounded(rows))}


def unpack_states(arrays: Fields, name: str) -> list[EgoState]:
    """The states of `pack_states`."""
    found = []
    for time, row in zip(arrays[f"{name}_time"], unpack(arrays[name]).tolist(), strict=True):
        values: dict[str, Any] = dict(zip(_EGO, row, strict=False))
        values["gear"] = round(values["gear"])
        values["shift_in_process"] = values["shift_in_process"] > 0.5
        pressures = tuple(row[len(_EGO) :])
        found.append(EgoState(time=float(time), brake_pressures=pressures, **values))
    return found


def pack_scenes(scenes: Sequence[Scene]) -> Fields:
    """Scenes as arrays; InputError's cases do not occur in a drive without events."""
    assert all(scene.signals == RoadSignals() for scene in scenes)
    frames = [VehicleFrame.of(scene.vehicles) for scene in scenes]
    names = sorted({i for frame in frames for i in frame.ids})
    return pack_states([scene.ego for scene in scenes], "ego") | {
        "footprint": np.array(dataclasses.astuple(scenes[0].footprint)),
        "vehicles": np.concatenate([rounded(frame.values) for frame in frames]),
        "counts": np.array([len(frame) for frame in frames]),
        "lanes": np.concatenate([frame.lanes for frame in frames]),
        "names": np.array(names),
        "kinds": np.concatenate([np.array(frame.kinds, dtype="U16") for frame in frames]),
        "name_of": np.array([names.index(i) for frame in frames for i in frame.ids], dtype=int),
    }


def unpack_scenes(arrays: Fields) -> list[Scene]:
    """The scenes of `pack_scenes`."""
    footprint = EgoFootprint(*arrays["footprint"].tolist())
    ends = np.cumsum(arrays["counts"])
    found = []
    for ego, end, count in zip(unpack_states(arrays, "ego"), ends, arrays["counts"], strict=True):
        rows = slice(end - count, end)
        values = arrays["vehicles"][rows].astype(float) * STEP
        vehicles = VehicleFrame(
            arrays["names"][arrays["name_of"][rows]].tolist(),
            arrays["kinds"][rows].tolist(),
            arrays["lanes"][rows].astype(np.intp),
            np.ascontiguousarray(values.T).reshape(len(COLUMNS), -1),
        )
        found.append(Scene(ego.time, ego, vehicles, footprint))
    return found


def pack_plans(plans: Sequence[Trajectory]) -> Fields:
    """Trajectories of equal length as arrays."""
    table = [[getattr(plan, name) for name in _PATH] for plan in plans]
    modes = list(PlanMode)
    others = [(modes.index(p.mode), p.target_lane, int(p.refused)) for p in plans]
    return {"plans": pack(rounded(table), axis=2), "plan_modes": np.array(others)}


def unpack_plans(arrays: Fields) -> list[Trajectory]:
    """The trajectories of `pack_plans`, without the words that explain them."""
    modes = list(PlanMode)
    found = []
    for table, (mode, lane, refused) in zip(
        unpack(arrays["plans"], axis=2), arrays["plan_modes"].tolist(), strict=True
    ):
        path: dict[str, Any] = dict(zip(_PATH, table, strict=True))
        path |= {"mode": modes[mode], "target_lane": lane, "refused": Decision(refused)}
        found.append(Trajectory(**path))
    return found


# --- drive and replay -------------------------------------------------------------------------


class Recorder(Observer):
    """Keeps the messages between the modules of a drive."""

    period = 0.1

    def __init__(self, simulation: Simulation) -> None:
        self.stack = simulation.stack
        self.scenes: list[Scene] = []
        self.plans: list[Trajectory] = []
        self.decisions: list[int] = []
        self.states: list[EgoState] = []

    def planned(self, scene: Scene, trajectory: Trajectory) -> None:
        """Keeps a scene and its plan, and the decision if there was one."""
        if self.stack.decisions != len(self.decisions):
            self.decisions.append(int(self.stack.last_decision))
        self.scenes.append(scene)
        self.plans.append(trajectory)

    def commanded(self, ego: EgoState, wanted: VehicleCommand, obeyed: VehicleCommand) -> None:
        """Keeps the state that the tracker sees."""
        del wanted, obeyed
        self.states.append(ego)

    def observe(self, simulation: Any, frame: Any) -> None:
        """Nothing to keep at the end of a cycle."""


def record() -> dict[str, Fields]:
    """Drives the reference drive; returns the inputs of each module."""
    with Simulation(DRIVE, visuals=False) as simulation:
        seen = Recorder(simulation)
        simulation.run([seen])
        if simulation.stack.lane_changes == 0 or simulation.collision:
            raise SystemExit("references: the reference drive has no lane change: choose another")
    scenes, decisions = pack_scenes(seen.scenes), {"decisions": np.array(seen.decisions)}
    return {
        "decision": scenes | decisions,
        "planner": scenes | decisions,
        "tracker": pack_states(seen.states, "states") | pack_plans(seen.plans) | {
            "plan_time": np.array([scene.time for scene in seen.scenes])
        },
        "traffic": pack_states([s.ego for s in seen.scenes], "ego")
        | {"footprint": scenes["footprint"]},
    }  # fmt: skip


class _Decisions:
    """Decision maker that returns given decisions, and may ask another one each time."""

    name = "reference"

    def __init__(self, decisions: Sequence[int], other: Any = None) -> None:
        self._decisions, self._other = decisions, other
        self.answers: Outputs = []

    def reset(self) -> None:
        self._next = 0
        if self._other is not None:
            self._other.reset()

    def decide(self, context: DecisionContext) -> Decision:
        if self._other is not None:
            network = self._other.network
            self.answers.append(
                (
                    context.scene.time,
                    {
                        "observation": context.observation,
                        "values": network.values(context.observation),
                        "decision": np.array(int(self._other.decide(context))),
                    },
                )
            )
        self._next += 1
        return Decision(int(self._decisions[self._next - 1]))


def _stack() -> Any:
    return make_stack(DRIVE, load_map(DRIVE.map).route(), TruckParameters.load())


def replay(module: str, inputs: Fields) -> Outputs:
    """Runs a module alone on its inputs; returns times and fields of its outputs."""
    return list({
        "decision": _decide, "planner": _plan, "tracker": _track, "traffic": _move
    }[module](inputs))  # fmt: skip


def _decide(inputs: Fields) -> Outputs:
    stack = _stack()
    maker = _Decisions(inputs["decisions"].tolist(), stack.decision_maker)
    stack.decision_maker = maker
    stack.reset()
    for scene in unpack_scenes(inputs):
        stack.plan(scene)
    return maker.answers


def _plan(inputs: Fields) -> Iterator[tuple[float, Fields]]:
    stack = _stack()
    stack.decision_maker = _Decisions(inputs["decisions"].tolist())
    stack.reset()
    for scene in unpack_scenes(inputs):
        plan = stack.plan(scene)
        fields = {name: np.asarray(getattr(plan, name)) for name in _PATH}
        fields["mode"] = np.array(list(PlanMode).index(plan.mode))
        fields["target_lane"] = np.array(plan.target_lane)
        fields["refused"] = np.array(int(plan.refused))
        yield scene.time, fields


def _track(inputs: Fields) -> Iterator[tuple[float, Fields]]:
    tracker = _stack().tracker
    tracker.reset()
    plans = list(zip(inputs["plan_time"].tolist(), unpack_plans(inputs), strict=True))
    place = 0
    for ego in unpack_states(inputs, "states"):
        while place + 1 < len(plans) and plans[place + 1][0] <= ego.time + 1e-9:
            place += 1
        command = tracker.command(ego, plans[place][1])
        values = dataclasses.asdict(command)
        yield ego.time, {name: np.array(float(value)) for name, value in values.items()}


def _move(inputs: Fields) -> Iterator[tuple[float, Fields]]:
    route = load_map(DRIVE.map).route()
    traffic = make_traffic(DRIVE, route, EgoFootprint(*inputs["footprint"].tolist()))
    assert traffic is not None
    with contextlib.closing(traffic):
        for number, ego in enumerate(unpack_states(inputs, "ego")):
            vehicles = VehicleFrame.of(traffic.step(ego) if number else traffic.reset(ego))
            fields = {name: vehicles.column(name).copy() for name in COLUMNS}
            fields["lane"] = np.asarray(vehicles.lanes, dtype=np.int64)
            fields["id"] = np.array(vehicles.ids, dtype="U32")
            yield ego.time, fields


# --- references -------------------------------------------------------------------------------


def kernels() -> dict[str, str]:
    """What decides about the last bits: processor, vector units in use, libraries."""
    units: Any = importlib.import_module("numpy._core._multiarray_umath")

    used = [name for name in units.__cpu_dispatch__ if units.__cpu_features__[name]]
    libraries = ("numpy", "scipy", "casadi", "libsumo")
    return {
        "machine": f"{platform.system()} {platform.machine()}",
        "vector_units": " ".join(used),
        "openblas": os.environ.get("OPENBLAS_CORETYPE", ""),
        "c_library": " ".join(platform.libc_ver()),
        **{name: version(name) for name in libraries},
    }


def _checksum(values: NDArray[Any]) -> int:
    return zlib.crc32(
        f"{values.dtype}{values.shape}".encode() + np.ascontiguousarray(values).tobytes()
    )


def digest_of(outputs: Outputs) -> str:
    """Sixteen hexadecimal digits of the SHA-256 of all outputs."""
    digest = hashlib.sha256()
    for time, fields in outputs:
        digest.update(np.float64(time).tobytes())
        for name, values in fields.items():
            digest.update(name.encode() + values.dtype.str.encode() + values.tobytes())
    return digest.hexdigest()[:16]


@dataclass
class Reference:
    """The stored reference of a module.

    Attributes:
      inputs: arrays; digest: of all outputs; kernels: under which they were computed.
      times, names: of the outputs and of their fields.
      checksums: shape (outputs, fields); stored: some outputs as values, by number.
    """

    inputs: Fields
    digest: str
    kernels: dict[str, str]
    times: NDArray[np.float64]
    names: list[str]
    checksums: NDArray[np.uint32]
    stored: dict[int, Fields]

    @classmethod
    def of(cls, module: str, inputs: Fields, outputs: Outputs) -> Reference:
        """Returns the reference of a module's outputs."""
        names = list(outputs[0][1])
        sums = [[_checksum(fields[name]) for name in names] for _, fields in outputs]
        every = STORED[module]
        return cls(
            inputs=inputs,
            digest=digest_of(outputs),
            kernels=kernels(),
            times=np.array([time for time, _ in outputs]),
            names=names,
            checksums=np.array(sums, dtype=np.uint32),
            stored={k: outputs[k][1] for k in range(0, len(outputs), every)},
        )

    @classmethod
    def load(cls, path: Path) -> Reference:
        """Reads a reference from its file."""
        with np.load(path, allow_pickle=False) as arrays:
            about = json.loads(str(arrays["about"]))
            stored: dict[int, Fields] = {int(k): {} for k in arrays["stored"]}
            for name in about["names"]:
                flat, begin = arrays[f"output/{name}"], 0
                for k, shape in zip(stored, arrays[f"shape/{name}"].tolist(), strict=True):
                    size = shape if shape >= 0 else 1
                    values = flat[begin : begin + size]
                    stored[k][name] = values if shape >= 0 else values.reshape(())
                    begin += size
            return cls(
                inputs={n[6:]: arrays[n] for n in arrays.files if n.startswith("input/")},
                digest=about["digest"],
                kernels=about["kernels"],
                times=arrays["times"],
                names=about["names"],
                checksums=arrays["checksums"],
                stored=stored,
            )

    def save(self, path: Path) -> None:
        """Writes the file."""
        about = {"digest": self.digest, "kernels": self.kernels, "names": self.names}
        arrays: Fields = {f"input/{name}": values for name, values in self.inputs.items()}
        for name in self.names:
            parts = [fields[name] for fields in self.stored.values()]
            arrays[f"output/{name}"] = np.concatenate([np.atleast_1d(part) for part in parts])
            # The length of an output; -1 for a single number.
            arrays[f"shape/{name}"] = np.array([p.size if p.ndim else -1 for p in parts])
        path.parent.mkdir(parents=True, exist_ok=True)
        np.savez_compressed(
            path,
            about=np.array(json.dumps(about)),
            times=self.times,
            checksums=self.checksums,
            stored=np.array(list(self.stored)),
            **arrays,  # type: ignore[arg-type]
        )


@dataclass
class Difference:
    """A field of a module's outputs that differs from the reference.

    Attributes:
      name: of the field; time: of the first output that differs [s]; count: of these outputs.
      largest: among the outputs whose values are stored; None if those are equal.
    """

    name: str
    time: float
    count: int
    largest: float | None

    def __str__(self) -> str:
        size = (
            "the stored values are equal" if self.largest is None else f"{self.largest:.3g} apart"
        )
        return f"{self.name}: {self.count} outputs, first at t = {self.time:.2f} s, {size}"


@dataclass
class Finding:
    """Comparison of a module with its reference.

    Attributes:
      bits: whether bits were compared, rather than values with a tolerance.
      differences: by field; digest: of the present outputs.
    """

    module: str
    bits: bool
    digest: str
    differences: list[Difference] = field(default_factory=list)


def compare(module: str, reference: Reference, outputs: Outputs, bits: bool) -> Finding:
    """Compares outputs with the reference: bits, or stored values with the tolerance."""
    found = Finding(module, bits, digest_of(outputs))
    now = Reference.of(module, reference.inputs, outputs)
    if now.names != reference.names or len(now.times) != len(reference.times):
        size = f"{len(outputs)} outputs of {', '.join(now.names)}"
        found.differences.append(Difference(f"shape ({size})", 0.0, len(outputs), None))
        return found
    for column, name in enumerate(reference.names):
        worst, beyond, allowed = 0.0, [], _allowed(reference, name)
        for k, fields in reference.stored.items():
            apart = _apart(fields[name], outputs[k][1][name])
            worst = max(worst, apart)
            if apart > allowed:
                beyond.append(k)
        if bits:
            beyond = np.flatnonzero(
                reference.checksums[:, column] != now.checksums[:, column]
            ).tolist()
        if beyond:
            time = float(reference.times[beyond[0]])
            found.differences.append(Difference(name, time, len(beyond), worst or None))
    return found


def _apart(one: NDArray[Any], other: NDArray[Any]) -> float:
    """The greatest difference; inf if the arrays cannot be subtracted."""
    if one.shape != other.shape:
        return np.inf
    if one.dtype.kind not in "if":
        return 0.0 if np.array_equal(one, other) else np.inf
    return float(np.abs(one.astype(float) - other.astype(float)).max(initial=0.0))


def _allowed(reference: Reference, name: str) -> float:
    values = [fields[name] for fields in reference.stored.values()]
    if values[0].dtype.kind != "f":
        return 0.0
    largest = max(float(np.abs(v).max(initial=0.0)) for v in values)
    return TOLERANCE[str(values[0].dtype)] * max(largest, 1e-3)


def check(modules: Sequence[str], folder: Path = FOLDER) -> list[Finding]:
    """Replays modules and compares them with their references."""
    found = []
    for module in modules:
        reference = Reference.load(folder / f"{module}.npz")
        outputs = replay(module, reference.inputs)
        found.append(compare(module, reference, outputs, reference.kernels == kernels()))
    return found


def renew(modules: Sequence[str], reason: str, drive: bool, folder: Path = FOLDER) -> list[str]:
    """Writes references whose outputs changed, and the reason; returns their modules.

    Args:
      modules: to replay.
      reason: why the outputs changed.
      drive: also record the inputs again.
      folder: of the references.
    """
    missing = [m for m in modules if not (folder / f"{m}.npz").exists()]
    inputs = record() if drive or missing else {}
    changed, lines = [], []
    for module in modules:
        path = folder / f"{module}.npz"
        old = Reference.load(path) if path.exists() else None
        given = inputs.get(module) if drive or old is None else old.inputs
        assert given is not None
        new = Reference.of(module, given, replay(module, given))
        if old is not None and not drive and (old.digest, old.kernels) == (new.digest, new.kernels):
            continue
        new.save(path)
        changed.append(module)
        today = datetime.date.today().isoformat()
        lines.append((today, module, old.digest if old else "", new.digest, reason))
    log = folder / LOG.name
    fresh = not log.exists()
    if lines:
        with log.open("a", newline="") as stream:
            writer = csv.writer(stream, lineterminator="\n")
            if fresh:
                writer.writerow(LOG_COLUMNS)
            writer.writerows(lines)
    return changed


def main() -> int:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("action", choices=("check", "renew"))
    parser.add_argument("--reason", default="", help="why the outputs changed; needed to renew")
    parser.add_argument("--only", default=",".join(MODULES), help="modules, comma separated")
    parser.add_argument("--drive", action="store_true", help="renew the inputs as well")
    parser.add_argument("--folder", type=Path, default=FOLDER)
    parser.add_argument("--json", action="store_true", help="print the findings as JSON")
    options = parser.parse_args()
    modules = [name for name in options.only.split(",") if name]
    unknown = set(modules) - set(MODULES)
    if unknown:
        parser.error(f"unknown modules {sorted(unknown)}; there are {', '.join(MODULES)}")
    if options.action == "renew":
        if not options.reason.strip():
            parser.error('renew needs a reason: make references REASON="why the outputs change"')
        changed = renew(modules, options.reason.strip(), options.drive, options.folder)
        print(f"renewed: {', '.join(changed) or 'nothing, the outputs are unchanged'}")
        return 0
    findings = check(modules, options.folder)
    if options.json:
        print(json.dumps([dataclasses.asdict(finding) for finding in findings]))
    for finding in findings if not options.json else ():
        how = "bit for bit" if finding.bits else "with a tolerance: other kernels or libraries"
        print(f"{finding.module}: {'differs' if finding.differences else 'equal'}, {how}")
        for difference in finding.differences:
            print(f"  {difference}")
    return 1 if any(finding.differences for finding in findings) else 0


if __name__ == "__main__":
    if any(os.environ.get(name) != value for name, value in KERNELS.items()):
        os.execve(sys.executable, [sys.executable, *sys.argv], {**os.environ, **KERNELS})
    sys.exit(main())
