"""Programs for the graphics driver. Light is blue, green, red with 1.0 for white; alpha is 1/depth,
negative for lamps.

Pictures are drawn upside down, so that the rows come out from the top.
"""

from __future__ import annotations

_HEAD = "#version 330 core\n"

_CAMERA = """
uniform vec3 eye;
uniform mat3 axes;   // rows: optical axes in the block's frame
uniform vec2 lens;   // 2 fx / width, 2 fy / height
uniform vec2 span;   // nearest and farthest depth

vec4 seen(vec3 place) {
    vec3 p = axes * (place - eye);
    float z = (p.z * (span.y + span.x) - 2.0 * span.x * span.y) / (span.y - span.x);
    return vec4(lens.x * p.x, lens.y * p.y, z, p.z);
}
"""

_AIR = """
uniform vec3 fog;
uniform float fog_per_m;

vec3 through_air(vec3 colour, float depth) {
    return mix(fog, clamp(colour, 0.0, 1.0), exp(-fog_per_m * depth));
}
"""

_SUN = """
uniform sampler2DShadow shadow_map;
uniform mat4 sun_view;

float sunlit(vec3 place, float bias) {
    vec3 at = (sun_view * vec4(place, 1.0)).xyz * 0.5 + 0.5;
    if (any(lessThan(at.xy, vec2(0.002))) || any(greaterThan(at.xy, vec2(0.998)))) return 1.0;
    vec2 texel = 1.0 / vec2(textureSize(shadow_map, 0));
    float total = 0.0;
    for (int i = -1; i <= 1; i += 2)
        for (int j = -1; j <= 1; j += 2)
            total += texture(shadow_map, vec3(at.xy + 0.6 * vec2(i, j) * texel, at.z - bias));
    return 0.25 * total;
}
"""

BODY_VERTEX = (
    _HEAD
    + _CAMERA
    + """
in vec3 place;
in vec3 lit;
in vec3 shade;
in vec2 uv;
in float kind;
out vec3 f_place;
out vec3 f_lit;
out vec3 f_shade;
out vec2 f_uv;
flat out int f_kind;
void main() {
    gl_Position = seen(place);
    f_place = place; f_lit = lit / 255.0; f_shade = shade / 255.0; f_uv = uv;
    f_kind = int(kind + 0.5);
}
"""
)

BODY_FRAGMENT = (
    _HEAD
    + _AIR
    + _SUN
    + """
uniform vec3 glass;
uniform vec3 window_lit;
uniform float lit_share;
uniform sampler2D noise;
in vec3 f_place;
in vec3 f_lit;
in vec3 f_shade;
in vec2 f_uv;
flat in int f_kind;
out vec4 picture;

float overlap(float start, float end, float low, float high) {
    return max(0.0, min(end, high) - max(start, low));
}

// As surfaces.window_mix: share of glass, and of lit window.
vec2 windows(vec2 at, vec2 width) {
    float blur = clamp((max(width.x, width.y) - 1.0) / 1.6, 0.0, 1.0);
    vec2 cell = floor(at / vec2(2.9, 3.1));
    vec2 w = clamp(width / vec2(2.9, 3.1), vec2(1e-3), vec2(0.44, 0.4));
    vec2 low = at / vec2(2.9, 3.1) - cell - 0.5 * w;
    vec2 high = low + w;
    float across = overlap(low.x, high.x, 0.22, 0.78), up = overlap(low.y, high.y, 0.3, 0.8);
    float clear = (across - overlap(low.x, high.x, 0.48, 0.52))
                * (up - overlap(low.y, high.y, 0.605, 0.635));
    float pane = (0.4 * across * up + 0.6 * clear) / (w.x * w.y);
    float share = pane + blur * (0.27 - pane);
    uint n = uint(int(cell.x)) * 73856093u ^ uint(int(cell.y)) * 19349663u;
    n = (n ^ (n >> 11)) * 0x5BD1E995u;
    float on = float((n >> 13) & 1023u) < lit_share * 1024.0
             ? 0.6 + 0.4 * float((n >> 25) & 1u) : 0.0;
    on += blur * (lit_share - on);
    return vec2(share, share * on);
}

void main() {
    float depth = 1.0 / gl_FragCoord.w;
    float sun = sunlit(f_place, 0.0012);
    vec3 colour = mix(f_shade, f_lit, sun);
    if (f_kind == 4) {
        vec2 w = windows(f_uv, max(abs(dFdx(f_uv)), abs(dFdy(f_uv))));
        colour = colour * (1.0 - w.x) + glass * (w.x - w.y) + window_lit * w.y;
    } else if (f_kind == 5) {
        colour *= 1.0 + 0.55 * texture(noise, f_uv * (14.0 / 256.0)).r;
    }
    picture = vec4(through_air(colour, depth), (f_kind == 3 ? -1.0 : 1.0) / depth);
}
"""
)

