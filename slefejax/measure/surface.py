"""Where surfaces really are on the screen: the one projection of everything that measures, in float64."""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from slefejax.arguments import on_host
from slefejax.errors import InputError
from slefejax.geometry.evaluate import as_control
from slefejax.geometry.gregory import Twisted
from slefejax.geometry.view import View, homogeneous

UNSEEN = -1.0


def undivided(patches: Any, view: View) -> Any:
    """Control points ``(du+1, dv+1, 4, patches)``: X/W, Y/W pixels from the lower left corner, Z/W window depth.

    ``Twisted`` of Gregory patches, with twists ``(slots, 4, patches)``.

    Made once, not for every block of what is looked at.

    >>> from slefejax import Camera
    >>> view = View(Camera.look_at((0.5, -3.0, 2.0), (0.5, 0.5, 0.0)), 300, 200)
    >>> undivided(np.zeros((5, 4, 3, 3)), view).shape
    (4, 3, 4, 5)
    """
    matrix = np.asarray(view.world_to_screen).T
    control = as_control(on_host(patches))
    if isinstance(control, Twisted):
        twists = np.asarray(control.twists, np.float64) @ matrix[:3]
        control = Twisted(homogeneous(np.asarray(control.net, np.float64)) @ matrix, twists)
    else:
        control = homogeneous(np.asarray(control, np.float64)) @ matrix
    with jax.enable_x64(True):
        return jax.device_put(jax.tree.map(lambda x: np.ascontiguousarray(np.moveaxis(x, 0, -1)), control))


def of_patches(control: Any, which: Any) -> Any:
    """Control points ``(..., patches)`` of some of the patches."""
    return jax.tree.map(lambda x: x[..., which], control)


class Surface(NamedTuple):
    """Patches in undivided screen coordinates: X/W, Y/W pixels, Z/W window depth, as ``(du+1, dv+1, 4, patches)``."""

    control: Any
    size: Any  # width and height of the picture in pixels

    @staticmethod
    def of(patches: Any, view: View) -> Surface:
        """In float64. Raises InputError for a view that is none, or for control points that are not finite."""
        if not isinstance(view, View):
            raise InputError(f"the view must be a slefejax.View, not {type(view).__name__}")
        finite = [np.isfinite(x).reshape(len(x), -1).all(axis=1) for x in jax.tree.leaves(as_control(on_host(patches)))]
        bad = np.flatnonzero(~np.all(finite, axis=0))
        if bad.size:
            raise InputError(f"patch {bad[0]} (counted from 0) has control points that are not finite numbers")
        return Surface(undivided(patches, view), np.array([view.width, view.height], np.float64))


def distance(exact: Any, drawn: Any, size: Any) -> Any:
    """Of undivided screen points ``(4, ...)``: max(|dx|, |dy|) in pixels; -1 where the drawn one is not visible.

    >>> exact, drawn = jnp.array([3.0, 4.0, 0.5, 1.0]), jnp.array([1.0, 4.5, 0.5, 1.0])
    >>> float(distance(exact, drawn, (10.0, 10.0)))
    2.0
    """
    x, y, z, w = drawn
    visible = (w > 0) & (x >= 0) & (x <= size[0] * w) & (y >= 0) & (y <= size[1] * w) & (z >= 0) & (z <= w)
    w, true_w = jnp.where(visible, w, 1.0), jnp.where(exact[3] > 0, exact[3], 1.0)
    far = jnp.maximum(jnp.abs(exact[0] / true_w - x / w), jnp.abs(exact[1] / true_w - y / w))
    return jnp.where(visible, jnp.where(exact[3] > 0, far, jnp.inf), UNSEEN)
