#version 330
// What a sample adds to a pixel: its colour by the pixel's own space-time Gaussian, and one to the count of samples.
flat in vec4 color_age;
flat in vec4 place;
flat in vec2 moved;

uniform sampler2D filters; // 1 / e_x^2, 1 / e_y^2, 1 / e_t^2
uniform sampler2D nearest; // least depth of the samples in the pixel
uniform sampler2D nearest_age; // how old the newest of that depth is, and -1 where one of them is a mover's
uniform float tail;
uniform float depth_tolerance;
uniform int pass_number;

layout(location = 0) out vec4 weighted;
layout(location = 1) out vec2 covered;

void main() {
    ivec2 pixel = ivec2(gl_FragCoord.xy);
    float age = color_age.w;
    weighted = vec4(0.0);
    covered = vec2(0.0);
    if (pass_number == 1) {
        weighted = vec4(place.w);
        return;
    }
    float least = depth_tolerance > 0.0 ? texelFetch(nearest, pixel, 0).x : 0.0;
    if (pass_number == 2) {
        if (place.w > least) discard;
        weighted = vec4(age, -moved.y, 0.0, 0.0);
        return;
    }
    if (depth_tolerance > 0.0 && place.w > least * depth_tolerance) {
        vec2 other = texelFetch(nearest_age, pixel, 0).xy;
        if (age > other.x && (moved.x > 0.5 || other.y < -0.5)) discard;
    }
    vec2 off = gl_FragCoord.xy - place.xy;
    float q = dot(vec3(off * off, age * age), texelFetch(filters, pixel, 0).xyz);
    float weight = tail / ((1.0 + q) * (1.0 + q));
    if (q < 4.0) weight += exp(-4.5 * q);
    weighted = weight * vec4(color_age.xyz, 1.0);
    covered = vec2(1.0, 2.0 * place.z);
}
