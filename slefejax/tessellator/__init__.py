"""What a tessellator does: counts, pattern of rings, shared edges, triangles on the host."""

from slefejax.tessellator.levels import levels_for, triangle_counts, with_pieces

__all__ = ["levels_for", "triangle_counts", "with_pieces"]
