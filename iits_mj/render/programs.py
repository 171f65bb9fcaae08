"""Shader programs, buffer layouts and textures in OpenGL's memory, for the current context."""

from __future__ import annotations

import mujoco
import numpy as np
from numpy.typing import NDArray
from OpenGL import GL

from iits_mj.core.arrays import FloatArray
from iits_mj.core.errors import RenderError
from iits_mj.render import shaders


class Program:
    """A shader program; its items are the locations of its uniforms."""

    def __init__(self, name: int) -> None:
        self.name = name
        self._places: dict[str, int] = {}

    def __getitem__(self, uniform: str) -> int:
        if uniform not in self._places:
            self._places[uniform] = GL.glGetUniformLocation(self.name, uniform)
        return self._places[uniform]


def set_vectors(place: int, values: FloatArray) -> None:
    """Sets a uniform array of vectors, (n, 3)."""
    if len(values):
        GL.glUniform3fv(place, len(values), np.ascontiguousarray(values, np.float32))


def make_program(vertex: str, fragment: str, *switches: str) -> Program:
    """Compiles a program; the switches are defined in both sources.

    Raises:
      RenderError: OpenGL refuses a source.
    """
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
    return Program(program)


def describe(columns: tuple[tuple[int, int], ...], divisor: int) -> None:
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


def load_textures(
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
