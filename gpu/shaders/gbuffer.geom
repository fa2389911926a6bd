#version 430
// Triangles as they are, and with them what the fragment stage needs of a whole triangle to tell where a point is drawn.
layout(triangles) in;
layout(triangle_strip, max_vertices = 3) out;

in vec2 parameter[];
flat in int patch_number[];
out vec2 place;
flat out vec4 corner_clip[3];
// u and v of the three corners, one after the other; the patch number, exact below 2^24, and a blank
flat out vec4 first_corners;
flat out vec4 last_corner;
#if NORMALS
in vec3 undivided[];
out vec3 normal;
#endif

void main() {
    for (int k = 0; k < 2; ++k) {
        place = parameter[k];
#if NORMALS
        normal = undivided[k];
#endif
        gl_Position = gl_in[k].gl_Position;
        EmitVertex();
    }
    place = parameter[2];
#if NORMALS
    normal = undivided[2];
#endif
    gl_Position = gl_in[2].gl_Position;
    // what is flat is taken from the last vertex
    for (int k = 0; k < 3; ++k)
        corner_clip[k] = gl_in[k].gl_Position;
    first_corners = vec4(parameter[0], parameter[1]);
    last_corner = vec4(parameter[2], float(patch_number[0]), 0.0);
    EmitVertex();
}
