"""Which conversion a control mesh gets, and the patches, tables and notes that come of it."""

from __future__ import annotations

from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, ClassVar, Protocol, runtime_checkable

import jax
import numpy as np
from jaxtyping import Bool, Int

from slefejax.arguments import check_choice, check_positive, imported, is_whole, no_such
from slefejax.conversion.acc import ALPHA, Neighbourhood, acc_patches
from slefejax.conversion.catmull_clark import CORNER, refine
from slefejax.conversion.gaussian.products import Dual, Products, patches_of
from slefejax.conversion.gregory_nets import gregory_patches
from slefejax.conversion.limit import (
    LimitSurface,
    irregular_corner,
    limit_of_q,
    limit_surface,
    smooth_sides,
)
from slefejax.conversion.natural import natural_grids
from slefejax.conversion.patchwork import Patchwork
from slefejax.conversion.tangents import tangent_tables
from slefejax.errors import InputError
from slefejax.model.gaussians import Gaussians
from slefejax.model.mesh import Mesh
from slefejax.model.stencils import StencilTable

_MOST_STEPS = 8
_MOST_PATCHES = 2_000_000  # of which the tables alone take a gigabyte


@dataclass(frozen=True, eq=False)
class Conversion:
    """A control mesh and how patches are made of it.

    mesh      : the control mesh as it was read
    scheme    : its name, not ``"auto"``
    finer     : the mesh that patches are made of: ``mesh``, or what subdivision made of it
    patchwork : from the vertices of ``mesh`` to patches; ``.faces`` are those of ``mesh``
    notes     : sentences on what the conversion leaves out, and on what it costs that nobody asked for
    """

    mesh: Mesh
    scheme: str
    finer: Mesh
    patchwork: Patchwork
    notes: tuple[str, ...]

    @cached_property
    def _tangents(self) -> tuple[StencilTable, StencilTable]:
        du, dv = tangent_tables(self.finer, self.patchwork)
        first = self.patchwork.first
        return (du, dv) if first is None else (du @ first, dv @ first)

    @cached_property
    def limit(self) -> LimitSurface:
        """The limit surface that patches approximate, of the vertices of ``mesh``; its faces are those of ``finer``."""
        work, vertices = self.patchwork, self.mesh.vertices
        inputs = vertices if work.products is None else work.products.dual(self.control)
        inputs = inputs if work.first is None else work.first.on_host(inputs)
        if work.products is None:
            return limit_surface(replace(self.finer, vertices=inputs))
        found = limit_of_q(self.finer, inputs)
        return replace(found, net=patches_of(found.net, work.products.dual))

    @property
    def control(self) -> Any:
        """What ``patchwork`` makes patches of: ``mesh.vertices``, or ``Gaussians`` of these."""
        return self.moved(self.mesh.vertices)

    def moved(self, vertices: Any, covariances: Any = None) -> Any:
        """The same of other positions, and of other covariances than the mesh's own."""
        if self.patchwork.products is None:
            return vertices
        return Gaussians(vertices, self.mesh.covariances if covariances is None else covariances)

    def precision(self) -> AbstractContextManager:
        """Within, JAX has the precision that patches are made in: Gaussian products need double precision."""
        return nullcontext() if self.patchwork.products is None else jax.enable_x64(True)

    @property
    def own_faces(self) -> bool:
        """Whether every face of ``finer`` has a patch, in their order: those of a scheme of one's own may not."""
        return self.scheme in SCHEMES

    @cached_property
    def one_irregular(self) -> Bool[np.ndarray, "faces"]:
        """Faces of ``finer`` with one irregular corner, a smooth inner vertex: those that ``natural`` takes."""
        return (irregular_corner(self.finer)[0] >= 0) & self.own_faces

    def natural(self, faces: Int[np.ndarray, "some"], places: int) -> tuple[Any, Any]:
        """Parameters of patches at equal steps, and those of the limit surface (``slefejax.conversion.natural``)."""
        return natural_grids(self.finer, self.patchwork.twists is not None, faces, places)

    @cached_property
    def smooth_sides(self) -> Int[np.ndarray, "edges 2 2"]:
        """Which sides of patches should join smoothly (``slefejax.conversion.limit.smooth_sides``)."""
        return smooth_sides(self.finer) if self.own_faces else np.zeros((0, 2, 2), np.int64)

    def tangents(self, vertices: Any) -> tuple[Any, Any]:
        """Tangent patches for shading, ``(patches, 3, 4, 3)`` along u and ``(patches, 4, 3, 3)`` along v, by JAX.

        Bernstein coefficients of bi-degree (2, 3) and (3, 2); their cross product is a normal that agrees with the
        neighbour's along every smooth inner edge, except next to triangles, corners and vertices of valence 2
        (``slefejax.conversion.tangents``). Raises InputError for Gregory patches and a scheme of one's own: their
        normals are those of the patches.
        """
        work = self.patchwork
        if self.scheme not in SCHEMES or work.twists is not None or work.products is not None:
            raise InputError(f"patches of the scheme {self.scheme!r} have no tangent patches, only their own normals")
        du, dv = self._tangents
        rest = np.shape(vertices)[1:]
        return du(vertices).reshape(-1, 3, 4, *rest), dv(vertices).reshape(-1, 4, 3, *rest)