SHADOW_VERTEX = (
    _HEAD
    + """
uniform mat4 sun_view;
in vec3 place;
void main() { gl_Position = sun_view * vec4(place, 1.0); }
"""
)
SHADOW_FRAGMENT = _HEAD + "void main() {}\n"

GROUND_VERTEX = (
    _HEAD
    + _CAMERA
    + """
in vec3 place;
in vec2 along;    // arc length and offset of the reference line
in float face;    // 1: the face of a kerb
out vec3 f_place;
out vec2 f_along;
out float f_face;
void main() {
    gl_Position = seen(place);
    f_place = place; f_along = along; f_face = face;
}
"""
)

GROUND_FRAGMENT = (
    _HEAD
    + _AIR
    + _SUN
    + """
uniform sampler2D sums_a;   // blue, green, red; one row per table
uniform sampler2D sums_b;   // dashes or zebra, grain or stop forward, paving or stop backward
uniform sampler2D noise;
uniform float cells_per_m;
uniform float half_width;
uniform float cell_m;
uniform float crossing;     // beyond 1e8: none
uniform float textured;
uniform vec3 marking;
uniform vec3 kerb_face;
uniform vec3 in_shadow;
uniform vec4 dashes;        // dash, its period, joint, its period
uniform vec3 zebra;         // half length, stop distance, stop width
uniform int boxes;
uniform vec4 box_place[48]; // x, y, cos, sin
uniform vec3 box_size[48];  // front, rear, half width
uniform float reach;
in vec3 f_place;
in vec2 f_along;
in float f_face;
out vec4 picture;

float pattern(float x, float w, float mark, float period) {
    float a = x - 0.5 * w, b = x + 0.5 * w;
    float na = floor(a / period), nb = floor(b / period);
    float fa = na * mark + min(a - na * period, mark);
    float fb = nb * mark + min(b - nb * period, mark);
    return (fb - fa) / w;
}
float band(float x, float w, float start, float end) {
    return max(0.0, min(end, x + 0.5 * w) - max(start, x - 0.5 * w)) / w;
}
vec3 sum_at(sampler2D sums, float cell, int row) {
    int i = int(floor(cell));
    return mix(texelFetch(sums, ivec2(i, row), 0).rgb, texelFetch(sums, ivec2(i + 1, row), 0).rgb,
               cell - float(i));
}
vec3 mean(sampler2D sums, float l, float w, int row) {
    float last = float(textureSize(sums, 0).x - 1);
    float a = clamp((l - 0.5 * w + half_width) * cells_per_m, 0.0, last - 1.0);
    float b = clamp((l + 0.5 * w + half_width) * cells_per_m, 1.0, last - 1e-3);
    return (sum_at(sums, b, row) - sum_at(sums, a, row)) * cells_per_m / max(b - a, 1e-3);
}
float noise_at(vec2 texel) { return textureLod(noise, (texel + 0.5) / 256.0, 0.0).r; }

float grain(float s, float l, float w) {
    float near = 1.0 - w / 0.12, middle = 1.0 - w / 1.5, coarse = 1.0 - w / 12.0, total = 0.0;
    if (coarse > 0.0) total += 0.8 * coarse * noise_at(vec2(0.45 * s, 1.1 * l));
    if (middle > 0.0) total += 0.9 * middle * noise_at(vec2(4.0 * s + 31.0, 4.0 * l));
    if (near > 0.0) total += 1.3 * near * noise_at(vec2(60.0 * s, 60.0 * l));
    return textured * total;
}
float contact() {
    float dark = 0.0;
    for (int n = 0; n < boxes; n++) {
        vec2 d = f_place.xy - box_place[n].xy;
        float c = box_place[n].z, s = box_place[n].w;
        float along = c * d.x + s * d.y, across = abs(c * d.y - s * d.x);
        float outside = max(max(along - box_size[n].x, -box_size[n].y - along), 0.0);
        float gap = length(vec2(outside, max(across - box_size[n].z, 0.0))) / reach;
        if (gap < 1.0) dark = max(dark, (1.0 - gap) * (1.0 - gap));
    }
    return dark;
}

void main() {
    float depth = 1.0 / gl_FragCoord.w;
    float s = f_along.x, l = f_along.y;
    vec2 ds = vec2(dFdx(s), dFdy(s)), dl = vec2(dFdx(l), dFdy(l));
    float ws = max(abs(ds.x) + abs(ds.y), cell_m), wl = max(abs(dl.x) + 0.5 * abs(dl.y), cell_m);
    vec3 colour = mean(sums_a, l, wl, 0);
    vec3 more = mean(sums_b, l, wl, 0);
    float mark = more.x * pattern(s, ws, dashes.x, dashes.y);
    float half_zebra = zebra.x;
    if (abs(s - crossing) < zebra.x + zebra.y + zebra.z + 0.5 * ws) {
        vec3 at = mean(sums_b, l, wl, 1);
        float zone = band(s, ws, crossing - half_zebra - 0.2, crossing + half_zebra + 0.2);
        colour = mix(colour, mean(sums_a, l, wl, 1), zone);
        mark *= 1.0 - zone;
        mark += at.x * band(s, ws, crossing - half_zebra, crossing + half_zebra);
        float stop = crossing - half_zebra - zebra.y;
        mark += at.y * band(s, ws, stop - zebra.z, stop);
        stop = crossing + half_zebra + zebra.y;
        mark += at.z * band(s, ws, stop, stop + zebra.z);
        mark = min(1.0, mark);
    }
    colour = mix(colour, marking, mark);
    colour *= 1.0 - 0.22 * more.z * pattern(s, ws, dashes.z, dashes.w);
    colour += more.y * grain(s, l, max(ws, wl));
    if (f_face > 0.5) colour = kerb_face;
    float sun = sunlit(f_place, 0.0006);
    colour *= (1.0 - 0.6 * contact()) * (vec3(1.0) - (1.0 - sun) * (vec3(1.0) - in_shadow));
    picture = vec4(through_air(colour / 255.0, depth), 0.0);
}
"""
)

SKY_VERTEX = (
    _HEAD
    + """
uniform mat3 rays;   // columns: at the picture's middle, per unit right, per unit down
out vec3 direction;
in vec2 corner;
void main() {
    gl_Position = vec4(corner, 0.0, 1.0);
    direction = rays * vec3(1.0, corner);
}
"""
)

SKY_FRAGMENT = (
    _HEAD
    + _AIR
    + """
uniform sampler2D panorama;
uniform vec3 far_ground;
uniform float eye_height;
in vec3 direction;
out vec4 picture;
void main() {
    if (direction.z < 0.0) {
        picture = vec4(through_air(far_ground, eye_height / max(-direction.z, 1e-5)), 0.0);
        return;
    }
    float slope = direction.z / length(direction.xy);
    float turn = atan(direction.y, direction.x) / 6.283185307 + 0.5;
    vec2 size = vec2(textureSize(panorama, 0));
    vec2 at = vec2(turn, slope / (1.0 + slope)) + vec2(0.0, 0.5) / size;
    picture = vec4(texture(panorama, at).rgb, 0.0);
}
"""
)
