"""What comes back from the device: pictures of parameters, and triangles."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int


@dataclass(frozen=True)
class GBuffer:
    """What is seen at every pixel centre; arrays ``(height, width)``, row 0 at the bottom (``slefejax.geometry.view``).

    u, v  : float32 parameters of the patch, interpolated with perspective by the rasteriser; where they would lie
            outside of what is drawn of the triangle, the nearest that lie in it (``slefejax.gpu.strays``)
    patch : int32 number of the patch, -1 where nothing was drawn
    depth : float32 window depth, 1 where nothing was drawn
    drawn : float32 ``(height, width, 2)``, where the triangle's point with these parameters is drawn: so many pixels to
            the right of the pixel's centre and above it, 0 where nothing was drawn
    normal : float32 ``(height, width, 3)``, unit normals in the scene's axes, along p_u x p_v whatever side is seen:
             those at the vertices, undivided, interpolated with perspective (docs/math.md, 4). NaN where nothing was
             drawn, and where the triangle has no normal. None unless they were asked for
    edge  : float32 ``(height, width, 2)``, the nearest point of the three sides of the triangle that is seen: so many
            pixels to the right of the pixel's centre and above it, NaN where nothing was drawn. None unless ``wire``
            was asked for
    area  : float32, how large that triangle is on the screen, hidden or not, in square pixels; of one that reaches
            behind the camera the part beyond the near plane. NaN where nothing was drawn, None as ``edge``
    """

    u: Float[np.ndarray, "height width"]
    v: Float[np.ndarray, "height width"]
    patch: Int[np.ndarray, "height width"]
    depth: Float[np.ndarray, "height width"]
    drawn: Float[np.ndarray, "height width 2"]
    normal: Float[np.ndarray, "height width 3"] | None = None
    edge: Float[np.ndarray, "height width 2"] | None = None
    area: Float[np.ndarray, "height width"] | None = None

    @staticmethod
    def of(parts: dict[str, Float[np.ndarray, "height width components"]]) -> GBuffer:
        """Of what the attachments hold, named and laid out as in gbuffer.frag: sample, drawn, normal, side."""
        sample, there = parts["sample"], parts["sample"][..., 2] >= 0
        patch = sample[..., 2].astype(np.int32)
        normal = edge = area = None
        if "normal" in parts:
            normal = parts["normal"][..., :3]
            normal = _where(there & np.any(normal != 0, axis=2), normal)
        if "side" in parts:
            side = _where(there, parts["side"])
            edge, area = side[..., :2], side[..., 2]
        return GBuffer(sample[..., 0], sample[..., 1], patch, sample[..., 3], parts["drawn"], normal, edge, area)


@dataclass(frozen=True)
class Triangles:
    """Triangles as the tessellator made them, in no particular order.

    patch      : ``(triangles,)`` int32
    parameters : ``(triangles, 3, 2)`` float32, (u, v) of each vertex
    clip       : ``(triangles, 3, 4)`` float32, its clip-space position
    normal     : ``(triangles, 3, 3)`` float32, its normal in the scene's axes, 0 if there is none: N over the distances
                 from sides that are points (``slefejax.geometry.normals``), times a number of the patch's own. None
                 unless they were asked for
    """

    patch: Int[np.ndarray, "triangles"]
    parameters: Float[np.ndarray, "triangles 3 2"]
    clip: Float[np.ndarray, "triangles 3 4"]
    normal: Float[np.ndarray, "triangles 3 3"] | None = None


def _where(
    there: Bool[np.ndarray, "height width"], values: Float[np.ndarray, "height width components"]
) -> Float[np.ndarray, "height width components"]:
    """The values, NaN elsewhere."""
    return np.where(there[..., None], values, np.float32(np.nan))
