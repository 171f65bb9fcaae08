"""Show a drive live in MuJoCo's interactive viewer.

Keys and mouse work as in MuJoCo's own viewer; closing the window ends the drive.
"""

from __future__ import annotations

import sys
import time
from dataclasses import dataclass
from typing import Any

import mujoco.viewer

from iits_mj.core.options import given_names, option
from iits_mj.core.timing import CONTROL_PERIOD
from iits_mj.render.offscreen import check_display, follow
from iits_mj.simulation import DriveConfig, DriveFrame, Observer, Simulation
from iits_mj.simulation.drive_log import check_given
from iits_mj.simulation.lock_step import LockStep


@dataclass(frozen=True, kw_only=True)
class Options(DriveConfig):
    """Flags of `iits-mj view`."""

    pace: float = option(
        1.0, help="simulated time over wall time", low=0.1, high=20.0, metavar="FACTOR"
    )
    given: frozenset[str] = given_names()


class _Window(Observer):
    """Observer that shows the drive at the pace of the wall clock."""

    period = CONTROL_PERIOD

    def __init__(self, window: Any, pace: float) -> None:
        self._window = window
        self._pace = pace
        self._start = time.perf_counter()

    def observe(self, simulation: LockStep, frame: DriveFrame) -> None:
        """Draws the frame and waits until the wall clock reaches its time."""
        if not self._window.is_running():
            simulation.stop("the window was closed")
            return
        self._window.sync()
        ahead = frame.time / self._pace - (time.perf_counter() - self._start)
        if ahead > 0.0:
            time.sleep(ahead)


def run(options: Options) -> int:
    """Opens the window and drives; returns the exit code.

    Raises:
      RenderError: there is no display. InputError: an option has no effect.
    """
    check_given(options, options.given)
    check_display()
    with Simulation(options) as simulation:
        truck = simulation.truck
        with mujoco.viewer.launch_passive(truck.model, truck.data) as window:
            follow(window, truck.model)
            summary = simulation.run([_Window(window, options.pace)])
    print(summary.to_text())
    sys.stdout.flush()
    return 0
