#version 430
// One vertex a patch: it carries the patch's number and nothing else. gl_PrimitiveID restarts with every draw.
in int number;
out int vertex_patch;

void main() {
    vertex_patch = number;
}
