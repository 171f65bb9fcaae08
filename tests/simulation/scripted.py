"""A drive with lane changes at given times, on an empty road."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from controllers.decision.base import DecisionContext
from controllers.stack import Stack
from iits_mj.core.messages import Decision
from iits_mj.road import Route
from iits_mj.simulation import DriveConfig, Observer, Simulation, Telemetry
from iits_mj.simulation.lock_step import CommandPath
from iits_mj.simulation.telemetry import COLUMNS
from iits_mj.truck import Truck

NUMBERS = [name for name in COLUMNS if name != "plan_mode [-]"]
# Columns that a drive by a log does not have.
PLANNED = (
    "reference_speed [m/s]",
    "target_lane [-]",
    "planned_offset [m]",
    "planned_speed [m/s]",
    "plan_mode [-]",
    "decision [-]",
    "lane_changes [-]",
)
DRIVEN = [name for name in COLUMNS if name not in PLANNED]


class Scripted:
    """Decision maker that follows a script of whole seconds."""

    name = "scripted"

    def __init__(self, script: Mapping[int, Decision]) -> None:
        self.script = script

    def reset(self) -> None:
        pass

    def decide(self, context: DecisionContext) -> Decision:
        return self.script.get(round(context.scene.time), Decision.KEEP)


def simulation(script: Mapping[int, Decision], **settings: object) -> Simulation:
    def driver(route: Route, truck: Truck) -> Stack:
        return Stack(route, Scripted(script), parameters=truck.parameters)

    config = DriveConfig(traffic_mode="none", **settings)  # type: ignore[arg-type]
    return Simulation(config, driver=driver, visuals=False)


def drive(
    script: Mapping[int, Decision], path: CommandPath | None = None, **settings: object
) -> Telemetry:
    """Returns the telemetry of a scripted drive, over another path if one is given."""
    telemetry = Telemetry(None)
    with simulation(script, **settings) as driven:
        if path is not None:
            driven.path = path
        driven.run([telemetry])
        assert driven.path.over_bytes == bool(driven.path.receiver.accepted)
        assert not driven.path.receiver.rejected
    return telemetry


def table(telemetry: Telemetry, columns: Sequence[str] = NUMBERS) -> np.ndarray:
    return np.array([telemetry.column(name) for name in columns])


def watch(driven: Simulation, *observers: Observer) -> Telemetry:
    telemetry = Telemetry(None)
    driven.run([telemetry, *observers])
    return telemetry
