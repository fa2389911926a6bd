"""Which boxes reach into the view volume: the test of [YBP12], section 6, without a division."""

from __future__ import annotations

from itertools import chain
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from slefejax.geometry.gregory import Twisted
from slefejax.geometry.projection import Projection, numbers
from slefejax.lanes import nets
from slefejax.lanes.maxima import larger, smaller
from slefejax.lanes.nets import Net
from slefejax.lanes.tuning import TUNING


def inside_of_tiles(lower: Array, upper: Array, frustum: Float[Array, "6 4"]) -> Net:
    """The Q-test: at least 0 for every tile, unless its four boxes lie outside of one and the same plane.

    Where W > 0 this is the test of the rectangle Q against the screen ([YBP12], section 6), with near and far added;
    it needs no division, so it holds for boxes at and behind the camera too.
    """
    unrolled = few(lower)
    ends = zip(nets.coordinates(lower, unrolled), nets.coordinates(upper, unrolled), strict=True)
    boxes = [
        (nets.each(lambda a, b: 0.5 * (a + b), low, high), nets.each(lambda a, b: 0.5 * (b - a), low, high))
        for low, high in ends
    ]
    inside: Net | None = None
    for plane, sizes in zip(numbers(frustum), numbers(jnp.abs(frustum)), strict=True):
        weights = [weight for pair in zip(plane, sizes, strict=True) for weight in pair]
        # homogeneous points bring their own last coordinate
        start = [] if len(boxes) == 4 else [plane[3]]

        def reach(*parts: Any, weights: Any = weights, start: Any = start) -> Any:
            return nets.total([*start, *(weight * part for weight, part in zip(weights, parts, strict=False))])

        furthest = tile_maxima(nets.each(reach, *chain(*boxes)))
        inside = furthest if inside is None else nets.each(smaller, inside, furthest)
    assert inside is not None
    return inside


def tile_maxima(net: Net) -> Net:
    """The largest of the values at the four corners of every tile.

    >>> tile_maxima(jnp.arange(9.0).reshape(3, 3, 1))[..., 0].tolist()
    [[4.0, 5.0], [7.0, 8.0]]
    """
    for _ in ("u", "v"):
        net = nets.transposed(nets.each(larger, net[:-1], net[1:]))
    return net


def few(grid: Array | np.ndarray) -> bool:
    """Whether a grid is few enough boxes for one after the other, of which the compiler makes faster code.

    >>> few(jnp.zeros((4, 4, 3, 16))), few(jnp.zeros((9, 9, 3, 16)))
    (True, False)
    """
    return grid.shape[0] * grid.shape[1] <= TUNING.unrolled_boxes


def on_screen(control: Any, projection: Projection) -> Array:
    """Whether the box around the control points reaches into the view volume."""
    net, room = control, 0.0
    if isinstance(control, Twisted):
        net, room = control.net, 0.5 * jnp.sum(jnp.abs(control.twists), axis=0)
    low, high = jnp.min(net, axis=(0, 1)) - room, jnp.max(net, axis=(0, 1)) + room
    low, high = (jnp.broadcast_to(bound, (2, 2, *bound.shape)) for bound in (low, high))
    return inside_of_tiles(low, high, projection.frustum)[0, 0] >= 0
