// Sides of patches that are points, along which derivatives along the side are 0: normals are divided by the distance, in
// the domain, from them. bezier.glsl comes before.
layout(std430, binding = 6) readonly buffer Collapsed {
    int collapsed[]; // a bit a side: u=0, v=0, u=1, v=1
};

bvec4 collapsed_sides(int number) {
    return notEqual(ivec4(collapsed[number]) & ivec4(1, 2, 4, 8), ivec4(0));
}

// A Bernstein polynomial over t where first says so, and over 1 - t where last does; 0 where that is no polynomial.
float bernstein_over(int degree, int j, float t, bool first, bool last) {
    int low = j - int(first), high = degree - j - int(last);
    return min(low, high) < 0 ? 0.0 : binomial(degree, j) * power(t, low) * power(1.0 - t, high);
}
