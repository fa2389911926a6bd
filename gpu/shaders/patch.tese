#version 430
layout(quads, SPACING, ccw) in;

#if NESTED
#include "nested.glsl"
#else
#include "bezier.glsl"
#endif
#include "place.glsl"
#if OWNED_SIDES
#include "sides.glsl"
#else
#define drawn_point patch_point
#endif
#if TANGENT_NETS
#include "tangents.glsl"
#elif NORMALS && !NESTED
#include "normal.glsl"
#endif

patch in int tessellated_patch;
patch in ivec4 piece;
patch in ivec2 inner_levels;
patch in ivec4 outer_levels;
uniform mat4 to_clip;
uniform bool in_pieces;

out vec2 parameter;
flat out int patch_number;
#if NORMALS
out vec3 undivided;
#endif

void main() {
    parameter = in_pieces ? place_in_patch(gl_TessCoord.xy, piece, inner_levels, outer_levels) : gl_TessCoord.xy;
    patch_number = tessellated_patch;
    // Undivided and homogeneous: the rasteriser then interpolates the parameters with perspective.
    precise vec4 position = to_clip * drawn_point(tessellated_patch, parameter.x, parameter.y);
    gl_Position = position;
#if NORMALS
    undivided = patch_normal(tessellated_patch, parameter);
#endif
}
