"""Numbers of one scene, and whether computations keep their digits (docs/stability.md)."""
