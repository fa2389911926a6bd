"""What a case looks like: everything that measures ask for, made when it is asked for, and once."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from slefejax import (
    Factors,
    Scene,
    View,
    minimal_factors,
    sampled_error,
    sampled_normal_error,
    triangle_error,
    triangle_normal_error,
)
from slefejax.experiments.shading import Shaded
from slefejax.experiments.studies.times import milliseconds
from slefejax.gpu import GBuffer, Renderer, Triangles
from slefejax.measure.error import drawn_error, normal_error
from slefejax.predict.methods import Certified
from slefejax.tessellator.levels import HIGHEST_LEVEL, pieces

NO_NORMALS = Shaded()


class Shown:
    """A scene in a view: what all cases there share.

    tolerance : in pixels, of the minimal factors
    settled   : hears of how many patches the minimal factor is known
    shaded    : which normals have to be right, too, of the minimal factors
    without   : ``(patches,)``, whose normals have no claim; a method's factors say so (``heard``)
    """

    def __init__(
        self,
        scene: Scene,
        view: View,
        tolerance: float,
        settled: Callable[[int], None] | None = None,
        shaded: Shaded = NO_NORMALS,
    ) -> None:
        self.scene, self.view, self.tolerance, self.shaded = scene, view, tolerance, shaded
        self.patches, self.without = scene.patches(), np.zeros(len(scene.patches()), bool)
        self._settled = settled or (lambda _: None)

    @cached_property
    def renderer(self) -> Renderer:
        """Of the scene's patches, on the device of this thread."""
        return Renderer(self.patches, **self.shaded.drawn)

    @cached_property
    def wired(self) -> Renderer:
        """The same, of pictures that know the areas of triangles; apart, so that run times are of plain ones."""
        return Renderer(self.patches, wire=True)

    def heard(self, factors: Factors) -> None:
        """Take over from factors of which patches normals have no claim, if they say so."""
        if factors.without_normal is not None:
            self.without = np.asarray(factors.without_normal)

    @cached_property
    def minimal(self) -> np.ndarray:
        """The smallest factors that keep the tolerances, ``(patches,)``; of normals that have a claim."""
        if not self.without.any():
            return self._minimal(self.patches, self.shaded, 0)
        found, done = np.zeros(len(self.patches), int), 0
        for which, shaded in ((~self.without, self.shaded), (self.without, NO_NORMALS)):
            if which.any():
                found[which] = self._minimal(self.patches[which], shaded.some(which), done)
                done += int(np.count_nonzero(which))
        return found

    def _minimal(self, patches: Any, shaded: Shaded, done: int) -> np.ndarray:
        kept = shaded.asked(Certified())
        return minimal_factors(
            patches, self.view, self.tolerance, progress=lambda count: self._settled(done + count), **kept
        )

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
        for name in {"renderer", "wired"} & self.__dict__.keys():
            self.__dict__[name].release()


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
    def area(self) -> np.ndarray:
        """On the screen, of the triangle that is seen, of every pixel; square pixels, NaN where nothing is."""
        if self.seen.area is not None:
            return self.seen.area
        area = self.beside.wired.draw(self.view, self.inner, self.outer).area
        assert area is not None
        return area

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

    @cached_property
    def turned(self) -> np.ndarray:
        """Between drawn and exact normals, of every pixel, in degrees; NaN where nothing is claimed of them."""
        found = normal_error(self.patches, self.view, self.seen, *self.beside.shaded.kind)
        return np.where(np.append(self.beside.without, True)[self.seen.patch], np.nan, found)

    @cached_property
    def uniform_turned(self) -> np.ndarray:
        """The largest angle of every patch over its domain, as ``uniform``; NaN where nothing is claimed."""
        own = self.with_factors
        levels = own.levels if own.pairs is None else own.pairs
        found = sampled_normal_error(self.patches, levels, self.view, *self.beside.shaded.kind)
        return np.where(self.beside.without, np.nan, found)

    @cached_property
    def worst_turned(self) -> np.ndarray:
        """The same over the triangles that were made."""
        found = triangle_normal_error(self.patches, self.captured, self.view, *self.beside.shaded.kind)
        return np.where(self.beside.without, np.nan, found)

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
