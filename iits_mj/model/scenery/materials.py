"""Materials, computed textures, sky and sun of the road scene."""

from __future__ import annotations

import functools
from dataclasses import dataclass

import mujoco
import numpy as np

from iits_mj.core.arrays import FloatArray

ASPHALT_TILE = 8.0  # [m] covered by one repeat of the asphalt texture
GRASS_TILE = 95.0
LAMP_SPACING = 12.0  # [m] of the lamps in a tunnel, at stations that are its multiples
LAMP_LENGTH = 7.0
_SKY_SIZE = 256

# name: (red, green, blue), specular, emission
_PLAIN = {
    "road_marking": ((0.92, 0.92, 0.90), 0.05, 0.25),
    "road_marking_yellow": ((0.95, 0.74, 0.12), 0.05, 0.25),
    "road_gravel": ((0.47, 0.44, 0.39), 0.02, 0.0),
    "road_steel": ((0.63, 0.66, 0.69), 0.4, 0.05),
    "road_concrete": ((0.62, 0.61, 0.58), 0.05, 0.0),
    "road_curb": ((0.40, 0.395, 0.37), 0.0, 0.5),
    "road_tunnel_light": ((1.0, 0.95, 0.84), 0.0, 1.0),
    "road_pothole": ((0.10, 0.10, 0.10), 0.0, 0.0),
    "road_post": ((0.93, 0.93, 0.93), 0.05, 0.1),
    "road_reflector": ((0.95, 0.30, 0.05), 0.2, 0.4),
    "road_sign": ((0.02, 0.36, 0.20), 0.1, 0.25),
    "road_conifer": ((0.10, 0.22, 0.10), 0.0, 0.0),
    "road_conifer_pale": ((0.15, 0.27, 0.12), 0.0, 0.0),
    "road_leaves": ((0.20, 0.34, 0.10), 0.0, 0.0),
    "road_leaves_pale": ((0.29, 0.38, 0.13), 0.0, 0.0),
    "road_trunk": ((0.24, 0.17, 0.11), 0.0, 0.0),
}
# Materials of maps with other roads and objects, added where they are used.
_TOWN = {
    "road_marking_red": ((0.75, 0.16, 0.12), 0.05, 0.25),
    "road_marking_blue": ((0.15, 0.35, 0.75), 0.05, 0.25),
    "road_marking_green": ((0.15, 0.55, 0.25), 0.05, 0.25),
    "road_marking_orange": ((0.92, 0.48, 0.10), 0.05, 0.25),
    "road_sidewalk": ((0.56, 0.55, 0.53), 0.02, 0.0),
    "road_border": ((0.46, 0.45, 0.43), 0.02, 0.0),
    "road_cycle_lane": ((0.45, 0.26, 0.23), 0.02, 0.0),
    "road_building": ((0.72, 0.66, 0.58), 0.02, 0.0),
    "road_sign_white": ((0.95, 0.95, 0.95), 0.1, 0.2),
    "road_sign_red": ((0.80, 0.06, 0.08), 0.1, 0.2),
    "road_sign_yellow": ((0.98, 0.80, 0.10), 0.1, 0.2),
    "road_sign_black": ((0.03, 0.03, 0.03), 0.0, 0.1),
    "road_sign_blue": ((0.05, 0.25, 0.65), 0.1, 0.2),
    "road_lamp_housing": ((0.06, 0.07, 0.07), 0.1, 0.0),
    "road_lamp_red": ((0.30, 0.05, 0.05), 0.2, 0.0),
    "road_lamp_yellow": ((0.30, 0.24, 0.05), 0.2, 0.0),
    "road_lamp_green": ((0.04, 0.24, 0.10), 0.2, 0.0),
}
_HAZE = (0.80, 0.87, 0.93)


@dataclass(frozen=True)
class Sky:
    """Colors of a sky.

    Attributes:
      horizon, zenith: of the clear sky; cloud: of the clouds.
      clouds: density from which clouds are seen, of zero mean and unit deviation; fewer if higher.
      glow: brightness about the sun; stars: their brightness.
    """

    horizon: tuple[float, float, float] = _HAZE
    zenith: tuple[float, float, float] = (0.22, 0.45, 0.78)
    clouds: float = 0.35
    cloud: tuple[float, float, float] = (1.0, 1.0, 1.0)
    glow: float = 0.0
    stars: float = 0.0


def add_road_materials(spec: mujoco.MjSpec) -> None:
    """Adds the road scene's materials with their textures."""
    _texture(spec, "road_asphalt", _asphalt())
    _texture(spec, "road_grass", _grass())
    for name, image in _tunnel_light().items():
        _texture(spec, name, image)
    # Emission in a tunnel stands for its lamps: their light is part of the textures, also beyond
    # the reach of the sun's shadow map.
    for name, gray, emission in (
        ("road_asphalt", 1.0, 0.0),
        ("road_asphalt_tunnel", 1.0, 0.6),
        ("road_tunnel_wall", 1.0, 0.6),
        ("road_tunnel_roof", 1.0, 0.6),
        ("road_grass", 1.0, 0.0),
    ):
        material = spec.add_material(
            name=name,
            rgba=[gray, gray, gray, 1.0],
            specular=0.05 if emission == 0.0 else 0.0,
            shininess=0.1,
            emission=emission,
        )
        textures = list(material.textures)
        textures[int(mujoco.mjtTextureRole.mjTEXROLE_RGB)] = name
        material.textures = textures
    for name in _PLAIN:
        _add_plain(spec, name)


