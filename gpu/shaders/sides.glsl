// Vertices on a side of a patch are points of the curve that the side is a part of (slefejax.edges), evaluated from the
// control points of the one side that owns it: whoever draws them has the same, bit for bit. bezier.glsl comes before.
struct Side {
    int owner; // 4 patch + edge
    float first, last; // where the side begins and ends in the owner's parameter
};
layout(std430, binding = 4) readonly buffer Sides {
    Side sides[];
};

// t: along the patch's own edge. Places of vertices are multiples of 2^-24, so 1 - t is exact, and as in patch_point
// reversing the curve exchanges operands and nothing else.
vec4 side_point(int number, int edge, float t) {
    Side side = sides[4 * number + edge];
    precise float at = side.first + t * (side.last - side.first);
    int degree = side.owner % 2 == 0 ? DEGREE_V : DEGREE_U;
    precise vec4 sum = vec4(0.0);
    for (int k = 0; 2 * k < degree; ++k) {
        precise vec4 first = bernstein(degree, k, at) * side_control(side.owner, k);
        precise vec4 last = bernstein(degree, degree - k, at) * side_control(side.owner, degree - k);
        precise vec4 both = first + last;
        sum = sum + both;
    }
    if (degree % 2 == 0) {
        precise vec4 middle = bernstein(degree, degree / 2, at) * side_control(side.owner, degree / 2);
        sum = sum + middle;
    }
#if COORDINATES == 3
    sum.w = 1.0;
#endif
    return sum;
}

// A corner belongs to two sides, whose owners end in equal points.
vec4 drawn_point(int number, float u, float v) {
    if (u == 0.0 || u == 1.0)
        return side_point(number, u == 0.0 ? 0 : 2, v);
    if (v == 0.0 || v == 1.0)
        return side_point(number, v == 0.0 ? 1 : 3, u);
    return patch_point(number, u, v);
}