@runtime_checkable
class Scheme(Protocol):
    """How a control mesh becomes patches: anything that has this method, a scheme of one's own too."""

    def patchwork(self, mesh: Mesh, /) -> Patchwork:
        """Tables from the mesh's vertices to the control points of patches, all of one bi-degree."""
        ...


@dataclass(frozen=True)
class _WithPoints:
    """Schemes of which one rule makes the points, after steps of subdivision or none.

    alpha : of triangles: the weight of a neighbour, positive
    """

    name: ClassVar[str]
    alpha: Any = ALPHA

    def patchwork(self, mesh: Mesh, /) -> Patchwork:
        """As ``convert`` makes them."""
        return self.refined(mesh)[1]

    def refined(self, mesh: Mesh) -> tuple[Mesh, Patchwork]:
        """The mesh that patches are made of, and the tables from the vertices of the one given."""
        self.check(mesh)
        return mesh, self.points(mesh)

    def points(self, mesh: Mesh) -> Patchwork:
        """Without any steps."""
        return acc_patches(mesh, float(self.alpha))

    def check(self, mesh: Mesh) -> None:
        """InputError for numbers out of their range, and for faces that the scheme cannot do with."""
        check_positive("alpha", self.alpha)
        _check_faces(mesh, self.name)


class Acc(_WithPoints):
    """Approximate Catmull-Clark [LS08]: a bicubic patch a quad."""

    name = "acc"


class Pinched(_WithPoints):
    """The same, and pinched quads for triangles [Yeo12].

    >>> from slefejax import load
    >>> load("walker", scheme=Pinched()).patches().shape[1:]
    (4, 4, 3)
    """

    name = "pinched"


class BSpline(_WithPoints):
    """Of regular meshes, where it is exact."""

    name = "bspline"


class Gregory(_WithPoints):
    """Gregory patches [LSNC09]: normals agree across edges. Faces of more than four vertices take a step of the mesh.

    >>> from slefejax import load
    >>> load("walker", scheme="gregory").patches()
    GregoryPatches(2496 of bi-degree 4)
    """

    name = "gregory"

    def refined(self, mesh: Mesh) -> tuple[Mesh, Patchwork]:
        """The mesh, or what a step makes of it, and the tables."""
        if mesh.sizes.max() > 4:
            return SubdividedGregory(self.alpha).refined(mesh)
        return super().refined(mesh)

    def points(self, mesh: Mesh) -> Patchwork:
        """Without any steps."""
        return gregory_patches(mesh)


@dataclass(frozen=True)
class Subdivided(_WithPoints):
    """Steps of Catmull-Clark subdivision first [CC78]: any faces; each step makes four times as many patches."""

    name = "catmull-clark+acc"
    steps: Any = 1

    def refined(self, mesh: Mesh) -> tuple[Mesh, Patchwork]:
        """Subdivided, and the table of all steps."""
        self.check(mesh)
        finer, table, parents = mesh, None, np.arange(mesh.face_count)
        for _ in range(self.steps):
            finer, table, parents = _one_more(finer, table, parents)
        return finer, replace(self.points(finer), faces=parents, first=table)

    def check(self, mesh: Mesh) -> None:
        """InputError for so many steps that there would be too many patches, too."""
        super().check(mesh)
        _check_steps(self.steps)
        made = len(mesh.corners) * 4 ** (self.steps - 1)
        if made > _MOST_PATCHES:
            raise InputError(f"{self.steps} steps would make {made:,} patches, more than {_MOST_PATCHES:,}: take fewer")


