#version 330
// Where this pixel was in the last picture, in pixels: projective, so that it is exact across depth differences.
in vec3 before;
out vec2 place_px;

void main() {
    place_px = before.xy / before.z;
}
