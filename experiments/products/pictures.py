"""Pictures of surfaces and of the Gaussians at their vertices."""

from __future__ import annotations

from typing import Any

import numpy as np

from slefejax import View
from slefejax.experiments.products.spreads import vertex_normals
from slefejax.geometry.view import homogeneous
from slefejax.gpu import GBuffer
from slefejax.measure.jumps import points_and_normals
from slefejax.model.mesh import Mesh

_SIZE = 0.3  # of the median edge: the median of the ellipsoids' longest half axes, as they are drawn
_PLACES = 33  # of an outline
_AT_A_TIME = 20_000  # pixels
_BESIDE = (0.35, 0.55, 0.75)  # where light comes from: to the right, up, towards the camera


def shaded(patches: Any, view: View, seen: GBuffer) -> np.ndarray:
    """``(height, width)``, row 0 at the top: 0 to 1, NaN for background.

    seen : what was drawn of them, of which the exact normals are taken
    """
    camera = view.camera
    eye = np.asarray(camera.eye, float)
    towards = eye - np.asarray(camera.target, float)
    towards /= np.linalg.norm(towards)
    right = np.cross(np.asarray(camera.up, float), towards)
    right /= np.linalg.norm(right)
    light = np.stack([right, np.cross(towards, right), towards], axis=1) @ _BESIDE
    light /= np.linalg.norm(light)
    there = seen.patch >= 0
    which, place = seen.patch[there], np.stack([seen.u[there], seen.v[there]], axis=1).astype(float)
    shades = [
        _shades(patches, which[k : k + _AT_A_TIME], place[k : k + _AT_A_TIME], eye, light)
        for k in range(0, len(which), _AT_A_TIME)
    ]
    picture = np.full(there.shape, np.nan)
    picture[there] = np.concatenate(shades) if shades else 0.0
    return picture[::-1]


def _shades(patches: Any, which: np.ndarray, place: np.ndarray, eye: np.ndarray, light: np.ndarray) -> np.ndarray:
    points, normals = (x[:, 0] for x in points_and_normals(patches[which], place[:, None]))
    facing = np.sign(np.sum(normals * (eye - points), axis=1))
    return 0.15 + 0.85 * np.clip(facing * (normals @ light), 0.0, 1.0)


def with_ellipsoids(mesh: Mesh, view: View) -> tuple[np.ndarray, np.ndarray]:
    """Edges ``(edges, 2, 2)`` and outlines ``(outlines, places, 2)`` in pixels, of what faces the camera.

    Outlines are of ellipsoids of constant density, all scaled alike; ellipses, as of a view from afar.
    """
    assert mesh.covariances is not None
    facing = np.sum(vertex_normals(mesh) * (np.asarray(view.camera.eye) - mesh.vertices), axis=1) > 0
    if not view.camera.perspective:
        facing[:] = True
    matrix = np.asarray(view.world_to_screen)
    screen = homogeneous(mesh.vertices) @ matrix.T
    place = screen[:, :2] / screen[:, 3:]
    slope = (matrix[:2, :3] - place[:, :, None] * matrix[3, :3]) / screen[:, 3, None, None]
    ends = mesh.vertices[mesh.edge_vertices]
    edge = np.median(np.linalg.norm(ends[:, 0] - ends[:, 1], axis=1))
    longest = np.median(np.sqrt(np.linalg.eigvalsh(mesh.covariances)[:, 2]))
    flat = (_SIZE * edge / longest) ** 2 * slope @ mesh.covariances @ np.swapaxes(slope, 1, 2)
    angle = np.linspace(0.0, 2.0 * np.pi, _PLACES)
    circle = np.stack([np.cos(angle), np.sin(angle)])
    values, vectors = np.linalg.eigh(flat)
    own = (vectors * np.sqrt(np.maximum(values, 0.0))[:, None]) @ circle
    outlines = place[facing, None] + np.swapaxes(own, 1, 2)[facing]
    both = facing[mesh.edge_vertices].all(axis=1)
    return place[mesh.edge_vertices[both]], outlines
