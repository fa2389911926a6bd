"""Measured minimal factors of patches in many views, beside what predictions of them are made of."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from slefejax.arguments import Number, Patches, check_patches, check_positive, check_segments
from slefejax.bounds.widths import screen_twists, screen_widths
from slefejax.errors import InputError
from slefejax.geometry.view import View, check_views
from slefejax.measure.minimal import minimal_factors
from slefejax.measure.supremum import sampled_error

TWIST = "twist"


def slefe_term(segments: int) -> str:
    """The name of the term m^2 w of the estimate with m segments.

    >>> slefe_term(3)
    'slefe 3'
    """
    return f"slefe {segments}"


@dataclass(frozen=True)
class Samples:
    """A sample is a patch in a view that shows it; arrays are ``(samples,)``.

    view, patch : numbers, counted from 0
    minimal     : the minimal factor, whole (``slefejax.minimal_factors``)
    needed      : the same as a real number: n sqrt(e / tolerance) with e the error that n = ``minimal`` leaves, above
                  n - 1 and at most n. Whoever predicts at least that is safe after rounding up
    terms       : by name what tau^2 is made of: ``slefe m``, m^2 w / tolerance, for every m that was asked for, and
                  ``twist``, the twist over the tolerance
    tolerance   : pixels
    """

    view: Int[np.ndarray, "samples"]
    patch: Int[np.ndarray, "samples"]
    minimal: Int[np.ndarray, "samples"]
    needed: Float[np.ndarray, "samples"]
    terms: dict[str, Float[np.ndarray, "samples"]]
    tolerance: float

    def __len__(self) -> int:
        return len(self.view)

    @property
    def views(self) -> Int[np.ndarray, "views"]:
        """The numbers of the views that show anything."""
        return np.unique(self.view)

    def design(self, names: Sequence[str]) -> Float[np.ndarray, "samples terms"]:
        """The terms of these names, side by side. Raises InputError for a name that there is not."""
        unknown = [name for name in names if name not in self.terms]
        if unknown or not names:
            known = ", ".join(self.terms)
            raise InputError(f"the samples have no term {unknown[0] if unknown else 'at all'!r}: they have {known}")
        return np.column_stack([self.terms[name] for name in names])

    def where(self, chosen: Any) -> Samples:
        """Only the samples of a mask or of numbers."""
        arrays = {f.name: getattr(self, f.name)[chosen] for f in fields(self) if f.name not in ("terms", "tolerance")}
        return replace(self, **arrays, terms={name: values[chosen] for name, values in self.terms.items()})

    @staticmethod
    def joined(parts: Sequence[Samples]) -> Samples:
        """Samples of several scenes as one; views and patches of different scenes get numbers of their own."""
        if len({part.tolerance for part in parts}) != 1 or len({tuple(part.terms) for part in parts}) != 1:
            raise InputError("samples that are joined need the same tolerance and the same terms")
        views = np.cumsum([0, *(1 + part.view.max(initial=-1) for part in parts)])
        patches = np.cumsum([0, *(1 + part.patch.max(initial=-1) for part in parts)])
        return Samples(
            np.concatenate([part.view + first for part, first in zip(parts, views, strict=False)]),
            np.concatenate([part.patch + first for part, first in zip(parts, patches, strict=False)]),
            np.concatenate([part.minimal for part in parts]),
            np.concatenate([part.needed for part in parts]),
            {name: np.concatenate([part.terms[name] for part in parts]) for name in parts[0].terms},
            parts[0].tolerance,
        )


def measure_factors(
    patches: Patches,
    views: Sequence[View],
    segments: Sequence[int] = (3,),
    tolerance: Number = 0.5,
    *,
    progress: Callable[[int], None] | None = None,
) -> Samples:
    """Minimal factors of all patches in all views, and the terms of their predictions: what ``fit_km`` works with.

    patches   : control points ``(patches, du+1, dv+1, 3)``, or 4 at the end if rational
    segments  : the numbers m of pieces for which there shall be terms
    tolerance : pixels
    progress  : hears how many views are done

    A patch of which nothing is visible makes no sample. Raises InputError as ``minimal_factors`` does.

    >>> from slefejax import Camera, load
    >>> teapot, eyes = load("teapot").patches(), [(4.5, -6.0, 4.0), (-4.5, -6.0, 4.0)]
    >>> samples = measure_factors(teapot, [View(Camera.look_at(e, (0.0, 0.0, 1.2)), 1440, 900) for e in eyes])
    >>> len(samples), int(2 * (samples.minimal[samples.view == 0] ** 2).sum())
    (64, 20178)
    """
    patches = check_patches(patches)
    check_positive("tolerance", tolerance)
    if not isinstance(segments, (tuple, list)) or not segments:
        raise InputError(f"segments must be a list of numbers of pieces, such as (3,), not {segments!r}")
    check_views(views)
    wanted = [check_segments(m) for m in segments]
    parts = []
    for number, view in enumerate(views):
        parts.append(_in_view(patches, number, view, wanted, float(tolerance)))
        if progress is not None:
            progress(number + 1)
    whole = [np.concatenate([getattr(p, name) for p in parts]) for name in ("view", "patch", "minimal", "needed")]
    terms = {name: np.concatenate([p.terms[name] for p in parts]) for name in parts[0].terms}
    return Samples(whole[0], whole[1], whole[2], whole[3], terms, float(tolerance))


def _in_view(patches: Any, number: int, view: View, segments: list[int], tolerance: float) -> Samples:
    minimal = minimal_factors(patches, view, tolerance)
    seen = np.flatnonzero(minimal > 0)
    n = minimal[seen]
    error = sampled_error(np.asarray(patches)[seen], n, view) if len(seen) else np.zeros(0)
    needed = np.clip(n * np.sqrt(error / tolerance), np.nextafter(n - 1.0, n), n)
    terms = {slefe_term(m): m * m * np.asarray(screen_widths(patches, view, m), np.float64)[seen] for m in segments}
    terms[TWIST] = np.asarray(screen_twists(patches, view), np.float64)[seen]
    terms = {name: values / tolerance for name, values in terms.items()}
    return Samples(np.full(len(seen), number), seen, n, needed, terms, tolerance)
