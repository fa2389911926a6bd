"""Factors and levels for interpolated normals (docs/certified.md, section 11)."""
