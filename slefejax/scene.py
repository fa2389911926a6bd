"""A scene: patches and the camera to look at them with."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int

from slefejax.bezier import elevate
from slefejax.data.small import (
    QUAD_EYE,
    QUAD_TARGET,
    STEEP_EYE,
    STEEP_FOV,
    STEEP_TARGET,
    steep_patch,
    twisted_quad,
)
from slefejax.data.teapot import EYE, TARGET, teapot
from slefejax.edges import shared_edges
from slefejax.errors import InputError
from slefejax.io.bpt import read_bpt
from slefejax.view import Camera, frame


@dataclass(frozen=True)
class Scene:
    """Patches with a name, and what was noticed when they were read.

    control : ``(patches, du+1, dv+1, 3)`` float64
    camera  : the camera that belongs to the scene, or None: ``default_camera`` then frames it
    notes   : sentences about what loading changed
    """

    name: str
    control: Float[np.ndarray, "patches nu nv dim"]
    camera: Camera | None = None
    notes: tuple[str, ...] = field(default=())

    def patches(self) -> Float[np.ndarray, "patches nu nv dim"]:
        """Control points at rest, ``(patches, du+1, dv+1, 3)``, u before v."""
        return self.control

    @cached_property
    def edge_numbers(self) -> Int[np.ndarray, "patches 4"]:
        """Which edges are shared (``slefejax.edges.shared_edges``), found once."""
        return shared_edges(self.control)

    def points(self) -> Float[np.ndarray, "points 3"]:
        """All control points, divided by their weights if there are any."""
        points = self.control[..., :3] / (self.control[..., 3:] if self.control.shape[-1] == 4 else 1.0)
        return points.reshape(-1, 3)

    def default_camera(self, aspect: float = 1.6) -> Camera:
        """The scene's own camera, or one that holds all of it in a picture of that width over height."""
        return self.camera or frame(self.points(), aspect=aspect)


def load(path: str | Path) -> Scene:
    """A scene from a file (``.bpt``) or by its built-in name (``"teapot"``, ``"twisted-quad"``,
    ``"steep-patch"``).

    Patches of different degrees are raised to the highest ones, which leaves their shape as it is; the scene's notes
    say so. Raises InputError for a file that is missing, of an unknown kind, or not what its name says.

    >>> load("teapot").patches().shape
    (32, 4, 4, 3)
    """
    if str(path) in BUILT_IN:
        return BUILT_IN[str(path)]()
    if not isinstance(path, (str, Path)):
        raise InputError(f"a file name or a built-in scene is needed, not {path!r}")
    path = Path(path)
    reader = READERS.get(path.suffix.lower())
    if reader is None:
        raise InputError(
            f"{path}: files of this kind are not read; give a file ending in {', '.join(READERS)}"
            f" or a built-in scene ({', '.join(BUILT_IN)})"
        )
    control, notes = _common_degree(reader(path))
    return Scene(path.stem, control, notes=notes)


def _common_degree(patches: list[np.ndarray]) -> tuple[np.ndarray, tuple[str, ...]]:
    degrees = np.array([np.subtract(patch.shape[:2], 1) for patch in patches])
    du, dv = degrees.max(axis=0).tolist()
    raised = int(np.any(degrees != (du, dv), axis=1).sum())
    if raised == 0:
        return np.stack(patches), ()
    same = [np.swapaxes(elevate(np.swapaxes(elevate(p, du), 0, 1), dv), 0, 1) for p in patches]
    return np.stack(same), (
        f"{raised} of {len(patches)} patches were raised to bi-degree {du} x {dv}, the highest here",
    )


def _teapot() -> Scene:
    return Scene("teapot", teapot(), Camera.look_at(EYE, TARGET))


def _twisted_quad() -> Scene:
    return Scene("twisted-quad", twisted_quad(), Camera.look_at(QUAD_EYE, QUAD_TARGET, up=(0.0, 1.0, 0.0)))


def _steep_patch() -> Scene:
    return Scene("steep-patch", steep_patch(), Camera.look_at(STEEP_EYE, STEEP_TARGET, fov_y=STEEP_FOV, near=0.05))


READERS: dict[str, Callable[[Path], list[np.ndarray]]] = {".bpt": read_bpt}
BUILT_IN: dict[str, Callable[[], Scene]] = {
    "teapot": _teapot,
    "twisted-quad": _twisted_quad,
    "steep-patch": _steep_patch,
}
