"""Levels of factors, as options ask for them: how vertices are spaced, and whose edges are whose."""

from __future__ import annotations

from typing import Any, Literal

import numpy as np

from slefejax import Factors, with_pieces
from slefejax.errors import InputError
from slefejax.experiments.options import PredictionOptions
from slefejax.predict.methods import Certified
from slefejax.tessellator.edges import edge_maxima
from slefejax.tessellator.levels import levels_for

Spacing = Literal["equal", "fractional-even", "fractional-odd"]
Edges = Literal["shared", "own"]


def levels_of(factors: Factors, spacing: str = "equal", edges: str = "shared") -> tuple[np.ndarray, np.ndarray]:
    """Inner ``(patches, 2)`` and outer levels ``(patches, 4)``; whole ones, or real ones for fractional spacing."""
    if spacing == "equal":
        if edges == "shared":
            return factors.inner, factors.edges
        own = np.repeat(factors.levels[:, None], 4, axis=1)
        return with_pieces(factors.inner, own, np.arange(own.size).reshape(own.shape))
    own = levels_for(np.asarray(factors.factor, np.float64), spacing)
    outer = edge_maxima(own, factors.edge_numbers) if edges == "shared" else np.repeat(own[:, None], 4, axis=1)
    return np.repeat(own[:, None], 2, axis=1), outer


def check_levels_are_real(prediction: PredictionOptions, spacing: str) -> None:
    """Raise InputError for methods that find whole levels, with fractional spacing."""
    if spacing != "equal" and (prediction.anisotropic or prediction.verify):
        raise InputError("--anisotropic and --verify find whole levels: they have no meaning with --spacing")


def unproved(method: Any, spacing: str) -> tuple[str, ...]:
    """A note where a claim is left that a method would have with equal spacing."""
    if isinstance(method, Certified) and spacing != "equal":
        return ("levels with fractional spacing are not proved: the certificate is for equal spacing",)
    return ()


def check_seen(factors: Factors) -> None:
    """Raise InputError where no patch has a factor."""
    if not np.any(np.asarray(factors.factor) > 0):
        raise InputError(
            "no patch is on the screen: turn the camera to the scene, or move it or its near and far planes"
        )
