#version 430
layout(triangles) in;
layout(points, max_vertices = 1) out;

in vec2 parameter[];
flat in int patch_number[];
#if NORMALS
in vec3 undivided[];
#endif

// A record of 20 floats a triangle: for each of its vertices u, v, clip-space X, Y, Z, W; then the patch number and a blank.
// With normals nine more, three of each vertex.
#define RECORD (20u + 9u * uint(NORMALS))
layout(std430, binding = 2) buffer Counter {
    uint count;
};
layout(std430, binding = 3) writeonly buffer Records {
    float records[];
};

void main() {
    uint at = atomicAdd(count, 1u) * RECORD;
    if (at + RECORD > uint(records.length()))
        return;
    for (int k = 0; k < 3; ++k) {
        records[at + 6u * k] = parameter[k].x;
        records[at + 6u * k + 1u] = parameter[k].y;
        for (int c = 0; c < 4; ++c)
            records[at + 6u * k + 2u + c] = gl_in[k].gl_Position[c];
    }
    records[at + 18u] = float(patch_number[0]);
    records[at + 19u] = 0.0;
#if NORMALS
    for (uint k = 0u; k < 9u; ++k)
        records[at + 20u + k] = undivided[k / 3u][k % 3u];
#endif
}
