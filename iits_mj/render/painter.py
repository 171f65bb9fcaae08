"""Draws triangles with OpenGL: one pass with sun, shadows and fog, as MuJoCo's own renderer looks.

MuJoCo's renderer draws every geom three times and sends each triangle's corners separately. Without
a graphics card that takes about three times as long as the one pass here.
"""

from __future__ import annotations

import mujoco
import numpy as np
from numpy.typing import NDArray
from OpenGL import GL

from iits_mj.core.arrays import IndexArray
from iits_mj.core.errors import RenderError
from iits_mj.render import shaders
from iits_mj.render.geometry import Geometry
from iits_mj.render.programs import Program, describe, load_textures, make_program, set_vectors
from iits_mj.render.shot import Lighting, Shot

ASPHALT, GRASS = "road_asphalt", "road_grass"  # textures that the weather changes
WHITE = 0.97  # the brightest color
SHADOW_LEVEL = 2  # of detail of what casts shadows


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
        self._plain = make_program(shaders.VERTEX, shaders.FRAGMENT, *switches)
        self._textured = make_program(shaders.VERTEX, shaders.FRAGMENT, "TEXTURED", *switches)
        self._road = self._textured
        if lighting.wet > 0.0:
            self._road = make_program(
                shaders.VERTEX, shaders.FRAGMENT, "TEXTURED", "WET", *switches
            )
        self._surfaces = {program.name: program for program in (self._plain, self._textured)}
        self._surfaces[self._road.name] = self._road
        self._shadow = make_program(shaders.SHADOW, shaders.SHADOW_FRAGMENT)
        self._sky = make_program(shaders.SKY, shaders.SKY_FRAGMENT)
        self._spot = make_program(shaders.SPOT, shaders.SPOT_FRAGMENT)
        self._smooth = make_program(shaders.SMOOTH, shaders.SMOOTH_FRAGMENT)
        self._textures, self._sky_texture = load_textures(model, lighting.sky)
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

    def _use(self, program: Program, shot: Shot) -> None:
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
                set_vectors(program[name], values)
        if lighting.wet > 0.0 and program is self._road:
            GL.glUniform1i(program["glints"], len(shot.glints[0]))
            for name, values in zip(("glint_at", "glint_color"), shot.glints, strict=True):
                set_vectors(program[name], values)

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
        describe(((0, 3), (1, 3), (2, 2)), 0)
        GL.glBindBuffer(GL.GL_ELEMENT_ARRAY_BUFFER, indices)
        corners = geometry.indices
        GL.glBufferData(GL.GL_ELEMENT_ARRAY_BUFFER, corners.nbytes, corners, GL.GL_STATIC_DRAW)
        GL.glBindBuffer(GL.GL_ARRAY_BUFFER, self._places)
        describe(((3, 4), (4, 4), (5, 4)), 1)
        GL.glBindBuffer(GL.GL_ARRAY_BUFFER, self._looks)
        describe(((6, 4), (7, 3), (8, 2)), 1)
        self._spot_array = GL.glGenVertexArrays(1)
        GL.glBindVertexArray(self._spot_array)
        self._spots = GL.glGenBuffers(1)
        GL.glBindBuffer(GL.GL_ARRAY_BUFFER, self._spots)
        describe(((0, 3), (1, 3), (2, 3), (3, 4), (4, 1)), 1)

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
