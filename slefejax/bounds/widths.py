"""What factors are made of: widths of slefe boxes on the screen, and the twist that they do not see."""

from __future__ import annotations

from functools import partial
from typing import Any

import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Float

from slefejax.arguments import Number, Patches, Segments, check_temperature, segment_pair
from slefejax.bounds.screen import visible_widths
from slefejax.bounds.slefe import enclose_patch
from slefejax.errors import InputError
from slefejax.geometry.packed import pack
from slefejax.geometry.projection import Projection, unless_bad
from slefejax.geometry.view import View, check_view
from slefejax.geometry.volume import inside_of_tiles
from slefejax.lanes import layout, loops, passes
from slefejax.lanes.maxima import Maxima, largest_along, maxima_of


def screen_widths(
    patches: Patches, view: View, segments: Segments = 3, smooth: Number | None = None
) -> Float[Array, "patches"]:
    """w, the largest side in pixels of the slefe boxes on the screen ([YBP12], (8)); 0 for a patch that is off-screen.

    The published estimate is k m sqrt(w / tolerance), but at least 1. Arguments, errors and derivatives as of
    ``slefejax.tessellation_factors`` with method ``slefe``.

    >>> from slefejax import Camera, load
    >>> view = View(Camera.look_at((4.5, -6.0, 4.0), (0.0, 0.0, 1.2)), width=1440, height=900)
    >>> patches = load("teapot").patches()
    >>> round(float(3 * np.sqrt(screen_widths(patches, view, segments=3)).sum()), 3)  # the factors at one pixel
    380.316
    """
    pair = segment_pair(segments)
    check_temperature(smooth)
    return _over_patches(patches, view, smooth, pair)


def screen_twists(patches: Patches, view: View) -> Float[Array, "patches"]:
    """The size of the mixed second derivative on the screen, over 4, in pixels; 0 for a patch that is off-screen.

    Without perspective so much a bilinear patch is off if it is drawn as two triangles, and sqrt(twist / tolerance)
    pieces are enough for it, while w is 0; with perspective that is nearly so, and no bound. Taken from control points:
    d_u d_v (D_uv X - s D_uv W) / W with D_uv the mixed difference of each quad of the control net, s and W those of its
    middle, the largest of all quads and both coordinates. Arguments as of ``screen_widths``; differentiable alike.
    """
    return _over_patches(patches, view, None, None)


def _over_patches(patches: Patches, view: View, smooth: Any, segments: Any) -> Any:
    packed = pack(patches)
    check_view(view)
    chunks, projection = packed.placed(view)
    maxima = maxima_of(None if smooth is None else jnp.asarray(smooth, packed.dtype))
    found = layout.unpack(_pass(chunks, projection, maxima, segments), len(packed))
    bad = [] if isinstance(found, Tracer) else np.flatnonzero(~np.isfinite(np.asarray(found)))
    if len(bad):
        raise InputError(f"patch {bad[0]} (counted from 0) has control points that are not finite, or too large")
    return found


@passes.as_pass(3)
def _pass(packed: Any, projection: Projection, maxima: Maxima, segments: Any) -> Any:
    kernel = _twist if segments is None else partial(_width, maxima=maxima, segments=segments)
    return loops.over_chunks(unless_bad(kernel), packed, projection)


def _width(control: Any, projection: Projection, maxima: Maxima, segments: tuple[int, int]) -> Any:
    boxes = enclose_patch(control, segments, maxima)
    found = visible_widths(boxes, control, projection, maxima, segments, with_depth=False)
    return jnp.where(found.seen, found.pixels, 0.0)


def _twist(control: Any, projection: Projection) -> Any:
    rows = projection.undivided(control)
    mixed = [jnp.diff(jnp.diff(row, axis=0), axis=1) for row in rows]
    middle = [0.25 * (row[1:, 1:] + row[1:, :-1] + row[:-1, 1:] + row[:-1, :-1]) for row in rows]
    w = jnp.maximum(middle[3], projection.near_w)
    sides = [
        jnp.abs(mixed[r] - jnp.clip(middle[r] / w, -projection.half[r], projection.half[r]) * mixed[3]) / w
        for r in (0, 1)
    ]
    scale = 0.25 * (control.shape[0] - 1) * (control.shape[1] - 1)
    seen = inside_of_tiles(*enclose_patch(control, (1, 1)), projection.frustum)[0, 0] >= 0
    return jnp.where(seen, scale * largest_along(jnp.maximum(*sides), (0, 1)), 0.0)
