#version 430
layout(vertices = 1) out;

in int vertex_patch[];
patch out int tessellated_patch;

// Six levels a patch: inner along u and v, outer at u=0, v=0, u=1, v=1.
layout(std430, binding = 1) readonly buffer Levels {
    float levels[];
};

void main() {
    int number = vertex_patch[0];
    tessellated_patch = number;
    for (int i = 0; i < 2; ++i)
        gl_TessLevelInner[i] = levels[6 * number + i];
    for (int i = 0; i < 4; ++i)
        gl_TessLevelOuter[i] = levels[6 * number + 2 + i];
}
