"""By how much normals of neighbouring patches differ along the edges that they share."""

from __future__ import annotations

from typing import Any

import jax
import numpy as np
from jaxtyping import Float, Int

from slefejax.arguments import Patches, check_patches, on_host
from slefejax.geometry.evaluate import beside_places, evaluate
from slefejax.geometry.normals import TangentNets, tangent_nets
from slefejax.geometry.tangents import unit_normals, with_normals
from slefejax.tessellator.edges import check_edge_numbers

_PLACES = 33  # along an edge
_AT_A_TIME = 8192  # edges


def edge_turns(patches: Patches, edge_numbers: Int[np.ndarray, "patches 4"]) -> Float[np.ndarray, "shared"]:
    """Angles, in degrees, by which the tangent plane turns from a patch to its neighbour: the largest along each edge.

    patches      : polynomial ones, Bézier or Gregory
    edge_numbers : from ``slefejax.tessellator.edges.shared_edges``

    ``normal_jumps`` of the edges that exactly two patches share, in the order in which patches come to them.

    >>> from slefejax.tessellator.edges import shared_edges
    >>> flat = np.array([[[0, 0, 0], [0, 1, 0]], [[1, 0, 0], [1, 1, 0]]], float)[None]
    >>> roof = flat * [1.0, 1.0, 0.0] + [1.0, 0.0, 0.0] + (flat[..., :1]) * [0.0, 0.0, 1.0]
    >>> both = np.concatenate([flat, roof])
    >>> edge_turns(both, shared_edges(both)).round(6).tolist()
    [45.0]
    """
    control = check_patches(patches, gregory=True)
    numbers = check_edge_numbers(edge_numbers, len(control)).ravel()
    order = np.argsort(numbers, kind="stable")
    _, first, count = np.unique(numbers[order], return_index=True, return_counts=True)
    pairs = order[first[count == 2][:, None] + np.arange(2)]
    pairs = pairs[np.argsort(pairs[:, 0])]
    return normal_jumps(control, np.stack(np.divmod(pairs, 4), axis=-1))


def normal_jumps(patches: Any, sides: Int[np.ndarray, "edges 2 2"], tangents: Any = None) -> Float[np.ndarray, "edges"]:
    """The largest angle, in degrees, between tangent planes on both sides of edges, of 33 places along each.

    patches  : polynomial ones, Bézier or Gregory
    sides    : (patch, side) on both sides of every edge, sides u=0, v=0, u=1, v=1; a scene's are
               ``scene.conversion.smooth_sides``
    tangents : tangent patches, such as ``scene.tangents()``, whose planes are looked at instead

    Ends of edges are left out, and places where tangents span no plane. Raises InputError for tangents of others.

    >>> flat = np.array([[[0, 0, 0], [0, 1, 0]], [[1, 0, 0], [1, 1, 0]]], float)[None]
    >>> roof = flat * [1.0, 1.0, 0.0] + [1.0, 0.0, 0.0] + (flat[..., :1]) * [0.0, 0.0, 1.0]
    >>> normal_jumps(np.concatenate([flat, roof]), np.array([[[0, 2], [1, 0]]])).round(6).tolist()
    [45.0]
    """
    control = on_host(check_patches(patches, gregory=True))
    if not len(sides):
        return np.zeros(0)
    if len(sides) > _AT_A_TIME:
        parts = range(0, len(sides), _AT_A_TIME)
        return np.concatenate([normal_jumps(patches, sides[k : k + _AT_A_TIME], tangents) for k in parts])
    places = side_places(_PLACES)
    nets = None if tangents is None else tangent_nets(control, "tangents", tangents)
    (one, n), (other, m) = (
        points_and_normals(control[which], places[side], jax.tree.map(lambda net, own=which: net[own], nets))
        for which, side in sides.transpose(1, 2, 0)
    )
    there, back = (np.abs(one - other[:, ::step]).max(axis=(1, 2)) for step in (1, -1))
    m = np.where((there <= back)[:, None, None], m, m[:, ::-1])
    angle = np.arctan2(np.linalg.norm(np.cross(n, m), axis=-1), np.abs(np.sum(n * m, axis=-1)))
    return np.degrees(angle.max(axis=1))


def points_and_normals(
    patches: Any, parameters: Float[np.ndarray, "patches places 2"], tangents: TangentNets | None = None
) -> tuple[Any, Any]:
    """Points and unit normals ``(patches, places, 3)`` of polynomial patches, each at parameters of its own; by NumPy.

    Normals are the patches', or of tangents if there are any; 0 where there is no tangent plane.

    >>> flat = np.array([[[0, 0, 0], [0, 1, 0]], [[1, 0, 0], [1, 1, 0]]], float)[None]
    >>> points_and_normals(flat, np.array([[[0.5, 0.25]]]))[1].tolist()
    [[[0.0, 0.0, 1.0]]]
    """
    control = beside_places(on_host(patches).astype(np.float64), np)
    nets = jax.tree.map(lambda net: beside_places(net.astype(np.float64), np), tangents)
    with jax.enable_x64(True):
        found = _normals_jit(control, nets, *np.moveaxis(np.asarray(parameters, np.float64), -1, 0))
    points, normals = (np.moveaxis(np.asarray(x), 0, -1) for x in found)
    return points, normals


def side_places(count: int) -> Float[np.ndarray, "4 count 2"]:
    """Parameters (u, v) of places inside of the sides u=0, v=0, u=1, v=1.

    >>> side_places(1).tolist()
    [[[0.0, 0.5]], [[0.5, 0.0]], [[1.0, 0.5]], [[0.5, 1.0]]]
    """
    t = (np.arange(count) + 0.5) / count
    zero, one = np.zeros(count), np.ones(count)
    return np.stack([np.stack(side, axis=-1) for side in ((zero, t), (t, zero), (one, t), (t, one))])


@jax.jit
def _normals_jit(control: Any, nets: TangentNets | None, u: Any, v: Any) -> tuple[Any, Any]:
    if nets is None:
        return with_normals(control, u, v)
    return evaluate(control, u, v), unit_normals(*(evaluate(net, u, v) for net in nets))
