"""Visual geoms of the truck, without mass or contact, all in geom group 1.

They follow the dimensions, axles and couplings of the parameters. Those of a unit belong to a body
of their own, welded to it: MuJoCo's search for contacts computes the box around all geoms of a body
that has a hull, in every step.
"""

from __future__ import annotations

import mujoco

from iits_mj.core.errors import InputError
from iits_mj.model.visuals.layout import layouts
from iits_mj.model.visuals.motor_vehicle import draw_motor_vehicle
from iits_mj.model.visuals.towed import draw_towed
from iits_mj.model.visuals.wheels import draw_axles
from iits_mj.parameters import TruckParameters

# name: (red, green, blue, alpha), specular, shininess, emission
TRUCK_MATERIALS = {
    "truck_paint": ((0.70, 0.06, 0.05, 1.0), 0.55, 0.75, 0.0),
    "truck_paint_dark": ((0.34, 0.025, 0.03, 1.0), 0.4, 0.6, 0.0),
    "truck_accent": ((0.93, 0.93, 0.94, 1.0), 0.4, 0.6, 0.0),
    "truck_glass": ((0.035, 0.05, 0.065, 1.0), 1.0, 0.95, 0.0),
    "truck_black": ((0.045, 0.047, 0.05, 1.0), 0.25, 0.3, 0.0),
    "truck_chassis": ((0.11, 0.115, 0.125, 1.0), 0.2, 0.2, 0.0),
    "truck_chrome": ((0.74, 0.76, 0.79, 1.0), 0.9, 0.8, 0.0),
    "truck_aluminum": ((0.60, 0.62, 0.64, 1.0), 0.5, 0.5, 0.0),
    "truck_rubber": ((0.055, 0.055, 0.058, 1.0), 0.08, 0.1, 0.0),
    "truck_headlight": ((1.0, 0.98, 0.90, 1.0), 0.5, 0.8, 0.9),
    "truck_amber": ((1.0, 0.52, 0.04, 1.0), 0.3, 0.5, 0.6),
    # Pictures of a drive light these by the state of the truck; see `iits_mj.render.lamps`.
    "truck_indicator_left": ((1.0, 0.52, 0.04, 1.0), 0.3, 0.5, 0.2),
    "truck_indicator_right": ((1.0, 0.52, 0.04, 1.0), 0.3, 0.5, 0.2),
    "truck_tail_light": ((0.92, 0.03, 0.03, 1.0), 0.3, 0.5, 0.6),
    "truck_plate": ((0.95, 0.80, 0.20, 1.0), 0.1, 0.1, 0.1),
    "trailer_curtain": ((0.88, 0.89, 0.91, 1.0), 0.15, 0.2, 0.0),
    "trailer_strap": ((0.66, 0.68, 0.71, 1.0), 0.15, 0.2, 0.0),
    "trailer_stripe": ((0.72, 0.07, 0.06, 1.0), 0.2, 0.3, 0.0),
    "trailer_navy": ((0.05, 0.12, 0.24, 1.0), 0.2, 0.3, 0.0),
}


def decorate(spec: mujoco.MjSpec, parameters: TruckParameters, payload: float) -> None:
    """Adds the truck's visual geoms to its bodies.

    Args:
      spec: with a body for each unit (the motor vehicle's origin on the ground below its first
        axle, a towed unit's at its coupling point), axle and wheel, as `iits_mj.model.builder`
        names them.
      parameters: give the dimensions of the physics; the styling scales with them.
      payload: of the combination [kg]; a laden body has buckled curtains, an empty one open straps,
        and axles that are lifted at this payload hang higher.

    Raises:
      InputError: a body is missing.
    """
    for unit in parameters.units:
        if spec.body(unit.name) is None:
            raise InputError(f"the specification has no body {unit.name!r} to decorate")
    for name, (rgba, specular, shininess, emission) in TRUCK_MATERIALS.items():
        spec.add_material(
            name=name, rgba=rgba, specular=specular, shininess=shininess, emission=emission
        )
    for layout in layouts(parameters, payload):
        draw = draw_motor_vehicle if layout.unit.coupling is None else draw_towed
        draw(spec, layout, laden=payload > 0 and layout.unit.payload is not None)
    draw_axles(spec, parameters)
