"""Runs plugin and kernels under AddressSanitizer, UndefinedBehaviorSanitizer and ThreadSanitizer.

    python tools/sanitize.py                 everything
    python tools/sanitize.py --only thread   one of address, thread

Both are compiled with the sanitizers into build/sanitize, and Python starts with their runtime in
LD_PRELOAD. Python, MuJoCo and the other libraries are not instrumented.

- address: AddressSanitizer, LeakSanitizer and UndefinedBehaviorSanitizer, with the tests of the
  plugin and of the kernels and 300 fuzzed inputs of the plugin.
- thread: ThreadSanitizer, with roll-outs of several trucks on two threads, and with two threads
  that make, step, copy and delete models and data.

First each sanitizer must find a deliberate fault (tests/plugin/sanitizer_bugs.cc). The exit code is
1 after any report, except for leaks outside the two: Python never frees some of its objects.
"""

from __future__ import annotations

import argparse
import atexit
import contextlib
import ctypes
import os
import re
import shutil
import subprocess
import sys
import tempfile
import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
PLUGIN = ROOT / "iits_mj" / "plugin"
KERNELS = ROOT / "iits_mj" / "kernels"
BUGS = ROOT / "tests" / "plugin" / "sanitizer_bugs.cc"
BUILD = ROOT / "build" / "sanitize"
BUGS_LIBRARY = "libsanitizer_bugs.so"
BUGS_VARIABLE = "IITS_SANITIZER_BUGS"
# Folders of the libraries, by the environment variable that names the build to load.
LIBRARIES = {"IITS_MJ_PLUGIN": PLUGIN, "IITS_MJ_KERNELS": KERNELS}
# As in CMakeLists.txt, but with little optimization, so that stacks are complete.
FLAGS = (
    *("-std=c++17", "-O1", "-g", "-fno-omit-frame-pointer", "-fPIC", "-shared"),
    *("-ffp-contract=off", "-fno-math-errno", "-fvisibility=hidden"),
)
# Without pytest's capture of the file descriptors, because the runtimes write to stderr.
PYTEST = (
    *("-m", "pytest", "-p", "sanitize", "-p", "no:cacheprovider", "-n", "0"),
    *("--capture=sys", "-m", "not slow"),
)
# The plugin's own tests, without those that compile programs or drive for long.
PLUGIN_TESTS = (
    *("tests/plugin", "tests/truck/test_rollouts.py", "tests/truck/test_fleet.py"),
    "tests/truck/test_plant.py",
    *("--ignore=tests/plugin/test_laws.py", "--ignore=tests/plugin/test_gearbox_hunting.py"),
    "--ignore=tests/plugin/test_manuals.py",
)
# Tests of the modules that call kernels. SUMO's own programs fail with the runtime preloaded.
KERNEL_TESTS = (
    *("tests/kernels", "tests/controllers/tracking", "tests/controllers/planning"),
    *("tests/controllers/pcc", "tests/traffic_bridge/mirror/test_units.py"),
    *(
        "tests/traffic_bridge/mirror/test_articulation.py",
        "tests/traffic_bridge/mirror/test_contact.py",
    ),
    "tests/traffic_bridge/modes/test_smoothing.py",
    *("tests/traffic_bridge/network/test_lane_poses.py", "tests/road/test_reference_line.py"),
    *("tests/truck/test_state.py", "tests/simulation/test_gaps.py"),
    *("tests/controllers/decision/test_rules.py", "tests/controllers/decision/test_worlds.py"),
    "tests/controllers/decision/test_fast_world_agreement.py",
    # The runtime ends a process that loads IPOPT, which CasADi opens with RTLD_DEEPBIND.
    *("-k", "not ipopt"),
)
# Command of each check, after `python`.
CHECKS: dict[str, dict[str, tuple[str, ...]]] = {
    "address": {
        "tests of the plugin": (*PYTEST, *PLUGIN_TESTS),
        "tests of the kernels": (*PYTEST, *KERNEL_TESTS),
        "fuzzing of the plugin": (__file__, "--fuzz"),
    },
    "thread": {"two threads": (__file__, "--threads")},
}
# Last line of a process that was not ended by the runtime, which may exit with 0.
ENDED = "sanitize: the process ended by itself"
# One report: from its first line to the next one's, or to the end.
_REPORT = re.compile(
    r"(?m)^(?=(?:==\d+==ERROR|WARNING: ThreadSanitizer|(?:Direct|Indirect) leak|.*runtime error:))"
)