@dataclass(frozen=True)
class GaussianProduct(_WithPoints):
    """Gaussian products [PBW19], of meshes with covariances: rational patches of bi-degree 9, one a quad.

    steps : of subdivision before, of the inverse covariances; faces of more than four vertices take one at least

    >>> from slefejax import load
    >>> load("walker", scheme=GaussianProduct(), gaussians="infer").patches().shape
    (2496, 10, 10, 4)
    """

    name = "gaussian"
    steps: Any = 0

    def refined(self, mesh: Mesh) -> tuple[Mesh, Patchwork]:
        """The mesh, or what steps make of it, and the tables and products."""
        steps = max(self.steps, int(mesh.sizes.max() > 4))
        if mesh.covariances is None:
            said = "scheme 'gaussian' needs a covariance at every vertex, and there are none: give gaussians"
            raise InputError(said, options=("gaussians",))
        if steps:
            finer, work = Subdivided(self.alpha, steps).refined(mesh)
        else:
            finer, work = super().refined(mesh)
        products, net = Products.of(work.net, Dual.of(Gaussians(mesh.vertices, mesh.covariances)))
        return finer, replace(work, net=net, products=products)


class SubdividedGregory(Subdivided):
    """The same, and Gregory patches then."""

    name = "catmull-clark+gregory"

    def points(self, mesh: Mesh) -> Patchwork:
        """Without any steps."""
        return gregory_patches(mesh)


_KINDS = (Acc, Pinched, BSpline, Gregory, Subdivided, SubdividedGregory, GaussianProduct)
_BY_NAME: dict[str, type[_WithPoints]] = {own.name: own for own in _KINDS}
_WITH_STEPS = {Subdivided.name: 1, SubdividedGregory.name: 1, GaussianProduct.name: 0}  # how many if not given
SCHEMES = ("auto", *_BY_NAME)


def convert(mesh: Mesh, scheme: Scheme | str = "auto", alpha: Any = ALPHA, steps: Any = None) -> Conversion:
    """Patches of a manifold control mesh.

    scheme : ``"acc"`` for meshes of quads; ``"pinched"`` for quads and triangles; ``"bspline"``, only for regular
             meshes, where it is exact; ``"catmull-clark+acc"`` for any, by steps of subdivision first, each of which
             makes four times as many patches; ``"gregory"`` and ``"catmull-clark+gregory"``: Gregory patches, which
             join smoothly (``slefejax.conversion.gregory``); ``"gaussian"``: Gaussian products of a mesh with
             covariances; ``"auto"``: these where there are covariances, pinched quads where there are triangles (none
             of them quadruples all patches), subdivision only where there are faces of more than four vertices. Or a
             value: ``slefejax.conversion.scheme.Acc()`` …, one's own (``Scheme``), or ``"my_module:MyScheme"``
    alpha  : of triangles: the weight of a neighbour, positive; [Yeo12] takes 2.5
    steps  : of ``"catmull-clark+acc"`` and ``"catmull-clark+gregory"``: how many, 1 if not given; of ``"gaussian"``: 0

    Raises InputError for a scheme that the mesh does not allow, with the number of the face or vertex.
    """
    value = _value(mesh, scheme, alpha, steps)
    if not isinstance(value, _WithPoints):
        return Conversion(mesh, _name(value), mesh, _checked(value.patchwork(mesh), mesh, _name(value)), ())
    finer, patchwork = value.refined(mesh)
    notes = _price_of_ngons(mesh, steps) if scheme == "auto" or isinstance(value, (Gregory, GaussianProduct)) else ()
    return Conversion(mesh, value.name, finer, patchwork, notes + _left_out(mesh, finer, value))


