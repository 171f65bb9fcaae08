"""Down a 6 % grade for 6 km at 55 t: engine brake and retarder hold the speed.

30 km/h is the speed of UN R13's type II test (annex 4, 1.6: 6 km, 6 %), 60 km/h the limit of the
paper's road. The driver is `SpeedKeeper`; how much the friction brakes had to do is reported as a
share of the height's energy, and the least pressure in a reservoir.
"""

from __future__ import annotations

import numpy as np

from iits_mj.core.results import Check, Panel
from iits_mj.core.units import GRAVITY, KMH
from iits_mj.road import Route
from iits_mj.truck import Truck
from iits_mj.validation.longitudinal.full_stop import panel
from iits_mj.validation.longitudinal.runs import Run, SpeedKeeper, run

GRADE = -0.06
LENGTH = 6000.0
_START = 50.0
# From then on the speed counts as held [s].
_SETTLED = 30.0
_HELD = 2.0
_RETARDER, _FRICTION, _RESERVOIR = "retarder_work", "brake_work", "reservoir_pressure_"


def descend(speed: float, timestep: float, length: float = LENGTH) -> Run:
    """Rolls down at a speed [m/s] for so long a way [m]."""
    truck = Truck.load(
        route=Route.straight(_START + length + 100.0, grade=GRADE), timestep=timestep, visuals=False
    )
    truck.reset(station=_START, speed=speed)
    keeper = SpeedKeeper(share=-1.0)
    return run(
        truck,
        lambda _, state: keeper.command(state.speed, speed),
        2.0 * length / speed,
        stop=lambda state: state.station > _START + length or state.speed > 2.0 * speed,
        sensors=(_FRICTION, _RETARDER, *reservoirs(truck)),
    )


def reservoirs(truck: Truck) -> list[str]:
    """Sensors of the brakes' reservoirs."""
    names = [truck.model.sensor(i).name for i in range(truck.model.nsensor)]
    return [name for name in names if name.startswith(_RESERVOIR)]


def compare(speed: float, timestep: float) -> tuple[list[Check], list[Panel]]:
    """The descent at one speed [m/s]."""
    record = descend(speed, timestep)
    label = f"-6 % for 6 km, 55 t, {speed / KMH:g} km/h"
    held = (record.speed[record.time > _SETTLED] - speed) / KMH
    fastest, slowest = float(held.max()), -float(held.min())
    way = float(record.station[-1] - record.station[0])
    truck = Truck.load(timestep=timestep, visuals=False)
    mass = truck.parameters.gross_mass(truck.payload)
    height = mass * GRAVITY * way * -GRADE
    # Before the first step the plugin has not chosen its state: its sensors read zero.
    pressures = [values[1:] for name, values in record.extra.items() if name.startswith(_RESERVOIR)]
    least = float(np.min(pressures)) / 1e3 if pressures else float("nan")
    checks = [
        Check(f"{label}: way", way / 1e3, "km", LENGTH / 1e3, f">= {LENGTH / 1e3:g}"),
        Check(f"{label}: fastest over the set speed", fastest, "km/h", None, f"<= {_HELD:g}"),
        Check(
            f"{label}: slowest under the set speed",
            slowest,
            "km/h",
            None,
            f"<= {_HELD:g}",
        ),
        _share(
            f"{label}: friction brakes' share of the height's energy", record, _FRICTION, height
        ),
        _share(f"{label}: retarder's share of the height's energy", record, _RETARDER, height),
        Check(f"{label}: least pressure in a reservoir", least, "kPa"),
        Check(f"{label}: most frequent gear", float(np.median(record.gear)), "1"),
        Check(
            f"{label}: engine speed, mean", float(record.engine_speed.mean()) * 30.0 / np.pi, "rpm"
        ),
        Check(f"{label}: gear changes", float(np.count_nonzero(np.diff(record.gear))), "1"),
    ]
    return checks, [
        panel(f"{label}: speed", "speed [km/h]", record, record.speed / KMH),
        panel(f"{label}: gear", "gear [1]", record, record.gear),
        panel(f"{label}: engine torque", "torque [N m]", record, record.engine_torque),
        panel(
            f"{label}: mean brake pressure",
            "pressure [kPa]",
            record,
            record.wheel_pressures.mean(axis=1) / 1e3,
        ),
    ]


def _share(name: str, record: Run, sensor: str, height: float) -> Check:
    """Work of a brake over the energy of the height [%], for information."""
    work = record.extra[sensor]
    return Check(name, 100.0 * float(work[-1] - work[0]) / height, "%")
