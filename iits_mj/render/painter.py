"""Draws triangles with OpenGL: one pass with sun, shadows and fog, as MuJoCo's own renderer looks.

MuJoCo's renderer draws every geom three times and sends each triangle's corners separately. Without
a graphics card that takes about three times as long as the one pass here.
"""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray
from OpenGL import GL

from iits_mj.core.arrays import FloatArray, IndexArray
from iits_mj.core.errors import RenderError
from iits_mj.render import shaders
from iits_mj.render.geometry import Floats, Geometry

ASPHALT, GRASS = "road_asphalt", "road_grass"  # textures that the weather changes
WHITE = 0.97  # the brightest color
SHADOW_LEVEL = 2  # of detail of what casts shadows


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


class Painter:
    """OpenGL's side of `Offscreen`, for the current context.

    Args:
      model: whose textures are used; geometry: its triangles.
      size: of the pictures; lighting: of the scene.

    Raises:
      RenderError: OpenGL refuses the size.
    """

    def __init__(
        self,
        model: mujoco.MjModel,
        geometry: Geometry,
        size: tuple[int, int],
        lighting: Lighting,
    ) -> None:
        self._size = size
        self._lighting = lighting
        # As in the indirect commands of OpenGL: count, instances, first index, vertex, instance.
        self._commands = np.zeros((*geometry.count.shape, 5), np.uint32)
        self._commands[..., 0] = geometry.count
        self._commands[..., 1] = 1
        self._commands[..., 2] = geometry.first
        self._commands[..., 4] = geometry.geom
        switches = [
            name
            for name, on in (
                ("MIST", lighting.mist > 0.0),
                ("BEAMS", lighting.beams),
            )
            if on
        ]
        self._plain = _program(shaders.VERTEX, shaders.FRAGMENT, *switches)
        self._textured = _program(shaders.VERTEX, shaders.FRAGMENT, "TEXTURED", *switches)
        self._road = self._textured
        if lighting.wet > 0.0:
            self._road = _program(shaders.VERTEX, shaders.FRAGMENT, "TEXTURED", "WET", *switches)
        self._surfaces = {program.name: program for program in (self._plain, self._textured)}
        self._surfaces[self._road.name] = self._road
        self._shadow = _program(shaders.SHADOW, shaders.SHADOW_FRAGMENT)
        self._sky = _program(shaders.SKY, shaders.SKY_FRAGMENT)
        self._spot = _program(shaders.SPOT, shaders.SPOT_FRAGMENT)
        self._smooth = _program(shaders.SMOOTH, shaders.SMOOTH_FRAGMENT)
        self._textures, self._sky_texture = _textures(model, lighting.sky)
        self._of_texture = {
            name: next((i for i in range(model.ntex) if model.texture(i).name == name), -2)
            for name in (ASPHALT, GRASS)
        }
        self._arrays(geometry)
        self._targets(size)
        self._constants()

    def paint(self, shot: Shot) -> NDArray[np.uint8]:
        """Returns the picture (height, width, 3), top row first."""
        for buffer, values in ((self._places, shot.places), (self._looks, shot.looks)):
            GL.glBindBuffer(GL.GL_ARRAY_BUFFER, buffer)
            GL.glBufferData(GL.GL_ARRAY_BUFFER, values.nbytes, values, GL.GL_STREAM_DRAW)
        GL.glBindVertexArray(self._vertex_array)
        groups = self._upload(shot)
        self._paint_shadows(shot, groups)
        width, height = self._size
        GL.glBindFramebuffer(GL.GL_FRAMEBUFFER, self._frame)
        GL.glViewport(0, 0, width, height)
        GL.glClear(GL.GL_COLOR_BUFFER_BIT | GL.GL_DEPTH_BUFFER_BIT)
        GL.glEnable(GL.GL_CULL_FACE)
        GL.glActiveTexture(GL.GL_TEXTURE0)
        for program in self._surfaces.values():
            self._use(program, shot)
        for texture in shot.opaque:
            program = self._plain if texture < 0 else self._textured
            if texture == self._of_texture[ASPHALT]:
                program = self._road
            GL.glUseProgram(program.name)
            if texture >= 0:
                GL.glBindTexture(GL.GL_TEXTURE_2D, self._textures[texture])
                grass = self._lighting.meadow if texture == self._of_texture[GRASS] else 0.0
                GL.glUniform1f(program["meadow"], grass)
            self._draw(groups[texture])
        if self._sky_texture:
            GL.glUseProgram(self._sky.name)
            GL.glUniformMatrix3fv(self._sky["axes"], 1, GL.GL_TRUE, shot.axes.astype(np.float32))
            GL.glBindTexture(GL.GL_TEXTURE_CUBE_MAP, self._sky_texture)
            GL.glDisable(GL.GL_CULL_FACE)
            GL.glDrawArrays(GL.GL_TRIANGLES, 0, 3)
            GL.glEnable(GL.GL_CULL_FACE)
        if len(shot.transparent):
            GL.glUseProgram(self._plain.name)
            GL.glUniform1i(self._plain["shadows"], 0)
            GL.glEnable(GL.GL_BLEND)
            GL.glDepthMask(GL.GL_FALSE)
            self._draw(groups["transparent"])
            GL.glDepthMask(GL.GL_TRUE)
            GL.glDisable(GL.GL_BLEND)
        self._paint_spots(shot)
        self._smooth_edges()
        pixels = np.empty((height, width, 3), np.uint8)
        GL.glReadPixels(0, 0, width, height, GL.GL_RGB, GL.GL_UNSIGNED_BYTE, pixels)
        return pixels

    def _paint_spots(self, shot: Shot) -> None:
        if not len(shot.spots):
            return
        values = np.ascontiguousarray(shot.spots, np.float32)
        GL.glBindVertexArray(self._spot_array)
        GL.glBindBuffer(GL.GL_ARRAY_BUFFER, self._spots)
        GL.glBufferData(GL.GL_ARRAY_BUFFER, values.nbytes, values, GL.GL_STREAM_DRAW)
        GL.glUseProgram(self._spot.name)
        view = shot.view.astype(np.float32)
        GL.glUniformMatrix4fv(self._spot["view"], 1, GL.GL_TRUE, view)
        GL.glUniform1f(self._spot["mist"], self._lighting.mist)
        GL.glEnable(GL.GL_BLEND)
        GL.glBlendFunc(GL.GL_ONE, GL.GL_ONE_MINUS_SRC_ALPHA)
        GL.glDepthMask(GL.GL_FALSE)
        GL.glDisable(GL.GL_CULL_FACE)
        GL.glDrawArraysInstanced(GL.GL_TRIANGLE_STRIP, 0, 4, len(values))
        GL.glBlendFunc(GL.GL_SRC_ALPHA, GL.GL_ONE_MINUS_SRC_ALPHA)
        GL.glDepthMask(GL.GL_TRUE)
        GL.glDisable(GL.GL_BLEND)

    def _smooth_edges(self) -> None:
        if not self._lighting.smooth:
            return
        GL.glBindFramebuffer(GL.GL_FRAMEBUFFER, self._smooth_frame)
        GL.glUseProgram(self._smooth.name)
        GL.glActiveTexture(GL.GL_TEXTURE0)
        GL.glBindTexture(GL.GL_TEXTURE_2D, self._picture)
        GL.glDisable(GL.GL_CULL_FACE)
        GL.glDisable(GL.GL_DEPTH_TEST)
        GL.glDrawArrays(GL.GL_TRIANGLES, 0, 3)
        GL.glEnable(GL.GL_DEPTH_TEST)

    def _upload(self, shot: Shot) -> dict[object, tuple[int, int]]:
        """Sends the drawing commands; returns the place and number of each group's."""
        chosen: dict[object, IndexArray] = {"casters": shot.casters}
        for texture, parts in shot.opaque.items():
            chosen[texture] = parts
        chosen["transparent"] = shot.transparent
        part = np.concatenate(list(chosen.values()))
        level = shot.level[part]
        level[: len(shot.casters)] = np.maximum(level[: len(shot.casters)], SHADOW_LEVEL)
        commands = self._commands[level, part]
        if count := len(shot.transparent):
            commands[-count:, 4] = shot.instances
        GL.glBindBuffer(GL.GL_DRAW_INDIRECT_BUFFER, self._indirect)
        GL.glBufferData(GL.GL_DRAW_INDIRECT_BUFFER, commands.nbytes, commands, GL.GL_STREAM_DRAW)
        groups, start = {}, 0
        for name, parts in chosen.items():
            groups[name] = (start, len(parts))
            start += len(parts)
        return groups

    def _draw(self, group: tuple[int, int]) -> None:
        start, count = group
        if count:
            size = 4 * self._commands.shape[-1]
            GL.glMultiDrawElementsIndirect(
                GL.GL_TRIANGLES, GL.GL_UNSIGNED_INT, GL.GLvoidp(size * start), count, size
            )

    def _paint_shadows(self, shot: Shot, groups: dict[object, tuple[int, int]]) -> None:
        side = self._lighting.shadow_size
        if not side:
            return
        GL.glUseProgram(self._shadow.name)
        GL.glUniformMatrix4fv(self._shadow["light"], 1, GL.GL_TRUE, shot.light.astype(np.float32))
        GL.glBindFramebuffer(GL.GL_FRAMEBUFFER, self._shadow_frame)
        GL.glViewport(0, 0, side, side)
        GL.glClear(GL.GL_DEPTH_BUFFER_BIT)
        # Without the edge, whose shadows would reach to infinity.
        GL.glViewport(1, 1, side - 2, side - 2)
        GL.glDisable(GL.GL_CULL_FACE)
        GL.glEnable(GL.GL_POLYGON_OFFSET_FILL)
        GL.glEnable(GL.GL_DEPTH_CLAMP)
        self._draw(groups["casters"])
        GL.glDisable(GL.GL_DEPTH_CLAMP)
        GL.glDisable(GL.GL_POLYGON_OFFSET_FILL)

    def _use(self, program: _Program, shot: Shot) -> None:
        GL.glUseProgram(program.name)
        for name, matrix in (("view", shot.view), ("light", shot.light)):
            GL.glUniformMatrix4fv(program[name], 1, GL.GL_TRUE, matrix.astype(np.float32))
        GL.glUniform3f(program["forward"], *shot.forward)
        GL.glUniform3f(program["to_sun"], *shot.to_sun)
        GL.glUniform1i(program["shadows"], bool(self._lighting.shadow_size))
        lighting = self._lighting
        if lighting.beams:
            GL.glUniform1i(program["beams"], len(shot.beams[0]))
            for name, values in zip(("beam_at", "beam_to", "beam_color"), shot.beams, strict=True):
                _vectors(program[name], values)
        if lighting.wet > 0.0 and program is self._road:
            GL.glUniform1i(program["glints"], len(shot.glints[0]))
            for name, values in zip(("glint_at", "glint_color"), shot.glints, strict=True):
                _vectors(program[name], values)

    def _constants(self) -> None:
        GL.glClipControl(GL.GL_LOWER_LEFT, GL.GL_ZERO_TO_ONE)
        GL.glEnable(GL.GL_DEPTH_TEST)
        # The depth runs from 1 near the camera to 0, where single precision is finest.
        GL.glDepthFunc(GL.GL_GEQUAL)
        GL.glClearDepth(0.0)
        GL.glClearColor(0.0, 0.0, 0.0, 1.0)
        # The picture is upside down, because its first row is read first.
        GL.glFrontFace(GL.GL_CW)
        GL.glPolygonOffset(-1.5, -4.0)
        GL.glBlendFunc(GL.GL_SRC_ALPHA, GL.GL_ONE_MINUS_SRC_ALPHA)
        GL.glPixelStorei(GL.GL_PACK_ALIGNMENT, 1)
        GL.glEnable(GL.GL_TEXTURE_CUBE_MAP_SEAMLESS)
        lighting = self._lighting
        for program in self._surfaces.values():
            GL.glUseProgram(program.name)
            for name in (
                "ambient",
                "ground",
                "tunnel_above",
                "tunnel_below",
                "head_diffuse",
                "head_specular",
                "sun_diffuse",
                "sun_specular",
            ):
                GL.glUniform3f(program[name], *getattr(lighting, name))
            GL.glUniform1i(program["shadow_map"], 1)
            GL.glUniform1i(program["mirrored"], 2)
            width = 2.0 * max(WHITE - lighting.knee, 0.0)
            GL.glUniform3f(program["tone"], lighting.knee, width, 0.5 / max(width, 1e-6))
            GL.glUniform1f(program["limit"], 1.0 if lighting.knee >= 1.0 else 8.0)
        for program in (*self._surfaces.values(), self._sky):
            GL.glUseProgram(program.name)
            GL.glUniform3f(program["fog"], *lighting.fog)
            GL.glUniform2f(program["fog_range"], *lighting.fog_range)
            GL.glUniform1f(program["mist"], lighting.mist)
        for program in (self._textured, self._road):
            GL.glUseProgram(program.name)
            GL.glUniform1i(program["pattern"], 0)
            GL.glUniform1f(program["wet"], lighting.wet)
        GL.glUseProgram(self._sky.name)
        GL.glUniform1i(self._sky["sky"], 0)
        GL.glUniform1f(self._sky["radius"], lighting.sky_radius)
        GL.glUseProgram(self._smooth.name)
        GL.glUniform1i(self._smooth["picture"], 0)
        GL.glUniform2f(self._smooth["pixel"], 1.0 / self._size[0], 1.0 / self._size[1])
        GL.glActiveTexture(GL.GL_TEXTURE2)
        GL.glBindTexture(GL.GL_TEXTURE_CUBE_MAP, self._sky_texture)

    def _arrays(self, geometry: Geometry) -> None:
        self._vertex_array = GL.glGenVertexArrays(1)
        GL.glBindVertexArray(self._vertex_array)
        vertices, indices, self._places, self._looks, self._indirect = GL.glGenBuffers(5)
        GL.glBindBuffer(GL.GL_ARRAY_BUFFER, vertices)
        data = geometry.vertices
        GL.glBufferData(GL.GL_ARRAY_BUFFER, data.nbytes, data, GL.GL_STATIC_DRAW)
        _attributes(((0, 3), (1, 3), (2, 2)), 0)
        GL.glBindBuffer(GL.GL_ELEMENT_ARRAY_BUFFER, indices)
        corners = geometry.indices
        GL.glBufferData(GL.GL_ELEMENT_ARRAY_BUFFER, corners.nbytes, corners, GL.GL_STATIC_DRAW)
        GL.glBindBuffer(GL.GL_ARRAY_BUFFER, self._places)
        _attributes(((3, 4), (4, 4), (5, 4)), 1)
        GL.glBindBuffer(GL.GL_ARRAY_BUFFER, self._looks)
        _attributes(((6, 4), (7, 3), (8, 2)), 1)
        self._spot_array = GL.glGenVertexArrays(1)
        GL.glBindVertexArray(self._spot_array)
        self._spots = GL.glGenBuffers(1)
        GL.glBindBuffer(GL.GL_ARRAY_BUFFER, self._spots)
        _attributes(((0, 3), (1, 3), (2, 3), (3, 4), (4, 1)), 1)

    def _targets(self, size: tuple[int, int]) -> None:
        self._frame, self._shadow_frame, self._smooth_frame = GL.glGenFramebuffers(3)
        depth = GL.glGenRenderbuffers(1)
        GL.glActiveTexture(GL.GL_TEXTURE0)
        self._picture, smoothed = GL.glGenTextures(2)
        for frame, name in ((self._smooth_frame, smoothed), (self._frame, self._picture)):
            GL.glBindTexture(GL.GL_TEXTURE_2D, name)
            GL.glTexStorage2D(GL.GL_TEXTURE_2D, 1, GL.GL_RGBA8, *size)
            for parameter in (GL.GL_TEXTURE_MIN_FILTER, GL.GL_TEXTURE_MAG_FILTER):
                GL.glTexParameteri(GL.GL_TEXTURE_2D, parameter, GL.GL_LINEAR)
            for parameter in (GL.GL_TEXTURE_WRAP_S, GL.GL_TEXTURE_WRAP_T):
                GL.glTexParameteri(GL.GL_TEXTURE_2D, parameter, GL.GL_CLAMP_TO_EDGE)
            GL.glBindFramebuffer(GL.GL_FRAMEBUFFER, frame)
            GL.glFramebufferTexture2D(
                GL.GL_FRAMEBUFFER, GL.GL_COLOR_ATTACHMENT0, GL.GL_TEXTURE_2D, name, 0
            )
        GL.glBindRenderbuffer(GL.GL_RENDERBUFFER, depth)
        GL.glRenderbufferStorage(GL.GL_RENDERBUFFER, GL.GL_DEPTH_COMPONENT32F, *size)
        GL.glFramebufferRenderbuffer(
            GL.GL_FRAMEBUFFER, GL.GL_DEPTH_ATTACHMENT, GL.GL_RENDERBUFFER, depth
        )
        if GL.glCheckFramebufferStatus(GL.GL_FRAMEBUFFER) != GL.GL_FRAMEBUFFER_COMPLETE:
            raise RenderError(f"OpenGL refuses a {size[0]}x{size[1]} picture")
        GL.glActiveTexture(GL.GL_TEXTURE1)
        shadow = GL.glGenTextures(1)
        GL.glBindTexture(GL.GL_TEXTURE_2D, shadow)
        side = max(self._lighting.shadow_size, 1)
        # 16 bits over the short range of depths cost half the memory traffic of 32.
        GL.glTexStorage2D(GL.GL_TEXTURE_2D, 1, GL.GL_DEPTH_COMPONENT16, side, side)
        for parameter, value in (
            (GL.GL_TEXTURE_MIN_FILTER, GL.GL_NEAREST),
            (GL.GL_TEXTURE_MAG_FILTER, GL.GL_NEAREST),
            (GL.GL_TEXTURE_WRAP_S, GL.GL_CLAMP_TO_EDGE),
            (GL.GL_TEXTURE_WRAP_T, GL.GL_CLAMP_TO_EDGE),
            (GL.GL_TEXTURE_COMPARE_MODE, GL.GL_COMPARE_REF_TO_TEXTURE),
            (GL.GL_TEXTURE_COMPARE_FUNC, GL.GL_GEQUAL),
        ):
            GL.glTexParameteri(GL.GL_TEXTURE_2D, parameter, value)
        GL.glBindFramebuffer(GL.GL_FRAMEBUFFER, self._shadow_frame)
        GL.glFramebufferTexture2D(
            GL.GL_FRAMEBUFFER, GL.GL_DEPTH_ATTACHMENT, GL.GL_TEXTURE_2D, shadow, 0
        )
        GL.glDrawBuffer(GL.GL_NONE)
        GL.glReadBuffer(GL.GL_NONE)


