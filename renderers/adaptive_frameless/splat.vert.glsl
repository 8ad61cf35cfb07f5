#version 330
// One corner of a sample's splat: the stored hit point is moved with its mover, seen by the camera, and made a rectangle
// of whole pixels, so that coverage does not hang on the rasteriser's sub-pixel steps.
in vec4 color_x; // red, green, blue; x of the hit point
in vec4 yz_px; // y, z of the hit point; where the picture had it
in int mover;
in float time_s;

uniform sampler2D movers; // a row a mover: three rows of its pose, then whether it exists
uniform sampler2D sizes; // splat size (px) that each pixel asks for
uniform vec4 camera[3];
uniform vec3 lens; // centre x, y (px), a pixel's size one unit ahead
uniform vec2 size_px;
uniform float now_s;
uniform int reproject;
uniform int pass_number; // 0: splats; 1, 2: only the pixel in which the sample lies

flat out vec4 color_age;
flat out vec4 place; // x, y (px), half the splat's size, depth
flat out vec2 moved; // how far in the picture since it was made (px); 1 for a mover's

void main() {
    gl_Position = vec4(2.0, 2.0, 2.0, 1.0);
    vec3 point = vec3(color_x.w, yz_px.xy);
    if (mover > 0) {
        if (texelFetch(movers, ivec2(3, mover), 0).x < 0.5) return;
        vec4 local = vec4(point, 1.0);
        for (int k = 0; k < 3; k++) point[k] = dot(texelFetch(movers, ivec2(k, mover), 0), local);
    }
    vec3 away = point - vec3(camera[0].w, camera[1].w, camera[2].w);
    vec3 own = away.x * camera[0].xyz + away.y * camera[1].xyz + away.z * camera[2].xyz;
    float depth = -own.z;
    if (depth <= 1e-9) return;
    vec2 at = lens.xy + vec2(own.x, -own.y) / (depth * lens.z);
    if (reproject == 0) at = yz_px.zw;
    moved = vec2(abs(at.x - yz_px.z) + abs(at.y - yz_px.w), mover > 0 ? 1.0 : 0.0);
    if (any(lessThan(at, vec2(-1.0))) || any(greaterThanEqual(at, size_px + 1.0))) return;

    vec2 first, last;
    float half_px = 0.5;
    if (pass_number == 0) {
        half_px = 0.5 * texelFetch(sizes, ivec2(clamp(at, vec2(0.0), size_px - 1.0)), 0).x;
        first = max(ceil(at - half_px - 0.5), vec2(0.0));
        last = min(floor(at + half_px - 0.5), size_px - 1.0);
    } else {
        first = last = floor(at);
    }
    color_age = vec4(color_x.xyz, max(now_s - time_s, 0.0));
    place = vec4(at, half_px, depth);
    if (any(greaterThan(first, last))) return;
    vec2 corner = mix(first, last + 1.0, vec2(gl_VertexID & 1, gl_VertexID >> 1));
    gl_Position = vec4(corner / size_px * 2.0 - 1.0, 0.0, 1.0);
}
