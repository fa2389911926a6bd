"""Control meshes for tests: grids, discs around a vertex of any valence, fans of triangles, random positions."""

from __future__ import annotations

import numpy as np

from slefejax.model.mesh import Mesh


def grid(nu, nv, closed_u=False, closed_v=False, rng=None):
    """nu x nv vertices (u first) joined to quads, wrapped around where closed; faces counter-clockwise in (u, v)."""
    number = np.arange(nu * nv).reshape(nu, nv)
    rows, columns = nu - (not closed_u), nv - (not closed_v)
    faces = [
        (number[i, j], number[(i + 1) % nu, j], number[(i + 1) % nu, (j + 1) % nv], number[i, (j + 1) % nv])
        for i in range(rows)
        for j in range(columns)
    ]
    u, v = np.meshgrid(np.arange(nu, dtype=float), np.arange(nv, dtype=float), indexing="ij")
    places = np.stack([u, v, 0 * u], axis=-1).reshape(-1, 3)
    if rng is not None:
        places = places + rng.normal(size=places.shape) * 0.3
    return Mesh.of(places, faces)


def disc(valence, rings=2, rng=None, half=False):
    """Quads in ``valence`` sectors around vertex 0; half of the sectors only, so that vertex 0 is at the boundary."""
    numbers = {}
    places: list[np.ndarray] = [np.zeros(3)]

    def vertex(k, i, j):
        if i == 0 and j == 0:
            return 0
        if i == 0:
            k, i, j = (k + 1) % valence, j, 0
        if (k, i, j) not in numbers:
            a, b = 2 * np.pi * k / valence, 2 * np.pi * (k + 1) / valence
            numbers[k, i, j] = len(places)
            places.append(np.array([i * np.cos(a) + j * np.cos(b), i * np.sin(a) + j * np.sin(b), 0.0]))
        return numbers[k, i, j]

    sectors = valence // 2 if half else valence
    faces = [
        (vertex(k, i, j), vertex(k, i + 1, j), vertex(k, i + 1, j + 1), vertex(k, i, j + 1))
        for k in range(sectors)
        for i in range(rings)
        for j in range(rings)
    ]
    noise = 0.0 if rng is None else rng.normal(size=(len(places), 3))
    return Mesh.of(np.array(places) + noise, faces)


def triangle_fan(valence, rng=None):
    """Triangles around vertex 0, and a ring of quads around them."""
    angles = 2 * np.pi * np.arange(valence) / valence
    ring = np.stack([np.cos(angles), np.sin(angles), 0 * angles], axis=1)
    places = np.concatenate([np.zeros((1, 3)), ring, 2 * ring, 3 * ring])
    faces = []
    for k in range(valence):
        a, b = 1 + k, 1 + (k + 1) % valence
        faces.append((0, a, b))
        for step in (0, valence):
            faces.append((a + step, a + step + valence, b + step + valence, b + step))
    if rng is not None:
        places = places + 0.2 * rng.normal(size=places.shape)
    return Mesh.of(places, faces)


def cube():
    """The corners 0 and 1, faces counter-clockwise seen from outside."""
    places = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], float)
    faces = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    return Mesh.of(places, faces)


def mixed(rng):
    """A closed mesh with a triangle, quads and pentagons: a cube with a corner cut off."""
    places = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], float)
    places[7] = (0.5, 1, 1)
    places = np.concatenate([places, [[1, 0.5, 1], [1, 1, 0.5]]]) + 0.05 * rng.normal(size=(10, 3))
    faces = [
        (0, 1, 3, 2), (4, 6, 9, 8, 5), (0, 4, 5, 1), (2, 3, 7, 9, 6), (0, 2, 6, 4), (1, 5, 8, 7, 3), (7, 8, 9),
    ]  # fmt: skip
    return Mesh.of(places, faces)
