"""A texture as it is drawn, at parameters that are off, beside the same at exact ones: what accuracy is for."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np
from scipy.ndimage import uniform_filter

from slefejax.experiments.looks.made import Made
from slefejax.experiments.looks.picture import looked_up
from slefejax.experiments.studies.look import Look
from slefejax.figures.looks.panels import CLOSER
from slefejax.figures.looks.pictures import write_textured
from slefejax.figures.style import occupied
from slefejax.gpu import GBuffer
from slefejax.measure.error import surface_on_screen
from slefejax.measure.exact import exact_parameters
from slefejax.model.texture import texture_at

FINER, COARSER = 4.0, 0.5  # scales of the other drawings: the one that exact parameters are found from, and the last


@dataclass(frozen=True)
class Texture:
    """A picture ``(height, width, 3)``, and where patches have it: ``Scene.texture_coordinates()``."""

    picture: np.ndarray
    coordinates: np.ndarray

    def colours(self, seen: GBuffer) -> np.ndarray:
        """Of every pixel, 0 to 1; NaN for background, and where a face has no coordinates."""
        return looked_up(self.picture, self.at(seen))

    def at(self, seen: GBuffer) -> np.ndarray:
        """Coordinates of every pixel, ``(height, width, 2)``, NaN for background."""
        found = texture_at(self.coordinates, seen.patch, seen.u, seen.v)
        return np.where((seen.patch >= 0)[..., None], found, np.nan)


@dataclass
class Textured(Look):
    """A look at a scene that has a texture.

    texture : the texture;  scale : of what is drawn
    finer, coarser : inner and outer levels of the other two drawings
    """

    texture: Texture | None = None
    scale: float = 1.0
    finer: tuple[np.ndarray, np.ndarray] | None = None
    coarser: tuple[np.ndarray, np.ndarray] | None = None

    @cached_property
    def exact(self) -> GBuffer:
        """What would be seen if nothing were off; u and v in float64."""
        assert self.finer is not None
        seen = self.renderer.draw(self.view, *self.finer)
        u, v = exact_parameters(self.patches, self.view, seen)
        return replace(seen, u=u, v=v)

    @cached_property
    def coarse(self) -> GBuffer:
        """With the smaller factors."""
        assert self.coarser is not None
        return self.renderer.draw(self.view, *self.coarser)


def texture(look: Textured) -> Made:
    """The texture at exact parameters, as drawn, and as drawn with smaller factors."""
    assert look.texture is not None
    off = displacement(look, look.seen)
    shown = {
        "exact": look.exact,
        f"as drawn, scale {look.scale:g}": look.seen,
        f"as drawn, scale {COARSER * look.scale:g}": look.coarse,
    }
    there = [seen.patch >= 0 for seen in shown.values()]
    draw = partial(
        write_textured,
        colours={title: look.texture.colours(seen) for title, seen in shown.items()},
        there=there,
        close=_worst_part(displacement(look, look.coarse), occupied(np.any(there, axis=0))),
    )
    channels = {"displacement_px": off}
    for name, seen in (("", look.seen), ("exact_", look.exact)):
        at = look.texture.at(seen)
        channels |= {f"{name}s": at[..., 0], f"{name}t": at[..., 1]}
    shows = f"a texture; what is drawn is at most {np.nanmax(off, initial=0.0):.2g} px from its place"
    return Made(shows, draw, channels, "displacement_px")


def displacement(look: Textured, seen: GBuffer) -> np.ndarray:
    """How far on the screen from what belongs there the texels lie that pixels show: max(|dx|, |dy|) in pixels.

    Between the exact surface's points that have the parameters drawn and the exact ones. NaN where one of both shows
    nothing.
    """
    exact = look.exact
    at = np.nonzero((exact.patch >= 0) & (seen.patch >= 0))
    found = np.full(seen.patch.shape, np.nan)
    if at[0].size:
        drawn, belongs = (
            surface_on_screen(look.patches, look.view, own.patch[at], own.u[at], own.v[at])[:, :2]
            for own in (seen, exact)
        )
        found[at] = np.max(np.abs(drawn - belongs), axis=1)
    return found


def _worst_part(off: np.ndarray, crop: tuple[slice, slice]) -> tuple[slice, slice]:
    """Rows and columns of the part of what is shown, a quarter as high and wide, that is furthest off on the whole."""
    shown = np.nan_to_num(off[crop])
    size = (max(1, shown.shape[0] // CLOSER), max(1, shown.shape[1] // CLOSER))
    middle = np.unravel_index(np.argmax(uniform_filter(shown, size, mode="constant")), shown.shape)  # type: ignore[arg-type]
    parts = []
    for at, n, most, part in zip(middle, size, shown.shape, crop, strict=True):
        first = part.start + int(np.clip(at - n // 2, 0, most - n))
        parts.append(slice(first, first + n))
    return parts[0], parts[1]
