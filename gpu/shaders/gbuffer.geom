#version 430
// Triangles as they are, and with them what the fragment stage needs of a whole triangle to tell where a point is drawn.
layout(triangles) in;
layout(triangle_strip, max_vertices = 3) out;

in vec2 parameter[];
flat in int patch_number[];
out vec2 place;
flat out vec4 corner_clip[3];
// u and v of the three corners, one after the other; the patch number, exact below 2^24, and with WIRE the area, else a blank
flat out vec4 first_corners;
flat out vec4 last_corner;
#if NORMALS
in vec3 undivided[];
out vec3 normal;
#endif
#if WIRE
#include "sides_seen.glsl"
uniform vec2 half_picture;  // pixels

// Square pixels of what lies beyond the near plane.
float area_seen() {
    vec2 corner[4];
    int count = 0;
    for (int k = 0; k < 3; ++k) {
        vec4 own = gl_in[k].gl_Position, next = gl_in[(k + 1) % 3].gl_Position;
        if (beyond_near(own))
            corner[count++] = own.xy / own.w * half_picture;
        if (beyond_near(own) != beyond_near(next)) {
            vec4 cut = beyond_near(own) ? at_near(own, next) : at_near(next, own);
            corner[count++] = cut.xy / cut.w * half_picture;
        }
    }
    float twice = 0.0;
    for (int k = 2; k < count; ++k) {
        vec2 a = corner[k - 1] - corner[0], b = corner[k] - corner[0];
        twice += a.x * b.y - a.y * b.x;
    }
    return 0.5 * abs(twice);
}
#else
#define area_seen() 0.0
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
    last_corner = vec4(parameter[2], float(patch_number[0]), area_seen());
    EmitVertex();
}
