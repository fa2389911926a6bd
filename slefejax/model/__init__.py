"""Control meshes and their defects, stencils, skinning, rigs."""
