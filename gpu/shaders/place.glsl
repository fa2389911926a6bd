// Where a vertex of a piece lies in its patch, for whole levels: at k/n of the patch's level n on its side of the patch, so
// that a neighbour which is cut into other pieces has the same vertices, bit for bit, whichever way it runs along the edge.

// k/n in steps of 2^-24, those of k and n-k adding up to exactly 1; whole numbers, as divisions of floats may be off
float share(int k, int n) {
    int low = min(k, n - k);
    int first = (low << 12) / n;
    int rest = (low << 12) - first * n;
    int steps = (first << 12) + ((rest << 12) + n / 2) / n;
    return float(low == k ? steps : 16777216 - steps) / 16777216.0;
}

// local: in the piece, near a multiple of 1/level
float along_axis(float local, int level, int place, int count) {
    int k = int(floor(local * float(level) + 0.5));
    return share(place * level + k, count * level);
}

// piece: which along u and v, of how many; levels: its own
vec2 place_in_patch(vec2 local, ivec4 piece, ivec2 inner, ivec4 outer) {
    // inside, a level of 1 acts as 2
    ivec2 level = max(inner, ivec2(2));
    if (local.y == 0.0 || local.y == 1.0)
        level.x = local.y == 0.0 ? outer[1] : outer[3];
    if (local.x == 0.0 || local.x == 1.0)
        level.y = local.x == 0.0 ? outer[0] : outer[2];
    return vec2(along_axis(local.x, level.x, piece.x, piece.z), along_axis(local.y, level.y, piece.y, piece.w));
}
