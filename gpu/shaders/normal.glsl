// Normals at vertices, undivided: how long they are says how much each counts between them. bezier.glsl comes before.
//
// With tangents p_u, p_v of p = (w x, w y, w z) and x the point, p_u - w_u x = w x_u. So w (p_u - w_u x) x (p_v - w_v x),
// which is w p_u x p_v - w_v p_u x p - w_u p x p_v and a polynomial, is w^3 x_u x x_v. With x taken off first nothing
// large cancels, wherever in the scene the patch lies.
//
// Where the side u = 0 is a point c, its control points are w_0j (c, 1), and p_v - w_v x is 0 there. Over u it is the sum
// of all other rows with B_i/u for B_i, and B_0 times the slope of the side's weights times (c - x)/u, a quotient that is
// the sum of (B_i/u) B_j (w_ij c - p_ij)/w over i > 0. Other sides likewise; weights of polynomial patches have no slope.
#include "collapsed.glsl"

// Of the largest that differences of control points allow: what is below is rounding, and has no direction.
const float ROUNDED = 5e-7;

float size(vec3 x) {
    return max(abs(x.x), max(abs(x.y), abs(x.z)));
}

#if COORDINATES == 4
// side: 4 patch + side, a point; from it to the patch's own point times the weight there, over the distance from the side
vec3 chord(int side, vec2 at) {
    bvec4 own = equal(ivec4(side % 4), ivec4(0, 1, 2, 3));
    vec4 tip = side_control(side, 0);
    vec3 sum = vec3(0.0);
    for (int i = 0; i <= DEGREE_U; ++i)
        for (int j = 0; j <= DEGREE_V; ++j) {
            vec4 other = control_point(side / 4, i, j);
            sum += bernstein_over(DEGREE_U, i, at.x, own[0], own[2]) * bernstein_over(DEGREE_V, j, at.y, own[1], own[3])
                * (other.xyz - other.w * (tip.xyz / tip.w));
        }
    return sum;
}

// of the weights along a side
float weight_slope(int side, float t) {
    int degree = side % 2 == 0 ? DEGREE_V : DEGREE_U;
    float sum = 0.0;
    for (int k = 0; k < degree; ++k)
        sum += float(degree) * bernstein(degree - 1, k, t) * (side_control(side, k + 1).w - side_control(side, k).w);
    return sum;
}

// What control points of sides that are points add to derivatives along them; weights count relative to unit.
void add_point_slopes(int number, vec2 at, bvec4 points, float unit, float weight, inout vec3 by_u, inout vec3 by_v) {
    vec4 share = vec4(bernstein_over(DEGREE_U, 0, at.x, false, points[2]), bernstein_over(DEGREE_V, 0, at.y, false, points[3]),
                      bernstein_over(DEGREE_U, DEGREE_U, at.x, points[0], false),
                      bernstein_over(DEGREE_V, DEGREE_V, at.y, points[1], false));
    for (int k = 0; k < 4; ++k)
        if (points[k]) {
            int side = 4 * number + k;
            vec3 found = -share[k] * (unit * weight_slope(side, k % 2 == 0 ? at.y : at.x)) * (unit * chord(side, at) / weight);
            by_u += k % 2 == 0 ? vec3(0.0) : found;
            by_v += k % 2 == 0 ? found : vec3(0.0);
        }
}
#endif

// Weights count relative to the patch's first, so that their cubes stay in range.
vec3 patch_normal(int number, vec2 at) {
    bvec4 points = collapsed_sides(number);
    float low_u[DEGREE_U + 1], low_v[DEGREE_V + 1], u[DEGREE_U + 1], v[DEGREE_V + 1];
    for (int i = 0; i <= DEGREE_U; ++i) {
        u[i] = bernstein_over(DEGREE_U, i, at.x, points[0], points[2]);
        low_u[i] = i < DEGREE_U ? float(DEGREE_U) * bernstein(DEGREE_U - 1, i, at.x) : 0.0;
    }
    for (int j = 0; j <= DEGREE_V; ++j) {
        v[j] = bernstein_over(DEGREE_V, j, at.y, points[1], points[3]);
        low_v[j] = j < DEGREE_V ? float(DEGREE_V) * bernstein(DEGREE_V - 1, j, at.y) : 0.0;
    }
#if COORDINATES == 4
    vec4 point = patch_point(number, at.x, at.y);
    float unit = 1.0 / control_point(number, 0, 0).w, weight = unit * point.w;
    point /= point.w;
#else
    vec4 point = vec4(0.0);
    float unit = 1.0, weight = 1.0;
#endif
    vec3 by_u = vec3(0.0), by_v = vec3(0.0);
    float most_u = 0.0, most_v = 0.0;
    for (int i = 0; i <= DEGREE_U; ++i)
        for (int j = 0; j <= DEGREE_V; ++j) {
            vec4 own = control_point(number, i, j);
            vec4 across = unit * (control_point(number, min(i + 1, DEGREE_U), j) - own);
            vec4 along = unit * (control_point(number, i, min(j + 1, DEGREE_V)) - own);
            across.xyz -= across.w * point.xyz;
            along.xyz -= along.w * point.xyz;
            by_u += low_u[i] * v[j] * across.xyz;
            by_v += u[i] * low_v[j] * along.xyz;
            most_u = max(most_u, float(DEGREE_U) * size(across.xyz));
            most_v = max(most_v, float(DEGREE_V) * size(along.xyz));
        }
#if COORDINATES == 4
    add_point_slopes(number, at, points, unit, weight, by_u, by_v);
#endif
#if TWISTS
    add_twist_slopes(number, at, mix(vec4(at, 1.0 - at), vec4(1.0), points), by_u, by_v);
#endif
    vec3 normal = weight * cross(by_u, by_v);
    return size(normal) <= ROUNDED * weight * most_u * most_v ? vec3(0.0) : normal;
}