def ensure_material(spec: mujoco.MjSpec, name: str) -> None:
    """Adds a material of towns, unless the specification has it."""
    if spec.material(name) is None:
        _add_plain(spec, name)


def _add_plain(spec: mujoco.MjSpec, name: str) -> None:
    rgb, specular, emission = (_PLAIN | _TOWN)[name]
    spec.add_material(
        name=name, rgba=[*rgb, 1.0], specular=specular, shininess=0.3, emission=emission
    )


def add_sky(spec: mujoco.MjSpec) -> None:
    """Adds a sky box with soft clouds, haze, a sun that follows the truck, and a fill light."""
    _texture(spec, "sky", _day(), mujoco.mjtTexture.mjTEXTURE_SKYBOX)
    tractor = spec.body("tractor")
    body = tractor if tractor is not None else spec.worldbody
    body.add_light(
        name="sun",
        type=mujoco.mjtLightType.mjLIGHT_DIRECTIONAL,
        mode=mujoco.mjtCamLight.mjCAMLIGHT_TRACK,
        pos=[-11.0, 13.2, 34.0],
        dir=[0.30, -0.36, -0.93],
        diffuse=[0.78, 0.75, 0.68],
        ambient=[0.0, 0.0, 0.0],
        specular=[0.35, 0.34, 0.30],
        castshadow=True,
    )
    visual = spec.visual
    visual.headlight.ambient = [0.42, 0.44, 0.48]
    visual.headlight.diffuse = [0.12, 0.12, 0.12]
    visual.headlight.specular = [0.05, 0.05, 0.05]
    visual.rgba.haze = [*_HAZE, 1.0]
    visual.rgba.fog = [*_HAZE, 1.0]


def set_view(spec: mujoco.MjSpec, center: tuple[float, float, float]) -> None:
    """Sets extent, clipping planes, fog and shadow map for a truck-sized subject on a long road."""
    spec.stat.center = list(center)
    spec.stat.extent = 20.0
    visual = spec.visual
    visual.map.znear = 0.01
    visual.map.zfar = 300.0
    visual.map.fogstart = 30.0
    visual.map.fogend = 480.0
    visual.map.haze = 0.25
    # A wide, coarse shadow map: a narrow or fine one leaves speckles far from the truck.
    visual.map.shadowclip = 4.0
    visual.map.shadowscale = 0.8
    visual.quality.shadowsize = 1536
    visual.quality.offsamples = 4
    visual.global_.offwidth = max(visual.global_.offwidth, 1920)
    visual.global_.offheight = max(visual.global_.offheight, 1080)


def periodic_noise(rng: np.random.Generator, size: int, exponent: float) -> FloatArray:
    """Tileable noise (size, size) of zero mean and unit deviation, power falling as f^-exponent."""
    frequency = np.fft.fftfreq(size) * size
    radius = np.hypot(frequency[:, None], frequency[None, :])
    radius[0, 0] = 1.0
    spectrum = np.fft.fft2(rng.standard_normal((size, size))) / radius**exponent
    spectrum[0, 0] = 0.0
    noise = np.real(np.fft.ifft2(spectrum))
    return np.asarray(noise / noise.std())


def _texture(
    spec: mujoco.MjSpec,
    name: str,
    image: FloatArray,
    kind: mujoco.mjtTexture = mujoco.mjtTexture.mjTEXTURE_2D,
) -> None:
    """Adds a texture from colors of 0 to 1, shape (height, width, 3)."""
    pixels = np.clip(np.round(255.0 * image), 0, 255).astype(np.uint8)
    texture = spec.add_texture(name=name, type=kind)
    texture.height, texture.width, texture.nchannel = pixels.shape
    texture.data = pixels.tobytes()


@functools.cache
def _asphalt() -> FloatArray:
    rng = np.random.default_rng(7)
    grain = periodic_noise(rng, 256, 0.15) * 0.028 + periodic_noise(rng, 256, 0.9) * 0.008
    return np.clip(0.30 + grain, 0.0, 1.0)[..., None] * np.array([0.98, 1.0, 1.03])


