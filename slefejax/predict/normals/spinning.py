"""What twist terms of Gregory patches add to the bound for normals (docs/certified.md, 11), tile by tile.

N is a product of tangents, and a product f g of functions is interpolated with f (g - I g) + g (f - I f) at the place
and what both change together, which is at most a quarter of what each changes from there to the triangle's corners.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import jax.numpy as jnp
from jaxtyping import Array

from slefejax.bounds.triangles import Extent, HalfCells, Triangles
from slefejax.geometry.bezier import tile_matrices
from slefejax.lanes import nets
from slefejax.lanes.maxima import Maxima, larger
from slefejax.lanes.nets import Lanes
from slefejax.predict.normals.slopes import COARSEST, TileSlopes, on_tiles
from slefejax.predict.normals.undivided import Spin


class Spinning(NamedTuple):
    """Of whole patches."""

    spin: Spin
    twists: tuple[Lanes, Lanes]  # lengths of a_k and of b_k, (slots, lanes)
    bends: tuple[Lanes, Lanes]  # |uu| + 2 |uv| + |vv| of A and of B
    largest: Any  # side of the box that holds a triangle, in units of 1/n

    @staticmethod
    def of(spin: Spin, extent: Extent, maxima: Maxima) -> Spinning:
        """For triangles in boxes of sides extent/n."""
        twists = nets.length(spin.by_u), nets.length(spin.by_v)
        bends = _bent(spin.along_u, maxima), _bent(spin.along_v, maxima)
        e_u, e_v = (jnp.asarray(e, bends[0].dtype) * jnp.ones_like(bends[0]) for e in extent)
        return Spinning(spin, twists, bends, larger(e_u, e_v))

    def on_tile(self, matrices: Any, slopes: TileSlopes, tiles: int, maxima: Maxima) -> TileSpin:
        """Of a tile.

        matrices : that make tiles of A, along u and v, and of B
        slopes   : of all terms, there
        """
        along_u, along_v = (_combined(net, *own) for net, own in zip(self.spin[:2], matrices, strict=True))
        with_u = jnp.cross(self.spin.by_u[:, None, None], along_v, axis=-2)
        with_v = jnp.cross(along_u, self.spin.by_v[:, None, None], axis=-2)
        both = jnp.cross(self.spin.by_u[:, None], self.spin.by_v[None], axis=-2)
        bent, more = self._weighted(slopes.size), self._weighted(slopes.steep)
        products = Products(with_u, with_v, both)
        lengths = Seen.of(products, lambda several: nets.longest(several, maxima), nets.length)
        size = lengths.weighted(slopes.size, slopes.size)
        return TileSpin(products, lengths, slopes, tiles, self.largest, bent, more, size)

    def _weighted(self, slopes: Any) -> Lanes:
        """An eighth of how much A and B are bent, times how much twists make of slopes ``(..., slots, 2)``."""
        long_u, long_v = (jnp.sum(slopes[..., k, None] * self.twists[k], axis=-2) for k in (0, 1))
        return (long_u * self.bends[1] + long_v * self.bends[0]) / 8.0


class Products(NamedTuple):
    """What slopes are multiplied with on a tile."""

    with_u: Any  # a_k x B, nets (slots, ..., ..., 3, lanes)
    with_v: Any  # A x b_k
    both: Any  # (slots, slots, 3, lanes): a_j x b_k


class Seen(NamedTuple):
    """How large these are at most, or what is seen of them."""

    with_u: Any  # (slots, lanes)
    with_v: Any
    both: Any  # (slots, slots, lanes)
    changing: tuple[Any, Any]  # what the first two change by along u and along v together, (slots, lanes)

    @staticmethod
    def of(products: Products, of_nets: Callable[[Any], Any], of_vectors: Callable[[Any], Any]) -> Seen:
        """With sizes of nets ``(slots, ..., ..., 3, lanes)`` and of vectors ``(..., 3, lanes)``."""
        with_u, with_v, both = products
        by_u, by_v = (nets.total([of_nets(own) for own in _derivatives(several)]) for several in (with_u, with_v))
        return Seen(of_nets(with_u), of_nets(with_v), of_vectors(both), (by_u, by_v))

    def weighted(self, sizes: Any, errors: Any) -> Lanes:
        """The sum of all products with what slopes are, and err, at most, ``(slots, 2)`` and ``(..., slots, 2)``."""
        sizes, errors = sizes[..., None], errors[..., None]
        by_u = self.with_u + jnp.sum(sizes[None, :, 1] * self.both, axis=1)
        by_v = self.with_v + jnp.sum(sizes[:, None, 0] * self.both, axis=0)
        return jnp.sum(errors[..., 0, :] * by_u + errors[..., 1, :] * by_v, axis=-2)


class TileSpin(NamedTuple):
    """Of a tile; grids are as ``TileSlopes`` has them where there are several, ``(coarsest, lanes)``."""

    products: Products
    lengths: Seen
    slopes: TileSlopes
    tiles: int
    largest: Any  # side of the box that holds a triangle, in units of 1/n
    bent: Lanes  # n^2 times what is off because A and B are bent
    more: Any  # (coarsest, lanes): n^3 times what is off because they are bent where slopes change
    size: Lanes  # what twists add to N is nowhere longer

    @property
    def coarsest(self) -> Any:
        """The numbers of cells a side from which on what there are several of holds, ``(coarsest, lanes)``."""
        whole, *parts = (m * self.largest for m in COARSEST)
        return jnp.stack([jnp.ones_like(whole), *parts])

    def errors(self, seen: Seen) -> tuple[Any, Any]:
        """What is interpolated of that vector is off by at most first/n + second/n^2, seen so, and by what A and B are
        bent: (14) of docs/certified.md.
        """
        first, second = (seen.weighted(self.slopes.size, own) for own in (self.slopes.first, self.slopes.second))
        steep_u, steep_v = self.slopes.steep[..., 0, None], self.slopes.steep[..., 1, None]
        # a quarter of how much A and B change where slopes do, and slopes where others do
        changing = jnp.sum(steep_u * seen.changing[0] + steep_v * seen.changing[1], axis=-2) * self.tiles
        changing = changing + jnp.sum(steep_u[:, :, None] * steep_v[:, None] * seen.both, axis=(1, 2))
        return self.largest * first, self.largest**2 * (second + 0.25 * changing)


def tile_tables(spin: Spin, triangles: Triangles, tiles: int) -> tuple[Any, TileSlopes]:
    """What ``Spinning.on_tile`` is told of every tile."""
    nu, nv = spin.along_v.shape[0], spin.along_u.shape[1]
    matrices = tile_matrices(nu - 1, nv, tiles), tile_matrices(nu, nv - 1, tiles)
    even = isinstance(triangles, HalfCells) and all(
        isinstance(x, float) and x == 1.0 for x in (*triangles.extent, triangles.evenness)
    )
    return matrices, on_tiles(len(spin.by_u), tiles, even)


def _combined(net: Any, u: Any, v: Any) -> Any:
    """A tile of a vector net."""
    flat = nets.combined(net.reshape(*net.shape[:2], -1), u, v)
    return flat.reshape(net.shape)


def _derivatives(net: Array) -> list[Array]:
    """Of nets ``(..., nu, nv, 3, lanes)`` by u, and by v."""
    du, dv = net.shape[-4] - 1, net.shape[-3] - 1
    return [du * jnp.diff(net, axis=-4), dv * jnp.diff(net, axis=-3)]


def _bent(net: Array, maxima: Maxima) -> Lanes:
    """The largest |uu| + 2 |uv| + |vv|."""
    by_u, by_v = _derivatives(net)
    (uu, uv), (_, vv) = _derivatives(by_u), _derivatives(by_v)
    found = [times * nets.longest(own, maxima) for own, times in ((uu, 1.0), (uv, 2.0), (vv, 1.0)) if own.size]
    return nets.total([jnp.zeros_like(net[0, 0, 0]), *found])
