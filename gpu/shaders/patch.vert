#version 430
// One vertex a piece of a patch: it carries the piece's number and nothing else. gl_PrimitiveID restarts with every draw.
in int number;
out int vertex_piece;

void main() {
    vertex_piece = number;
}
