"""Text files that are one list of numbers, read in order; whatever is wrong is told with its line."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from slefejax.errors import InputError
from slefejax.io.content import read_bytes


class Numbers:
    """The items of a text file in order, each with the line that it stands on.

    Raises InputError, with the file and the line, for anything that is not what is asked for.
    """

    def __init__(self, path: Path, comment: str | None = None) -> None:
        self._path, self._comment = path, comment
        self._items = self._split(_text(path))
        self.line = 1

    def _split(self, text: str) -> Iterator[tuple[int, str]]:
        for number, line in enumerate(text.splitlines(), 1):
            for item in (line if self._comment is None else line.split(self._comment, 1)[0]).split():
                yield number, item

    def fail(self, what: str) -> InputError:
        """An error that names the file and the line."""
        return InputError(f"{self._path}, line {self.line}: {what}")

    def next(self, wanted: str) -> str:
        """The next item, which has to be there."""
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
        """The next item as a whole number in a range."""
        item = self.next(wanted)
        if not (item.isascii() and item.isdigit() and len(item) < 10 and lowest <= int(item) <= highest):
            raise self.fail(f"{wanted} should be a whole number from {lowest} to {highest}, not {item[:40]!r}")
        return int(item)

    def real(self, wanted: str) -> float:
        """The next item as a finite number."""
        item = self.next(wanted)
        value = parse_real(item)
        if value is None:
            raise self.fail(f"{wanted} should be a number, not {item[:40]!r}")
        if not np.isfinite(value):
            raise self.fail(f"{wanted} is not a finite number ({item[:40]})")
        return value

    def points(self, shape: tuple[int, ...], wanted: str) -> np.ndarray:
        """The next numbers as an array of that shape."""
        return np.array([self.real(wanted) for _ in range(int(np.prod(shape)))]).reshape(shape)


def parse_real(item: str) -> float | None:
    """The number that a text stands for, or None."""
    try:
        return float(item) if "_" not in item else None
    except ValueError:
        return None


def _text(path: Path) -> str:
    try:
        return read_bytes(path).decode("utf-8-sig")
    except UnicodeDecodeError:
        raise InputError(f"{path} is not a text file: a {path.suffix} file holds plain numbers") from None
