"""The .bpt format: lists of Bézier patches in plain text.

First the number of patches; then for every patch its degrees ``du dv`` and (du+1)(dv+1) control points ``x y z``, the
points of u = 0 first, v growing along them. Numbers are separated by blanks or line ends.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from slefejax.errors import InputError
from slefejax.slefe import HIGHEST_DEGREE


class _Numbers:
    """The numbers of a text file in order, each with the line that it stands on."""

    def __init__(self, path: Path, text: str) -> None:
        self._path = path
        self._items = self._split(text)
        self.line = 1

    def _split(self, text: str) -> Iterator[tuple[int, str]]:
        for number, line in enumerate(text.splitlines(), 1):
            for item in line.split():
                yield number, item

    def fail(self, what: str) -> InputError:
        return InputError(f"{self._path}, line {self.line}: {what}")

    def next(self, wanted: str) -> str:
        item = self.rest()
        if item is None:
            raise self.fail(f"the file ends where {wanted} should be: is it complete?")
        return item

    def rest(self) -> str | None:
        """The next item, or None at the end of the file."""
        for line, item in self._items:
            self.line = line
            return item
        return None

    def whole(self, wanted: str, lowest: int, highest: int) -> int:
        item = self.next(wanted)
        if not (item.isascii() and item.isdigit() and len(item) < 10 and lowest <= int(item) <= highest):
            raise self.fail(f"{wanted} should be a whole number from {lowest} to {highest}, not {item[:40]!r}")
        return int(item)

    def real(self, wanted: str) -> float:
        item = self.next(wanted)
        try:
            value = float(item) if "_" not in item else None
        except ValueError:
            value = None
        if value is None:
            raise self.fail(f"{wanted} should be a number, not {item[:40]!r}")
        if not np.isfinite(value):
            raise self.fail(f"{wanted} is not a finite number ({item[:40]})")
        return value


def read_bpt(path: Path) -> list[np.ndarray]:
    """Control points of every patch, ``(du+1, dv+1, 3)`` float64 each.

    Raises InputError, with the file and the line, for anything that is not such a file.
    """
    numbers = _Numbers(path, _text(path))
    count = numbers.whole("the number of patches", 0, 10**9)
    if count == 0:
        raise numbers.fail("the file says that it has no patches: at least one is needed")
    patches = [_read_patch(numbers, index) for index in range(count)]
    if (item := numbers.rest()) is not None:
        raise numbers.fail(f"{item[:40]!r} follows the last of the {count} patches: is the count on line 1 right?")
    return patches


def _read_patch(numbers: _Numbers, index: int) -> np.ndarray:
    name = f"of patch {index} (counted from 0)"
    du, dv = (numbers.whole(f"degree {axis} {name}", 1, HIGHEST_DEGREE) for axis in "uv")
    wanted = f"a coordinate {name}"
    values = [numbers.real(wanted) for _ in range((du + 1) * (dv + 1) * 3)]
    return np.array(values).reshape(du + 1, dv + 1, 3)


def _text(path: Path) -> str:
    try:
        return path.read_bytes().decode("utf-8-sig")
    except UnicodeDecodeError:
        raise InputError(f"{path} is not a text file: a .bpt file holds plain numbers") from None
    except FileNotFoundError:
        raise InputError(f"there is no file {path}: check the name") from None
    except OSError as error:
        raise InputError(f"{path} cannot be read: {error.strerror or error}") from None
