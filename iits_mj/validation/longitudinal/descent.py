"""Descent of a 6 % grade for 6 km with the greatest load: engine brake and retarder hold the speed.

30 km/h is the speed of the type II test of UN R13 (annex 4, 1.6: 6 km, 6 %), 60 km/h the limit of
the paper's road. `SpeedKeeper` drives. The work of the friction brakes is reported as a share of
the potential energy, together with the least pressure in a reservoir.
"""

from __future__ import annotations

import numpy as np

from iits_mj.core.results import Findings
from iits_mj.core.units import GRAVITY, KMH
from iits_mj.parameters import TruckParameters
from iits_mj.road import Route
from iits_mj.validation.harness.maneuver import Run, run
from iits_mj.validation.harness.recorder import placed_truck
from iits_mj.validation.longitudinal.hills import SpeedKeeper

GRADE = -0.06
LENGTH = 6000.0
_START = 50.0
# Time after which the speed must be steady [s], and its allowed error [km/h].
_SETTLED = 30.0
_HELD = 2.0
_RETARDER, _FRICTION, _RESERVOIR = "retarder_work", "brake_work", "reservoir_pressure_"


def descend(
    parameters: TruckParameters, speed: float, timestep: float, length: float = LENGTH
) -> tuple[Run, float]:
    """Drives down at a speed [m/s] over a distance [m]; also returns the gross mass [kg]."""
    route = Route.straight(_START + length + 100.0, grade=GRADE)
    start = {"station": _START, "speed": speed}
    truck = placed_truck(parameters, parameters.payload_max, timestep, route, **start)
    keeper = SpeedKeeper(share=-1.0)
    names = [truck.model.sensor(i).name for i in range(truck.model.nsensor)]
    reservoirs = [name for name in names if name.startswith(_RESERVOIR)]
    record = run(
        truck,
        lambda _, state: keeper.command(state.speed, speed),
        2.0 * length / speed,
        stop=lambda state: state.station > _START + length or state.speed > 2.0 * speed,
        sensors=(_FRICTION, _RETARDER, *reservoirs),
    )
    return record, truck.parameters.gross_mass(truck.payload)


def compare(parameters: TruckParameters, speed: float, timestep: float) -> Findings:
    """The descent at one speed [m/s]."""
    record, mass = descend(parameters, speed, timestep)
    found = Findings(f"-6 % for 6 km, {mass / 1e3:g} t, {speed / KMH:g} km/h")
    way = float(record.station[-1] - record.station[0])
    found.check("way", way / 1e3, "km", LENGTH / 1e3, f">= {LENGTH / 1e3:g}")
    held = (record.speed[record.time > _SETTLED] - speed) / KMH
    found.check("fastest over the set speed", held.max(), "km/h", must=f"<= {_HELD:g}")
    found.check("slowest under the set speed", -held.min(), "km/h", must=f"<= {_HELD:g}")
    height = mass * GRAVITY * way * -GRADE
    for name, sensor in (("friction brakes'", _FRICTION), ("retarder's", _RETARDER)):
        work = record.extra[sensor]
        share = 100.0 * float(work[-1] - work[0]) / height
        found.check(f"{name} share of the height's energy", share, "%")
    # Before the first step the sensors of the plugin read zero.
    pressures = [values[1:] for name, values in record.extra.items() if name.startswith(_RESERVOIR)]
    least = float(np.min(pressures)) / 1e3 if pressures else float("nan")
    found.check("least pressure in a reservoir", least, "kPa")
    found.check("most frequent gear", np.median(record.gear), "1")
    found.check("engine speed, mean", float(record.engine_speed.mean()) * 30.0 / np.pi, "rpm")
    found.check("gear changes", np.count_nonzero(np.diff(record.gear)), "1")
    found.history("speed", "speed [km/h]", record.time, record.speed / KMH)
    found.history("gear", "gear [1]", record.time, record.gear)
    found.history("engine torque", "torque [N m]", record.time, record.engine_torque)
    pressure = record.wheel_pressures.mean(axis=1) / 1e3
    found.history("mean brake pressure", "pressure [kPa]", record.time, pressure)
    return found