class _Program:
    """A shader program; its items are the locations of its uniforms."""

    def __init__(self, name: int) -> None:
        self.name = name
        self._places: dict[str, int] = {}

    def __getitem__(self, uniform: str) -> int:
        if uniform not in self._places:
            self._places[uniform] = GL.glGetUniformLocation(self.name, uniform)
        return self._places[uniform]


def _vectors(place: int, values: FloatArray) -> None:
    if len(values):
        GL.glUniform3fv(place, len(values), np.ascontiguousarray(values, np.float32))


def _program(vertex: str, fragment: str, *switches: str) -> _Program:
    sizes = ("BEAMS_MAX", shaders.BEAMS_MAX), ("GLINTS_MAX", shaders.GLINTS_MAX)
    lines = [f"#define {name}" for name in switches]
    lines += [f"#define {name} {number}" for name, number in sizes]
    head = "\n".join(["#version 430", *lines])
    program = GL.glCreateProgram()
    for kind, source in ((GL.GL_VERTEX_SHADER, vertex), (GL.GL_FRAGMENT_SHADER, fragment)):
        shader = GL.glCreateShader(kind)
        GL.glShaderSource(shader, source.replace("#version 430", head, 1))
        GL.glCompileShader(shader)
        if not GL.glGetShaderiv(shader, GL.GL_COMPILE_STATUS):
            raise RenderError(f"OpenGL refuses a shader: {GL.glGetShaderInfoLog(shader)!r}")
        GL.glAttachShader(program, shader)
    GL.glLinkProgram(program)
    if not GL.glGetProgramiv(program, GL.GL_LINK_STATUS):
        raise RenderError(f"OpenGL refuses a shader: {GL.glGetProgramInfoLog(program)!r}")
    return _Program(program)


