"""Text files that are one list of numbers, read in order; whatever is wrong is told with its line."""

from __future__ import annotations

import io
import re
import warnings
from array import array
from collections.abc import Iterable, Iterator, Sequence
from itertools import takewhile
from math import prod
from pathlib import Path

import numpy as np

from slefejax.errors import InputError
from slefejax.io.content import read_bytes
from slefejax.io.limits import LARGEST_TEXT

_MARGIN = 1.25  # for what a program computed, in single precision perhaps, before it wrote
_COARSEST = 1e-4  # of the size of a model
_LONGEST_EXPONENT = 9  # in digits: with more the number is 0 or none, or they are zeros


class Numbers:
    """The items of a text file in order, each with the line that it stands on.

    Raises InputError, with the file and the line, for anything that is not what is asked for.
    """

    def __init__(self, path: Path, comment: str | None = None) -> None:
        self._path = path
        self._items = self._split(_lines_of(path), comment)
        self._kept: tuple[int, str] | None = None
        self.line = 1
        self._digits, self._unit = 0, 0.0

    def _split(self, lines: Iterable[str], comment: str | None) -> Iterator[tuple[int, str]]:
        for number, line in enumerate(lines, 1):
            for item in line.split() if comment is None else words_before(line, comment):
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
        found = self._kept or next(self._items, None)
        self._kept = None
        if found is None:
            return None
        self.line, item = found
        return item

    def keep(self, item: str) -> None:
        """Give an item back, or what is left of it: it is the next one."""
        self._kept = (self.line, item)

    def whole(self, wanted: str, lowest: int, highest: int) -> int:
        """The next item as a whole number in a range."""
        item = self.next(wanted)
        value = parse_whole(item)
        if value is None or not lowest <= value <= highest:
            raise self.fail(f"{wanted} should be a whole number from {lowest} to {highest}, not {item[:40]!r}")
        return value

    def real(self, wanted: str) -> float:
        """The next item as a finite number."""
        item = self.next(wanted)
        value = parse_real(item)
        if value is None:
            raise self.fail(f"{wanted} should be a number, not {item[:40]!r}")
        if not np.isfinite(value):
            raise self.fail(f"{wanted} is not a finite number ({item[:40]})")
        self._count_digits(item)
        return value

    def _count_digits(self, item: str) -> None:
        """Keep the worth of the last digit of the numbers with the most digits."""
        mantissa, _, exponent = item.lower().partition("e")
        whole, point, fraction = mantissa.lstrip("+-").partition(".")
        count = len((whole + fraction).lstrip("0"))
        if point and count >= max(self._digits, 1) and len(exponent) <= _LONGEST_EXPONENT:
            unit = 10.0 ** (int(exponent or 0) - len(fraction))
            self._unit = unit if count > self._digits else max(unit, self._unit)
            self._digits = count

    def digits(self, patches: Sequence[np.ndarray]) -> float | None:
        """``Content.digits`` of patches that were read: what two roundings to the last digit make, and a quarter more.

        None where all numbers are whole, or have so few digits that they are more likely meant than rounded.
        """
        last = self._unit
        with np.errstate(over="ignore", invalid="ignore"):  # what is too large is told later
            if not 0.0 < last <= _COARSEST * _size(patches):
                return None
            for patch in patches:
                if patch.shape[2] == 4:  # w x and w are rounded
                    reach = np.abs(patch[..., :3] / patch[..., 3:]).max()
                    last = max(last, float(self._unit * (1.0 + reach) / patch[..., 3].min()))
        return _MARGIN * last

    def points(self, shape: tuple[int, ...], wanted: str) -> np.ndarray:
        """The next numbers as an array of that shape."""
        return np.array(array("d", (self.real(wanted) for _ in range(prod(shape)))), np.float64).reshape(shape)


def rows_of(path: Path, kind: np.dtype, comment: str) -> np.ndarray | None:
    """All of a file that is rows of finite numbers, at once; None where it is not, and ``Numbers`` says why.

    kind : of a row; whole numbers are written as such
    """
    lines = list(_lines_of(path))
    if any(comment in line and re.search(rf"\S{re.escape(comment)}", line) for line in lines):
        return None  # inside of a word it begins no comment
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")  # for an empty file, or a whole number that is none
            rows = np.loadtxt(lines, kind, comments=comment, ndmin=1)
    except (ValueError, OverflowError, Warning):
        return None
    finite = all(np.isfinite(rows[name]).all() for name in kind.names or ())
    return rows if finite else None


def _size(patches: Sequence[np.ndarray]) -> float:
    """The largest extent of control points along a coordinate."""
    if not patches:
        return 0.0
    points = [(patch[..., :3] / patch[..., 3:] if patch.shape[2] == 4 else patch).reshape(-1, 3) for patch in patches]
    return float(np.ptp(np.concatenate(points), axis=0).max())


def parse_real(item: str) -> float | None:
    """The number that a text stands for, or None.

    >>> parse_real("1e3"), parse_real("1_0")
    (1000.0, None)
    """
    try:
        return float(item) if "_" not in item else None
    except ValueError:
        return None


def parse_whole(item: str) -> int | None:
    """The whole number, of nine digits at most, that a text stands for, or None.

    >>> parse_whole("-12"), parse_whole("1.0")
    (-12, None)
    """
    digits = item[1:] if item[:1] == "-" else item
    return int(item) if digits.isascii() and digits.isdigit() and len(digits) < 10 else None


def words_before(line: str, comment: str) -> Iterable[str]:
    """The words of a line up to a comment, which begins where a word begins: ``a#1`` and ``1.#IND`` are words.

    >>> list(words_before("1 2 a#3 # rest", "#"))
    ['1', '2', 'a#3']
    """
    words = line.split()
    return words if comment not in line else takewhile(lambda word: not word.startswith(comment), words)


def lines_of(data: bytes) -> io.TextIOWrapper:
    """The lines of a text with any line ends, one after another: they are never all in memory.

    >>> list(lines_of(b"a\\rb\\r\\nc"))
    ['a\\n', 'b\\n', 'c']
    """
    return io.TextIOWrapper(io.BytesIO(data), "utf-8-sig", "replace", newline=None)


def _lines_of(path: Path) -> io.TextIOWrapper:
    data = read_bytes(path, LARGEST_TEXT)
    try:
        data.decode("utf-8")
    except UnicodeDecodeError:
        raise InputError(f"{path} is not a text file: a {path.suffix} file holds plain numbers") from None
    return lines_of(data)