@functools.cache
def _tunnel_light() -> dict[str, FloatArray]:
    """Road, wall and ceiling of a tunnel in the light of its lamps, by the name of the texture.

    Rows are along the road, one spacing of the lamps, a lamp at the first row; columns are across:
    the wall from its foot to its top, the ceiling from wall to wall.
    """
    size = 256
    share = np.arange(size) / size
    along, across = np.meshgrid(share, share, indexing="ij")
    near = 0.5 + 0.5 * np.cos(2.0 * np.pi * along)  # to a lamp
    grain = periodic_noise(np.random.default_rng(9), size, 0.4)
    broad = periodic_noise(np.random.default_rng(10), size, 1.3)

    def colored(gray: FloatArray, tint: tuple[float, float, float]) -> FloatArray:
        return np.clip(gray, 0.0, 1.0)[..., None] * np.array(tint)

    road = (0.31 + 0.05 * near) * (1.0 + 0.09 * grain + 0.03 * broad)
    # Bright panels with joints above a dark plinth; the lamps light their upper part.
    joint = (np.abs((4.0 * along) % 1.0 - 0.5) > 0.490) | (np.abs(across - 0.62) < 0.006)
    panel = np.where(across < 0.28, 0.30, np.where(joint, 0.45, 0.70)) * (1.0 + 0.02 * broad)
    wall = panel * (0.66 + 0.22 * across + 0.16 * near * across**2)
    # Two rows of lamps light the ceiling about them.
    row = np.minimum(np.abs(across - 0.32), np.abs(across - 0.68))
    ceiling = (0.26 + 0.06 * broad.clip(-1, 1) * 0.3) * (1.0 + 0.02 * grain)
    ceiling = ceiling + 0.42 * np.exp(-((row / 0.07) ** 2)) * (0.35 + 0.65 * near)
    return {
        "road_asphalt_tunnel": colored(road, (1.0, 0.98, 0.92)),
        "road_tunnel_wall": colored(wall, (1.0, 0.985, 0.93)),
        "road_tunnel_roof": colored(ceiling, (1.0, 0.96, 0.86)),
    }


@functools.cache
def _grass() -> FloatArray:
    rng = np.random.default_rng(8)
    fine = periodic_noise(rng, 768, 0.55)[..., None]
    broad = periodic_noise(rng, 768, 1.15)[..., None]
    base = np.array([0.315, 0.415, 0.175])
    return base * (1.0 + 0.09 * fine) + broad * np.array([0.028, 0.014, 0.006])


@functools.cache
def _day() -> FloatArray:
    return sky_faces(Sky(), np.array([0.0, 0.0, 1.0]))


def sky_faces(sky: Sky, to_sun: FloatArray) -> FloatArray:
    """Cube faces right, left, up, down, front, back stacked, (6 size, size, 3)."""
    horizon, zenith, tint = (np.array(c) for c in (sky.horizon, sky.zenith, sky.cloud))
    size = _SKY_SIZE
    line = (np.arange(size) + 0.5) / size * 2 - 1
    u, v = np.meshgrid(line, line)
    one = np.ones_like(u)
    # Axes of OpenGL cube maps: y is up there, v runs downwards.
    directions = (
        (one, -v, -u),
        (-one, -v, u),
        (u, one, v),
        (u, -one, -v),
        (u, -v, one),
        (-u, -v, -one),
    )
    rng = np.random.default_rng(3)
    cloud = periodic_noise(rng, 512, 1.75)
    faces = []
    star = rng.random((6, size, size, 1)) ** 2
    lit = rng.random((6, size, size, 1)) < 0.0012
    for face, (x, y, z) in enumerate(directions):
        norm = np.sqrt(x * x + y * y + z * z)
        up = y / norm
        rise = np.clip(up, 0.0, 1.0)[..., None]
        color = horizon + (zenith - horizon) * rise**0.55
        if sky.glow:
            # The map's axes are x, -z, y of the cube.
            toward = (x * to_sun[0] - z * to_sun[1] + y * to_sun[2]) / norm
            near = np.clip(toward, 0.0, 1.0)[..., None]
            light = 0.45 * near**6 + 0.35 * near**60 + 1.2 * near**3000
            color = color + sky.glow * light * np.array([1.0, 0.82, 0.55])
        color = color + sky.stars * np.where(lit[face], star[face], 0.0) * np.clip(rise * 6, 0, 1)
        # Clouds on a plane above: they shrink towards the horizon, where they fade.
        reach = 1.0 / np.maximum(up + 0.08, 0.05)
        row = (x / norm * reach * 60.0 + 256.0) % 512
        column = (z / norm * reach * 60.0 + 256.0) % 512
        density = bilinear(cloud, row, column)
        cover = np.clip((density - sky.clouds) / 1.6, 0.0, 1.0)
        cover *= np.clip((up - 0.03) / 0.22, 0.0, 1.0)
        color = color + (tint - color) * 0.85 * cover[..., None]
        color[up < 0.0] = horizon * 0.96
        faces.append(np.clip(color, 0.0, 1.0))
    return np.concatenate(faces)


def bilinear(image: FloatArray, row: FloatArray, column: FloatArray) -> FloatArray:
    """Interpolates a tileable image (n, n) at rows and columns of any shape."""
    size = image.shape[0]
    i, j = np.floor(row).astype(int), np.floor(column).astype(int)
    a, b = row - i, column - j
    i, j, k, m = i % size, j % size, (i + 1) % size, (j + 1) % size
    upper = image[i, j] * (1 - b) + image[i, m] * b
    lower = image[k, j] * (1 - b) + image[k, m] * b
    return np.asarray(upper * (1 - a) + lower * a)
