"""Which conversion a control mesh gets, and the patches, tables and notes that come of it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from jaxtyping import Int

from slefejax.arguments import check_choice, check_positive, is_whole
from slefejax.conversion.acc import ALPHA, acc_patches
from slefejax.conversion.catmull_clark import refine
from slefejax.conversion.patchwork import Patchwork
from slefejax.conversion.tangents import tangent_tables
from slefejax.errors import InputError
from slefejax.model.mesh import Mesh
from slefejax.model.stencils import StencilTable

SCHEMES = ("auto", "acc", "pinched", "bspline", "catmull-clark+acc")
_MOST_STEPS = 8
_MOST_PATCHES = 2_000_000  # of which the tables alone take a gigabyte


@dataclass(frozen=True, eq=False)
class Conversion:
    """A control mesh and how patches are made of it.

    mesh      : the control mesh as it was read
    scheme    : one of SCHEMES, not ``"auto"``
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

    def tangents(self, vertices: Any) -> tuple[Any, Any]:
        """Tangent patches for shading, ``(patches, 3, 4, 3)`` along u and ``(patches, 4, 3, 3)`` along v, by JAX.

        Bernstein coefficients of bi-degree (2, 3) and (3, 2); their cross product is a normal that agrees with the
        neighbour's along every smooth inner edge, except next to triangles, corners and vertices of valence 2
        (``slefejax.conversion.tangents``).
        """
        du, dv = self._tangents
        rest = np.shape(vertices)[1:]
        return du(vertices).reshape(-1, 3, 4, *rest), dv(vertices).reshape(-1, 4, 3, *rest)


def convert(mesh: Mesh, scheme: str = "auto", alpha: Any = ALPHA, steps: Any = None) -> Conversion:
    """Patches of a manifold control mesh.

    scheme : ``"acc"`` for meshes of quads; ``"pinched"`` for quads and triangles; ``"bspline"``, only for regular
             meshes, where it is exact; ``"catmull-clark+acc"`` for any, by steps of subdivision first, each of which
             makes four times as many patches; ``"auto"``: pinched quads where there are triangles (none of them
             quadruples all patches), subdivision only where there are faces of more than four vertices
    alpha  : of triangles: the weight of a neighbour, positive; [Yeo12] takes 2.5
    steps  : of ``"catmull-clark+acc"``: how many; 1 if not given

    Raises InputError for a scheme that the mesh does not allow, with the number of the face or vertex.
    """
    _check(scheme, alpha, steps)
    chosen = _automatic(mesh) if scheme == "auto" else scheme
    if steps is not None and chosen != "catmull-clark+acc":
        raise InputError(f"steps belong to the scheme 'catmull-clark+acc', not to {chosen!r}", options=("steps",))
    _check_faces(mesh, chosen)
    if chosen == "catmull-clark+acc" and len(mesh.corners) * 4 ** ((steps or 1) - 1) > _MOST_PATCHES:
        made = len(mesh.corners) * 4 ** ((steps or 1) - 1)
        raise InputError(f"{steps or 1} steps would make {made:,} patches, more than {_MOST_PATCHES:,}: take fewer")
    finer, table, parents = mesh, None, np.arange(mesh.face_count)
    for _ in range((steps or 1) if chosen == "catmull-clark+acc" else 0):
        finer, table, parents = _one_more(finer, table, parents)
    own = acc_patches(finer, float(alpha))
    patchwork = replace(own, faces=parents, first=table)
    notes = _price_of_ngons(mesh, steps) if scheme == "auto" else ()
    return Conversion(mesh, chosen, finer, patchwork, notes + _left_out(finer, alpha))


def _one_more(
    mesh: Mesh, table: StencilTable | None, parents: Int[np.ndarray, "faces"]
) -> tuple[Mesh, StencilTable, Int[np.ndarray, "children"]]:
    finer, step, faces = refine(mesh)
    return finer, step if table is None else step @ table, parents[faces]


def _check(scheme: str, alpha: Any, steps: Any) -> None:
    check_choice("scheme", scheme, SCHEMES)
    check_positive("alpha", alpha)
    if steps is not None and not (is_whole(steps, 1) and steps <= _MOST_STEPS):
        raise InputError(f"steps must be a whole number from 1 to {_MOST_STEPS}, not {steps!r}", options=("steps",))


def _automatic(mesh: Mesh) -> str:
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


def _left_out(finer: Mesh, alpha: float) -> tuple[str, ...]:
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
    return tuple(notes)
