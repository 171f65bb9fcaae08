"""Trucks of all kinds of units, made from the shipped one."""

from dataclasses import replace

from iits_mj.parameters import TruckParameters, Unit, shipped_trucks

_RIGID = {
    "kind": "rigid_truck",
    "length": 9.6,
    "height": 3.9,
    "width": 2.55,
    "cg_position": 2.6,
    "axles": {
        "axle2": {"position": 4.8},
        "axle3": {"position": 6.15, "tire": "steer", "driven": False, "track": 2.04},
    },
}
_EYE = {
    "kind": "drawbar_eye",
    "position": 7.7,
    "height": 0.55,
    "roll_stiffness": 0.0,
    "roll_damping": 0.0,
    "roll_lash": 0.0,
    "plate_width": 0.0,
}
# A semitrailer behind a shorter one.
REAR = {
    "like": "trailer",
    "length": 12.7,
    "axles": {
        "axle1": {"position": 6.7},
        "axle2": {"position": 7.9},
        "axle3": {"position": 9.1},
    },
}
_OVERLAYS = {
    "tractor alone": {"remove": ["units.trailer"]},
    "8x4 tractor": {
        "units": {
            "tractor": {
                "length": 7.6,
                "axles": {
                    "axle1b": {"like": "axle1", "position": 1.9},
                    "axle2": {"position": 3.9},
                    "axle3": {"position": 5.3},
                },
            },
            "trailer": {"coupling": {"position": 4.4}},
        }
    },
    "lift axles": {
        "units": {
            "tractor": {
                "axles": {
                    "axle2": {
                        "position": 3.0,
                        "driven": False,
                        "tire": "steer",
                        "track": 2.04,
                        "lifted_below": 10e3,
                    },
                    "axle3": {"position": 4.35},
                }
            },
            "trailer": {"axles": {"axle1": {"lifted_below": 10e3}}},
        }
    },
    "short semitrailer": {
        "remove": [
            "units.tractor.axles.axle3",
            "units.trailer.axles.axle2",
            "units.trailer.axles.axle3",
        ],
        "units": {
            "tractor": {"length": 5.9, "height": 3.0, "axles": {"axle2": {"position": 3.6}}},
            "trailer": {
                "front_overhang": 0.9,
                "length": 8.0,
                "height": 3.6,
                "axles": {"axle1": {"position": 5.6}},
                "coupling": {"position": 3.1},
            },
        },
    },
    "rigid truck": {"remove": ["units.trailer"], "units": {"tractor": _RIGID}},
    "rigid truck with center-axle trailer": {
        "remove": ["units.trailer.axles.axle3"],
        "units": {
            "tractor": _RIGID,
            "trailer": {
                "kind": "center_axle_trailer",
                "mass": 5000.0,
                "front_overhang": -1.9,
                "length": 7.8,
                "cg_position": 5.6,
                "cg_height": 1.2,
                "inertia_x": 7e3,
                "inertia_y": 26e3,
                "inertia_z": 27e3,
                "height": 3.9,
                "axles": {"axle1": {"position": 5.3}, "axle2": {"position": 6.6}},
                "coupling": _EYE,
                "payload": {"cg_position": 5.7},
            },
        },
    },
    "B-double": {
        "units": {
            "trailer": {
                "length": 10.2,
                "axles": {
                    "axle1": {"position": 6.0},
                    "axle2": {"position": 7.2},
                    "axle3": {"position": 8.4},
                },
            },
            "rear": {**REAR, "coupling": {"position": 7.7}},
        }
    },
}


def combinations() -> dict[str, TruckParameters]:
    """Returns the shipped trucks, and others, by name."""
    found = {name: TruckParameters.load(name) for name in shipped_trucks()}
    found |= {name: TruckParameters.load(overlay=overlay) for name, overlay in _OVERLAYS.items()}
    double = found["B-double"]
    lead, trailer, rear = found["tractor_semitrailer_6x4"].lead, *double.units[1:]
    long = found["tractor_semitrailer_6x4"].units[1]
    found["A-double"] = replace(
        double, units=(lead, long, _dolly(trailer, 11.6, 0.75, 2), _on(rear, 3.85))
    )
    rigid, short = found["rigid truck"].lead, found["rigid truck with center-axle trailer"].units[1]
    full = replace(
        _on(rear, 2.6, kind="turntable"),
        front_overhang=1.0,
        length=7.8,
        axles=tuple(
            replace(axle, position=at) for axle, at in zip(short.axles, (4.6, 5.9), strict=True)
        ),
    )
    front = replace(_dolly(trailer, 8.1, 0.8, 1), front_overhang=-1.9, length=1.4)
    found["full trailer"] = replace(double, units=(rigid, front, full))
    return found


def _dolly(trailer: Unit, position: float, height: float, axles: int) -> Unit:
    """Returns a dolly whose eye is at `position` of the unit ahead."""
    assert trailer.coupling is not None
    places = (2.6,) if axles == 1 else (3.2, 4.5)
    eye = {**_EYE, "position": position, "height": height}
    return replace(
        trailer,
        name="dolly",
        kind="dolly",
        mass=2800.0,
        cg_position=sum(places) / axles,
        cg_height=0.8,
        inertia_x=2600.0,
        inertia_y=3600.0,
        inertia_z=5200.0,
        front_overhang=-2.4,
        length=2.8,
        height=1.1,
        axles=tuple(
            replace(axle, name=f"dolly_axle{i + 1}", position=at)
            for i, (axle, at) in enumerate(zip(trailer.axles, places, strict=False))
        ),
        coupling=replace(trailer.coupling, **eye),
        payload=None,
    )


def _on(unit: Unit, position: float, **changes: str) -> Unit:
    assert unit.coupling is not None
    return replace(unit, coupling=replace(unit.coupling, position=position, **changes))