def _value(mesh: Mesh, scheme: Any, alpha: Any, steps: Any) -> Any:
    """The scheme as a value with its numbers."""
    check_positive("alpha", alpha)
    if steps is not None:
        _check_steps(steps)
    if isinstance(scheme, str) and ":" not in scheme:
        check_choice("scheme", scheme, SCHEMES)
        chosen = _automatic(mesh) if scheme == "auto" else scheme
        if alpha != ALPHA and issubclass(_BY_NAME[chosen], (Gregory, SubdividedGregory)):
            said = f"alpha is of triangles' points in 'acc', 'pinched' and their like, not of {chosen!r}"
            raise InputError(said, options=("alpha",))
        if chosen in _WITH_STEPS:
            return _BY_NAME[chosen](alpha, _WITH_STEPS[chosen] if steps is None else steps)  # type: ignore[call-arg]
        if steps is not None:
            said = f"steps belong to the schemes {' and '.join(map(repr, _WITH_STEPS))}, not to {chosen!r}"
            raise InputError(said, options=("steps",))
        return _BY_NAME[chosen](alpha)
    value = imported(scheme, "scheme") if isinstance(scheme, str) else scheme
    value = value() if isinstance(value, type) and isinstance(scheme, str) else value
    if not isinstance(value, Scheme) or isinstance(value, type):
        raise InputError(no_such("scheme", scheme, SCHEMES))
    if steps is not None or alpha != ALPHA:
        name = "alpha" if steps is None else "steps"
        raise InputError(f"the scheme is a value with its numbers, {value!r}: give {name} to it", options=(name,))
    return value


def _check_steps(steps: Any) -> None:
    if not (is_whole(steps, 1) and steps <= _MOST_STEPS):
        raise InputError(f"steps must be a whole number from 1 to {_MOST_STEPS}, not {steps!r}", options=("steps",))


def _name(scheme: Any) -> str:
    """Of a scheme of one's own; those of the package keep theirs."""
    name = str(getattr(scheme, "name", type(scheme).__name__))
    return type(scheme).__name__ if name in SCHEMES else name


def _checked(work: Any, mesh: Mesh, name: str) -> Patchwork:
    """What a scheme of one's own made, or InputError if it is not of this mesh."""
    if not isinstance(work, Patchwork):
        raise InputError(f"scheme {name!r} must make a slefejax Patchwork, not {type(work).__name__}")
    table = work.points if work.first is None else work.first
    if table.columns != mesh.vertex_count:
        raise InputError(
            f"scheme {name!r} made a table for {table.columns} vertices, and the mesh has {mesh.vertex_count}"
        )
    if not len(work.net) == len(work.faces) == len(work.kinds) > 0:
        raise InputError(
            f"scheme {name!r} must make a face and a kind a patch, not {len(work.faces)} and {len(work.kinds)} for"
            f" {len(work.net)} patches"
        )
    if work.net.min() < 0 or work.net.max() >= work.points.rows:
        raise InputError(f"scheme {name!r} made a net with numbers of points that there are not")
    return work


def _one_more(
    mesh: Mesh, table: StencilTable | None, parents: Int[np.ndarray, "faces"]
) -> tuple[Mesh, StencilTable, Int[np.ndarray, "children"]]:
    finer, step, faces = refine(mesh)
    return finer, step if table is None else step @ table, parents[faces]


def _automatic(mesh: Mesh) -> str:
    if mesh.covariances is not None:
        return "gaussian"
    if mesh.sizes.max() > 4:
        return "catmull-clark+acc"
    return "pinched" if mesh.sizes.min() < 4 else "acc"


def _check_faces(mesh: Mesh, scheme: str) -> None:
    """Raise InputError if the scheme cannot do with the faces that there are."""
    most = {"acc": (4, 4), "bspline": (4, 4), "pinched": (3, 4)}.get(scheme)
    if most is None:
        return
    wrong = np.flatnonzero((mesh.sizes < most[0]) | (mesh.sizes > most[1]))
    if wrong.size:
        taken = "quads" if scheme != "pinched" else "quads and triangles"
        other = "'pinched' or 'catmull-clark+acc'" if mesh.sizes.max() <= 4 else "'catmull-clark+acc'"
        raise InputError(
            f"scheme {scheme!r} takes {taken} only, and face {mesh.numbers[wrong[0]]} (counted from 0) has"
            f" {mesh.sizes[wrong[0]]} vertices ({wrong.size} such faces): choose {other}"
        )
    if scheme == "bspline":
        _check_regular(mesh)


