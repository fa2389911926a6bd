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
