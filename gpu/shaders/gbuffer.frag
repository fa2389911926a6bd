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
#if WIRE
// from the pixel's centre to the nearest point of the triangle's sides: pixels to the right, and above it; the triangle's
// area on the screen; a blank
#if NORMALS
layout(location = 3) out vec4 nearest_side;
#else
layout(location = 2) out vec4 nearest_side;
#endif
#include "sides_seen.glsl"
#endif

// Of a barycentric coordinate: at the finest levels, 16,384, parameters are rounded to so much of a triangle.
const float ROUNDING = 1.0 / 1024.0;

// On the screen, in pixels from a pixel's centre, which is given from the picture's.
vec2 from_centre(vec4 position, vec2 centre) {
    return (position.xy * half_picture - centre * position.w) / position.w;
}

#if WIRE
vec2 to_nearest_side(vec2 centre) {
    vec2 nearest = vec2(1e9);
    for (int k = 0; k < 3; ++k) {
        vec4 a = corner_clip[k], b = corner_clip[(k + 1) % 3];
        if (!beyond_near(a) && !beyond_near(b))
            continue;
        if (!beyond_near(a))
            a = at_near(b, a);
        else if (!beyond_near(b))
            b = at_near(a, b);
        vec2 first = from_centre(a, centre), along = from_centre(b, centre) - first;
        float square = dot(along, along);
        vec2 found = first + (square > 0.0 ? clamp(-dot(first, along) / square, 0.0, 1.0) : 0.0) * along;
        nearest = dot(found, found) < dot(nearest, nearest) ? found : nearest;
    }
    return nearest;
}
#endif

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
    drawn = inside ? from_centre(position, centre)
                   : first_corners.xy + first_corners.zw + last_corner.xy;
    sample_ = vec4(place, inside ? last_corner.z : -2.0 - last_corner.z, gl_FragCoord.z);
#if NORMALS
    // squares of small numbers would vanish
    float size = max(abs(normal.x), max(abs(normal.y), abs(normal.z)));
    unit_normal = size > 0.0 ? vec4(normalize(normal / size), 0.0) : vec4(0.0);
#endif
#if WIRE
    nearest_side = vec4(to_nearest_side(centre), last_corner.w, 0.0);
#endif
}
