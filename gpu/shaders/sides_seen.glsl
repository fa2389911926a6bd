// Sides of triangles on the screen, beyond the near plane: what lies behind the camera has no place there.

bool beyond_near(vec4 position) {
    return position.z + position.w >= 0.0;
}

// Where the side from a, which lies beyond the near plane, to b, which does not, passes through it.
vec4 at_near(vec4 a, vec4 b) {
    float own = a.z + a.w;
    return a + own / (own - (b.z + b.w)) * (b - a);
}
