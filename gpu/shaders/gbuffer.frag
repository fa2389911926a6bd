#version 430
in vec2 place;
flat in vec4 corner_clip[3];
flat in vec4 first_corners;
flat in vec4 last_corner;
uniform vec2 half_picture;  // pixels

// u, v, patch number, window depth
layout(location = 0) out vec4 sample_;
// where the point with these parameters is drawn: pixels to the right of the pixel's centre, and above it
layout(location = 1) out vec2 drawn;
#if NORMALS
in vec3 normal;
// 0 if there is none
layout(location = 2) out vec4 unit_normal;
#endif

// Of a barycentric coordinate: at the finest levels, 16,384, parameters are rounded to so much of a triangle.
const float ROUNDING = 1.0 / 1024.0;

void main() {
    vec2 first = first_corners.xy, point = place - first;
    vec2 second = first_corners.zw - first, third = last_corner.xy - first;
    float area = second.x * third.y - second.y * third.x;
    vec3 shares;
    shares.y = (point.x * third.y - point.y * third.x) / area;
    shares.z = (second.x * point.y - second.y * point.x) / area;
    shares.x = 1.0 - shares.y - shares.z;
    vec4 position = shares.x * corner_clip[0] + shares.y * corner_clip[1] + shares.z * corner_clip[2];
    // false for what is not a number, too
    bool inside = all(greaterThanEqual(shares, vec3(-ROUNDING))) && all(lessThanEqual(abs(position.xyz), position.www));
    // A point that is not there, which the renderer moves into its triangle (strays.py): -2 - patch number, and of the
    // triangle the sum of its corners.
    vec2 centre = gl_FragCoord.xy - half_picture;  // whole halves, exact
    drawn = inside ? (position.xy * half_picture - centre * position.w) / position.w
                   : first_corners.xy + first_corners.zw + last_corner.xy;
    sample_ = vec4(place, inside ? last_corner.z : -2.0 - last_corner.z, gl_FragCoord.z);
#if NORMALS
    // squares of small numbers would vanish
    float size = max(abs(normal.x), max(abs(normal.y), abs(normal.z)));
    unit_normal = size > 0.0 ? vec4(normalize(normal / size), 0.0) : vec4(0.0);
#endif
}
