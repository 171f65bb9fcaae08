"""The published 40 % pedal run, computed anew from the published tables: a point mass, no MuJoCo.

What the paper's authors released of their own truck model are tables: pedal map, full load, shift
speeds, ratios, torque rates, and that a gear change takes 0.6 to 1.0 s with torque below 60 N m for
0.6 to 0.7 s. This puts them together as that model does: one gear at a time, no torque in a change,
then the ramp; no air drag. Its two known readings are 10th gear near 31 s and 46.9 km/h at 40 s;
rolling resistance, which was published as 0.012 to 0.02, is chosen so that the second comes out.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from iits_mj.core.arrays import FloatArray
from iits_mj.parameter_files import Table2D
from iits_mj.parameters import TruckParameters
from iits_mj.validation.force_balance import ForceBalance
from iits_mj.validation.recorder import PERIOD

# Middle of the published 0.6 to 0.7 s without torque [s].
_NO_TORQUE = 0.65
_ROLLING_RESISTANCE = 0.015


@dataclass(frozen=True)
class PublishedRun:
    """Time histories of shape (n,), every 10 ms: time [s], speed [m/s], gear."""

    time: FloatArray
    speed: FloatArray
    gear: FloatArray


def balance() -> ForceBalance:
    """The empty truck with the published rolling resistance, and without air drag."""
    overlay = {
        "aerodynamics": {"density": 0.0},
        "tire_common": {"rolling_resistance": _ROLLING_RESISTANCE},
    }
    return ForceBalance(TruckParameters.load(overlay=overlay), 0.0)


def compute(truck: ForceBalance, pedal: float, duration: float) -> PublishedRun:
    """Standing start on the flat at a constant pedal.

    Args:
      truck: at its payload; its air drag counts when it has any.
      pedal: 0 to 1.
      duration: [s].
    """
    engine, gearbox = truck.parameters.engine, truck.parameters.gearbox
    map_torque, shift_up = _at(engine.pedal_map, pedal), _at(gearbox.upshift, pedal)
    gear, torque, speed, pause = int(gearbox.start_gear), 0.0, 0.0, 0.0
    rows = []
    for k in range(round(duration / PERIOD) + 1):
        rows.append([k * PERIOD, speed, float(gear)])
        spin = max(engine.idle_speed, speed * float(truck.reduction(gear)))
        wanted = float(np.interp(spin, engine.pedal_map.rows, map_torque))
        if pause > 0.0:
            pause -= PERIOD
            torque = 0.0
        elif gear <= len(shift_up) and speed > shift_up[gear - 1]:
            gear, pause, torque = gear + 1, _NO_TORQUE, 0.0
        else:
            torque = _ramp(torque, wanted, truck)
        coupled = torque > 0.0 and speed * float(truck.reduction(gear)) > engine.idle_speed
        mass = truck.mass + (float(truck.rotating_mass(gear)) if coupled else truck.wheel_mass)
        push = float(truck.pull(torque, gear) - truck.resistance(speed))
        speed = max(0.0, speed + PERIOD * push / mass)
    table = np.array(rows)
    return PublishedRun(*table.T)


def _at(table: Table2D, column: float) -> FloatArray:
    """A column of a table, between its columns, shape of its rows."""
    return np.array([np.interp(column, table.columns, row) for row in table.values])


def _ramp(torque: float, wanted: float, balance: ForceBalance) -> float:
    """Torque of the next sample: towards the map at the published rates."""
    engine = balance.parameters.engine
    low = torque < engine.torque_rise_threshold
    rise = engine.torque_rise_rate_low if low else engine.torque_rise_rate
    above = torque > engine.torque_fall_threshold
    fall = engine.torque_fall_rate if above else engine.torque_fall_rate_low
    return float(np.clip(wanted, torque - fall * PERIOD, torque + rise * PERIOD))
