"""Check the installation: versions, engine plugin, OpenGL, SUMO; name a remedy for each problem.

Exit code 0 when every required part works, 1 otherwise; optional parts do not count.
"""

from __future__ import annotations

import functools
import importlib
import importlib.metadata
import json as json_module
import os
import platform
import subprocess
import sys
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path

import mujoco

import iits_mj
from iits_mj import plugin as plugin_library
from iits_mj.commands.terminal import show
from iits_mj.core.errors import Error
from iits_mj.core.options import option
from iits_mj.core.progress import each
from iits_mj.parameters import TruckParameters, shipped_trucks

MUJOCO_WANTED = "3.17.0"
_GL_PROBE = """
import mujoco
context = mujoco.GLContext(64, 64)
context.make_current()
model = mujoco.MjModel.from_xml_string("<mujoco><worldbody><geom size='1'/></worldbody></mujoco>")
mujoco.MjrContext(model, mujoco.mjtFontScale.mjFONTSCALE_100)
"""


@dataclass(frozen=True, kw_only=True)
class Options:
    """Flags of `iits-mj doctor`."""

    json: bool = option(False, help="print one JSON object instead of the table", group="output")


@dataclass(frozen=True, slots=True)
class Finding:
    """One line of the report: a part of the installation, its state and a remedy."""

    name: str
    ok: bool
    detail: str
    remedy: str = ""
    needed: bool = True

    @property
    def verdict(self) -> str:
        """Returns ok, MISSING (a needed part) or absent (an optional part)."""
        return "ok" if self.ok else ("MISSING" if self.needed else "absent")

    @property
    def remedy_text(self) -> str:
        """Returns the remedy, "" for a part that works."""
        return "" if self.ok else self.remedy


def run(options: Options) -> int:
    """Checks every part and prints one line each; returns the exit code."""
    findings = [probe() for probe in each(PROBES, "checking")]
    well = all(finding.ok for finding in findings if finding.needed)
    if options.json:
        rows = [asdict(finding) | {"remedy": finding.remedy_text} for finding in findings]
        print(json_module.dumps({"command": "doctor", "ok": well, "findings": rows}))
    else:
        width = max(len(finding.name) for finding in findings)
        for finding in findings:
            line = f"{finding.verdict:8}{finding.name.ljust(width)}  {finding.detail}"
            show(line + (f"; remedy: {finding.remedy_text}" if finding.remedy_text else ""))
    return 0 if well else 1


def python() -> Finding:
    """Checks the Python interpreter."""
    return Finding(
        "Python",
        sys.version_info >= (3, 11),
        f"{platform.python_version()} on {platform.system()} {platform.machine()}",
        "install Python 3.11 or newer",
    )


def package() -> Finding:
    """Reports version and place of this package."""
    return Finding("iits-mj", True, f"{iits_mj.__version__} in {Path(iits_mj.__file__).parent}")


def engine() -> Finding:
    """Checks the version of MuJoCo, for which the plugin is compiled."""
    return Finding(
        "MuJoCo",
        mujoco.__version__ == MUJOCO_WANTED,
        f"{mujoco.__version__}, the plugin is built for {MUJOCO_WANTED}",
        f"pip install mujoco=={MUJOCO_WANTED}",
    )


def plugin() -> Finding:
    """Checks the compiled engine plugin."""
    try:
        path = plugin_library.register()
    except Error as error:
        return Finding("engine plugin", False, str(error), "pip install . (needs g++)")
    return Finding("engine plugin", True, str(path))


def truck() -> Finding:
    """Simulates the truck for 0.2 s on a plane."""
    try:
        standing = iits_mj.Truck.load(visuals=False)
        standing.step(100)
    except Error as error:
        return Finding("truck", False, str(error), "see the engine plugin above")
    return Finding("truck", True, f"{standing.observe().mass / 1e3:.1f} t, 0.2 s stepped")