def _check_regular(mesh: Mesh) -> None:
    sharp = np.flatnonzero(~mesh.boundary & (mesh.edge_sharpness > 0))
    if sharp.size or np.any(mesh.vertex_sharpness > 0):
        raise InputError("scheme 'bspline' knows no creases: choose 'acc'")
    faces = np.bincount(mesh.corners, minlength=mesh.vertex_count)
    at_boundary = mesh.valence > faces
    irregular = np.flatnonzero((mesh.valence > 0) & np.where(at_boundary, faces > 2, faces != 4))
    if irregular.size:
        vertex = irregular[0]
        raise InputError(
            f"scheme 'bspline' is for regular meshes, and vertex {vertex} (counted from 0) has {faces[vertex]} faces"
            f" ({irregular.size} such vertices): choose 'acc'"
        )


def _price_of_ngons(mesh: Mesh, steps: int | None) -> tuple[str, ...]:
    """What a few faces of more than four vertices cost, where nobody asked for a step of subdivision."""
    count = int(np.sum(mesh.sizes > 4))
    if not count or steps is not None:
        return ()
    faces = "1 face" if count == 1 else f"{count:,} faces"
    return (
        f"{faces} of more than four vertices (n-gons) among {mesh.face_count:,} made a step of subdivision of the whole"
        f" mesh necessary: {len(mesh.corners):,} patches; cut into quads and triangles, every face would be one patch",
    )


def _left_out(mesh: Mesh, finer: Mesh, scheme: _WithPoints) -> tuple[str, ...]:
    alpha = scheme.alpha
    inner = np.where(finer.boundary, 0.0, finer.edge_sharpness)
    rounded = np.append(inner[(inner >= 1) & np.isfinite(inner)], finer.vertex_sharpness[finer.vertex_sharpness >= 1])
    dropped = np.count_nonzero((inner > 0) & (inner < 1)) + np.count_nonzero(
        (finer.vertex_sharpness > 0) & (finer.vertex_sharpness < 1)
    )
    notes = []
    if rounded.size:
        notes.append(
            f"{rounded.size} creases of sharpness up to {rounded.max():g} are drawn infinitely sharp; steps of"
            " 'catmull-clark+acc' follow their sharpness, 1 a step"
        )
    if dropped:
        notes.append(f"{dropped} creases of sharpness below 1 are drawn smooth")
    if alpha != ALPHA and finer.sizes.min() < 4:
        notes.append(
            f"alpha = {alpha:g}: edge points next to triangles are not midway between the interior points on both"
            f" sides, as they are for {ALPHA:g}, so patches join less smoothly there"
        )
    if isinstance(scheme, (Gregory, SubdividedGregory)):
        notes += _not_smooth(finer)
    if isinstance(scheme, GaussianProduct) and finer.sizes.min() < 4:
        notes.append(f"{np.sum(finer.sizes < 4)} triangles are pinched quads")
    if not isinstance(scheme, GaussianProduct) and mesh.covariances is not None:
        notes.append(f"covariances of vertices have no meaning for the scheme {scheme.name!r}, only for 'gaussian'")
    return tuple(notes)


def _not_smooth(mesh: Mesh) -> list[str]:
    """Where nothing is promised about normals of Gregory patches."""
    around = Neighbourhood.of(mesh)
    fans = around.fans
    corners = np.bincount(fans.vertex[around.rule[fans.vertex] == CORNER], minlength=mesh.vertex_count)
    several = np.flatnonzero((corners > 0) & (np.bincount(mesh.corners, minlength=mesh.vertex_count) > corners))
    folds = fans.vertex[fans.closed & (fans.size == 2)]
    odd = np.concatenate([several, folds])
    if not odd.size:
        return []
    return [
        f"patches may not join smoothly at {odd.size} vertices that are corners of several faces or have two edges"
        f" (vertex {odd[0]}, counted from 0)"
    ]
