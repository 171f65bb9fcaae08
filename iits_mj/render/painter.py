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

from iits_mj.core.arrays import BoolArray, FloatArray, IndexArray
from iits_mj.core.errors import RenderError
from iits_mj.render.geometry import Floats, Geometry

# The light of each vertex, as OpenGL's fixed functions compute it: the camera's lamp and what a
# material emits in `base`, the sun in `sunlit`, which shadows remove.
_VERTEX = """#version 430
layout(location = 0) in vec3 position;
layout(location = 1) in vec3 normal;
layout(location = 2) in vec2 coordinates;
layout(location = 3) in vec4 row0;
layout(location = 4) in vec4 row1;
layout(location = 5) in vec4 row2;
layout(location = 6) in vec4 rgba;
layout(location = 7) in vec3 surface;  // emission, specular, shininess
uniform mat4 view;
uniform mat4 light;
uniform vec3 forward;
uniform vec3 ambient, head_diffuse, head_specular;
uniform vec3 to_sun, sun_diffuse, sun_specular;
out vec4 base;
out vec3 sunlit;
out vec3 place;
#ifdef TEXTURED
out vec2 at;
#endif

vec3 lit(vec3 n, vec3 to_light, vec3 to_eye, vec3 diffuse, vec3 specular) {
  float facing = dot(n, to_light);
  if (facing <= 0.0) return vec3(0.0);
  float mirror = max(dot(n, normalize(to_light + to_eye)), 1e-9);
  return facing * diffuse * rgba.rgb + surface.y * pow(mirror, surface.z) * specular;
}

void main() {
  vec4 p = vec4(position, 1.0);
  vec4 world = vec4(dot(row0, p), dot(row1, p), dot(row2, p), 1.0);
  vec3 n = normalize(vec3(dot(row0.xyz, normal), dot(row1.xyz, normal), dot(row2.xyz, normal)));
  vec3 to_eye = -normalize(world.xyz);
  gl_Position = view * world;
  place = (light * world).xyz * vec3(0.5, 0.5, 1.0) + vec3(0.5, 0.5, 0.0);
  vec3 own = (surface.x + ambient) * rgba.rgb;
  own += lit(n, -forward, to_eye, head_diffuse, head_specular);
  base = vec4(min(own, 1.0), rgba.a);
  sunlit = min(lit(n, to_sun, to_eye, sun_diffuse, sun_specular), 1.0);
#ifdef TEXTURED
  at = coordinates;
#endif
}
"""
_FRAGMENT = """#version 430
in vec4 base;
in vec3 sunlit;
in vec3 place;
uniform vec3 fog;
uniform vec2 fog_range;
uniform bool shadows;
uniform sampler2DShadow shadow_map;
#ifdef TEXTURED
in vec2 at;
uniform sampler2D pattern;
#endif
out vec4 color;
void main() {
  float sun = shadows ? texture(shadow_map, place) : 1.0;
  vec3 own = base.rgb, direct = sunlit;
#ifdef TEXTURED
  vec3 texel = texture(pattern, at).rgb;
  own *= texel;
  direct *= texel;
#endif
  float clear = (fog_range.y - 1.0 / gl_FragCoord.w) / (fog_range.y - fog_range.x);
  color = vec4(mix(fog, own + sun * direct, clamp(clear, 0.0, 1.0)), base.a);
}
"""
_SHADOW = """#version 430
layout(location = 0) in vec3 position;
layout(location = 3) in vec4 row0;
layout(location = 4) in vec4 row1;
layout(location = 5) in vec4 row2;
uniform mat4 light;
void main() {
  vec4 p = vec4(position, 1.0);
  gl_Position = light * vec4(dot(row0, p), dot(row1, p), dot(row2, p), 1.0);
}
"""
_SHADOW_FRAGMENT = """#version 430
void main() {}
"""
# A triangle that covers the picture, at infinite distance.
_SKY = """#version 430
uniform mat3 axes;
out vec3 direction;
void main() {
  vec2 corner = vec2(gl_VertexID % 2, gl_VertexID / 2) * 4.0 - 1.0;
  direction = axes * vec3(corner, 1.0);
  gl_Position = vec4(corner, 0.0, 1.0);
}
"""
_SKY_FRAGMENT = """#version 430
in vec3 direction;
uniform samplerCube sky;
uniform vec3 fog;
uniform vec2 fog_range;
uniform float radius;
out vec4 color;
void main() {
  // MuJoCo draws the sky on a cylinder in the fog.
  float depth = radius / max(length(direction.xz), abs(direction.y));
  float clear = (fog_range.y - depth) / (fog_range.y - fog_range.x);
  color = vec4(mix(fog, texture(sky, direction).rgb, clamp(clear, 0.0, 1.0)), 1.0);
}
"""


@dataclass(frozen=True)
class Lighting:
    """Lights, fog and sky of a scene.

    Attributes:
      ambient, head_diffuse, head_specular: of the lamp at the camera.
      sun_diffuse, sun_specular: of the sun, black without one.
      shadow_size: side of the shadow map in pixels, 0 for no shadows.
      fog, fog_range: its color, and the distances where it begins and hides everything [m].
      sky_radius: of the cylinder with the sky [m].
    """

    ambient: Floats
    head_diffuse: Floats
    head_specular: Floats
    sun_diffuse: Floats
    sun_specular: Floats
    shadow_size: int
    fog: Floats
    fog_range: tuple[float, float]
    sky_radius: float


