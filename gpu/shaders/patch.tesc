#version 430
layout(vertices = 1) out;

in int vertex_piece[];
patch out int tessellated_patch;
patch out ivec4 piece;
patch out ivec2 inner_levels;
patch out ivec4 outer_levels;

// A record of 12 floats a piece: its patch's number; which piece it is along u and v, of how many; its levels: inner along
// u and v, outer at u=0, v=0, u=1, v=1; a blank.
layout(std430, binding = 1) readonly buffer Pieces {
    float pieces[];
};

void main() {
    int at = 12 * vertex_piece[0];
    tessellated_patch = int(pieces[at]);
    piece = ivec4(pieces[at + 1], pieces[at + 2], pieces[at + 3], pieces[at + 4]);
    for (int i = 0; i < 2; ++i)
        gl_TessLevelInner[i] = pieces[at + 5 + i];
    for (int i = 0; i < 4; ++i)
        gl_TessLevelOuter[i] = pieces[at + 7 + i];
    inner_levels = ivec2(pieces[at + 5], pieces[at + 6]);
    outer_levels = ivec4(pieces[at + 7], pieces[at + 8], pieces[at + 9], pieces[at + 10]);
}
