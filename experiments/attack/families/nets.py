"""Families of control nets that are meant to break a bound: seeded, so that every net can be made again.

A net lies over the square [-1/2, 1/2]^2 of the x and y axes. The *relief* is the size of what a family does to it.
"""

from __future__ import annotations

from collections.abc import Callable
from math import comb
from typing import Any

import numpy as np

from slefejax import GregoryPatches
from slefejax.experiments.attack.families.products import ProductNets, product_nets
from slefejax.experiments.attack.families.shaded import Shaded
from slefejax.geometry.gregory import QUAD_TWISTS, TRIANGLE_TWISTS

DEGREES = ((1, 1), (2, 2), (3, 3), (2, 3), (3, 1), (4, 4), (5, 2), (6, 6), (2, 8), (9, 9), (12, 1), (12, 12))
WEIGHT_DECADES = 12.0
_TAME = 0.7  # how often weights spread over half a decade only
_SWAPS = 3  # points of a net that are moved onto others

Net = np.ndarray  # (du+1, dv+1, 3)
Rng = np.random.Generator
Shape = Callable[[Rng, int, int], Net]


def plane(du: int, dv: int) -> Net:
    """The square itself."""
    u, v = np.meshgrid(np.linspace(-0.5, 0.5, du + 1), np.linspace(-0.5, 0.5, dv + 1), indexing="ij")
    return np.stack([u, v, np.zeros_like(u)], axis=2)


def _direction(rng: Rng) -> np.ndarray:
    vector = rng.normal(size=3)
    return vector / np.linalg.norm(vector)


def _square(degree: int) -> np.ndarray:
    """Coefficients of t^2; of degree 1 there are none."""
    j = np.arange(degree + 1)
    return j * (j - 1) / max(1, degree * (degree - 1))


def _twist(rng: Rng, du: int, dv: int) -> Net:
    return np.outer(np.arange(du + 1) / du, np.arange(dv + 1) / dv)[..., None] * _direction(rng)


def _quadratic(rng: Rng, du: int, dv: int, a: float, b: float, c: float) -> Net:
    t, s = np.arange(du + 1) / du, np.arange(dv + 1) / dv
    form = a / 2 * _square(du)[:, None] + b * np.outer(t, s) + c / 2 * _square(dv)
    return form[..., None] * _direction(rng)


def _saddle(rng: Rng, du: int, dv: int) -> Net:
    """Half of them balanced: errors grow where a cell is made narrower one way."""
    a, b, c = rng.uniform(0.1, 1.0, 3)
    if rng.integers(2):
        b, c = a * rng.uniform(0.3, 0.6), a * rng.uniform(0.9, 1.1)
    return _quadratic(rng, du, dv, a, b if rng.integers(4) else 0.0, -c)


def _cylinder(rng: Rng, du: int, dv: int) -> Net:
    a, c = np.eye(2)[rng.integers(2)]
    return _quadratic(rng, du, dv, a, 0.0, c)


def _cusp(rng: Rng, du: int, dv: int) -> Net:
    """Inner rows in the opposite order: curves along u turn back, some on the spot."""
    net = plane(du, dv)
    turned = net.copy()
    turned[1:-1] = net[1:-1][::-1] * [rng.choice([1.0, 3.0]), 1.0, 1.0]
    return turned - net + 0.3 * rng.normal() * _square(du)[:, None, None] * _direction(rng)


def _alternating(rng: Rng, du: int, dv: int) -> Net:
    signs = (-1.0) ** np.add.outer(np.arange(du + 1), np.arange(dv + 1))
    return 0.5 * signs[..., None] * _direction(rng)


def _chebyshev(rng: Rng, du: int, dv: int) -> Net:
    """The Chebyshev polynomials of these degrees, whose derivatives are as large as can be."""
    along = [np.array([(-1.0) ** (d - i) * comb(2 * d, 2 * i) / comb(d, i) for i in range(d + 1)]) for d in (du, dv)]
    if rng.integers(2):
        along[rng.integers(2)][:] = 1.0
    return 0.5 * np.multiply.outer(*along)[..., None] * _direction(rng)


def _spike(rng: Rng, du: int, dv: int) -> Net:
    net = np.zeros((du + 1, dv + 1, 3))
    net[rng.integers(du + 1), rng.integers(dv + 1)] = 3.0 * rng.normal() * _direction(rng)
    return net


