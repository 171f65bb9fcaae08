"""A truck as a point mass, integrated by explicit Euler: logs with known parameters."""

from __future__ import annotations

import functools

import numpy as np

from iits_mj.identification import Log
from iits_mj.parameters import TruckParameters
from iits_mj.parameters.mass_state import static_axle_loads

PARAMETERS = TruckParameters.load()
MASS, ROLLING, DRAG = 38_400.0, 0.0078, 5.2
DEAD_TIME, BUILD_UP = 0.25, 0.45
CIRCUITS = ("front", "drive", "trailer")
STEP, KEEP = 0.01, 5


def _slope(x):
    return 0.03 * np.sin(x / 260.0) + 0.01 * np.sin(x / 90.0)


def _radii():
    """Rolling radius of each axle: a third of the deflection beyond that of the nominal load."""
    loads = static_axle_loads(PARAMETERS, MASS - PARAMETERS.gross_mass(0.0))
    found = []
    for axle, load in zip(PARAMETERS.axles, loads, strict=True):
        tire = PARAMETERS.tires[axle.tire]
        over = load / (2 * tire.count) - PARAMETERS.tire_common.nominal_load
        found.append(tire.rolling_radius - over / tire.vertical_stiffness / 3.0)
    return loads, np.array(found)


def _force_per_pascal(radii):
    """Brake force of a circuit per pressure above push-out [N/Pa], shape (3,)."""
    brake = PARAMETERS.air_brake
    secant = 150e3 / (150e3 - brake.push_out_pressure)
    per_pressure = np.array([axle.brake.torque_per_pressure for axle in PARAMETERS.axles])
    slope = 2.0 * secant * per_pressure / radii
    return np.array([slope[0], slope[1:3].sum(), slope[3:].sum()])


@functools.cache
def drive(
    seed=0,
    *,
    gains=(0.85, 0.85, 0.85),
    scale=1.0,
    duration=600.0,
    flat=False,
    coast=True,
    brake="together",
    noise=0.01,
):
    """A 20 Hz log: the truck accelerates, coasts and brakes over hills.

    Args:
      seed: of the noise.
      gains: of the three circuits, over those of the parameters.
      scale: real over recorded engine torque.
      duration: [s].
      flat: level road.
      coast: False holds one pedal.
      brake: "together" all circuits, "in turn" one after the other, "" none.
      noise: of the recorded speed [1].
    """
    rng = np.random.default_rng(seed)
    loads, radii = _radii()
    per_pascal = _force_per_pascal(radii)
    gear_of = PARAMETERS.gearbox.ratios
    efficiency = PARAMETERS.gearbox.efficiency * PARAMETERS.gearbox.driveline_efficiency
    places = [axle.position for axle in PARAMETERS.lead.axles]
    places += [
        PARAMETERS.couplings[0].position + axle.position for axle in PARAMETERS.units[1].axles
    ]
    spin = sum(
        2 * axle.wheel_inertia_spin / r**2 for axle, r in zip(PARAMETERS.axles, radii, strict=True)
    )
    share = loads / loads.sum()
    v, x, gear, torque, shift_until = 12.0, 100.0, 10, 700.0, -1.0
    brakes, supply = PARAMETERS.air_brake, np.zeros(3)
    pressure, through, history, rows = np.zeros(3), np.zeros(3), [], []
    for k in range(int(duration / STEP)):
        t = k * STEP
        phase, cycle = t % 60.0, int(t / 60.0)
        target = 1900.0 if phase < 28.0 else (900.0 if phase < 34.0 else -150.0)
        if not coast:
            target = 700.0
        if t < shift_until:
            target = 0.0
        # The torque of an engine has no steps.
        torque += np.clip(target - torque, -3000.0 * STEP, 3000.0 * STEP)
        braking = bool(brake) and 48.0 <= phase < 56.0 and v > 7.0
        demand = -1.0 - 0.5 * (cycle % 3) if braking else 0.0
        used = np.ones(3) if brake != "in turn" else np.eye(3)[cycle % 3]
        step = np.array([brakes.supply_fall_rate, brakes.supply_rise_rate]) * STEP
        supply += np.clip(-100e3 * demand * used - supply, -step[0], step[1])
        history.append(supply.copy())
        delayed = history[max(k - round(DEAD_TIME / STEP), 0)]
        pressure = pressure + (delayed - pressure) / BUILD_UP * STEP
        wanted = 9 if v < 11.0 else 10 if v < 15.0 else 11 if v < 20.0 else 12
        if wanted != gear and t > shift_until + 3.0:
            gear, shift_until = wanted, t + 0.8
        shifting = t < shift_until
        overall = gear_of[gear - 1] * PARAMETERS.gearbox.final_drive
        losses = efficiency if torque > 0 else 1 / efficiency
        force = scale * torque * overall / radii[1] * losses
        felt = 0.0 if flat else share @ _slope(x - np.array(places))
        angle = np.arctan(felt)
        force -= MASS * 9.81 * (np.sin(angle) + ROLLING * np.cos(angle)) + 0.6 * DRAG * v * v
        # During a release the mechanism's friction holds the brake up to the hysteresis.
        through = np.minimum(np.maximum(through, pressure), pressure + brakes.hysteresis_pressure)
        above = np.maximum(through - brakes.push_out_pressure, 0.0)
        force -= (np.array(gains) * per_pascal) @ above
        inertia = PARAMETERS.engine.inertia + PARAMETERS.gearbox.inertias[gear - 1]
        turning = 0.0 if shifting else inertia * (overall / radii[1]) ** 2
        if k % KEEP == 0:
            road = 0.0 if flat else _slope(x)
            seen = np.round(pressure / 5e3) * 5e3
            mode = 2 if braking else 0
            rows.append([t, v, road, gear, torque, shifting, demand, mode, *seen])
        v = max(v + force / (MASS + spin + turning) * STEP, 0.5)
        x += v * STEP
    table = np.array(rows)
    names = ("time", "speed", "grade", "gear", "engine_torque", "shift_in_process")
    names += ("command_xbr_demand", "command_xbr_mode")
    signals = dict(zip(names, table[:, :8].T, strict=True))
    signals["speed"] = table[:, 1] * (1.0 + noise * rng.standard_normal(len(table)))
    circuits = ("front_left", "front_right", "rear_left", "rear_right", "trailer")
    for place, column in zip(circuits, (8, 8, 9, 9, 10), strict=True):
        signals[f"brake_pressure_{place}"] = table[:, column]
    return Log(signals)
