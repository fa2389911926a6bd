"""Bernstein form, camera and viewport, patches brought to where kernels' numbers hold them."""
