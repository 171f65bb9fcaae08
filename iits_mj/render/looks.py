"""Colors and textures of a model's geoms, and the light of its scene."""

from __future__ import annotations

import dataclasses
import math

import mujoco
import numpy as np
from numpy.typing import NDArray

from iits_mj.render.shot import Lighting
from iits_mj.render.weather import Weather

# The sky is this share of the largest distance away, as in MuJoCo, and hides what is beyond.
SKY = 0.7
_DEFAULT_COLOR = (0.5, 0.5, 0.5, 1.0)
# Light of a tunnel's lamps from above, and from the road.
_TUNNEL_ABOVE, _TUNNEL_BELOW = (0.80, 0.77, 0.68), (0.44, 0.42, 0.38)
_MEADOW = math.pi  # patches of grass over the texture's coordinates
_KNEE = 0.68


def looks_of(model: mujoco.MjModel) -> NDArray[np.float32]:
    """Returns color with alpha, emission, specular and shininess of each geom, (n, 9).

    The last columns, light of a tunnel and answer to head lamps, are 0 and 1.
    """
    looks = np.zeros((model.ngeom, 9), np.float32)
    looks[:, :4] = model.geom_rgba
    looks[:, 5:7] = 0.5
    looks[:, 8] = 1.0
    material = model.geom_matid
    made = material >= 0
    which = material[made]
    looks[made, 4] = model.mat_emission[which]
    looks[made, 5] = model.mat_specular[which]
    looks[made, 6] = model.mat_shininess[which]
    # A geom's own color counts where it is not MuJoCo's default.
    plain = made & (model.geom_rgba == _DEFAULT_COLOR).all(axis=1)
    looks[plain, :4] = model.mat_rgba[material[plain]]
    looks[:, 6] *= 128.0
    return looks


def textures_of(model: mujoco.MjModel) -> NDArray[np.int64]:
    """Returns the number of the 2D texture on each geom, -1 without one."""
    found = np.full(model.ngeom, -1)
    made = np.flatnonzero(model.geom_matid >= 0)
    role = int(mujoco.mjtTextureRole.mjTEXROLE_RGB)
    found[made] = model.mat_texid[model.geom_matid[made], role]
    for geom in np.flatnonzero(found >= 0):
        mesh, kind = model.geom_dataid[geom], model.geom_type[geom]
        mapped = kind == mujoco.mjtGeom.mjGEOM_PLANE
        if kind == mujoco.mjtGeom.mjGEOM_MESH:
            mapped = model.mesh_texcoordadr[mesh] >= 0
        if not mapped or model.tex_type[found[geom]] != mujoco.mjtTexture.mjTEXTURE_2D:
            found[geom] = -1
    return found


def lighting_of(model: mujoco.MjModel, sun: int | None, weather: Weather | None) -> Lighting:
    """Returns the light of a scene: the model's with its sun, if any, or that of a weather."""
    black = np.zeros(3, np.float32)
    head = model.vis.headlight
    extent = model.stat.extent
    ambient = head.ambient + (black if sun is None else model.light_ambient[sun])
    found = Lighting(
        ambient=ambient,
        ground=ambient,
        head_diffuse=head.diffuse,
        head_specular=head.specular,
        sun_diffuse=black if sun is None else model.light_diffuse[sun],
        sun_specular=black if sun is None else model.light_specular[sun],
        shadow_size=0 if sun is None else model.vis.quality.shadowsize,
        fog=model.vis.rgba.fog[:3],
        fog_range=(extent * model.vis.map.fogstart, extent * model.vis.map.fogend),
        sky_radius=SKY * extent * model.vis.map.zfar,
        tunnel_above=np.array(_TUNNEL_ABOVE, np.float32),
        tunnel_below=np.array(_TUNNEL_BELOW, np.float32),
    )
    if weather is None:
        return found
    sunlight = np.array(weather.sunlight, np.float32)
    return dataclasses.replace(
        found,
        ambient=np.array(weather.above, np.float32),
        ground=np.array(weather.below, np.float32),
        head_diffuse=0.15 * np.array(weather.above, np.float32),
        head_specular=0.06 * np.array(weather.above, np.float32),
        sun_diffuse=sunlight,
        sun_specular=0.5 * sunlight,
        fog=np.array(weather.fog, np.float32),
        knee=_KNEE,
        mist=weather.mist,
        beams=weather.beams,
        wet=weather.wet,
        meadow=_MEADOW,
        smooth=True,
        sky=np.round(255.0 * weather.faces()).astype(np.uint8),
    )
