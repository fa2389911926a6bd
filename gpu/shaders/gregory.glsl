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

// s t (s - t)/(2 (s + t)) and its derivatives by s and t: 0 at the corner, as they are wherever one goes there
vec3 turning(float s, float t) {
    float both = s + t > 0.0 ? s + t : 1.0, y = t / both;
    return vec3(0.5 * s * y * (s - t), 0.5 * t - t * y * y, 0.5 * s - s * y * (2.0 - y));
}

// derivatives of quad_term by s and t
vec2 quad_slopes(float s, float t) {
    float a = 1.0 - s, b = 1.0 - t;
    vec3 turned = turning(s, t);
    return 9.0 * a * b * (a * b * turned.yz - 2.0 * turned.x * vec2(b, a));
}

// derivatives by u and w of the term of a triangle's corner at u = w = 0
vec2 triangle_slopes(float u, float w) {
    float a = 1.0 - u, b = 1.0 - w;
    vec3 turned = turning(u, a * w);
    vec2 slopes = vec2(turned.y - w * turned.z, a * turned.z);
    return 12.0 * a * b * (a * b * slopes - 2.0 * turned.x * vec2(b, a));
}

// on the sides too, where derivatives across them are not 0
void add_twist_slopes(int number, vec2 at, inout vec3 by_u, inout vec3 by_v) {
    vec2 back = 1.0 - at;
    vec2 slopes[TWISTS];
    slopes[0] = quad_slopes(at.x, at.y);
    slopes[1] = quad_slopes(at.y, back.x).yx * vec2(-1.0, 1.0);
    slopes[2] = -quad_slopes(back.x, back.y);
    slopes[3] = quad_slopes(back.y, at.x).yx * vec2(1.0, -1.0);
#if TWISTS > 4
    slopes[4] = triangle_slopes(at.x, at.y);
    slopes[5] = triangle_slopes(at.x, back.y) * vec2(-1.0, 1.0);
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
