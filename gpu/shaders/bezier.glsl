// A patch at (u, v), so evaluated that neighbours agree bit for bit along a shared edge, whichever way each of them
// runs along it:
// - u and 1 - u enter in the same way, and coefficients i and d - i are added as a pair, so that reversing an
//   edge exchanges operands of commutative operations and nothing else;
// - at u = 0 or 1 (v likewise) all weights but one are exactly 0, so only the edge's own points count;
// - 'precise' keeps the compiler from fusing or reordering;
// - the twist terms of Gregory patches (gregory.glsl) are left out there, where they are 0.
layout(std430, binding = 0) readonly buffer Control {
    float control[];
};

#define NET_FLOATS ((DEGREE_U + 1) * (DEGREE_V + 1) * COORDINATES)
#define PATCH_FLOATS (NET_FLOATS + 3 * TWISTS)

vec4 control_point(int number, int i, int j) {
    int at = number * PATCH_FLOATS + (i * (DEGREE_V + 1) + j) * COORDINATES;
#if COORDINATES == 4
    return vec4(control[at], control[at + 1], control[at + 2], control[at + 3]);
#else
    return vec4(control[at], control[at + 1], control[at + 2], 1.0);
#endif
}

// side: 4 patch + edge, as edges are numbered: u=0, v=0, u=1, v=1
vec4 side_control(int side, int k) {
    int number = side / 4, edge = side % 4;
    if (edge % 2 == 0)
        return control_point(number, edge == 0 ? 0 : DEGREE_U, k);
    return control_point(number, k, edge == 1 ? 0 : DEGREE_V);
}

#if TWISTS
#include "gregory.glsl"
#endif

float power(float x, int n) {
    precise float result = 1.0;
    for (int k = 0; k < n; ++k)
        result = result * x;
    return result;
}

float binomial(int n, int k) {
    float result = 1.0;
    for (int i = 1; i <= min(k, n - k); ++i)
        result = result * float(n - i + 1) / float(i);
    return result;
}

float bernstein(int degree, int j, float t) {
    precise float factor = power(t, j) * power(1.0 - t, degree - j);
    precise float result = binomial(degree, j) * factor;
    return result;
}

vec4 curve_point(int number, int i, float weights[DEGREE_V + 1]) {
    precise vec4 sum = vec4(0.0);
    for (int j = 0; 2 * j < DEGREE_V; ++j) {
        precise vec4 first = weights[j] * control_point(number, i, j);
        precise vec4 last = weights[DEGREE_V - j] * control_point(number, i, DEGREE_V - j);
        precise vec4 both = first + last;
        sum = sum + both;
    }
    if (DEGREE_V % 2 == 0) {
        precise vec4 middle = weights[DEGREE_V / 2] * control_point(number, i, DEGREE_V / 2);
        sum = sum + middle;
    }
    return sum;
}

vec4 patch_point(int number, float u, float v) {
    float weights[DEGREE_V + 1];
    for (int j = 0; j <= DEGREE_V; ++j)
        weights[j] = bernstein(DEGREE_V, j, v);
    precise vec4 sum = vec4(0.0);
    for (int i = 0; 2 * i < DEGREE_U; ++i) {
        precise vec4 first = bernstein(DEGREE_U, i, u) * curve_point(number, i, weights);
        precise vec4 last = bernstein(DEGREE_U, DEGREE_U - i, u) * curve_point(number, DEGREE_U - i, weights);
        precise vec4 both = first + last;
        sum = sum + both;
    }
    if (DEGREE_U % 2 == 0) {
        precise vec4 middle = bernstein(DEGREE_U, DEGREE_U / 2, u) * curve_point(number, DEGREE_U / 2, weights);
        sum = sum + middle;
    }
#if COORDINATES == 3
    sum.w = 1.0;
#endif
#if TWISTS
    if (u > 0.0 && u < 1.0 && v > 0.0 && v < 1.0)
        sum.xyz += twist_terms(number, u, v);
#endif
    return sum;
}
