"""The triangles that a tessellator makes of patches, without OpenGL: parameters, positions, normals, faces."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import jax
import numpy as np
from jaxtyping import Float, Int

from slefejax.arguments import Patches, check_patches, on_host, real_numbers, whole_numbers
from slefejax.errors import InputError
from slefejax.geometry.bezier import bernstein, derivative
from slefejax.geometry.evaluate import as_control
from slefejax.geometry.gregory import GregoryPatches, Twisted, twist_basis, twist_slopes
from slefejax.geometry.view import homogeneous
from slefejax.tessellator.direct3d11 import tessellate
from slefejax.tessellator.edges import Sides, edge_points
from slefejax.tessellator.levels import (
    GRID,
    MOST_LEVEL,
    Pieces,
    check_spacing,
    highest_level,
    shares,
    triangle_counts,
)

_MOST = 2**27  # triangles
_BLOCK = 2**15  # vertices that are evaluated at once
_INSIDE = 2.0**-16  # of the domain, towards the middle: where a normal is taken that is not defined on the rim
_SINGULAR = 1e-10  # of the product of both derivatives' largest sizes: a normal shorter than that is no direction


@dataclass(frozen=True, eq=False)
class Triangulation:
    """Patches as triangles.

    patch      : whose a vertex is; patches share none, but vertices on a shared side are equal bit for bit
    parameters : (u, v) of vertices, what the driver's are too; multiples of 2^-24
    faces      : numbers of three vertices, counter-clockwise in the domain, patch after patch
    """

    patch: Int[np.ndarray, "vertices"]
    parameters: Float[np.ndarray, "vertices 2"]
    faces: Int[np.ndarray, "triangles 3"]
    _patches: Any = field(repr=False)
    _sides: Sides | None = field(default=None, repr=False)

    @cached_property
    def positions(self) -> Float[np.ndarray, "vertices 3"]:
        """Points of the surface in scene units, float64."""
        found = self._through(_positions, self.parameters)
        if self._sides is not None:
            for along_u in (False, True):
                at, points = _on_sides(_nets(self._patches), self._sides, self.patch, self.parameters, along_u)
                found[at] = points
        return found

    @cached_property
    def normals(self) -> Float[np.ndarray, "vertices 3"]:
        """Unit normals of the surface, along p_u x p_v; beside a vertex where it has none, such as on a collapsed side.

        0 where there is none either.
        """
        found = self._through(_normals, self.parameters)
        lost = np.flatnonzero(~found.any(axis=1))
        inside = self.parameters + _INSIDE * np.sign(0.5 - self.parameters)
        found[lost] = self._through(_normals, inside, lost)
        return found

    def _through(self, function: Callable[..., np.ndarray], parameters: np.ndarray, which: Any = None) -> np.ndarray:
        which = np.arange(len(parameters)) if which is None else which
        found = np.empty((len(which), 3))
        for start in range(0, len(which), _BLOCK):
            own = which[start : start + _BLOCK]
            control = as_control(self._patches[self.patch[own]])
            control = jax.tree.map(lambda x: np.moveaxis(x, 0, -1), control)
            found[start : start + _BLOCK] = function(control, *parameters[own].T).T
        return found


def triangulate(patches: Patches, factors: Any, spacing: str = "equal", sides: Sides | None = None) -> Triangulation:
    """What Direct3D 11's tessellator makes of patches cut by these levels (``slefejax.tessellator.direct3d11``).

    patches : control points ``(patches, du+1, dv+1, 3)``, or 4 at the end if rational
    factors : a ``Factors``, or (inner, edges): levels ``(patches, 2)`` along u and v and ``(patches, 4)`` at u=0, v=0,
              u=1, v=1; 0 on an edge leaves a patch out. Past 64 patches are cut as for drawing, and what pieces have in
              common is one vertex
    spacing : ``"equal"``, ``"fractional-even"`` or ``"fractional-odd"``, for which levels are real numbers up to 64
    sides   : which curve each side is (``tessellator.edges``): positions on it are points of its owner. If they are not
              given, sides are shared where their points are equal, or equal once raised to one degree

    If a patch is cut, all vertices are placed with 24 bits (docs/certified.md, section 6), as in a picture with it;
    else with 16. Raises InputError for levels of the wrong shape or kind, or that nobody could draw.

    >>> quad = np.array([[[0, 0, 0], [0, 1, 0]], [[1, 0, 0], [1, 1, 0]]], float)
    >>> made = triangulate(quad[None], ([[2, 2]], [[2, 2, 2, 2]]))
    >>> made.faces.shape, made.positions[made.faces[0]].tolist()
    ((8, 3), [[0.0, 0.0, 0.0], [0.5, 0.0, 0.0], [0.5, 0.5, 0.0]])
    """
    given = on_host(check_patches(patches, gregory=True))
    inner, outer = _checked_levels(factors, len(given), spacing)
    if sides is None and given.shape[1] != given.shape[2]:
        sides = Sides.of(given)
    given = given.astype(np.float64)
    parts = Pieces.of(inner, outer, spacing)
    made = tessellate(parts.inner, parts.outer, spacing)
    if np.all(parts.along == 1):
        return Triangulation(made.patch, made.parameters(), made.triangles, given, sides)
    place, along = parts.place[made.patch], parts.along[made.patch]
    steps = shares(place * made.segments + made.point, along * made.segments)
    patch, steps, number = _without_twins(parts.patch[made.patch], steps)
    return Triangulation(patch, steps * GRID, number[made.triangles], given, sides)


def _without_twins(
    patch: Int[np.ndarray, "n"], steps: Int[np.ndarray, "n 2"]
) -> tuple[Int[np.ndarray, "m"], Int[np.ndarray, "m 2"], Int[np.ndarray, "n"]]:
    """Vertices of patches at different places, patch after patch, and the number of each one among them."""
    order = np.lexsort((steps[:, 1], steps[:, 0], patch))
    own, places = patch[order], steps[order]
    new = np.ones(len(order), bool)
    new[1:] = (own[1:] != own[:-1]) | np.any(places[1:] != places[:-1], axis=1)
    number = np.empty(len(order), np.int64)
    number[order] = np.cumsum(new) - 1
    return own[new], places[new], number


def _checked_levels(factors: Any, count: int, spacing: str) -> tuple[np.ndarray, np.ndarray]:
    check_spacing(spacing)
    if hasattr(type(factors), "edges"):
        inner, outer = factors.inner, factors.edges
    elif isinstance(factors, (tuple, list)) and len(factors) == 2:
        inner, outer = factors
    else:
        raise InputError(f"levels are a Factors or a pair (inner, edges), not {type(factors).__name__}")
    numbers = whole_numbers if spacing == "equal" else real_numbers
    inner, outer = numbers(inner, "levels"), numbers(outer, "levels")
    if inner.shape != (count, 2) or outer.shape != (count, 4):
        raise InputError(
            f"levels of {count} patches must have shapes ({count}, 2) and ({count}, 4), not {inner.shape} and"
            f" {outer.shape}"
        )
    highest = MOST_LEVEL if spacing == "equal" else highest_level(spacing)
    if not min(inner.min(), outer.min()) >= 0 or max(inner.max(), outer.max()) > highest:
        raise InputError(f"levels must be from 0 to {highest}, the most that can be drawn; 0 leaves a patch out")
    total = int(triangle_counts(inner, outer, spacing).sum())
    if total > _MOST:
        raise InputError(
            f"these levels make {total:,} triangles, and {_MOST:,} at once are the most: take fewer patches"
        )
    return inner, outer


def _symmetric_sum(coefficients: Any, basis: list[Any]) -> Any:
    """The sum of coefficients times basis over the first axis; reversing both changes no bit of it."""
    terms = [c * b for c, b in zip(coefficients, basis, strict=True)]
    half, count = len(terms) // 2, len(terms)
    pairs = [terms[k] + terms[count - 1 - k] for k in range(half)] + terms[half : half + count % 2]
    total = pairs[0]
    for pair in pairs[1:]:
        total = total + pair
    return total


def _at(control: Any, u: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Homogeneous points; on a side its own control points alone count, and neither direction nor axis does."""
    if isinstance(control, Twisted):
        terms = twist_basis(len(control.twists), u, v)  # 0 on sides
        return _at(control.net, u, v) + _symmetric_sum(control.twists, terms)
    across = bernstein(control.shape[1] - 1, v)
    rows = [_symmetric_sum(row, across) for row in control]
    return _symmetric_sum(rows, bernstein(control.shape[0] - 1, u))


