"""Cases that are meant to break a bound, of the nets and views of ``slefejax attack``: one for every seed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from slefejax.experiments.attack.families.nets import RATIONAL, SHAPES, moved, nets
from slefejax.experiments.attack.views import VIEWS, elsewhere, view_of
from slefejax.geometry.view import View

_DECADES = 4.0  # of weights; with more, factors become numbers that no tessellation can have


@dataclass(frozen=True)
class Case:
    """Patches of one bi-degree in one view."""

    name: str
    patches: np.ndarray
    view: View


def case(seed: int, count: int) -> Case:
    """Bi-degrees 1 to 5, all families, or, every other seed, rational; scales over six decades."""
    rng = np.random.default_rng(seed)
    degrees = (int(rng.integers(1, 6)), int(rng.integers(1, 6)))
    looks = list(VIEWS)[seed % len(VIEWS)]
    families = [RATIONAL] if seed % 2 else list(SHAPES)
    shares = [own for own in np.array_split(10.0 ** rng.uniform(-1.0, 0.5, count), len(families)) if own.size]
    made = [nets(name, rng, degrees, own, _DECADES) for name, own in zip(families, shares, strict=False)]
    scale = 10.0 ** rng.uniform(-3.0, 3.0)
    look = elsewhere(VIEWS[looks](rng), scale, np.zeros(3))._replace(width=800, height=600)
    name = f"seed {seed}: bi-degree {degrees}, {'rational' if seed % 2 else 'polynomial'}, {looks}, scale {scale:.3g}"
    return Case(name, moved(np.concatenate(made), scale, np.zeros(3)), view_of(look))
