// Normals of tangent patches at vertices, undivided: of T_u, of degrees (DEGREE_U - 1, DEGREE_V), and T_v, of degrees
// (DEGREE_U, DEGREE_V - 1). bezier.glsl comes before.
#include "collapsed.glsl"

layout(std430, binding = 7) readonly buffer TangentNets {
    float tangent_nets[]; // of a patch first T_u, then T_v
};

#define OF_U (DEGREE_U * (DEGREE_V + 1))
#define OF_V ((DEGREE_U + 1) * DEGREE_V)

vec3 tangent(int number, int k) {
    int at = 3 * ((OF_U + OF_V) * number + k);
    return vec3(tangent_nets[at], tangent_nets[at + 1], tangent_nets[at + 2]);
}

vec3 patch_normal(int number, vec2 at) {
    bvec4 points = collapsed_sides(number);
    vec3 by_u = vec3(0.0), by_v = vec3(0.0);
    for (int i = 0; i < DEGREE_U; ++i)
        for (int j = 0; j <= DEGREE_V; ++j)
            by_u += bernstein(DEGREE_U - 1, i, at.x) * bernstein_over(DEGREE_V, j, at.y, points[1], points[3])
                * tangent(number, i * (DEGREE_V + 1) + j);
    for (int i = 0; i <= DEGREE_U; ++i)
        for (int j = 0; j < DEGREE_V; ++j)
            by_v += bernstein_over(DEGREE_U, i, at.x, points[0], points[2]) * bernstein(DEGREE_V - 1, j, at.y)
                * tangent(number, OF_U + i * DEGREE_V + j);
    return cross(by_u, by_v);
}