def _random(rng: Rng, du: int, dv: int) -> Net:
    return 0.5 * rng.normal(size=(du + 1, dv + 1, 3))


def _collapsed(rng: Rng, du: int, dv: int) -> Net:
    """One or two sides that are points, or points of the net on others."""
    net = plane(du, dv) + 0.3 * _random(rng, du, dv)
    sides = [(0, slice(None)), (slice(None), 0), (-1, slice(None)), (slice(None), -1)]
    if rng.integers(3):
        for k in rng.permutation(4)[: rng.integers(1, 3)]:
            net[sides[k]] = net[sides[k]][:1]
    else:
        for _ in range(_SWAPS):
            a, b = ((rng.integers(du + 1), rng.integers(dv + 1)) for _ in range(2))
            net[a] = net[b]
    return net - plane(du, dv)


SHAPES: dict[str, Shape] = {
    "twist": _twist,
    "saddle": _saddle,
    "cylinder": _cylinder,
    "cusp": _cusp,
    "alternating": _alternating,
    "chebyshev": _chebyshev,
    "spike": _spike,
    "collapsed": _collapsed,
    "random": _random,
}
RATIONAL = "rational"
GREGORY = {"gregory": 3, "gregory-triangle": 4}  # degrees of their nets
GAUSSIAN = "gaussian"
FAMILIES = (*SHAPES, RATIONAL, *GREGORY, GAUSSIAN)


def nets(
    family: str, rng: Rng, degrees: tuple[int, int], relief: np.ndarray, weight_decades: float = WEIGHT_DECADES
) -> Any:
    """A net for every relief, ``(n, du+1, dv+1, 3)``; 4 at the end of ``rational`` ones, (w x, w y, w z, w).

    Half of them are turned any way. Rational ones and Gregory patches take their shapes from the other families;
    weights spread over up to half a decade, or of all of them over up to so many; twists are of any size. Gaussian
    products have bicubic nets of means from there.
    """
    names = [family] * len(relief) if family in SHAPES else rng.choice(list(SHAPES), len(relief))
    if family in GREGORY or family == GAUSSIAN:
        degrees = GREGORY.get(family, 3), GREGORY.get(family, 3)
    made = np.stack([_placed(SHAPES[name], rng, degrees, size) for name, size in zip(names, relief, strict=True)])
    if family in GREGORY:
        return GregoryPatches(made, _twists(family, rng, relief))
    if family == GAUSSIAN:
        return product_nets(rng, made)
    if family != RATIONAL:
        return made
    decades = rng.uniform(0.0, 0.5 if rng.uniform() < _TAME else weight_decades, len(made))
    weights = 10.0 ** (rng.uniform(-0.5, 0.5, made.shape[:3]) * decades[:, None, None])
    return np.concatenate([made * weights[..., None], weights[..., None]], axis=3)


def _twists(family: str, rng: Rng, relief: np.ndarray) -> np.ndarray:
    """Some of them 0, others alone; triangles have two, and none of quads."""
    slots = QUAD_TWISTS if family == "gregory" else QUAD_TWISTS + TRIANGLE_TWISTS
    sizes = relief[:, None] * 10.0 ** rng.uniform(-1.0, 0.7, (len(relief), slots))
    sizes *= rng.integers(0, 2, sizes.shape)
    if family != "gregory":
        sizes[:, :QUAD_TWISTS] = 0.0
    return sizes[..., None] * rng.normal(size=(len(relief), slots, 3))


def _placed(shape: Shape, rng: Rng, degrees: tuple[int, int], relief: float) -> Net:
    net = plane(*degrees) + relief * shape(rng, *degrees)
    if rng.integers(2):
        net = net @ np.linalg.qr(rng.normal(size=(3, 3)))[0] + 0.2 * rng.normal(size=3)
    return net


def moved(patches: Any, scale: float, offset: np.ndarray) -> Any:
    """Patches with another size, and then elsewhere."""
    if isinstance(patches, GregoryPatches):
        return GregoryPatches(moved(patches.net, scale, offset), patches.twists * scale)
    if isinstance(patches, (ProductNets, Shaded)):
        return patches.moved(scale, offset)
    weight = patches[..., 3:] if patches.shape[-1] == 4 else 1.0
    return np.concatenate([patches[..., :3] * scale + offset * weight, patches[..., 3:]], axis=-1)
