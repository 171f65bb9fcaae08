"""What a picture shows and how it is lit, between `Offscreen` and `Painter`."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from iits_mj.core.arrays import FloatArray, IndexArray
from iits_mj.render.geometry import Floats


@dataclass(frozen=True)
class Lighting:
    """Lights, fog and sky of a scene.

    Attributes:
      ambient, ground: light from above, and from the ground, with that of the lamp at the camera.
      head_diffuse, head_specular: of the lamp at the camera.
      sun_diffuse, sun_specular: of the sun, black without one.
      shadow_size: side of the shadow map in pixels, 0 for no shadows.
      fog, fog_range: its color, and the distances where it begins and hides everything [m].
      sky_radius: of the cylinder with the sky [m].
      tunnel_above, tunnel_below: light in tunnels.
      knee: brightness from which colors approach white; 1 cuts them off.
      mist: extinction of the air [1/m].
      beams: whether head lamps light the scene; wet: film of water on the road, 0 to 1.
      meadow: scale of patches of grass over the texture's coordinates [rad], 0 for none.
      smooth: whether to smooth edges.
      sky: faces of the sky's cube instead of the model's, (6 n, n, 3), or None.
    """

    ambient: Floats
    ground: Floats
    head_diffuse: Floats
    head_specular: Floats
    sun_diffuse: Floats
    sun_specular: Floats
    shadow_size: int
    fog: Floats
    fog_range: tuple[float, float]
    sky_radius: float
    tunnel_above: Floats
    tunnel_below: Floats
    knee: float = 1.0
    mist: float = 0.0
    beams: bool = False
    wet: float = 0.0
    meadow: float = 0.0
    smooth: bool = False
    sky: NDArray[np.uint8] | None = None


@dataclass(frozen=True)
class Shot:
    """What one picture shows.

    Attributes:
      places: rotation and position of each instance relative to the eye, rows of (n, 3, 4).
      looks: color with alpha, emission, specular, shininess, light of a tunnel and answer to head
        lamps of each instance, (n, 9).
      opaque: parts by texture (-1 for none); casters: parts that cast shadows.
      transparent: parts, in the order of drawing.
      instances: of the transparent parts; level: of detail of each part.
      view, light: from places to the picture and to the shadow map, (4, 4).
      forward, to_sun: directions of view and to the sun.
      axes: from (right, down, 1) on the picture to the sky's directions, (3, 3).
      spots: as of `iits_mj.render.spots`; beams, glints: place, direction and color, and place and
        color, of lamps.
    """

    places: Floats
    looks: Floats
    opaque: dict[int, IndexArray]
    casters: IndexArray
    transparent: IndexArray
    instances: IndexArray
    level: IndexArray
    view: FloatArray
    light: FloatArray
    forward: FloatArray
    to_sun: FloatArray
    axes: FloatArray
    spots: FloatArray
    beams: tuple[FloatArray, ...]
    glints: tuple[FloatArray, ...]
