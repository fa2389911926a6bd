"""What drawn normals reflect: those of the surface, and those of tangent patches."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy.ndimage import uniform_filter

from slefejax import Scene, View, tessellation_factors
from slefejax.experiments.checks.mirror import stripes
from slefejax.geometry.view import homogeneous
from slefejax.gpu import Renderer
from slefejax.measure.jumps import normal_jumps

_CLOSE = (720, 720)  # pixels
_SHARE = 0.2  # of the picture's height, what is shown from near


class Reflected(NamedTuple):
    """Stripes that are reflected by normals of the surface, and by those of tangent patches.

    whole : both pictures ``(height, width)``, 0 to 1, row 0 at the top, NaN for background
    near  : both from the same eye, where they differ most
    frame : corners of that part of the whole, ``(4, 2)``, in pixels from its upper left corner
    jumps : the largest of both kinds across edges that should be smooth, degrees
    """

    whole: list[np.ndarray]
    near: list[np.ndarray]
    frame: np.ndarray
    jumps: list[float]


def reflected(scene: Scene, view: View, tolerance: float) -> Reflected | None:
    """As they are drawn at certified levels; None where nothing of the scene is seen.

    Raises InputError for a scene without tangent patches, NoOpenGLError without a device.
    """
    tangents = scene.tangents()
    renderers = (
        Renderer(scene.patches(), normals="surface"),
        Renderer(scene.patches(), normals="tangents", tangents=tangents),
    )

    def pictures(own: View) -> list[np.ndarray]:
        factors = tessellation_factors(scene.patches(), own, tolerance=tolerance, edge_numbers=scene.edge_numbers)
        drawn = [each.draw(own, factors.inner, factors.edges).normal for each in renderers]
        return [mirrored(normals, own, view)[::-1] for normals in drawn if normals is not None]

    whole = pictures(view)
    if np.isnan(whole[0]).all():
        return None
    close = _close_view(view, np.abs(whole[0] - whole[1])[::-1])
    near = pictures(close)
    return Reflected(whole, near, _frame(view, close), [_largest_jump(scene, own) for own in (None, tangents)])


def _largest_jump(scene: Scene, tangents: object) -> float:
    assert scene.conversion is not None
    return float(np.max(normal_jumps(scene.patches(), scene.conversion.smooth_sides, tangents), initial=0.0))


def mirrored(normals: np.ndarray, own: View, whole: View) -> np.ndarray:
    """Stripes, 0 to 1, of an environment that stands upright in the whole picture, its middle behind the camera.

    normals : unit vectors of every pixel of one's own view, ``(height, width, 3)``, to either side; NaN for none
    """
    right, up, _ = axes_of(whole)
    return stripes(towards_camera(own), normals.astype(float), up, np.cross(right, up))


def towards_camera(view: View) -> np.ndarray:
    """From what every pixel shows to the camera, a perspective one: ``(height, width, 3)``, of any length."""
    rows, columns = np.indices((view.height, view.width)) + 0.5
    return view.camera.eye - _in_space(view, np.stack([columns, rows], axis=-1))


def axes_of(view: View) -> np.ndarray:
    """Unit vectors to the right of a picture, along the camera's up, and from the target to the camera."""
    camera = view.camera
    back = _unit(camera.eye - camera.target)
    return np.array([_unit(np.cross(camera.up, back)), _unit(np.asarray(camera.up)), back])


def _close_view(view: View, difference: np.ndarray) -> View:
    """From the same eye, the part of the picture with the largest mean of differences, row 0 at the bottom."""
    size = round(_SHARE * view.height)
    mean = uniform_filter(np.nan_to_num(difference), size, mode="constant")
    row, column = np.unravel_index(np.argmax(mean), mean.shape)
    target = _in_space(view, np.array([column, row]) + 0.5)
    half = np.tan(np.deg2rad(0.5 * view.camera.extent))
    return View(replace(view.camera, target=target, extent=np.rad2deg(2.0 * np.arctan(_SHARE * half))), *_CLOSE)


def _frame(whole: View, part: View) -> np.ndarray:
    width, height = _CLOSE
    corners = _in_space(part, np.array([[0.0, 0.0], [width, 0.0], [width, height], [0.0, height]]))
    x, y, _, w = (homogeneous(corners) @ np.asarray(whole.world_to_screen).T).T
    return np.stack([x / w, whole.height - y / w], axis=1)


def _in_space(view: View, pixels: np.ndarray) -> np.ndarray:
    """Points of the near plane, of pixels from the lower left corner."""
    matrix = np.linalg.inv(np.asarray(view.world_to_screen))
    found = homogeneous(np.concatenate([pixels, 0.0 * pixels[..., :1]], axis=-1)) @ matrix.T
    return found[..., :3] / found[..., 3:]


def _unit(vector: np.ndarray) -> np.ndarray:
    return vector / np.linalg.norm(vector)
