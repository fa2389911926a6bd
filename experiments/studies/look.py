"""What a case looks like: everything that measures ask for, made when it is asked for, and once."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from slefejax import Factors, Scene, View, minimal_factors, sampled_error, triangle_error
from slefejax.experiments.studies.times import milliseconds
from slefejax.gpu import GBuffer, Renderer, Triangles
from slefejax.measure.error import drawn_error
from slefejax.tessellator.levels import HIGHEST_LEVEL, pieces


class Shown:
    """A scene in a view: what all cases there share.

    tolerance : in pixels, of the minimal factors
    settled   : hears of how many patches the minimal factor is known
    """

    def __init__(
        self, scene: Scene, view: View, tolerance: float, settled: Callable[[int], None] | None = None
    ) -> None:
        self.scene, self.view, self.tolerance, self._settled = scene, view, tolerance, settled
        self.patches = scene.patches()

    @cached_property
    def renderer(self) -> Renderer:
        """Of the scene's patches, on the device of this thread."""
        return Renderer(self.patches)

    @cached_property
    def minimal(self) -> np.ndarray:
        """The smallest factors that keep the tolerance, ``(patches,)``."""
        return minimal_factors(self.patches, self.view, self.tolerance, progress=self._settled)

    @cached_property
    def reference(self) -> GBuffer:
        """Four samples a pixel of the scene, every patch cut as finely as is good for all of them."""
        finest = HIGHEST_LEVEL * int(pieces(self.minimal).max())
        levels = np.where(self.minimal[:, None] > 0, finest, np.zeros(6, int))
        view = View(self.view.camera, 2 * self.view.width, 2 * self.view.height)
        return self.renderer.draw(view, levels[:, :2], levels[:, 2:])

    def drawn(self, factors: Factors, name: str = "") -> Look:
        """With these factors, edges shared."""
        levels = factors.inner, factors.edges
        return Look(self.patches, self.view, self.renderer, *levels, factors=factors, shown=self, name=name)

    def release(self) -> None:
        """Give the device's memory back."""
        if "renderer" in self.__dict__:
            self.renderer.release()


@dataclass
class Look:
    """Patches in a view, cut by inner and outer levels.

    factors : that the levels come from;  shown : what is shared with other cases; each None if nothing asks for it
    name    : of the method, where there are several
    """

    patches: Any
    view: View
    renderer: Renderer
    inner: np.ndarray
    outer: np.ndarray
    spacing: str = "equal"
    factors: Factors | None = None
    shown: Shown | None = None
    name: str = ""

    @cached_property
    def seen(self) -> GBuffer:
        """What the tessellator drew."""
        return self.renderer.draw(self.view, self.inner, self.outer)

    @cached_property
    def render_ms(self) -> float:
        """How long the tessellator takes to draw; what it drew is ``seen``."""
        self.renderer.submit(self.view, self.inner, self.outer)  # once unmeasured: the driver may compile
        found = milliseconds(lambda: self.renderer.submit(self.view, self.inner, self.outer))
        self.__dict__.setdefault("seen", self.renderer.read(self.view))
        return found

    @cached_property
    def error(self) -> np.ndarray:
        """Of every pixel, in pixels; NaN where nothing is."""
        return drawn_error(self.patches, self.view, self.seen)

    @cached_property
    def captured(self) -> Triangles:
        """The triangles that the tessellator made."""
        return self.renderer.capture(self.view, self.inner, self.outer)

    @cached_property
    def uniform(self) -> np.ndarray:
        """The largest error of every patch over its domain, cut uniformly as the factors say; pixels."""
        own = self.factors
        if own is None:
            return sampled_error(self.patches, self.inner, self.view)
        return sampled_error(self.patches, own.levels if own.pairs is None else own.pairs, self.view)

    @cached_property
    def worst(self) -> np.ndarray:
        """The largest error of every patch over the triangles that were made; pixels."""
        return triangle_error(self.patches, self.captured, self.view)

    @property
    def with_factors(self) -> Factors:
        """The factors, of a case that has some."""
        assert self.factors is not None
        return self.factors

    @property
    def beside(self) -> Shown:
        """What is shared with other cases of the scene in the view."""
        assert self.shown is not None
        return self.shown
