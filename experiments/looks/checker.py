"""A checker by the patches' own parameters, as they were drawn."""

from __future__ import annotations

from functools import partial

import numpy as np

from slefejax.experiments.looks.made import Made
from slefejax.experiments.studies.look import Look
from slefejax.figures.looks.pictures import write_checker
from slefejax.gpu import GBuffer

SQUARES = 8  # along each side of a patch; an even number, so that it goes on from patch to patch


def checker(look: Look) -> Made:
    """Squares of u and v; where parameters are off, they are bent."""
    seen = look.seen
    there = seen.patch >= 0
    numbers = {"u": seen.u, "v": seen.v, "patch": seen.patch.astype(np.float32)}  # exact: there are fewer than 2^24
    channels = {name: np.where(there, own, np.float32(np.nan)) for name, own in numbers.items()}
    draw = partial(write_checker, squares=squares(seen), label=f"a square is 1/{SQUARES} of a patch wide")
    return Made("the parameters u and v of every patch, as drawn", draw, channels)


def squares(seen: GBuffer) -> np.ndarray:
    """0 or 1 by the square that a pixel lies in, -1 for background."""
    along_u, along_v = (np.clip(np.floor(SQUARES * own), 0, SQUARES - 1) for own in (seen.u, seen.v))
    return np.where(seen.patch >= 0, (along_u + along_v) % 2, -1).astype(int)
