"""Looks that show what normals do to light: with exact normals, and with interpolated ones as they are drawn."""

from __future__ import annotations

from functools import partial

import numpy as np

from slefejax import View
from slefejax.experiments.checks.reflected import axes_of, mirrored, towards_camera
from slefejax.experiments.looks.made import Made
from slefejax.experiments.studies.look import Look
from slefejax.figures.checks.limit import stripe_greys
from slefejax.figures.looks.pictures import grey_colours, write_greys, write_reflections
from slefejax.measure.error import exact_normals

_TITLES = ["exact normals", "as drawn: interpolated between vertices"]
_LAMP = np.array([-0.5, 0.7, 1.0])  # to the right, up, and back from the target, of the camera
_DARKEST, _MATT, _SHINE, _SHARPNESS = 0.15, 0.6, 0.25, 50.0


def shaded(look: Look) -> Made:
    """Matt and shiny light from beside the camera."""
    shades = [lit(normals, look.view) for normals in both_normals(look)]
    return Made("shading", partial(write_greys, greys=shades, titles=_TITLES))


def reflection(look: Look) -> Made:
    """Stripes of an environment that the surface reflects."""
    stripes = [mirrored(normals, look.view, look.view) for normals in both_normals(look)]
    return Made("reflected stripes", partial(write_reflections, stripes=stripes, titles=_TITLES))


def shades(look: Look) -> np.ndarray:
    """How bright every pixel is with the normals that were drawn, ``(height, width)``; NaN for background."""
    return lit(_drawn_normals(look), look.view)


def shaded_colours(look: Look) -> np.ndarray:
    """The same as colours."""
    return grey_colours(shades(look))


def stripe_colours(look: Look) -> np.ndarray:
    """Stripes that drawn normals reflect, as colours."""
    return grey_colours(stripe_greys(mirrored(_drawn_normals(look), look.view, look.view)))


def both_normals(look: Look) -> tuple[np.ndarray, np.ndarray]:
    """Exact and drawn unit normals of every pixel, ``(height, width, 3)``, NaN for none."""
    exact = exact_normals(look.patches, look.seen, *look.beside.shaded.kind)
    return exact, _drawn_normals(look)


def lit(normals: np.ndarray, view: View) -> np.ndarray:
    """0 black to 1 white, NaN for none: how bright both sides of a surface are.

    normals : unit vectors of every pixel, to either side
    """
    towards = _unit(towards_camera(view))
    lamp = _unit(_LAMP @ axes_of(view))
    facing = np.where(np.sum(normals * towards, axis=-1, keepdims=True) < 0.0, -normals, normals)
    halfway = _unit(towards + lamp)
    matt = np.maximum(facing @ lamp, 0.0)
    shine = np.maximum(np.sum(facing * halfway, axis=-1), 0.0) ** _SHARPNESS
    return _DARKEST + _MATT * matt + _SHINE * shine


def _drawn_normals(look: Look) -> np.ndarray:
    assert look.seen.normal is not None
    return look.seen.normal.astype(np.float64)


def _unit(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)
