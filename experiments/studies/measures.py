"""What studies measure: functions of a look, each with the names of the columns that it fills."""

from __future__ import annotations

from collections.abc import Callable
from functools import update_wrapper
from typing import Any

import numpy as np

from slefejax import View
from slefejax.errors import InputError
from slefejax.experiments.store import Row
from slefejax.experiments.studies.look import Look
from slefejax.figures.style import SIZE_CLASSES
from slefejax.gpu import GBuffer, Triangles
from slefejax.measure.covering import covering_error
from slefejax.measure.error import SLIPPED, slip
from slefejax.tessellator.levels import triangle_counts

THRESHOLDS = (0.1, 0.5, 1.0)  # pixels; the limits of the error colours of [YBP12]
SIZES = tuple(limit for limit, _, _ in SIZE_CLASSES[:-1])  # square pixels, between the classes of triangles
AREAS = (0.5, *SIZES)  # with that of a micro-polygon
_SHARES = tuple(f"share_above_{limit:g}" for limit in THRESHOLDS)
_SLIPS = ("slipped_pixels", "max_slip_px")
ERRORS = ("covered_pixels", *_SHARES, "max_error_px", *_SLIPS)


class Measure:
    """A function of a look, and the columns that it fills; of names that begin with _ tables show nothing."""

    def __init__(self, columns: tuple[str, ...], take: Callable[[Any], Row]) -> None:
        self.columns, self._take = columns, take
        update_wrapper(self, take)

    def __call__(self, look: Any) -> Row:
        """The row's part. What is missing, or too much, is a mistake in the measure."""
        row = self._take(look)
        assert tuple(row) == self.columns, (self, tuple(row))
        return row


def measure(*columns: str) -> Callable[[Callable[[Any], Row]], Measure]:
    """Decorates a function that fills these columns."""
    return lambda take: Measure(columns, take)


@measure("patches", "triangles")
def size(look: Look) -> Row:
    """How many patches there are, and triangles that they are drawn as."""
    count = int(triangle_counts(look.inner, look.outer, look.spacing).sum())
    return {"patches": len(look.patches), "triangles": count}


@measure("render_ms")
def rendering(look: Look) -> Row:
    """How long it takes to draw, in milliseconds."""
    return {"render_ms": look.render_ms}


@measure(*ERRORS)
def pixels(look: Look) -> Row:
    """Covered pixels, shares of them above each threshold, the largest error, the driver's slips."""
    covered = look.error[~np.isnan(look.error)]
    if covered.size == 0:
        raise InputError("the picture is empty: no pixel centre is covered by the scene")
    shares = {f"share_above_{limit:g}": float(np.mean(covered > limit)) for limit in THRESHOLDS}
    return {"covered_pixels": int(covered.size), **shares, "max_error_px": float(covered.max()), **slips(look.seen)}


@measure(*ERRORS)
def pixels_or_none(look: Look) -> Row:
    """The same, of pictures in which there may be nothing."""
    if (look.seen.patch >= 0).any():
        return pixels(look)
    return {"covered_pixels": 0} | dict.fromkeys(ERRORS[1:], float("nan")) | {"slipped_pixels": 0}


def slips(seen: GBuffer) -> Row:
    """How many pixels show what was drawn further than ``SLIPPED`` from their centres, and the furthest."""
    found = slip(seen)
    return {
        "slipped_pixels": int(np.count_nonzero(found > SLIPPED)),
        "max_slip_px": float(np.max(found, where=~np.isnan(found), initial=0.0)),
    }


@measure("max_normal_error_deg", "patches_without_normal")
def normals(look: Look) -> Row:
    """The largest angle between drawn and exact normals of pixels, and of how many patches nothing is claimed."""
    return {
        "max_normal_error_deg": largest(look.turned),
        "patches_without_normal": int(np.count_nonzero(look.beside.without)),
    }


@measure("sup_normal_error_deg", "drawn_sup_normal_error_deg")
def domain_of_normals(look: Look) -> Row:
    """The largest angle over the domain, cut uniformly and as the tessellator draws it, where a claim is made."""
    return {
        "sup_normal_error_deg": largest(look.uniform_turned),
        "drawn_sup_normal_error_deg": largest(look.worst_turned),
    }


@measure("_without_normal")
def without_normal(look: Look) -> Row:
    """The numbers of the patches of whose normals nothing is claimed."""
    return {"_without_normal": np.flatnonzero(look.beside.without).tolist()}


