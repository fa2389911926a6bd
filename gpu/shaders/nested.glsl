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

mat3 symmetric(float q[9]) {
    return mat3(q[0], q[1], q[2], q[1], q[3], q[4], q[2], q[4], q[5]);
}

// Q mu = h by Q = L D L^T: the inverse by cofactors loses twice as many digits where Gaussians are long or flat.
vec3 solved(float q[9]) {
    float l10 = q[1] / q[0], l20 = q[2] / q[0];
    float d1 = q[3] - l10 * q[1];
    float rest = q[4] - l20 * q[1];
    float l21 = rest / d1;
    float d2 = q[5] - l20 * q[2] - l21 * rest;
    float y1 = q[7] - l10 * q[6];
    float y2 = q[8] - l20 * q[6] - l21 * y1;
    float z = y2 / d2;
    float y = y1 / d1 - l21 * z;
    return vec3(q[6] / q[0] - l10 * y - l20 * z, y, z);
}

// A place of a net, and how often larger than the square's its parameters are.
struct Place {
    int net;
    vec2 at;
    float scale;
};

Place place_in_nets(int number, vec2 at) {
    Square square = squares[number];
    int net = square.first;
    float scale = 1.0;
    if (square.nested != 0) {
        bool found = false;
        for (int level = 0; level < LEVELS && !found; ++level) {
            at *= 2.0;
            scale *= 2.0;
            ivec2 beyond = ivec2(greaterThanEqual(at, vec2(1.0)));
            found = beyond.x + beyond.y > 0;
            net += found ? beyond.x + 2 * beyond.y - 1 : 3;
            at -= vec2(beyond);
        }
    }
    return Place(net, at, scale);
}

vec4 patch_point(int number, float u, float v) {
    Place place = place_in_nets(number, vec2(u, v));
    int net = place.net;
    vec2 at = place.at;
    vec4 along_u = cubic(at.x), along_v = cubic(at.y);
    float q[9];
    for (int k = 0; k < 9; ++k)
        q[k] = 0.0;
    for (int i = 0; i < 4; ++i)
        for (int j = 0; j < 4; ++j)
            for (int k = 0; k < 9; ++k)
                q[k] += along_u[i] * along_v[j] * nets[(16 * net + 4 * i + j) * 9 + k];
    return vec4(solved(q), 1.0);
}

#if NORMALS
// of differences of the points
vec4 cubic_slopes(float t) {
    float s = 1.0 - t;
    return vec4(s * s, 1.0 + 2.0 * s * t, t * t, 0.0) / 2.0;
}

// From Q mu = h follows Q mu_u = h_u - Q_u mu. Of two such vectors a and b Q^-1 a x Q^-1 b is Q (a x b)/det Q: nothing
// else has to be solved. det Q, which is positive, is left in it, as weights are (normal.glsl).
vec3 patch_normal(int number, vec2 at) {
    Place place = place_in_nets(number, at);
    vec4 u = cubic(place.at.x), v = cubic(place.at.y);
    vec4 low_u = cubic_slopes(place.at.x), low_v = cubic_slopes(place.at.y);
    float q[9], by_u[9], by_v[9];
    for (int k = 0; k < 9; ++k)
        q[k] = by_u[k] = by_v[k] = 0.0;
    for (int i = 0; i < 4; ++i)
        for (int j = 0; j < 4; ++j)
            for (int k = 0; k < 9; ++k) {
                float own = nets[(16 * place.net + 4 * i + j) * 9 + k];
                q[k] += u[i] * v[j] * own;
                by_u[k] += low_u[i] * v[j] * (nets[(16 * place.net + 4 * min(i + 1, 3) + j) * 9 + k] - own);
                by_v[k] += u[i] * low_v[j] * (nets[(16 * place.net + 4 * i + min(j + 1, 3)) * 9 + k] - own);
            }
    vec3 mu = solved(q);
    vec3 a = vec3(by_u[6], by_u[7], by_u[8]) - symmetric(by_u) * mu;
    vec3 b = vec3(by_v[6], by_v[7], by_v[8]) - symmetric(by_v) * mu;
    return place.scale * place.scale * (symmetric(q) * cross(a, b));
}
#endif
