"""What a study measures, by the names of its file."""

from __future__ import annotations

import platform
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from slefejax.experiments.checks.limit import distance_row, largest_jump
from slefejax.experiments.store import Row
from slefejax.experiments.studies.look import Look
from slefejax.experiments.studies.measures import (
    Measure,
    covering,
    measure,
    normals,
    pixels_or_none,
    size,
    triangles_over_minimal,
)
from slefejax.experiments.studies.measures import minimal as minimal_triangles
from slefejax.experiments.studies.times import milliseconds

_REPEATS = 5


@dataclass
class Sight(Look):
    """A case of a study, and how its factors are found once more."""

    again: Callable[[], Any] = lambda: None


@measure("sup_error_px")
def domain(look: Look) -> Row:
    """The largest error over the domain, cut uniformly."""
    return {"sup_error_px": float(look.uniform.max())}


@measure("drawn_sup_error_px")
def drawn(look: Look) -> Row:
    """The largest error over the domain, as the tessellator cuts it."""
    return {"drawn_sup_error_px": float(look.worst.max())}


@measure("limit_max_percent", "limit_rms_percent", "limit_bound_percent", "limit_max_px", "normal_jump_deg")
def limit(look: Look) -> Row:
    """How far patches are from the limit surface, and how far normals jump; NaN where there is no control mesh."""
    scene = look.beside.scene
    if scene.conversion is None:
        return dict.fromkeys(limit.columns, float("nan"))
    return {**distance_row(scene, look.view), "normal_jump_deg": largest_jump(scene)}


@measure("minimal_triangles", "triangles_over_minimal", "factor_over_minimal_median", "factor_over_minimal_p95")
def minimal(look: Look) -> Row:
    """Beside the smallest uniform grids that keep the tolerance; NaN where nothing is seen."""
    there = look.beside.minimal > 0
    ratio = look.with_factors.levels[there] / look.beside.minimal[there] if there.any() else np.array([np.nan])
    return {
        **minimal_triangles(look),
        **triangles_over_minimal(look),
        "factor_over_minimal_median": float(np.median(ratio)),
        "factor_over_minimal_p95": float(np.quantile(ratio, 0.95)),
    }


@measure("predict_ms", "render_ms", "machine")
def times(look: Sight) -> Row:
    """Medians of calls once everything is compiled, and of what machine."""
    look.again()
    predicted = [milliseconds(look.again) for _ in range(_REPEATS)]
    return {"predict_ms": float(np.median(predicted)), "render_ms": look.render_ms, "machine": platform.node()}


ALWAYS = size
MEASURES: dict[str, Measure] = {
    "pixels": pixels_or_none,
    "domain": domain,
    "drawn": drawn,
    "covering": covering,
    "normals": normals,
    "limit": limit,
    "minimal": minimal,
    "times": times,
}
# of each, what says most where there is no room for all
TELLING = {
    "pixels": "max_error_px",
    "domain": "sup_error_px",
    "drawn": "drawn_sup_error_px",
    "covering": "share_wrong_silhouette",
    "normals": "max_normal_error_deg",
    "limit": "limit_max_px",
    "minimal": "triangles_over_minimal",
    "times": "predict_ms",
}
DRAWN = ("pixels", "drawn", "covering", "normals", "times")  # those that need an OpenGL device
