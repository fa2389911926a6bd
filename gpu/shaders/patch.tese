#version 430
layout(quads, SPACING, ccw) in;

#include "bezier.glsl"

patch in int tessellated_patch;
uniform mat4 to_clip;

out vec2 parameter;
flat out int patch_number;

void main() {
    parameter = gl_TessCoord.xy;
    patch_number = tessellated_patch;
    // Undivided and homogeneous: the rasteriser then interpolates the parameters with perspective.
    precise vec4 position = to_clip * patch_point(tessellated_patch, gl_TessCoord.x, gl_TessCoord.y);
    gl_Position = position;
}
