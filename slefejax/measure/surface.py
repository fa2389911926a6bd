"""Where surfaces really are on the screen: the one projection of everything that measures, in float64.

A ``Quantity`` says what is measured of them: what triangles interpolate, and how far that is from the exact surface.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from slefejax.arguments import on_host
from slefejax.errors import InputError
from slefejax.geometry.evaluate import as_control
from slefejax.geometry.gregory import Twisted
from slefejax.geometry.view import View, homogeneous
from slefejax.lanes.tuning import TUNING

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
    return patches_last(control)


def patches_last(control: Any) -> Any:
    """Arrays ``(patches, ...)`` as ``(..., patches)``, on the device, in their own precision.

    >>> patches_last({"net": np.zeros((5, 4, 3))})["net"].shape
    (4, 3, 5)
    """
    with jax.enable_x64(True):
        return jax.device_put(jax.tree.map(lambda x: np.ascontiguousarray(np.moveaxis(x, 0, -1)), control))


def of_patches(control: Any, which: Any) -> Any:
    """Control points ``(..., patches)`` of some of the patches."""
    return jax.tree.map(lambda x: x[..., which], control)


class Quantity(NamedTuple):
    """What is measured. Programs are compiled for its functions.

    rows  : ``rows(control, u, v, evaluator)``: what triangles interpolate, ``(rows, ...)``; evaluators are ``evaluate``
            and ``evaluate_grid``
    error : ``error(exact, drawn, size)`` of such rows, of a picture of that width and height; UNSEEN where what is
            drawn does not count
    lanes : windows or triangles of a chunk
    """

    rows: Callable[..., Any]
    error: Callable[..., Any]
    lanes: int = TUNING.lanes


class Surface(NamedTuple):
    """Patches in a view, and what is measured of them."""

    control: Any  # what the quantity's rows are made of, (..., patches)
    size: Any  # width and height of the picture in pixels
    quantity: Quantity

    @staticmethod
    def of(patches: Any, view: View) -> Surface:
        """Positions on the screen, in float64.

        Raises InputError for a view that is none, or for control points that are not finite.
        """
        if not isinstance(view, View):
            raise InputError(f"the view must be a slefejax.View, not {type(view).__name__}")
        finite = [np.isfinite(x).reshape(len(x), -1).all(axis=1) for x in jax.tree.leaves(as_control(on_host(patches)))]
        bad = np.flatnonzero(~np.all(finite, axis=0))
        if bad.size:
            raise InputError(f"patch {bad[0]} (counted from 0) has control points that are not finite numbers")
        return Surface(undivided(patches, view), np.array([view.width, view.height], np.float64), _POSITION)


def visible(drawn: Any, size: Any) -> Any:
    """Which undivided screen points ``(4, ...)`` lie in the view volume.

    >>> visible(jnp.array([[1.0, 9.0], [4.5, 4.5], [0.5, 0.5], [1.0, 0.5]]), (10.0, 10.0)).tolist()
    [True, False]
    """
    x, y, z, w = drawn
    return (w > 0) & (x >= 0) & (x <= size[0] * w) & (y >= 0) & (y <= size[1] * w) & (z >= 0) & (z <= w)


def distance(exact: Any, drawn: Any, size: Any) -> Any:
    """Of undivided screen points ``(4, ...)``: max(|dx|, |dy|) in pixels; -1 where the drawn one is not visible.

    >>> exact, drawn = jnp.array([3.0, 4.0, 0.5, 1.0]), jnp.array([1.0, 4.5, 0.5, 1.0])
    >>> float(distance(exact, drawn, (10.0, 10.0)))
    2.0
    """
    x, y, _, w = drawn
    seen = visible(drawn, size)
    w, true_w = jnp.where(seen, w, 1.0), jnp.where(exact[3] > 0, exact[3], 1.0)
    far = jnp.maximum(jnp.abs(exact[0] / true_w - x / w), jnp.abs(exact[1] / true_w - y / w))
    return jnp.where(seen, jnp.where(exact[3] > 0, far, jnp.inf), UNSEEN)


def _places(control: Any, u: Any, v: Any, evaluator: Callable[..., Any]) -> Any:
    return evaluator(control, u, v)


_POSITION = Quantity(_places, distance)
