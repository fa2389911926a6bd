"""A ring whose outer ridge is round on one side and sharp on the other, by covariances alone."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from slefejax.io.content import Content
from slefejax.model.mesh import Mesh

_AROUND, _ACROSS = 24, 8
_RADIUS, _THICKNESS = 1.0, 0.4
_SHARPEST = 2.0  # decimal logarithm of the condition number of the sharpest Gaussian


def ring() -> Content:
    """A torus of 24 x 8 quads, no tags: Gaussians go from balls, at x < 0, to flat and long ones, at x > 0.

    At the ridge they are long along it, beside it flat along its two flanks.

    >>> mesh = ring().mesh
    >>> mesh.face_count, mesh.covariances.shape
    (192, (192, 3, 3))
    """
    turn, across = np.meshgrid(*(2 * np.pi * np.arange(n) / n for n in (_AROUND, _ACROSS)), indexing="ij")
    outward = np.stack([np.cos(turn), np.sin(turn), 0 * turn], axis=-1)
    up = np.broadcast_to([0.0, 0.0, 1.0], outward.shape)
    # round inside, with two straight flanks outside
    out, high = np.cos(across), np.sin(across)
    size = np.where(out > 1e-9, np.abs(out) + np.abs(high), 1.0)
    section = (out / size)[..., None] * outward + (high / size)[..., None] * up
    normal = (outward + np.sign(np.sin(across))[..., None] * up) / np.sqrt(2.0)
    thin = 10.0 ** (-_SHARPEST * (0.5 + 0.5 * np.cos(turn)))[..., None, None]
    one = np.eye(3)
    long, flat = (x[..., :, None] * x[..., None, :] for x in (np.cross(up, outward), normal))
    place = np.minimum(np.arange(_ACROSS), np.arange(_ACROSS)[::-1] + 1)[:, None, None]  # away from the ridge
    covariances = np.where(place == 0, thin * one + (1.0 - thin) * long, one - (1.0 - thin) * flat * (place == 1))
    i, j = np.divmod(np.arange(_AROUND * _ACROSS), _ACROSS)
    number = lambda i, j: i % _AROUND * _ACROSS + j % _ACROSS  # noqa: E731
    faces = np.stack([number(i, j), number(i + 1, j), number(i + 1, j + 1), number(i, j + 1)], axis=1)
    means = (_RADIUS * outward + _THICKNESS * section).reshape(-1, 3)
    mesh = Mesh.packed(means, faces.ravel(), np.full(len(faces), 4))
    return Content(mesh=replace(mesh, covariances=covariances.reshape(-1, 3, 3)))
