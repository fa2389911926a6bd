"""The renderer: tessellation levels in, G-buffer or triangles out.

It draws what it is told and knows nothing of how the levels were predicted.
"""

from slefejax.gpu.buffers import GBuffer, Triangles
from slefejax.gpu.context import Device, open_device
from slefejax.gpu.pattern import measure_pattern
from slefejax.gpu.renderer import Renderer

__all__ = ["Device", "GBuffer", "Renderer", "Triangles", "measure_pattern", "open_device"]
