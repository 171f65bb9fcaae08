"""The telemetry of combinations with several couplings."""

import csv
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np

from iits_mj.core.messages import Decision, EgoState, Trajectory, VehicleCommand
from iits_mj.simulation import DriveFrame, Telemetry
from iits_mj.simulation.drive_plots import drive_figures
from iits_mj.simulation.drive_table import DriveTable
from iits_mj.simulation.telemetry import COLUMNS

NOBODY: Any = None


def frame(time: float, *rear: float) -> DriveFrame:
    """An instant of a truck whose couplings behind the first have these yaw angles."""
    ego = EgoState(time=time, articulation=0.1, rear_articulations=rear)
    scene: Any = SimpleNamespace(vehicles=())
    still = np.zeros(2)
    plan = Trajectory(np.array([0.0, 1.0]), *(still for _ in range(9)))
    numbers = (0, 2, 0.0, 0.0, 25.0, 22.0, np.inf, np.inf, np.inf, 0.0, 0, 0)
    return DriveFrame(time, ego, scene, plan, VehicleCommand(), Decision.KEEP, *numbers)


def test_each_coupling_behind_the_first_has_a_column_and_a_line(tmp_path: Path) -> None:
    path = tmp_path / "telemetry.csv"
    with Telemetry(path) as telemetry:
        for time in (0.0, 0.1):
            telemetry.observe(NOBODY, frame(time, 0.2, -0.3 * time))
    rows = list(csv.reader(path.open()))
    assert rows[0] == [*COLUMNS, "articulation2 [rad]", "articulation3 [rad]"]
    assert rows[2][-2:] == ["0.2", "-0.03"]
    assert telemetry.column("articulation3 [rad]").tolist() == [0.0, -0.03]
    panels = drive_figures(DriveTable.of(telemetry))["Lateral"]
    panel = next(panel for panel in panels if "Articulation" in panel.title)
    assert [line.label for line in panel.lines] == ["coupling 1", "coupling 2", "coupling 3"]


def test_a_truck_with_one_coupling_has_the_usual_columns(tmp_path: Path) -> None:
    path = tmp_path / "telemetry.csv"
    with Telemetry(path) as telemetry:
        telemetry.observe(NOBODY, frame(0.0))
    assert path.read_text().splitlines()[0] == ",".join(COLUMNS)
    assert telemetry.names == list(COLUMNS)