@dataclass(frozen=True)
class Kind:
    """A build with sanitizers.

    Attributes:
      name: of its folder; flags: of the compiler; runtimes: libraries to preload.
      options: environment variables with the settings of the runtimes, by name.
      bugs: deliberate faults that it must report, with a part of the report's text.
    """

    name: str
    flags: tuple[str, ...]
    runtimes: tuple[str, ...]
    options: dict[str, str]
    bugs: dict[str, str]

    @property
    def folder(self) -> Path:
        """Folder of the libraries and the reports."""
        return BUILD / self.name

    def library(self, sources: Path) -> Path:
        """Path of the library of a folder of sources."""
        return self.folder / f"libiits_mj_{sources.name}.so"


KINDS = {
    kind.name: kind
    for kind in (
        Kind(
            "address",
            # Conversions of too large floating-point numbers are undefined, too. After a report
            # the program goes on, so that one run finds all faults.
            ("-fsanitize=address,undefined,float-cast-overflow", "-fsanitize-recover=all"),
            # libstdc++ first loaded by a plugin would be unknown to the runtime.
            ("libasan.so", "libubsan.so", "libstdc++.so.6"),
            {
                "ASAN_OPTIONS": "halt_on_error=0:detect_leaks=1",
                "UBSAN_OPTIONS": "print_stacktrace=1",
                "LSAN_OPTIONS": "exitcode=0",
                # Python's arenas would hide the ends of its arrays.
                "PYTHONMALLOC": "malloc",
            },
            {
                "overflow": "heap-buffer-overflow",
                "undefined": "signed integer overflow",
                "leak": "leak of",
            },
        ),
        Kind(
            "thread",
            ("-fsanitize=thread",),
            ("libtsan.so",),
            # Memory that libraries without instrumentation hand from thread to thread by atomics
            # looks like a race. Their locks count all the same.
            {"TSAN_OPTIONS": "ignore_noninstrumented_modules=1:halt_on_error=0:exitcode=0"},
            {"race": "data race"},
        ),
    )
}


# --- building ---------------------------------------------------------------------------------


def compiler() -> str:
    """Returns the C++ compiler; it must be GCC, whose runtimes are libraries of their own.

    Raises:
      SystemExit: there is no GCC.
    """
    found = shutil.which(os.environ.get("CXX", "g++")) or shutil.which("g++")
    if found is None:
        raise SystemExit("sanitize: g++ is missing: apt-get install g++")
    return found


def runtime(name: str) -> str:
    """Returns the path of a runtime library.

    Raises:
      SystemExit: the compiler does not have it.
    """
    command = [compiler(), f"-print-file-name={name}"]
    path = subprocess.run(command, check=True, capture_output=True, text=True).stdout.strip()
    if not Path(path).is_file():
        raise SystemExit(f"sanitize: {compiler()} has no {name}")
    # A linker script is no library; the link beside it has a version.
    return str(Path(path).resolve())


def build(kind: Kind, library: Path, sources: Sequence[Path]) -> None:
    """Compiles a library with the sanitizers, unless it is newer than its sources."""
    import mujoco

    headers = [*PLUGIN.glob("**/*.h"), *KERNELS.glob("*.h"), Path(__file__)]
    newest = max(path.stat().st_mtime for path in (*sources, *headers))
    if library.is_file() and library.stat().st_mtime > newest:
        return
    kind.folder.mkdir(parents=True, exist_ok=True)
    root = Path(mujoco.__file__).parent
    (engine,) = root.glob("libmujoco.so.*")
    partial = library.with_suffix(".partial")
    subprocess.run(
        [
            *(compiler(), *FLAGS, *kind.flags, f"-I{root / 'include'}", f"-I{ROOT / 'iits_mj'}"),
            *(*map(str, sources), str(engine), f"-Wl,-rpath,{root}", "-o", str(partial)),
        ],
        check=True,
    )
    partial.replace(library)


# --- running ----------------------------------------------------------------------------------


def run(kind: Kind, arguments: Sequence[str], quiet: bool = False) -> tuple[int, list[str]]:
    """Runs Python with the sanitizers; returns its exit code and all reports."""
    environment = (
        os.environ
        | {
            "LD_PRELOAD": " ".join(runtime(name) for name in kind.runtimes),
            "PYTHONPATH": os.pathsep.join((str(ROOT / "tools"), str(ROOT))),
            BUGS_VARIABLE: str(kind.folder / BUGS_LIBRARY),
        }
        | {variable: str(kind.library(sources)) for variable, sources in LIBRARIES.items()}
    )
    environment |= kind.options
    command = [*fixed_addresses(), sys.executable, *arguments]
    output = subprocess.DEVNULL if quiet else None
    errors = kind.folder / "stderr.txt"
    with errors.open("w") as file:
        code = subprocess.run(command, cwd=ROOT, env=environment, stdout=output, stderr=file)
    return code.returncode, read_reports(errors.read_text(errors="replace"))


