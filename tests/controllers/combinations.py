"""Combinations of one to four units, made from the shipped tractor and semitrailer."""

import dataclasses

from iits_mj.parameters import TruckParameters

SHIPPED = TruckParameters.load()
TRACTOR, TRAILER = SHIPPED.units


def towed(name, kind, at, places, tare, load, length, joint="fifth_wheel"):
    """A unit of the shipped trailer's parts, with its center of gravity a little ahead of its axles.

    Args:
      name, kind: of the unit; at: its coupling on the unit ahead [m]; joint: kind of the coupling.
      places: of its axles [m]; tare, load: [kg]; length: of the body [m].
    """
    cg = sum(places) / len(places) - (0.1 * length if kind == "semitrailer" else 0.0)
    free = {"height": 0.9, "roll_stiffness": 0.0, "roll_damping": 0.0, "yaw_friction": 0.0}
    changes = free if joint in ("drawbar_eye", "pintle") else {}
    per_mass = TRAILER.inertia_x / TRAILER.mass
    payload = dataclasses.replace(
        TRAILER.payload,
        mass_max=max(load, 1.0),
        cg_position=cg,
        inertia_x=load * TRAILER.payload.inertia_x / TRAILER.payload.mass_max,
        inertia_y=load * length**2 / 10.0,
        inertia_z=load * length**2 / 10.0,
    )
    return dataclasses.replace(
        TRAILER,
        name=name,
        kind=kind,
        mass=tare,
        cg_position=cg,
        cg_height=TRAILER.cg_height if load else 0.8,
        inertia_x=tare * per_mass,
        inertia_y=tare * length**2 / 10.0,
        inertia_z=tare * length**2 / 10.0,
        length=length,
        axles=tuple(
            dataclasses.replace(TRAILER.axles[0], name=f"{name}_axle{i}", position=place)
            for i, place in enumerate(places, start=1)
        ),
        coupling=dataclasses.replace(TRAILER.coupling, kind=joint, position=at, **changes),
        payload=payload if load else None,
    )


def combination(*units):
    """The shipped tractor with towed units."""
    return dataclasses.replace(SHIPPED, units=(TRACTOR, *units))


TRACTOR_ALONE = combination()
B_DOUBLE = combination(
    towed("trailer", "semitrailer", 3.6, (5.8, 7.1), 7e3, 16e3, 8.4),
    towed("trailer2", "semitrailer", 6.6, (6.7, 7.9, 9.1), 9e3, 24e3, 12.7),
)
A_DOUBLE = combination(
    towed("trailer", "semitrailer", 3.6, (6.7, 7.9, 9.1), 9e3, 24e3, 12.7),
    towed("dolly", "dolly", 10.9, (3.4, 4.6), 3e3, 0.0, 5.0, "drawbar_eye"),
    towed("trailer2", "semitrailer", 4.0, (6.7, 7.9, 9.1), 9e3, 24e3, 12.7, "turntable"),
)
# As a rigid truck: the tractor's load is carried by a body on it.
RIGID_WITH_TRAILER = dataclasses.replace(
    SHIPPED,
    units=(
        dataclasses.replace(
            TRACTOR,
            kind="rigid_truck",
            length=8.5,
            payload=dataclasses.replace(
                TRAILER.payload,
                mass_max=12e3,
                cg_position=3.2,
                cg_height=1.8,
                inertia_x=12e3,
                inertia_y=40e3,
                inertia_z=40e3,
            ),
        ),
        towed("trailer", "center_axle_trailer", 5.7, (5.6, 6.9), 5e3, 13e3, 9.0, "pintle"),
    ),
)
COMBINATIONS = {
    "tractor alone": TRACTOR_ALONE,
    "semitrailer": SHIPPED,
    "rigid truck with trailer": RIGID_WITH_TRAILER,
    "B-double": B_DOUBLE,
    "A-double": A_DOUBLE,
}
