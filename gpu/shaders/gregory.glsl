// The twist terms of Gregory patches (slefejax.geometry.gregory), inside of the domain.
vec3 twist(int number, int slot) {
    int at = number * PATCH_FLOATS + NET_FLOATS + 3 * slot;
    return vec3(control[at], control[at + 1], control[at + 2]);
}

// s, t from 0 at the corner
float quad_term(float s, float t) {
    float rest = (1.0 - s) * (1.0 - t);
    return 4.5 * s * t * rest * rest * (s - t) / (s + t);
}

// of the corner where a = 1
float triangle_term(float a, float b, float c) {
    return 6.0 * a * a * b * c * (c - b) / (b + c);
}

// Derivatives by s and t of s t (s - t)/(2 (s + t)), over t and over s: 0 at the corner, where they have no limit; then t
// over s + t.
vec3 turning(float s, float t) {
    if (s + t == 0.0)
        return vec3(0.0);
    float y = t / (s + t);
    return vec3(0.5 - y * y, 0.5 - y * (2.0 - y), y);
}

// Slopes below have s, t, 1 - s and 1 - t as factors: left has them in this order, 1 where one is divided out.

// derivatives of quad_term by s and t
vec2 quad_slopes(float s, float t, vec4 left) {
    float a = 1.0 - s, b = 1.0 - t;
    vec3 turned = turning(s, t);
    return 9.0 * a * b * left.yx * left.wz * (vec2(a, b) * turned.xy - vec2(1.0 - turned.z, turned.z) * (s - t));
}

// derivatives by u and w of the term of a triangle's corner at u = w = 0
vec2 triangle_slopes(float u, float w, vec4 left) {
    float a = 1.0 - u, b = 1.0 - w;
    vec3 turned = turning(u, a * w);
    float by_u = a * (a * turned.x - u * turned.y - (1.0 - turned.z) * (u - a * w));
    float by_w = a * b * turned.y - turned.z * (u - a * w);
    return 12.0 * a * b * left.yx * left.wz * vec2(by_u, by_w);
}

// On the sides too, where derivatives across them are not 0. left: at and 1 - at, 1 where slopes are divided by it.
void add_twist_slopes(int number, vec2 at, vec4 left, inout vec3 by_u, inout vec3 by_v) {
    vec2 back = 1.0 - at;
    vec2 slopes[TWISTS];
    slopes[0] = quad_slopes(at.x, at.y, left);
    slopes[1] = quad_slopes(at.y, back.x, left.yzwx).yx * vec2(-1.0, 1.0);
    slopes[2] = -quad_slopes(back.x, back.y, left.zwxy);
    slopes[3] = quad_slopes(back.y, at.x, left.wxyz).yx * vec2(1.0, -1.0);
#if TWISTS > 4
    slopes[4] = triangle_slopes(at.x, at.y, left);
    slopes[5] = triangle_slopes(at.x, back.y, left.xwzy) * vec2(-1.0, 1.0);
#endif
    for (int k = 0; k < TWISTS; ++k) {
        by_u += slopes[k].x * twist(number, k);
        by_v += slopes[k].y * twist(number, k);
    }
}

vec3 twist_terms(int number, float u, float v) {
    vec3 sum = vec3(0.0);
    vec3 own[TWISTS];
    bool any_of_quad = false;
    for (int k = 0; k < TWISTS; ++k) {
        own[k] = twist(number, k);
        any_of_quad = any_of_quad || k < 4 && own[k] != vec3(0.0);
    }
    if (any_of_quad)
        sum = own[0] * quad_term(u, v) + own[1] * quad_term(v, 1.0 - u) + own[2] * quad_term(1.0 - u, 1.0 - v)
            + own[3] * quad_term(1.0 - v, u);
#if TWISTS > 4
    float a = (1.0 - u) * (1.0 - v), b = (1.0 - u) * v;
    sum += own[4] * triangle_term(a, b, u) - own[5] * triangle_term(b, a, u);
#endif
    return sum;
}