def fixed_addresses() -> list[str]:
    """Returns a prefix that switches random addresses off: older runtimes cannot cope with them."""
    setarch = shutil.which("setarch")
    if setarch and not subprocess.run([setarch, "-R", "true"], capture_output=True).returncode:
        return [setarch, "-R"]
    return []


def read_reports(text: str) -> list[str]:
    """Returns the reports of the runtimes, without leaks outside plugin and kernels."""
    own = (str(PLUGIN), str(KERNELS), BUGS.name)
    reports = []
    for report in _REPORT.split(text)[1:]:
        leak = "leak of" in report.splitlines()[0] or "detected memory leaks" in report
        if not leak or any(name in report for name in own):
            reports.append(report)
    return reports


def check(kind: Kind, what: str, arguments: Sequence[str]) -> bool:
    """Runs a check and prints its result; True without a report."""
    print(f"sanitize: {kind.name}: {what}", flush=True)
    code, reports = run(kind, arguments)
    errors = (kind.folder / "stderr.txt").read_text(errors="replace")
    good = code == 0 and not reports and ENDED in errors
    if not good:
        print("\n".join(reports) or errors[-4000:])
    result = "no report" if good else f"{len(reports)} reports, exit code {code}"
    print(f"sanitize: {kind.name}: {what}: {result}", flush=True)
    return good


def check_finds_bugs(kind: Kind) -> bool:
    """Runs every deliberate fault; True if all are reported, in the file that has them."""
    good = True
    for bug, text in kind.bugs.items():
        _, reports = run(kind, [__file__, "--bug", bug], quiet=True)
        found = any(text in report and BUGS.name in report for report in reports)
        _, others = run(kind, [__file__, "--bug", "none"], quiet=True) if found else (0, [])
        good &= found and not others
        result = "reported" if found else "NOT REPORTED"
        result += "; A REPORT WITHOUT A FAULT" if others else ""
        print(f"sanitize: {kind.name}: deliberate fault '{bug}': {result}", flush=True)
    return good


# --- inside the instrumented process ----------------------------------------------------------


def check_libraries() -> None:
    """Checks that this process runs the instrumented libraries, and no other builds of them.

    Raises:
      RuntimeError: it does not.
    """
    from iits_mj import kernels
    from iits_mj.plugin import register

    kernels.function("iits_multiply_add", kernels.Real)
    # A line of the memory map ends with the file; the runtime may have unlinked a copy.
    lines = Path("/proc/self/maps").read_text().splitlines()
    for library in (register(), kernels.path()):
        mapped = {line.split(maxsplit=5)[5] for line in lines if library.name in line}
        if BUILD not in library.parents or mapped != {str(library)}:
            raise RuntimeError(f"named: {library}, loaded: {mapped}; expected a build in {BUILD}")


def begin() -> None:
    """Checks the libraries, and lets the process say at its end that it was not ended."""
    check_libraries()
    atexit.register(print, ENDED, file=sys.__stderr__)


def pytest_configure(config: object) -> None:
    """Hook of pytest, which loads this file as a plugin."""
    del config
    begin()


def show_bug(bug: str) -> None:
    """Steps a model with a deliberate fault on two threads."""
    import mujoco
    import mujoco.rollout
    import numpy as np

    mujoco.mj_loadPluginLibrary(os.environ[BUGS_VARIABLE])
    model = mujoco.MjModel.from_xml_string(
        f"""<mujoco><extension><plugin plugin="iits.sanitizer_bugs"><instance name="bugs">
        <config key="bug" value="{bug}"/></instance></plugin></extension>
        <worldbody><body><freejoint/><geom size=".1"/><plugin instance="bugs"/></body></worldbody>
        </mujoco>"""
    )
    datas = [mujoco.MjData(model) for _ in range(2)]
    kind = mujoco.mjtState.mjSTATE_FULLPHYSICS
    state = np.zeros(mujoco.mj_stateSize(model, kind))
    mujoco.mj_getState(model, datas[0], state, kind)
    # Long enough that the threads run at the same time on a busy machine, too.
    steps = 20_000 if bug == "race" else 10
    with mujoco.rollout.Rollout(nthread=2) as pool:
        pool.rollout(model, datas, np.tile(state, (8, 1)), nstep=steps)


def fuzz(inputs: int) -> None:
    """Sets random controls and states, and steps; errors of this package are allowed."""
    import numpy as np

    from iits_mj.core.errors import Error
    from tests.fuzz.targets import attack, make_targets

    with tempfile.TemporaryDirectory() as folder:
        target = make_targets(Path(folder))["plugin"]
        for number in range(inputs):
            mutant = attack(target, np.random.default_rng((0, number)))
            with contextlib.suppress(Error):
                target.take(mutant)


