"""Looks that are a number a pixel: errors, angles between normals, depth, factors."""

from __future__ import annotations

from functools import partial

import numpy as np

from slefejax.experiments.looks.made import Made
from slefejax.experiments.studies.look import Look
from slefejax.figures.error_image import error_colours
from slefejax.figures.looks.pictures import write_errors, write_values

_MOST = 0.995  # of the pixels; a few at outlines and creases are far worse than all others


def error(look: Look) -> Made:
    """How far from where it was drawn the exact surface has the point of every pixel."""
    shows = f"the error of every pixel, at most {np.nanmax(look.error):.2g} px"
    return Made(shows, partial(write_errors, error=look.error), {"error_px": look.error}, "error_px")


def coloured_errors(look: Look) -> np.ndarray:
    """The colours of the errors, of every pixel."""
    return error_colours(look.error)[::-1] / 255.0


def normals(look: Look) -> Made:
    """The angle between drawn and exact normals; and the drawn ones."""
    angle = look.turned
    shows = "how far interpolated normals are off"
    if not np.isnan(angle).all():
        shows += f", at most {np.nanmax(angle):.2g}°"
    assert look.seen.normal is not None
    channels = {"normal_error_deg": angle}
    channels |= {f"normal_{axis}": look.seen.normal[..., k] for k, axis in enumerate("xyz")}
    draw = partial(write_values, values=angle, label="between drawn and\nexact normals, degrees", part=_MOST)
    return Made(shows, draw, channels, "normal_error_deg")


def depth(look: Look) -> Made:
    """Window depth."""
    found = np.where(look.seen.patch >= 0, look.seen.depth, np.float32(np.nan))
    draw = partial(write_values, values=found, label="window depth\n(near plane 0, far plane 1)")
    return Made("window depth", draw, {"depth": found}, "depth")


def factors(look: Look) -> Made:
    """The factor of the patch that is seen."""
    of_patches = np.append(np.asarray(look.with_factors.factor, float), np.nan)
    found = of_patches[look.seen.patch]
    draw = partial(write_values, values=found, label="factor:\npieces along each side")
    return Made("the tessellation factor of every patch", draw, {"factor": found}, "factor")
