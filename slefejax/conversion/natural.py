"""Which natural parameters of the limit surface belong to the parameters of a patch at an irregular vertex.

Around a vertex of valence n there is a net of the plane that a step of subdivision only shrinks: the subdominant
eigenvectors are its coordinates. There both the patch and the limit surface are maps chi from the square to the plane:

    phi = chi_limit^-1 o chi_patch

says, for every net, where the limit surface is that the patch should be compared with. The difference patch(u, v) -
limit(phi(u, v)) is linear in the net and vanishes for constants and both eigenvectors: what the patch does to (u, v)
costs nothing. On the two sides away from the vertex phi is the identity, and it maps the other two to themselves.
"""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from slefejax.conversion.acc import acc_patches
from slefejax.conversion.catmull_clark import refine
from slefejax.conversion.gregory import eigenvalue
from slefejax.conversion.gregory_nets import gregory_patches
from slefejax.conversion.limit import CORNERS, FRAMES, irregular_corner, limit_surface
from slefejax.geometry.evaluate import evaluate_patches
from slefejax.geometry.nearest import Surfaces
from slefejax.model.mesh import Mesh

_RINGS = 2  # of faces around the vertex: all that the patch depends on


def natural_grids(
    mesh: Mesh, gregory: bool, faces: Int[np.ndarray, "some"], places: int
) -> tuple[Float[np.ndarray, "some places places 2"], Float[np.ndarray, "some places places 2"]]:
    """Parameters of patches at equal steps, and the natural ones that belong to them, of some of the faces.

    Faces must have one irregular corner (``irregular_corner``); the first steps go away from it.
    """
    corner, valence = (x[faces] for x in irregular_corner(mesh))
    natural = np.stack([natural_parameters(int(n), gregory, places) for n in valence])
    t = np.linspace(0.0, 1.0, places)
    own = np.broadcast_to(np.stack(np.meshgrid(t, t, indexing="ij"), axis=-1), natural.shape)
    turned = [CORNERS[corner][:, None, None] + np.einsum("fij,fuvj->fuvi", FRAMES[corner], x) for x in (own, natural)]
    return turned[0], turned[1]


@lru_cache(maxsize=256)
def natural_parameters(valence: int, gregory: bool, places: int) -> Float[np.ndarray, "places places 2"]:
    """phi at equal steps of u and v, of a quad whose corner (0, 0) is a smooth inner vertex of that valence.

    >>> natural_parameters(4, True, 3).round(9)[1, 2].tolist()
    [0.5, 1.0]
    """
    mesh = characteristic_mesh(valence)
    t = np.linspace(0.0, 1.0, places)
    grid = np.stack(np.meshgrid(t, t, indexing="ij"), axis=-1).reshape(-1, 2)
    patch = (gregory_patches if gregory else acc_patches)(mesh).on_host(mesh.vertices)[:1]
    points = np.asarray(evaluate_patches(patch, grid))[0]
    limit = limit_surface(mesh)
    own = np.flatnonzero(limit.face == 0)
    found = Surfaces(limit.net[own]).nearest(points)
    part = own[found.patch]
    phi = limit.origin[part] + np.einsum("pij,pj->pi", limit.frame[part], found.parameters)
    return phi.reshape(places, places, 2)


def characteristic_mesh(valence: int) -> Mesh:
    """Quads around vertex 0, a flat net that a step of subdivision makes smaller by the subdominant eigenvalue.

    >>> characteristic_mesh(5).face_count
    20
    """
    number: dict[Any, int] = {}
    of = lambda place: number.setdefault(_canonical(place, valence), len(number))  # noqa: E731
    of((0, 0, 0))
    faces = [
        [of(place) for place in ((k, i, j), (k, i + 1, j), (k, i + 1, j + 1), (k, i, j + 1))]
        for k in range(valence)
        for i in range(_RINGS)
        for j in range(_RINGS)
    ]
    places = np.array(list(number))
    angle = 2.0 * np.pi * np.stack([places[:, 0], places[:, 0] + 1]) / valence
    start = sum(c * np.stack([np.cos(a), np.sin(a)], axis=1) for c, a in zip(places.T[1:, :, None], angle, strict=True))
    mesh = Mesh.of(np.concatenate([start, np.zeros((len(places), 1))], axis=1), faces)
    step = _step(mesh, places, number, valence)
    shifted = step - (eigenvalue(float(valence)) + 1e-9) * np.eye(len(step))
    plane = start
    for _ in range(4):
        plane = np.linalg.solve(shifted, plane)
        plane /= np.abs(plane).max()
    return replace(mesh, vertices=np.concatenate([plane, np.zeros((len(places), 1))], axis=1))


def _canonical(place: tuple[int, int, int], valence: int) -> tuple[int, int, int]:
    """Of a vertex i edges out along spoke k and j along the next one."""
    k, i, j = place
    if i == 0 and j == 0:
        return 0, 0, 0
    return ((k + 1) % valence, j, 0) if i == 0 else (k % valence, i, j)


def _step(mesh: Mesh, places: np.ndarray, number: dict[Any, int], valence: int) -> Float[np.ndarray, "n n"]:
    """A step of subdivision: from the vertices to those of the same mesh, half as large."""
    table = refine(mesh)[1]
    pairs = {tuple(sorted(pair)): e for e, pair in enumerate(mesh.edge_vertices.tolist())}
    quads = {tuple(sorted(face)): f for f, face in enumerate(mesh.corners.reshape(-1, 4).tolist())}
    rows = []
    for k, i, j in places.tolist():
        ends = sorted(
            {number[_canonical((k, a, b), valence)] for a in {i // 2, (i + 1) // 2} for b in {j // 2, (j + 1) // 2}}
        )
        if len(ends) == 1:
            rows.append(ends[0])
        elif len(ends) == 2:
            rows.append(mesh.vertex_count + pairs[tuple(ends)])
        else:
            rows.append(mesh.vertex_count + mesh.edge_count + quads[tuple(ends)])
    return table.take(rows).matrix.toarray()
