"""The error of pixels, over the domain, of triangles; which patch is seen; minimal factors."""
