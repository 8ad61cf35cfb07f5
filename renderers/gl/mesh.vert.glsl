#version 330
// A vertex of the depth mesh: where it is in the new picture, and where it was in the last one (times its depth there).
in vec4 at;
in vec4 was;
out vec3 before;

void main() {
    gl_Position = at;
    before = was.xyz;
}
