"""Pictures of what triangles depend on."""
