"""Constants of the inverse powertrain: from force at the wheels to pedal, brakes and XBR.

The inverse is static and compiled, in `iits_mj/kernels/driveline_inverse.h`. Braking forces at the
wheels are increased by losses. The engine brake's greatest torque beyond the drag is a power law of
the engine speed, 0 at idle; the retarder, assumed to be cold, has a rise, a greatest torque and a
greatest power; both brake less as the truck slows down. The engine's drag brakes first, then the
engine brake, the retarder, and friction.
"""

from __future__ import annotations

import numpy as np

from iits_mj.parameters import TruckParameters
from iits_mj.parameters.mass_state import rolling_resistance, wheel_mass


def pack_powertrain(parameters: TruckParameters) -> bytes:
    """The kernel's `Powertrain` and its tables."""
    tires, air, gearbox = parameters.tires, parameters.aerodynamics, parameters.gearbox
    engine, retarder, table = parameters.engine, parameters.retarder, parameters.engine.pedal_map
    radius = tires[parameters.driven_axles[0].tire].rolling_radius
    ratios = [float(ratio) * gearbox.final_drive for ratio in gearbox.ratios]
    # Equivalent mass of engine and gearbox by gear [kg].
    spins = [
        (engine.inertia + float(inertia)) * ratio**2 / radius**2
        for inertia, ratio in zip(gearbox.inertias, ratios, strict=True)
    ]
    numbers = (
        rolling_resistance(parameters, parameters.payload_max),
        0.5 * air.density * air.mean_drag_area(),
        wheel_mass(parameters),
        radius,
        gearbox.final_drive / radius,
        gearbox.driveline_efficiency,
        engine.auxiliary_power,
        engine.engine_brake_speed_min,
        engine.engine_brake_speed,
        engine.engine_brake_power / engine.engine_brake_speed,
        engine.engine_brake_exponent - 1.0,
        engine.engine_brake_fade,
        retarder.full_torque_speed,
        retarder.torque_max,
        retarder.power_max,
        len(ratios),
        len(engine.drag_speed),
        len(table.rows),
        len(table.columns),
    )
    tables = (
        ratios,
        spins,
        gearbox.gear_efficiencies(engine) * gearbox.driveline_efficiency,
        engine.drag_speed,
        engine.drag_torque,
        table.rows,
        table.columns,
        np.minimum(1.0, table.columns / engine.pedal_fade),
        np.ravel(table.values),
    )
    return np.concatenate([numbers, *tables], dtype=float).tobytes()
