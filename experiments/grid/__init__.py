"""Studies: grids of scenes, views, tolerances, methods and more, as a file says them, a row a case."""
