"""How far a part of a patch errs on the screen at most: kernels for cells, triangles, and parts of both.

The error is that of interpolating X - s W over W (docs/certified.md, sections 2 and 7). Patches come as
``predict.cells`` pictures them: control points and twists, patches first, half of the picture, sizes of terms, the
floor of W.
"""

from __future__ import annotations

from functools import partial, reduce
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np

from slefejax.bounds.quadratics import PARTS, Box, Places, Polynomial, drawn_corners, places_of
from slefejax.geometry.projection import reaches
from slefejax.lanes import loops, nets
from slefejax.lanes.maxima import larger, smaller
from slefejax.lanes.nets import Lanes, Net
from slefejax.lanes.tuning import TUNING

ROUNDING = 256.0 * np.finfo(np.float64).eps


class _Part(NamedTuple):
    """A part of a patch: what lies in a box of the domain."""

    rows: list[Polynomial]  # of X, Y (and Z) less s W, with an s of the box's middle
    w: Polynomial
    places: Places
    least: Lanes  # W is at least that
    deep: Lanes  # and that is away from 0
    far: list[Lanes]  # how far s can be from that of the middle, for every row
    blur: list[Lanes]  # what rounding may have done
    unseen: Lanes  # outside of one plane, with all that is drawn of it

    @staticmethod
    def of(
        pictured: tuple[Any, ...],
        patch: Lanes,
        box: Box,
        rows: int,
    ) -> _Part:
        """Of a patch, what lies in a box."""
        control, twists, half, sizes, floor = pictured
        low, high, inside, window = box
        index = patch.astype(jnp.int32)
        # once: other fusions would gather again
        own, size = loops.once(jnp.moveaxis(control[index], 0, -1)), sizes[:, index]
        few = own.shape[0] * own.shape[1] <= TUNING.unrolled_coefficients
        along = [nets.restricting(n, a, b) for n, a, b in zip(own.shape[:2], low, high, strict=True)]
        slots, spun = twists.shape[1], loops.once(jnp.moveaxis(twists[index], 0, -1))
        turned = [[spun[k, a] for k in range(slots)] for a in range(4)]
        whole = nets.coordinates(own, few)
        corners = [[]] * 4 if window is None else [window.corners(*both) for both in zip(whole, turned, strict=True)]
        restricted = [nets.restricted(net, *along) for net in whole]
        *every, w = (Polynomial(*parts) for parts in zip(restricted, turned, corners, strict=True))
        places = places_of(low, high, inside, window, slots, own.shape[:2])
        swing = [own.swing(places) for own in (*every, w)] if slots else [0.0] * 4
        least = nets.bottom(w.centred(places)) - swing[-1]
        if window is not None:
            least = smaller(least, nets.bottom(drawn_corners(w, places, inside is not None)))
        least = least - ROUNDING * size[3]
        deep = least >= 0.5 * floor[index]
        least = jnp.where(deep, least, 1.0)
        outline = _corners if window is None else partial(drawn_corners, triangle=False)
        drawn = [outline(own, places) if inside is None else own.centred(places) for own in (*every, w)]
        room = [0.0] * 3 if inside is None else [swing[k] + half[k] * swing[-1] for k in range(3)]
        planes = [_outside(net, drawn[-1], half[k], size[k], size[3], room[k]) for k, net in enumerate(drawn[:-1])]
        middle = w.middle(places)
        relative, far, blur = [], [], []
        for k in range(rows):
            s = jnp.clip(every[k].middle(places) / jnp.where(deep, middle, 1.0), -half[k], half[k])
            relative.append(every[k].less(s, w))
            largest = nets.top(nets.each(jnp.abs, relative[-1].centred(places)))
            far.append((largest + relative[-1].swing(places) if slots else largest) / least)
            blur.append(ROUNDING * (size[k] + half[k] * size[3]))
        return _Part(relative, w, places, least, deep, far, blur, reduce(jnp.logical_or, planes))

    def error(self, measured: Any) -> Lanes:
        """The largest error, for what measures the interpolation error of one polynomial from above."""
        of_w, worst = measured(self.w, self.places).size, jnp.zeros_like(self.least)
        for own, far, blur in zip(self.rows, self.far, self.blur, strict=True):
            # linear in s, and a seminorm
            worst = larger(worst, (measured(own, self.places).size + far * of_w + blur) / self.least)
        return jnp.where(self.unseen, 0.0, jnp.where(self.deep, worst, jnp.inf))


def part_error(lanes: Any, *pictured: Any, kind: str, rows: int) -> Lanes:
    """Of parts of a kind (``PARTS``), lanes: patch, then what tells the part."""
    told, measured = PARTS[kind]
    return _Part.of(pictured, lanes[0], told(lanes[1:]), rows).error(measured)


def _corners(own: Polynomial, places: Places) -> Net:
    """The values at the corners of a cell."""
    values = [own.net[-i, -j] for i in (0, 1) for j in (0, 1)]
    if own.twists:
        ends = np.array([0, 4, 20, 24])
        values = own.at(values, places._replace(terms=[b[ends] for b in places.terms]))
    return nets.objects([values[:2], values[2:]])


def _outside(net: Net, w: Net, half: Any, size: Lanes, w_size: Lanes, room: Any) -> Lanes:
    """Whether points lie outside of one of two opposite planes of the view volume."""
    margin = ROUNDING * (size + half * w_size) + room
    low, high = reaches(net, w, half)
    return (low + margin < 0) | (high + margin < 0)
