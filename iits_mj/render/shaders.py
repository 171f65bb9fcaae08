"""The programs that run on the graphics card, or on the processor in its place, in GLSL.

Positions are relative to the eye, in the axes of the map. Switches: TEXTURED, with a texture; MIST,
with fog or rain in the air; BEAMS, with head lamps that light the scene; WET, a textured road that
mirrors sky and lamps. On a processor both sides of a condition take time: variants have switches.
"""

from __future__ import annotations

BEAMS_MAX, GLINTS_MAX = 6, 16

# The light of each vertex, as OpenGL's fixed functions compute it: the camera's lamp, the sky's
# light and what a material emits in `base`, the sun in `sunlit`, which shadows remove. The sky's
# light comes from above and, weaker, from the ground. `inside` is 1 in the light of a tunnel's
# lamps, and 2 for surfaces that have it in their texture.
VERTEX = """#version 430
layout(location = 0) in vec3 position;
layout(location = 1) in vec3 normal;
layout(location = 2) in vec2 coordinates;
layout(location = 3) in vec4 row0;
layout(location = 4) in vec4 row1;
layout(location = 5) in vec4 row2;
layout(location = 6) in vec4 rgba;
layout(location = 7) in vec3 surface;  // emission, specular, shininess
layout(location = 8) in vec2 place_of;  // inside, answer to head lamps
uniform mat4 view;
uniform mat4 light;
uniform vec3 forward;
uniform vec3 ambient, ground, head_diffuse, head_specular;
uniform vec3 to_sun, sun_diffuse, sun_specular;
uniform vec3 tunnel_above, tunnel_below;
uniform float limit;
out vec4 base;
out vec3 sunlit;
out vec3 place;
#ifdef TEXTURED
uniform float meadow;
out vec2 at;
#endif
#if defined(BEAMS) || defined(WET)
out vec3 away;
#endif
#ifdef BEAMS
out vec3 answer, facing;
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
  float inside = place_of.x, above = 0.5 + 0.5 * n.z;
  vec3 all_around = mix(ground, ambient, above);
  all_around = mix(all_around, mix(tunnel_below, tunnel_above, above), min(inside, 1.0));
  vec3 own = (surface.x + all_around * clamp(2.0 - inside, 0.0, 1.0)) * rgba.rgb;
  own += lit(n, -forward, to_eye, head_diffuse, head_specular);
  base = vec4(min(own, limit), rgba.a);
  vec3 direct = lit(n, to_sun, to_eye, sun_diffuse, sun_specular);
  sunlit = min(direct, limit) * max(1.0 - inside, 0.0);
#ifdef TEXTURED
  at = coordinates;
  if (meadow > 0.0) {
    // Broad patches of other plants, which break the repetition of the texture.
    vec2 m = coordinates * meadow;
    float patch_of = sin(0.61 * m.x + 1.3 * sin(0.37 * m.y)) * sin(0.53 * m.y + sin(0.29 * m.x));
    float dry = sin(0.23 * m.x - 0.31 * m.y + 2.0 * sin(0.11 * m.y + 0.7));
    vec3 tint = vec3(1.0 + 0.15 * patch_of + 0.13 * dry, 1.0 + 0.11 * patch_of, 1.0 - 0.10 * dry);
    base.rgb *= tint;
    sunlit *= tint;
  }
#endif
#if defined(BEAMS) || defined(WET)
  away = world.xyz;
#endif
#ifdef BEAMS
  answer = rgba.rgb * place_of.y * max(1.0 - 0.7 * inside, 0.0);
  facing = n;
#endif
}
"""
FRAGMENT = """#version 430
in vec4 base;
in vec3 sunlit;
in vec3 place;
uniform vec3 fog;
uniform vec2 fog_range;
uniform vec3 tone;  // where the shoulder begins, its width, its curvature
uniform bool shadows;
uniform sampler2DShadow shadow_map;
#ifdef MIST
uniform float mist;  // extinction of the air [1/m]
#endif
#ifdef TEXTURED
in vec2 at;
uniform sampler2D pattern;
#endif
#if defined(BEAMS) || defined(WET)
in vec3 away;
#endif
#ifdef BEAMS
in vec3 answer, facing;
uniform int beams;
uniform vec3 beam_at[BEAMS_MAX], beam_to[BEAMS_MAX], beam_color[BEAMS_MAX];

// Low beams: a wide spot below a cut-off, on average half of the light comes back.
vec3 illumination(vec3 n) {
  vec3 sum = vec3(0.0);
  for (int i = 0; i < beams; i++) {
    vec3 d = away - beam_at[i];
    float along = dot(d, beam_to[i]);
    if (along < 0.4 || along > 160.0) continue;
    vec3 aside = (d - along * beam_to[i]) / along;
    float cut = mix(0.04, 1.0, smoothstep(0.02, -0.02, aside.z));
    float spread = exp(-6.0 * dot(aside.xy, aside.xy) - 12.0 * aside.z * aside.z);
    float level = cut * spread / (0.55 + 0.0009 * along * along);
    sum += level * beam_color[i] * (0.35 + 0.65 * max(dot(n, -normalize(d)), 0.0));
  }
  return sum;
}
#endif
#ifdef WET
uniform float wet;
uniform samplerCube mirrored;
uniform int glints;
uniform vec3 glint_at[GLINTS_MAX], glint_color[GLINTS_MAX];

// What a rough film of water on a level road shows: the sky, and lamps as upright streaks.
vec3 reflection(float film) {
  vec3 v = normalize(away);
  float graze = 1.0 - abs(v.z);
  float share = film * (0.04 + 0.60 * pow(graze, 6.0));
  vec3 sky = textureLod(mirrored, vec3(v.x, max(-v.z, 0.04), -v.y), 3.0).rgb;
  vec3 sum = sky * share;
  vec2 flat_v = normalize(v.xy);
  float rise = v.z / max(length(v.xy), 1e-3);
  for (int i = 0; i < glints; i++) {
    vec3 image = glint_at[i];
    image.z = 2.0 * away.z - image.z;
    float reach = length(image.xy);
    if (reach < length(away.xy) || image.z > away.z) continue;
    vec2 aim = image.xy / reach;
    float aside = (flat_v.x * aim.y - flat_v.y * aim.x) / (0.006 + 0.16 / reach);
    float up = (rise - image.z / reach) / (0.012 + 0.9 / reach);
    float near = dot(flat_v, aim) > 0.0 ? exp(-aside * aside - up * up) : 0.0;
    sum += film * near * glint_color[i];
  }
  return sum;
}
#endif
out vec4 color;
void main() {
  float sun = shadows ? texture(shadow_map, place) : 1.0;
  float distance = 1.0 / gl_FragCoord.w;
  vec3 own = base.rgb, direct = sunlit;
#ifdef TEXTURED
  vec3 texel = texture(pattern, at).rgb;
  own *= texel;
  direct *= texel;
#endif
  vec3 shown = own + sun * direct;
#ifdef BEAMS
  vec3 back = answer;
#ifdef TEXTURED
  back *= texel;
#endif
  shown += back * illumination(facing);
#endif
#ifdef WET
  float film = wet * clamp(3.2 - 8.0 * texel.g, 0.35, 1.0);
  shown = shown * (1.0 - 0.62 * film) + reflection(film);
#endif
  // Bright colors approach white without reaching it.
  vec3 over = clamp(shown - tone.x, 0.0, tone.y);
  shown = min(shown, tone.x + tone.y) - over * over * tone.z;
  float clear = clamp((fog_range.y - distance) / (fog_range.y - fog_range.x), 0.0, 1.0);
#ifdef MIST
  clear *= exp(-mist * distance);
#endif
  color = vec4(mix(fog, shown, clear), base.a);
}
"""
SHADOW = """#version 430
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
SHADOW_FRAGMENT = """#version 430
void main() {}
"""
# A triangle that covers the picture, at infinite distance.
SKY = """#version 430
uniform mat3 axes;
out vec3 direction;
void main() {
  vec2 corner = vec2(gl_VertexID % 2, gl_VertexID / 2) * 4.0 - 1.0;
  direction = axes * vec3(corner, 1.0);
  gl_Position = vec4(corner, 0.0, 1.0);
}
"""
SKY_FRAGMENT = """#version 430
in vec3 direction;
uniform samplerCube sky;
uniform vec3 fog;
uniform vec2 fog_range;
uniform float radius, mist;
out vec4 color;
void main() {
  // MuJoCo draws the sky on a cylinder in the fog.
  float depth = radius / max(length(direction.xz), abs(direction.y));
  float clear = clamp((fog_range.y - depth) / (fog_range.y - fog_range.x), 0.0, 1.0);
  // A layer of mist, 400 m thick in mist of 1/100 m: thin above, endless at the horizon.
  if (mist > 0.0) clear *= exp(-mist * 60.0 / max(normalize(direction).y, 0.01));
  color = vec4(mix(fog, texture(sky, direction).rgb, clear), 1.0);
}
"""
# Soft spots: glow of lamps, spray, drops, and the shade below vehicles.
SPOT = """#version 430
layout(location = 0) in vec3 center;
layout(location = 1) in vec3 half_u;
layout(location = 2) in vec3 half_v;
layout(location = 3) in vec4 tint;  // color, opacity
layout(location = 4) in float box;
uniform mat4 view;
uniform float mist;
out vec2 corner;
flat out vec4 spot;
flat out float boxed;
void main() {
  corner = vec2(gl_VertexID % 2, gl_VertexID / 2) * 2.0 - 1.0;
  gl_Position = view * vec4(center + corner.x * half_u + corner.y * half_v, 1.0);
  spot = tint * exp(-mist * length(center));
  boxed = box;
}
"""
SPOT_FRAGMENT = """#version 430
in vec2 corner;
flat in vec4 spot;
flat in float boxed;
out vec4 color;
void main() {
  vec2 square = corner * corner;
  float soft = max(1.0 - square.x - square.y, 0.0);
  vec2 edge = 1.0 - square * square;
  color = spot * mix(soft * soft * soft, edge.x * edge.y, boxed);
}
"""
# Smooths steps along edges: blends along the direction in which brightness changes least.
SMOOTH = """#version 430
void main() {
  gl_Position = vec4(vec2(gl_VertexID % 2, gl_VertexID / 2) * 4.0 - 1.0, 0.0, 1.0);
}
"""
SMOOTH_FRAGMENT = """#version 430
uniform sampler2D picture;
uniform vec2 pixel;
out vec4 color;
void main() {
  // Green stands for the brightness.
  ivec2 here = ivec2(gl_FragCoord.xy);
  vec3 middle = texelFetch(picture, here, 0).rgb;
  float a = texelFetchOffset(picture, here, 0, ivec2(-1, -1)).g;
  float b = texelFetchOffset(picture, here, 0, ivec2(1, -1)).g;
  float d = texelFetchOffset(picture, here, 0, ivec2(-1, 1)).g;
  float e = texelFetchOffset(picture, here, 0, ivec2(1, 1)).g;
  float low = min(middle.g, min(min(a, b), min(d, e)));
  float high = max(middle.g, max(max(a, b), max(d, e)));
  vec2 along = vec2(d + e - a - b, a + d - b - e);
  float least = min(abs(along.x), abs(along.y)) + max(0.03 * (a + b + d + e), 0.008);
  along = clamp(along / least, -8.0, 8.0) * pixel;
  vec2 at = gl_FragCoord.xy * pixel;
  vec3 mean = texture(picture, at - 0.3 * along).rgb + texture(picture, at + 0.3 * along).rgb;
  mean *= 0.5;
  color = vec4(high - low < max(0.03, 0.10 * high) ? middle : mean, 1.0);
}
"""
