"""From control meshes and spline surfaces to Bézier patches; every scheme is a table of stencils."""
