"""What the published method draws of Gaussian products, against the same surface in float64."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from slefejax import View
from slefejax.conversion.gaussian.published import Published
from slefejax.experiments.studies.look import Look
from slefejax.gpu import Renderer
from slefejax.measure.error import pixel_error
from slefejax.measure.surface import UNSEEN, distance

_SAMPLES = 1_000_000  # of errors over the domain
_DENSEST = 16  # samples along the sides of a triangle
_AT_A_TIME = 100_000


@dataclass
class NestedLook(Look):
    """Quarters that are all cut alike, 2^level segments along a face.

    surface : what they are of
    """

    surface: Any = None

    @staticmethod
    def of(surface: Published, view: View, renderer: Renderer, level: int) -> NestedLook:
        """At a level, 1 to 6."""
        inner, outer = (np.full((len(surface.nets), k), 2 ** (level - 1)) for k in (2, 4))
        return NestedLook(surface.nets, view, renderer, inner, outer, surface=surface)

    @cached_property
    def error(self) -> np.ndarray:
        """Of every pixel, in pixels; NaN where nothing is."""
        patch, u, v = self.surface.on_limit(self.seen.patch, self.seen.u, self.seen.v)
        return pixel_error(self.surface.limit.net, self.view, u, v, patch, self.seen.drawn)

    @cached_property
    def largest(self) -> float:
        """The largest error over the triangles that were drawn, in pixels, of a million samples at most."""
        triangles = self.captured
        chosen = np.arange(len(triangles.patch))
        density = int(np.clip(np.sqrt(2.0 * _SAMPLES / len(chosen)) - 1.0, 2, _DENSEST))
        shares = np.array([(i, j, density - i - j) for i in range(density + 1) for j in range(density + 1 - i)])
        if len(shares) * len(chosen) > _SAMPLES:
            chosen = np.random.default_rng(0).choice(chosen, _SAMPLES // len(shares), replace=False)
        step = max(1, _AT_A_TIME // len(shares))
        parts = [chosen[k : k + step] for k in range(0, len(chosen), step)]
        return max(self._largest_of(triangles, own, shares / density) for own in parts)

    def _largest_of(self, triangles: Any, which: np.ndarray, shares: np.ndarray) -> float:
        quarter = np.repeat(triangles.patch[which], len(shares))
        place, clip = (
            np.einsum("sk,tkc->tsc", shares, x[which].astype(np.float64)).reshape(len(quarter), -1)
            for x in (triangles.parameters, triangles.clip)
        )
        exact = self.surface.limit.at(quarter, place)
        to_screen = np.asarray(self.view.world_to_screen) @ np.linalg.inv(np.asarray(self.view.world_to_clip))
        both = (np.asarray(self.view.world_to_screen) @ np.c_[exact, np.ones(len(exact))].T, to_screen @ clip.T)
        return float(np.max(distance(*both, (self.view.width, self.view.height)), initial=UNSEEN))