@dataclass(frozen=True)
class Shot:
    """What one picture shows.

    Attributes:
      places: rotation and position of each instance relative to the eye, rows of (n, 3, 4).
      looks: color with alpha, emission, specular, shininess of each instance, (n, 7).
      opaque: parts by texture (-1 for none); casters: parts that cast shadows.
      transparent: parts, in the order of drawing.
      instances: of the transparent parts; coarse: whether to draw each part
        in its coarse form, as shadows are.
      view, light: from places to the picture and to the shadow map, (4, 4).
      forward, to_sun: directions of view and to the sun.
      axes: from (right, down, 1) on the picture to the sky's directions, (3, 3).
    """

    places: Floats
    looks: Floats
    opaque: dict[int, IndexArray]
    casters: IndexArray
    transparent: IndexArray
    instances: IndexArray
    coarse: BoolArray
    view: FloatArray
    light: FloatArray
    forward: FloatArray
    to_sun: FloatArray
    axes: FloatArray


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
        self._plain = _program(_VERTEX, _FRAGMENT)
        self._textured = _program(*(_textured(source) for source in (_VERTEX, _FRAGMENT)))
        self._shadow = _program(_SHADOW, _SHADOW_FRAGMENT)
        self._sky = _program(_SKY, _SKY_FRAGMENT)
        self._textures, self._sky_texture = _textures(model)
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
        for program in (self._plain, self._textured):
            self._use(program, shot)
        for texture in shot.opaque:
            program = self._plain if texture < 0 else self._textured
            GL.glUseProgram(program.name)
            if texture >= 0:
                GL.glBindTexture(GL.GL_TEXTURE_2D, self._textures[texture])
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
        pixels = np.empty((height, width, 3), np.uint8)
        GL.glReadPixels(0, 0, width, height, GL.GL_RGB, GL.GL_UNSIGNED_BYTE, pixels)
        return pixels

    def _upload(self, shot: Shot) -> dict[object, tuple[int, int]]:
        """Sends the drawing commands; returns the place and number of each group's."""
        chosen: dict[object, IndexArray] = {"casters": shot.casters}
        for texture, parts in shot.opaque.items():
            chosen[texture] = parts
        chosen["transparent"] = shot.transparent
        part = np.concatenate(list(chosen.values()))
        coarse = shot.coarse[part]
        coarse[: len(shot.casters)] = True
        commands = self._commands[coarse.astype(int), part]
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
        for program in (self._plain, self._textured):
            GL.glUseProgram(program.name)
            for name in (
                "ambient",
                "head_diffuse",
                "head_specular",
                "sun_diffuse",
                "sun_specular",
            ):
                GL.glUniform3f(program[name], *getattr(lighting, name))
            GL.glUniform1i(program["shadow_map"], 1)
        for program in (self._plain, self._textured, self._sky):
            GL.glUseProgram(program.name)
            GL.glUniform3f(program["fog"], *lighting.fog)
            GL.glUniform2f(program["fog_range"], *lighting.fog_range)
        GL.glUseProgram(self._textured.name)
        GL.glUniform1i(self._textured["pattern"], 0)
        GL.glUseProgram(self._sky.name)
        GL.glUniform1i(self._sky["sky"], 0)
        GL.glUniform1f(self._sky["radius"], lighting.sky_radius)

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
        _attributes(((6, 4), (7, 3)), 1)

    def _targets(self, size: tuple[int, int]) -> None:
        self._frame, self._shadow_frame = GL.glGenFramebuffers(2)
        color, depth = GL.glGenRenderbuffers(2)
        GL.glBindFramebuffer(GL.GL_FRAMEBUFFER, self._frame)
        for name, kind, attachment in (
            (color, GL.GL_RGBA8, GL.GL_COLOR_ATTACHMENT0),
            (depth, GL.GL_DEPTH_COMPONENT32F, GL.GL_DEPTH_ATTACHMENT),
        ):
            GL.glBindRenderbuffer(GL.GL_RENDERBUFFER, name)
            GL.glRenderbufferStorage(GL.GL_RENDERBUFFER, kind, *size)
            GL.glFramebufferRenderbuffer(GL.GL_FRAMEBUFFER, attachment, GL.GL_RENDERBUFFER, name)
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


def _textured(source: str) -> str:
    return source.replace("#version 430", "#version 430\n#define TEXTURED", 1)


def _program(vertex: str, fragment: str) -> _Program:
    program = GL.glCreateProgram()
    for kind, source in ((GL.GL_VERTEX_SHADER, vertex), (GL.GL_FRAGMENT_SHADER, fragment)):
        shader = GL.glCreateShader(kind)
        GL.glShaderSource(shader, source)
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


def _textures(model: mujoco.MjModel) -> tuple[dict[int, int], int]:
    """Returns the 2D textures by number, and the sky, 0 without one."""
    flat, sky = {}, 0
    GL.glPixelStorei(GL.GL_UNPACK_ALIGNMENT, 1)
    GL.glActiveTexture(GL.GL_TEXTURE0)
    for i in range(model.ntex):
        width, height, channels = model.tex_width[i], model.tex_height[i], model.tex_nchannel[i]
        start = model.tex_adr[i]
        data = model.tex_data[start : start + width * height * channels]
        cube = model.tex_type[i] != mujoco.mjtTexture.mjTEXTURE_2D
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
