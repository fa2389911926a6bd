// Normals at vertices, undivided: how long they are says how much each counts between them. bezier.glsl comes before.
//
// With tangents p_u, p_v of p = (w x, w y, w z) and x the point, p_u - w_u x = w x_u. So w (p_u - w_u x) x (p_v - w_v x),
// which is w p_u x p_v - w_v p_u x p - w_u p x p_v and a polynomial, is w^3 x_u x x_v. With x taken off first nothing
// large cancels, wherever in the scene the patch lies.

// Of the largest that a derivative's control points allow: where less is left, it is 0 but for rounding.
const float FLAT = 1e-5;
// From a side along which derivatives are 0 so much of the domain further in there is a normal: as good as their limit.
const float NEAR = 1.0 / 1024.0;

struct Tangents {
    vec3 by_u, by_v; // times the weight
    float weight;
    float most_u, most_v; // how large both may be
};

float size(vec3 x) {
    return max(abs(x.x), max(abs(x.y), abs(x.z)));
}

// Weights count relative to the patch's first, so that their cubes stay in range.
Tangents tangents_at(int number, vec2 at) {
    float low_u[DEGREE_U + 1], low_v[DEGREE_V + 1], u[DEGREE_U + 1], v[DEGREE_V + 1];
    for (int i = 0; i <= DEGREE_U; ++i) {
        u[i] = bernstein(DEGREE_U, i, at.x);
        low_u[i] = i < DEGREE_U ? float(DEGREE_U) * bernstein(DEGREE_U - 1, i, at.x) : 0.0;
    }
    for (int j = 0; j <= DEGREE_V; ++j) {
        v[j] = bernstein(DEGREE_V, j, at.y);
        low_v[j] = j < DEGREE_V ? float(DEGREE_V) * bernstein(DEGREE_V - 1, j, at.y) : 0.0;
    }
    float unit = 1.0 / control_point(number, 0, 0).w;
#if COORDINATES == 4
    vec4 point = patch_point(number, at.x, at.y);
    point /= point.w;
    float weight = 0.0;
#else
    vec4 point = vec4(0.0);
    float weight = 1.0;
#endif
    Tangents found = Tangents(vec3(0.0), vec3(0.0), weight, 0.0, 0.0);
    for (int i = 0; i <= DEGREE_U; ++i)
        for (int j = 0; j <= DEGREE_V; ++j) {
            vec4 own = control_point(number, i, j);
            vec4 across = unit * (control_point(number, min(i + 1, DEGREE_U), j) - own);
            vec4 along = unit * (control_point(number, i, min(j + 1, DEGREE_V)) - own);
            across.xyz -= across.w * point.xyz;
            along.xyz -= along.w * point.xyz;
            found.by_u += low_u[i] * v[j] * across.xyz;
            found.by_v += u[i] * low_v[j] * along.xyz;
            found.most_u = max(found.most_u, float(DEGREE_U) * size(across.xyz));
            found.most_v = max(found.most_v, float(DEGREE_V) * size(along.xyz));
#if COORDINATES == 4
            found.weight += u[i] * v[j] * unit * own.w;
#endif
        }
#if TWISTS
    add_twist_slopes(number, at, found.by_u, found.by_v);
#endif
    return found;
}

vec3 cross_product(Tangents own) {
    return own.weight * cross(own.by_u, own.by_v);
}

bool is_flat(Tangents own) {
    return size(cross_product(own)) <= FLAT * own.weight * own.most_u * own.most_v;
}

// The nearest place with a normal, if there is one: off a side along which nothing moves, or else off all that are near.
Tangents tangents_beside(int number, vec2 at, Tangents own) {
    vec2 inside = clamp(at, NEAR, 1.0 - NEAR);
    bool still_u = size(own.by_u) <= FLAT * own.most_u, still_v = size(own.by_v) <= FLAT * own.most_v;
    Tangents found = tangents_at(number, vec2(still_v ? inside.x : at.x, still_u ? inside.y : at.y));
    if (is_flat(found))
        found = tangents_at(number, inside);
    return found;
}

// step: of the domain, a level. Normals that shrink towards a side are drawn as the one that they tend to: it must be as
// long as its neighbours are, to count as much.
vec3 patch_normal(int number, vec2 at, vec2 step) {
    Tangents own = tangents_at(number, at);
    if (!is_flat(own))
        return cross_product(own);
    vec3 limit = cross_product(tangents_beside(number, at, own));
    step = clamp(step, NEAR, 0.5);
    float next = size(cross_product(tangents_at(number, clamp(at, step, 1.0 - step))));
    float long_ = size(limit);
    return long_ > 0.0 ? next / long_ * limit : vec3(0.0);
}