def trucks() -> Finding:
    """Reads every shipped truck and lists their names."""
    names = shipped_trucks()
    try:
        for name in names:
            TruckParameters.load(name)
    except Error as error:
        return Finding("trucks", False, str(error), "reinstall iits-mj")
    return Finding("trucks", True, ", ".join(names))


def opengl() -> Finding:
    """Checks offscreen OpenGL in another process, because a bad driver may abort it."""
    backend = os.environ.get("MUJOCO_GL") or "egl"
    probe = subprocess.run(
        [sys.executable, "-c", _GL_PROBE],
        env=os.environ | {"MUJOCO_GL": backend},
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )
    remedy = (
        "apt-get install libegl1 libgl1-mesa-dri libopengl0 (drives work without, videos do not)"
    )
    if probe.returncode == 0:
        return Finding("OpenGL", True, f"offscreen pictures through {backend}", needed=False)
    reason = (probe.stderr.strip().splitlines() or ["the process was aborted"])[-1]
    return Finding("OpenGL", False, f"no offscreen pictures: {reason}", remedy, needed=False)


def ffmpeg() -> Finding:
    """Checks the video encoder inside the imageio-ffmpeg wheel."""
    try:
        imageio_ffmpeg = importlib.import_module("imageio_ffmpeg")
        path = imageio_ffmpeg.get_ffmpeg_exe()
    except (ImportError, RuntimeError) as error:
        return Finding("ffmpeg", False, str(error), "pip install imageio-ffmpeg", needed=False)
    return Finding("ffmpeg", True, str(path), needed=False)


def display() -> Finding:
    """Checks that there is a display for `iits-mj view`."""
    shown = os.environ.get("WAYLAND_DISPLAY") or os.environ.get("DISPLAY") or ""
    there = bool(shown) or platform.system() != "Linux"
    return Finding(
        "display",
        there,
        shown or ("native" if there else "none, 'iits-mj view' needs one"),
        "run from a desktop session or with ssh -X",
        needed=False,
    )


def netconvert() -> Finding:
    """Checks SUMO's network converter, which only the eclipse-sumo wheel has."""
    name, remedy = "netconvert", "pip install 'iits-mj[maps]'"
    try:
        home = importlib.import_module("sumo").SUMO_HOME
        program = Path(home) / "bin" / "netconvert"
        answer = subprocess.run(
            [program, "--version"], capture_output=True, text=True, timeout=60, check=False
        )
    except (ImportError, OSError, subprocess.TimeoutExpired) as error:
        return Finding(name, False, str(error), remedy, needed=False)
    first = (answer.stdout.strip().splitlines() or [f"exit code {answer.returncode}"])[0]
    return Finding(name, answer.returncode == 0, f"{first}, {program}", remedy, needed=False)


def module(module: str, name: str, remedy: str, *, needed: bool = True) -> Finding:
    """Imports a Python package: an installed package may still lack a library."""
    try:
        importlib.import_module(module)
        version = importlib.metadata.version(module)
    except (ImportError, OSError) as error:
        return Finding(name, False, " ".join(str(error).split()), remedy, needed)
    return Finding(name, True, version, needed=needed)


PROBES: tuple[Callable[[], Finding], ...] = (
    python,
    package,
    engine,
    plugin,
    truck,
    trucks,
    functools.partial(module, "libsumo", "SUMO (libsumo)", "pip install libsumo==1.28.0"),
    netconvert,
    functools.partial(
        module, "casadi", "CasADi (IPOPT)", "pip install 'iits-mj[ipopt]'", needed=False
    ),
    functools.partial(
        module,
        "dm_control",
        "dm_control (tasks)",
        "pip install --no-deps dm-control==1.0.50",
        needed=False,
    ),
    opengl,
    ffmpeg,
    display,
    functools.partial(
        module, "torch", "torch (training)", "pip install 'iits-mj[train]'", needed=False
    ),
)
