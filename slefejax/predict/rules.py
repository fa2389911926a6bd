"""Other rules for tessellation factors, to compare with. Kernels run with the patches last (``slefejax.lanes.layout``).

filip        the second-derivative bound of [FMM86], made sound on the screen (``filip``)
minmax       the control net's extent on the screen over the tolerance: pieces whose box is as small as the tolerance
edge-length  no edge's control polygon longer than ``setting`` pixels a piece (8: [FFB09]; no bound)
screen-box   the longer side of the box around the projection, over mu = ``setting`` px ([YBP12], section 7; no bound)
fixed        ``setting`` pieces for every patch that is on the screen
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import reduce
from typing import Any

import jax.numpy as jnp
from jaxtyping import Array, Float

from slefejax.arguments import Number, check_positive
from slefejax.bounds.screen import rational_boxes
from slefejax.bounds.slefe import enclose_patch
from slefejax.geometry.gregory import Twisted
from slefejax.geometry.projection import Projection
from slefejax.lanes.maxima import at_least, larger, largest_along, root, smallest_along
from slefejax.lanes.plain import plain
from slefejax.predict.kernel import Kernel, Tolerances

Control = Float[Array, "nu nv dim lanes"]
_BOX_SEGMENTS = (3, 3)  # of the slefe whose boxes hold the projection


@plain()
@dataclass(frozen=True)
class Filip(Kernel):
    """The factor at which the published bound keeps the tolerance: sound wherever all control points have W > 0.

    Cut into n x n cells, |p - L| <= (M_uu + 2 M_uv + M_vv) / (8 n^2) in space, with M the longest coefficient vectors
    of the second derivatives. For two points of which the drawn one has the screen coordinate s = X'/W', X/W - s is
    ((X - X') - s (W - W'))/W: at most (|row_X| + |s| |row_W|) |p - L| / W, with the gradients of X and W, |s| at most
    half the picture, and W at least the smallest of the control points' (the near plane's, if some lie nearer).

    >>> Filip().label
    'filip'
    """

    name = "filip"
    takes_rational = False

    def kernel(self, control: Control, projection: Projection, tolerances: Tolerances) -> Array:
        """sqrt of the error of one piece over the tolerance."""
        du, dv = control.shape[0] - 1, control.shape[1] - 1
        by_u, by_v = jnp.diff(control, axis=0), jnp.diff(control, axis=1)
        reach = 2.0 * du * dv * _longest(jnp.diff(by_u, axis=1))
        for first, d in ((jnp.diff(by_u, axis=0), du), (jnp.diff(by_v, axis=1), dv)):
            reach = reach + (d * (d - 1) * _longest(first) if d > 1 else 0.0)
        rows = projection.to_pixels
        steepness = [_norm(rows[r, :3]) + projection.half[r] * _norm(rows[3, :3]) for r in (0, 1)]
        w = smallest_along(projection.undivided(control)[3], (0, 1))
        pixels = larger(*steepness) / at_least(w, projection.near_w) * reach / 8.0
        return jnp.sqrt(at_least(pixels / tolerances.pixels, 1.0))


@plain()
@dataclass(frozen=True)
class Minmax(Kernel):
    """The longer side of the box around the projected control points, over the tolerance.

    >>> Minmax().label
    'minmax'
    """

    name = "minmax"

    def kernel(self, control: Control, projection: Projection, tolerances: Tolerances) -> Array:
        """Pieces whose box is as small as the tolerance."""
        x, y = _projected(control, projection)
        return at_least(_extent(x, y) / tolerances.pixels, 1.0)


class _WithSetting(Kernel):
    """A rule with one number of its own."""

    setting: Number

    def check(self, dimension: int, tolerances: Tolerances) -> None:
        """InputError for a setting that is not positive too."""
        check_positive("setting", self.setting)
        super().check(dimension, tolerances)


@plain("setting")
@dataclass(frozen=True)
class EdgeLength(_WithSetting):
    """The length on the screen of the longest edge's control polygon, over ``setting`` pixels.

    >>> EdgeLength().label
    'edge-length 8'
    """

    name = "edge-length"
    takes_gregory = True  # twists are nothing on edges
    setting: Number = 8.0

    def kernel(self, control: Control, projection: Projection, tolerances: Tolerances) -> Array:
        """Pieces of an edge."""
        x, y = _projected(_net(control), projection)
        edges = [(x[0], y[0]), (x[-1], y[-1]), (x[:, 0], y[:, 0]), (x[:, -1], y[:, -1])]
        # collapsed edges have no direction: their derivative counts as 0
        lengths = [jnp.sum(root(jnp.diff(a, axis=0) ** 2 + jnp.diff(b, axis=0) ** 2), axis=0) for a, b in edges]
        return at_least(reduce(larger, lengths) / self.setting, 1.0)


@plain("setting")
@dataclass(frozen=True)
class ScreenBox(_WithSetting):
    """The longer side of the box around the projection (of the slefe's boxes), over mu = ``setting`` pixels.

    >>> ScreenBox(2.0).label
    'screen-box 2'
    """

    name = "screen-box"
    setting: Number = 1.0

    def kernel(self, control: Control, projection: Projection, tolerances: Tolerances) -> Array:
        """Pieces of the box."""
        if control.shape[2] == 4:  # a slefe of w x would depend on where the origin is
            at, low, high = rational_boxes(control, projection, _BOX_SEGMENTS, rows=2)
            pairs = [(at[:, :, 0] + own[:, :, 0], at[:, :, 1] + own[:, :, 1]) for own in (low, high)]
        else:
            pairs = [_projected(bound, projection) for bound in enclose_patch(control, _BOX_SEGMENTS)]
        x, y = (jnp.concatenate([pair[axis] for pair in pairs]) for axis in (0, 1))
        return at_least(_extent(x, y) / self.setting, 1.0)


@plain("setting")
@dataclass(frozen=True)
class Fixed(_WithSetting):
    """``setting`` pieces for every patch that is on the screen.

    >>> Fixed().label
    'fixed 16'
    """

    name = "fixed"
    takes_gregory = True
    setting: Number = 16.0

    def kernel(self, control: Control, projection: Projection, tolerances: Tolerances) -> Array:
        """The same everywhere."""
        own = _net(control)
        return jnp.full(own.shape[-1], self.setting, own.dtype)


def _net(control: Any) -> Control:
    return control.net if isinstance(control, Twisted) else control


def _projected(control: Control, projection: Projection) -> tuple[Any, Any]:
    x, y, _, w = projection.undivided(control)
    w = at_least(w, projection.near_w)
    return x / w, y / w


def _extent(x: Any, y: Any) -> Any:
    sides = [largest_along(t, (0, 1)) - smallest_along(t, (0, 1)) for t in (x, y)]
    return larger(*sides)


def _longest(vectors: Any) -> Any:
    """Length of the longest of vectors ``(i, j, 3, lanes)``."""
    return root(largest_along(jnp.sum(vectors**2, axis=2), (0, 1)))


def _norm(vector: Any) -> Any:
    # row W is 0 without perspective
    return root(jnp.sum(vector**2))
