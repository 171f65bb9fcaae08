"""How the truck looks: visual geoms without mass or contact, all in geom group 1."""

from __future__ import annotations

import mujoco

from iits_mj.errors import InputError
from iits_mj.model.palette import add_materials
from iits_mj.model.tractor_visuals import draw_tractor
from iits_mj.model.trailer_visuals import draw_trailer
from iits_mj.model.wheel_visuals import draw_axles
from iits_mj.parameters import TruckParameters


def decorate(spec: mujoco.MjSpec, parameters: TruckParameters, payload: float) -> None:
    """Adds the truck's visual geoms to its bodies.

    Args:
      spec: with the bodies `tractor` (origin on the ground below the steer axle), `trailer` (origin
        at the kingpin), the axles and the wheels, as `iits_mj.model.builder` names them.
      parameters: give every dimension that physics knows; the styling scales with them.
      payload: [kg]; shown as sealed curtains when laden, open straps when empty.

    Raises:
      InputError: a body is missing.
    """
    for name in ("tractor", "trailer"):
        if spec.body(name) is None:
            raise InputError(f"the specification has no body {name!r} to decorate")
    add_materials(spec)
    draw_tractor(spec, parameters)
    draw_trailer(spec, parameters, laden=payload > 0)
    draw_axles(spec, parameters)
