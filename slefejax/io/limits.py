"""How much a file may be, for every reader: nothing is allocated because a file says so.

A reader keeps to three rules, which together bound its memory by the file's size:

- a file is not larger than ``LARGEST_FILE``, one that is parsed word by word (text, JSON) not than ``LARGEST_TEXT``;
- a count that a header tells is compared with the bytes that are there for it (``check_count``);
- where a small file may ask for a large array (a table of all joints in all frames), that array is compared with
  ``MOST_NUMBERS`` (``check_numbers``).

So a reader takes at most ``MEMORY_A_BYTE`` bytes of memory for every byte of text, and arrays beside it.
"""

from __future__ import annotations

from pathlib import Path

from slefejax.errors import InputError

LARGEST_FILE = 1 << 30  # bytes
LARGEST_TEXT = 1 << 28
MEMORY_A_BYTE = 48  # of a text: an object of Python's has about as many bytes, and takes two characters to write
MOST_NUMBERS = 10**8  # of an array that a file does not write out: 0.8 GB


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


def check_numbers(path: Path, what: str, count: int) -> None:
    """Raise InputError for an array that would have more numbers than are made from one file."""
    if count > MOST_NUMBERS:
        raise InputError(f"{path} asks for {count:,} numbers for {what}, more than the {MOST_NUMBERS:,} that are made")
