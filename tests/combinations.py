"""Overlays that make other combinations of the shipped truck: alone, with dolly, steered axles."""

import dataclasses

from iits_mj.parameters import TruckParameters, shipped_trucks

_SHIPPED = TruckParameters.load()


def _axle(position, **changes):
    """Returns the table of a trailer axle at another place."""
    table = dataclasses.asdict(_SHIPPED.last.axles[0])
    del table["name"]
    return table | {"position": position, "self_steering": None} | changes


# A dolly on a pintle hook with a tandem, on whose turntable the second semitrailer lies.
DOLLY = {
    "kind": "dolly",
    "behind": "trailer",
    "mass": 2800.0,
    "cg_position": 4.2,
    "cg_height": 0.8,
    "load_equalization": 0.95,
    "inertia_x": 2000.0,
    "inertia_y": 3200.0,
    "inertia_z": 4200.0,
    "air_share": 0.1,
    "front_overhang": 0.0,
    "length": 6.0,
    "width": 2.5,
    "height": 1.2,
    "axles": {"axle1": _axle(4.0), "axle2": _axle(5.3)},
    "coupling": {
        "kind": "pintle",
        "position": 11.0,
        "height": 0.85,
        "yaw_limit": 1.0,
        "pitch_min": -0.2,
        "pitch_max": 0.2,
    },
}
SECOND = {
    "like": "trailer",
    "behind": "dolly",
    "coupling": {"kind": "turntable", "position": 4.6, "height": 1.1, "roll_lash": 0.0},
}
ALONE = {"remove": ["units.trailer"]}
WITH_DOLLY = {"units": {"dolly": DOLLY, "second": SECOND}}
B_DOUBLE = {"units": {"second": {"like": "trailer", "coupling": {"position": 7.9}}}}
LIFT_AXLE = {"units": {"trailer": {"axles": {"axle1": {"lifted_below": 15_000.0}}}}}
_CASTER = {"trail": 0.15, "stiffness": 2e3, "damping": 1e3, "angle_max": 0.35}
SELF_STEERING = {"units": {"trailer": {"axles": {"axle3": {"self_steering": _CASTER}}}}}
TWO_STEERED = {"units": {"tractor": {"axles": {"axle4": {"like": "axle1", "position": 1.8}}}}}
UNEQUAL = {
    "units": {
        "tractor": {"axles": {"axle3": {"load_share": 0.5}}},
        "trailer": {"axles": {"axle1": {"load_share": 0.8}}},
    }
}
COMBINATIONS = {
    "alone": ALONE,
    "dolly": WITH_DOLLY,
    "b_double": B_DOUBLE,
    "lift_axle": LIFT_AXLE,
    "self_steering": SELF_STEERING,
    "two_steered": TWO_STEERED,
    "unequal": UNEQUAL,
}


TRUCKS = (*COMBINATIONS, *shipped_trucks()[1:])


def load(name):
    """Returns the parameters of one of `TRUCKS`, our combinations and the other shipped trucks."""
    if name in COMBINATIONS:
        return TruckParameters.load(overlay=COMBINATIONS[name])
    return TruckParameters.load(name)
