// Gaussian products as they were published: cubic B-splines of the nine numbers (Q, h), solved at every vertex, in single
// precision. A square is one net, or nets that are nested around its corner at (0, 0),
// three a level, and a last one (slefejax.geometry.nested).
layout(std430, binding = 0) readonly buffer Nets {
    float nets[];
};
struct Square {
    int first; // net
    int nested; // whether there are several
};
layout(std430, binding = 5) readonly buffer Squares {
    Square squares[];
};

vec4 cubic(float t) {
    float s = 1.0 - t;
    return vec4(s * s * s, 3.0 * t * t * (t - 2.0) + 4.0, 3.0 * s * s * (s - 2.0) + 4.0, t * t * t) / 6.0;
}

vec4 patch_point(int number, float u, float v) {
    Square square = squares[number];
    int net = square.first;
    vec2 at = vec2(u, v);
    if (square.nested != 0) {
        bool found = false;
        for (int level = 0; level < LEVELS && !found; ++level) {
            at *= 2.0;
            ivec2 beyond = ivec2(greaterThanEqual(at, vec2(1.0)));
            found = beyond.x + beyond.y > 0;
            net += found ? beyond.x + 2 * beyond.y - 1 : 3;
            at -= vec2(beyond);
        }
    }
    vec4 along_u = cubic(at.x), along_v = cubic(at.y);
    float q[9];
    for (int k = 0; k < 9; ++k)
        q[k] = 0.0;
    for (int i = 0; i < 4; ++i)
        for (int j = 0; j < 4; ++j)
            for (int k = 0; k < 9; ++k)
                q[k] += along_u[i] * along_v[j] * nets[(16 * net + 4 * i + j) * 9 + k];
    mat3 precision_ = mat3(q[0], q[1], q[2], q[1], q[3], q[4], q[2], q[4], q[5]);
    return vec4(inverse(precision_) * vec3(q[6], q[7], q[8]), 1.0);
}
