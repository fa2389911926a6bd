"""Levels for the triangles that a tessellator really makes (docs/certified.md, section 6)."""