def _attributes(columns: tuple[tuple[int, int], ...], divisor: int) -> None:
    """Describes the float columns (location, width) of the bound buffer's rows."""
    stride = 4 * sum(width for _, width in columns)
    start = 0
    for location, width in columns:
        GL.glEnableVertexAttribArray(location)
        GL.glVertexAttribPointer(
            location, width, GL.GL_FLOAT, GL.GL_FALSE, stride, GL.GLvoidp(start)
        )
        GL.glVertexAttribDivisor(location, divisor)
        start += 4 * width


def _textures(
    model: mujoco.MjModel, other_sky: NDArray[np.uint8] | None
) -> tuple[dict[int, int], int]:
    """Returns the 2D textures by number, and the sky, 0 without one."""
    flat, sky = {}, 0
    GL.glPixelStorei(GL.GL_UNPACK_ALIGNMENT, 1)
    GL.glActiveTexture(GL.GL_TEXTURE0)
    for i in range(model.ntex):
        width, height, channels = model.tex_width[i], model.tex_height[i], model.tex_nchannel[i]
        start = model.tex_adr[i]
        data = model.tex_data[start : start + width * height * channels]
        cube = model.tex_type[i] != mujoco.mjtTexture.mjTEXTURE_2D
        if cube and other_sky is not None:
            width, channels, data = other_sky.shape[1], 3, other_sky.ravel()
        if cube and (sky or model.tex_type[i] != mujoco.mjtTexture.mjTEXTURE_SKYBOX):
            continue
        target = GL.GL_TEXTURE_CUBE_MAP if cube else GL.GL_TEXTURE_2D
        name = GL.glGenTextures(1)
        GL.glBindTexture(target, name)
        kind = GL.GL_RGB if channels == 3 else GL.GL_RGBA
        if cube:
            sky = name
            faces = data.reshape(-1, width * width * channels)
            for face in range(6):
                GL.glTexImage2D(
                    GL.GL_TEXTURE_CUBE_MAP_POSITIVE_X + face,
                    *(0, GL.GL_RGB8, width, width, 0, kind, GL.GL_UNSIGNED_BYTE),
                    faces[face % len(faces)],
                )
        else:
            flat[i] = name
            GL.glTexImage2D(
                target, 0, GL.GL_RGB8, width, height, 0, kind, GL.GL_UNSIGNED_BYTE, data
            )
        GL.glTexParameteri(target, GL.GL_TEXTURE_MAG_FILTER, GL.GL_LINEAR)
        GL.glTexParameteri(target, GL.GL_TEXTURE_MIN_FILTER, GL.GL_LINEAR_MIPMAP_LINEAR)
        edge = GL.GL_CLAMP_TO_EDGE if cube else GL.GL_REPEAT
        for axis in (GL.GL_TEXTURE_WRAP_S, GL.GL_TEXTURE_WRAP_T, GL.GL_TEXTURE_WRAP_R):
            GL.glTexParameteri(target, axis, edge)
        GL.glGenerateMipmap(target)
    return flat, sky