def _nets(patches: Any) -> np.ndarray:
    """Of Gregory patches: their sides are the nets'."""
    return patches.net if isinstance(patches, GregoryPatches) else patches


def _positions(control: Any, u: np.ndarray, v: np.ndarray) -> np.ndarray:
    point = _at(control, u, v)
    return point[:3] / point[3:] if len(point) == 4 else point


def _on_sides(
    patches: np.ndarray, sides: Sides, patch: np.ndarray, parameters: np.ndarray, along_u: bool
) -> tuple[Int[np.ndarray, "n"], Float[np.ndarray, "n 3"]]:
    """Vertices on sides whose owners run along u, or v, and these owners' points there.

    A corner belongs to two sides, whose owners end in equal points.
    """
    u, v = parameters.T
    edge = np.select([u == 0, u == 1, v == 0, v == 1], [0, 2, 1, 3], -1)
    owner = np.where(edge >= 0, sides.owner[patch, edge], -1)
    at = np.flatnonzero((owner >= 0) & (owner % 2 == along_u))
    own, whose = (patch[at], edge[at]), owner[at]
    first, last = sides.first[own], sides.last[own]
    t = first + np.where(edge[at] % 2 == 0, v[at], u[at]) * (last - first)
    curves = np.stack(edge_points(patches)[int(along_u) :: 2], axis=1)
    points = _symmetric_sum(np.moveaxis(curves[whose // 4, whose % 4 // 2], 0, -1), bernstein(curves.shape[2] - 1, t))
    return at, (points[:3] / points[3:] if len(points) == 4 else points).T


def _normals(control: Any, u: np.ndarray, v: np.ndarray) -> np.ndarray:
    """p_u x p_v at length 1; 0 where that has no direction."""
    control, twists = control if isinstance(control, Twisted) else (control, None)
    control = np.moveaxis(homogeneous(np.moveaxis(control, 2, -1)), -1, 2)
    point = _at(control, u, v)
    nets = derivative(control), np.swapaxes(derivative(np.swapaxes(control, 0, 1)), 0, 1)
    # times w, whatever its size
    along_u, along_v = ((t := _at(net, u, v))[:3] * point[3] - point[:3] * t[3] for net in nets)
    if twists is not None:
        slopes = twist_slopes(len(twists), u, v)
        along_u, along_v = (own + _symmetric_sum(twists, s) for own, s in zip((along_u, along_v), slopes, strict=True))
    cross = np.cross(along_u, along_v, axis=0)
    length = np.linalg.norm(cross, axis=0)
    size = np.prod([np.abs(net).max(axis=(0, 1, 2)) for net in nets], axis=0) * point[3] ** 2
    fine = length > _SINGULAR * size
    return np.where(fine, cross / np.where(fine, length, 1.0), 0.0)