def roll_out_trucks() -> None:
    """Rolls out drives of three trucks on two threads, by MuJoCo's interfaces and each plant."""
    import mujoco
    import mujoco.rollout
    import numpy as np

    from iits_mj.core.timing import PLANTS
    from iits_mj.road import Route
    from iits_mj.truck.fleet import TruckFleet
    from iits_mj.truck.placement import TruckPlacement
    from iits_mj.truck.rollouts import Scenario, roll_out

    road = Route.straight(length=3000.0, lanes=2)
    fleet = TruckFleet.load((0.0, 12_000.0, 36_000.0), route=road, visuals=False)
    fleet.reset([TruckPlacement(station=100.0 + 60.0 * k, speed=15.0) for k in range(3)])
    model, kind = fleet.model, mujoco.mjtState.mjSTATE_FULLPHYSICS
    state = np.zeros(mujoco.mj_stateSize(model, kind))
    mujoco.mj_getState(model, fleet.data, state, kind)
    datas = [mujoco.MjData(model) for _ in range(2)]
    low, high = model.actuator_ctrlrange.T
    controls = np.random.default_rng(0).uniform(low, high, (8, 200, model.nu))
    with mujoco.rollout.Rollout(nthread=2) as pool:
        pool.rollout(model, datas, np.tile(state, (8, 1)), controls)
    scenarios = [
        Scenario(route=road, payload=payload, place=TruckPlacement(station=100.0, speed=speed))
        for payload in (0.0, 36_000.0)
        for speed in (5.0, 15.0)
    ]
    for plant in PLANTS:
        for command in ({"accelerator_pedal": 1.0}, {"brake_pedal": 1.0}):
            roll_out(scenarios, command, duration=1.0, threads=2, plant=plant)
            roll_out(scenarios[:2], command, duration=1.0, threads=2, plant=plant)


def make_and_delete(rounds: int = 30) -> None:
    """Makes, steps, copies and deletes models and data in two threads at the same time.

    The threads call the engine by ctypes, which runs without Python's lock.
    """
    import mujoco

    from iits_mj.truck import Truck

    truck = Truck.load(12_000.0, visuals=False)
    truck.reset(speed=10.0)
    (path,) = Path(mujoco.__file__).parent.glob("libmujoco.so.*")
    engine = ctypes.CDLL(str(path))

    def function(name: str, *arguments: Any) -> Callable[..., int]:
        found: Callable[..., int] = getattr(engine, name)
        found.restype, found.argtypes = ctypes.c_void_p, list(arguments)  # type: ignore[attr-defined]
        return found

    pointer = ctypes.c_void_p
    copy_model = function("mj_copyModel", pointer, pointer)
    make_data = function("mj_makeData", pointer)
    copy_data = function("mj_copyData", pointer, pointer, pointer)
    reset = function("mj_resetData", pointer, pointer)
    step = function("mj_step", pointer, pointer)
    delete_data = function("mj_deleteData", pointer)
    delete_model = function("mj_deleteModel", pointer)
    shared, state = truck.model._address, truck.data._address
    start = threading.Barrier(2)

    def work() -> None:
        start.wait()
        for _ in range(rounds):
            own = copy_model(None, shared)
            for model in (own, shared):
                first = make_data(model)
                for _ in range(10):
                    step(model, first)
                second = copy_data(None, model, first)
                copy_data(second, model, first)
                for _ in range(10):
                    step(model, second)
                reset(model, first)
                step(model, first)
                delete_data(first)
                delete_data(second)
            third = copy_data(None, shared, state)
            step(shared, third)
            delete_data(third)
            delete_model(own)

    threads = [threading.Thread(target=work) for _ in range(2)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()


def main(arguments: list[str] | None = None) -> int:
    """Command line; 1 after a report, or when a deliberate fault is not reported."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--only", choices=tuple(KINDS), help="one kind of sanitizers")
    parser.add_argument("--self-check", action="store_true", help="only the deliberate faults")
    parser.add_argument("--bug", help=argparse.SUPPRESS)
    parser.add_argument("--fuzz", action="store_true", help=argparse.SUPPRESS)
    parser.add_argument("--threads", action="store_true", help=argparse.SUPPRESS)
    options = parser.parse_args(arguments)
    if options.bug:
        show_bug(options.bug)
        return 0
    if options.fuzz:
        begin()
        fuzz(300)
        return 0
    if options.threads:
        begin()
        roll_out_trucks()
        make_and_delete()
        return 0
    good = True
    for kind in KINDS.values():
        if options.only not in (None, kind.name):
            continue
        build(kind, kind.folder / BUGS_LIBRARY, [BUGS])
        for sources in LIBRARIES.values():
            build(kind, kind.library(sources), sorted(sources.rglob("*.cc")))
        good &= check_finds_bugs(kind)
        if options.self_check:
            continue
        for what, command in CHECKS[kind.name].items():
            good &= check(kind, what, command)
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main())