def largest(values: np.ndarray) -> float:
    """Of those that are numbers; NaN if none is."""
    known = values[~np.isnan(values)]
    return float(known.max()) if known.size else float("nan")


@measure("sup_error_px", "drawn_sup_error_px")
def domain(look: Look) -> Row:
    """The largest error over the domain, cut uniformly and as the tessellator draws it."""
    return {"sup_error_px": float(look.uniform.max()), "drawn_sup_error_px": float(look.worst.max())}


@measure("minimal_triangles")
def minimal(look: Look) -> Row:
    """Triangles of the smallest uniform grids that keep the tolerance."""
    return {"minimal_triangles": int(2 * np.sum(look.beside.minimal**2))}


@measure("triangles_over_minimal")
def triangles_over_minimal(look: Look) -> Row:
    """Triangles over those of the smallest uniform grids that keep the tolerance; NaN where these are not found.

    Less than 1 where edges with fewer pieces, or grids of unequal levels, keep it too.
    """
    try:
        fewest = minimal(look)["minimal_triangles"]
    except InputError:
        fewest = 0
    return {"triangles_over_minimal": size(look)["triangles"] / fewest if fewest else float("nan")}


@measure("factor_over_minimal_median", "factor_over_minimal_p95")
def over_minimal(look: Look) -> Row:
    """How far above the minimal factors these are, rounded up."""
    there = look.beside.minimal > 0
    ratio = look.with_factors.levels[there] / look.beside.minimal[there]
    return {
        "factor_over_minimal_median": float(np.median(ratio)),
        "factor_over_minimal_p95": float(np.quantile(ratio, 0.95)),
    }


@measure("share_worse_by_rings", "share_unsafe_by_rings", "largest_ring_ratio")
def rings(look: Look) -> Row:
    """``ring_effect`` on the patches that are seen."""
    there = look.beside.minimal > 0
    return ring_effect(look.uniform[there], look.worst[there], look.beside.tolerance)


def ring_effect(uniform: np.ndarray, drawn: np.ndarray, tolerance: float) -> Row:
    """What the rule for shared edges does to patches: their errors as uniform grids, and as they are drawn.

    Shares of the patches that got worse by more than 1 %, and that were within the tolerance and are no more; and the
    largest ratio, over patches that err by more than a hundredth of a pixel.
    """
    noticed = uniform > 0.01
    return {
        "share_worse_by_rings": float(np.mean(drawn > 1.01 * uniform)),
        "share_unsafe_by_rings": float(np.mean((uniform <= tolerance) & (drawn > tolerance))),
        "largest_ring_ratio": float(np.max(drawn[noticed] / uniform[noticed], initial=1.0)),
    }


@measure(
    "share_wrong_silhouette",
    "share_wrong_patch_inside",
    "share_wrong_depth_inside",
    "wrong_regions_inside",
    "largest_wrong_region_px",
)
def covering(look: Look) -> Row:
    """Pixels that show the wrong piece of surface, beside a reference with four samples a pixel."""
    return covering_error(look.seen, look.beside.reference).summary()


_PIXEL_AREAS = tuple(f"share_pixels_area_below_{limit:g}" for limit in SIZES)


@measure(*(f"share_area_below_{limit:g}" for limit in AREAS), *_PIXEL_AREAS)
def areas(look: Look) -> Row:
    """``area_shares`` of the triangles that were made, and of covered pixels by the triangle that they show."""
    seen = look.area[~np.isnan(look.area)]
    shares = [float(np.mean(seen < limit)) if len(seen) else 0.0 for limit in SIZES]
    return {**area_shares(look.captured, look.view), **dict(zip(_PIXEL_AREAS, shares, strict=True))}


def area_shares(triangles: Triangles, view: View) -> Row:
    """Shares of the triangles in front of the camera whose area on the screen is below each of ``AREAS``."""
    area = areas_on_screen(triangles, view)
    return {f"share_area_below_{limit:g}": float(np.mean(area < limit)) if len(area) else 0.0 for limit in AREAS}


def areas_on_screen(triangles: Triangles, view: View) -> np.ndarray:
    """Square pixels of the triangles in front of the camera, hidden or not."""
    clip = triangles.clip.astype(np.float64)
    clip = clip[np.all(clip[..., 3] > 0, axis=1)]
    corners = clip[..., :2] / clip[..., 3:] * np.array([view.width / 2, view.height / 2])
    a, b = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    return 0.5 * np.abs(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])
