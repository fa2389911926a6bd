"""How much a file may be, for every reader: nothing is allocated because a file says so.

A reader keeps to three rules, which together bound its memory by the file's size:

- a file is not larger than ``LARGEST_FILE``, one that is parsed item by item (text, JSON, PLY) than ``LARGEST_TEXT``;
- a count that a header tells is compared with the bytes that are there for it (``check_count``);
- where a small file may ask for a large array (all joints in all frames, all patches raised to the degree of one), that
  array is compared with ``MOST_NUMBERS`` (``check_numbers``).

So a reader takes at most ``MEMORY_A_BYTE`` bytes of memory for every byte that is parsed, and arrays beside it. What is
made of a control mesh takes a few hundred bytes a corner, so there are at most ``MOST_CORNERS``.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

from slefejax.errors import InputError

LARGEST_FILE = 1 << 30  # bytes
LARGEST_TEXT = 1 << 28
MEMORY_A_BYTE = 48  # an object of Python's has about as many bytes, and takes two characters to write
MOST_NUMBERS = 2 * 10**8  # of an array that a file does not write out: 1.6 GB, four million bicubic patches
MOST_CORNERS = 16 * 10**6  # four million quads
_SCHEME = re.compile(r"[A-Za-z][A-Za-z0-9+.-]*:")


def check_size(path: Path, size: int, largest: int = LARGEST_FILE) -> None:
    """Raise InputError for a file of more bytes than are read."""
    if size > largest:
        raise InputError(
            f"{path} has {size / 1e6:,.0f} MB, more than the {largest / 1e6:,.0f} MB that a file of its kind may have:"
            " split it, or leave out what is not needed"
        )


def check_count(path: Path, what: str, count: int, bytes_each: int, available: int) -> None:
    """Raise InputError if a header tells of more than the file holds.

    what       : what is counted, in the plural, for the message
    bytes_each : the fewest bytes that one of them takes
    available  : how many bytes are there for them
    """
    if not 0 <= count * bytes_each <= available:
        raise InputError(f"{path} tells of {count:,} {what}, but has {available:,} bytes for them: is it complete?")


def check_numbers(path: Path | str, what: str, count: int) -> None:
    """Raise InputError for an array that would have more numbers than are made from one file."""
    if count > MOST_NUMBERS:
        raise InputError(f"{path} asks for {count:,} numbers for {what}, more than the {MOST_NUMBERS:,} that are made")


def check_corners(path: Path, count: int) -> None:
    """Raise InputError for a control mesh with more corners of faces than patches are made of."""
    if count > MOST_CORNERS:
        raise InputError(f"{path} has faces with {count:,} corners, more than {MOST_CORNERS:,}: take a coarser mesh")


def check_spline(name: str, counts: Sequence[int], degrees: Sequence[int]) -> None:
    """Raise InputError for a spline surface whose Bézier patches would be out of proportion.

    counts  : of control points along u and v; ``degrees`` likewise
    """
    along = [max(count - degree, 0) * (degree + 1) for count, degree in zip(counts, degrees, strict=True)]
    for points, count in zip(along, counts, strict=True):
        check_numbers(name, "how Bézier points are made of its control points", points * count)
    check_numbers(name, "its Bézier patches", 4 * along[0] * along[1])


def within(folder: Path, name: str) -> Path | None:
    """The file of that name, there or not, if it lies in the folder or below, links followed; otherwise None."""
    try:
        found = (folder / name).resolve()
        there = found.is_file() or not (found.exists() or found.is_symlink())  # a link to itself is there, and no file
        inside = there and found.is_relative_to(folder.resolve())
    except (OSError, ValueError, RuntimeError):  # a name that no file can have, a link to itself
        return None
    return found if inside and not _SCHEME.match(name) else None
