"""One figure a file, drawn from tables and images that are handed in; nothing is recomputed."""
