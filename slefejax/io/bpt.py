"""The .bpt format: lists of Bézier patches in plain text.

First the number of patches; then for every patch its degrees ``du dv`` and (du+1)(dv+1) control points ``x y z``, the
points of u = 0 first, v growing along them. Numbers are separated by blanks or line ends.
"""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np

from slefejax.errors import InputError
from slefejax.geometry.bezier import HIGHEST_DEGREE
from slefejax.io.content import Content
from slefejax.io.numbers import Numbers


def read_bpt(path: Path) -> Content:
    """The patches of a file.

    Raises InputError, with the file and the line, for anything that is not such a file.
    """
    numbers = Numbers(path)
    count = numbers.whole("the number of patches", 0, 10**9)
    if count == 0:
        raise numbers.fail("the file says that it has no patches: at least one is needed")
    patches = tuple(_read_patch(numbers, index) for index in range(count))
    if (item := numbers.rest()) is not None:
        raise numbers.fail(f"{item[:40]!r} follows the last of the {count} patches: is the count on line 1 right?")
    return Content(patches=patches, digits=numbers.digits(patches))


def _read_patch(numbers: Numbers, index: int) -> np.ndarray:
    name = f"of patch {index} (counted from 0)"
    du, dv = (numbers.whole(f"degree {axis} {name}", 1, HIGHEST_DEGREE) for axis in "uv")
    return numbers.points((du + 1, dv + 1, 3), f"a coordinate {name}")


def write_bpt(path: Path, patches: np.ndarray) -> None:
    """Patches ``(patches, du+1, dv+1, 3)`` to a file that ``read_bpt`` reads again, bit for bit."""
    count, nu, nv = patches.shape[:3]
    lines = [str(count)]
    for patch in np.asarray(patches, np.float64).reshape(count, nu * nv, 3):
        lines.append(f"{nu - 1} {nv - 1}")
        lines += [" ".join(repr(float(x)) for x in point) for point in patch]
    try:
        (part := path.with_name(f".{path.name}.partial")).write_text("\n".join(lines) + "\n")
        os.replace(part, path)
    except OSError as error:
        raise InputError(f"{path} cannot be written: {error.strerror or error}") from None
