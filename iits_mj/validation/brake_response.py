"""Response of the service brake on the standing truck, as UN R13, annex 6 measures it.

The pedal goes down at once and in full; what counts is the least favorable chamber: the time until
it has 75 % of its final pressure must not exceed 0.6 s. Pressure begins to rise after the dead time
of the lines; the trailer's control line adds its own.
"""

from __future__ import annotations

import numpy as np

from iits_mj.messages import VehicleCommand
from iits_mj.parameters import TruckParameters
from iits_mj.results import Check, Line, Panel
from iits_mj.truck import Truck
from iits_mj.validation.brake_measures import first_rise, rise_time
from iits_mj.validation.full_stop import FULL
from iits_mj.validation.longitudinal_run import run
from iits_mj.validation.recorder import PERIOD

_START, _RELEASE, _END = 1.0, 4.0, 7.0
_LIMIT = 0.6
_SHARE = 0.75
# A rise is seen later than it begins: 2 kPa have to be there, sampled every 10 ms [s].
_DETECTED = 0.03


def dead_times(parameters: TruckParameters) -> list[float]:
    """Time before a chamber's pressure rises [s], of each axle; the trailer's with its line."""
    brakes, count = parameters.air_brake, len(parameters.tractor.axles)
    return [
        time + (brakes.trailer_line_delay if axle >= count else 0.0)
        for axle, time in enumerate(brakes.dead_time)
    ]


def compare(payload: float, timestep: float) -> tuple[list[Check], list[Panel]]:
    """Pedal down in full for 3 s on the standing truck, payload [kg]."""
    truck = Truck.load(payload, timestep=timestep, visuals=False)
    truck.reset()
    down, up = FULL, VehicleCommand()
    record = run(truck, lambda time, _: down if _START <= time < _RELEASE else up, _END)
    time = record.time - _START
    label = f"brake pedal down at standstill, {truck.parameters.gross_mass(payload) / 1e3:g} t"
    checks, lines = [], []
    for axle, dead_time in enumerate(dead_times(truck.parameters)):
        pressure = record.wheel_pressures[:, 2 * axle : 2 * axle + 2].min(axis=1)
        final = float(pressure[record.time < _RELEASE][-1])
        checks += [
            Check(
                f"{label}, axle {axle + 1}: first rise after",
                first_rise(time, pressure),
                "s",
                dead_time,
                f"{dead_time - PERIOD:.2f} .. {dead_time + _DETECTED:.2f}",
            ),
            Check(
                f"{label}, axle {axle + 1}: 75 % of the pressure after (UN R13)",
                rise_time(time, pressure, _SHARE, final),
                "s",
                None,
                f"<= {_LIMIT:g}",
            ),
        ]
        lines.append(Line(f"axle {axle + 1}", record.time, pressure / 1e3))
    final = float(record.wheel_pressures[record.time < _RELEASE][-1].min())
    left = record.wheel_pressures.max(axis=1)
    gone = np.flatnonzero((record.time > _RELEASE) & (left < 0.1 * final))
    released = float(record.time[gone[0]] - _RELEASE) if len(gone) else float("nan")
    checks += [
        Check(f"{label}: least final pressure", final / 1e3, "kPa"),
        Check(f"{label}: down to 10 % after the release", released, "s", None, "<= 2"),
    ]
    return checks, [Panel(f"{label}: pressures", "time [s]", "pressure [kPa]", tuple(lines))]
