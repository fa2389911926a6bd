"""The container of PLY: a header that names elements and their properties, and their rows, as text or binary.

A row has the properties of its element one after another; a list is its length and so many values. As text every row
has a line of its own. Some writers put more into it than the header tells, and some break rows or join them, so a row
goes on in the next line where its own is too short, and what is left of a line is left out where there are lines
enough for the rows that follow.
"""

from __future__ import annotations

import re
import struct
from array import array
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import numpy as np
from jaxtyping import Float, Int

from slefejax.errors import InputError
from slefejax.io.limits import check_count
from slefejax.io.numbers import lines_of, parse_real

_TYPES = {
    "char": "b",
    "uchar": "B",
    "short": "h",
    "ushort": "H",
    "int": "i",
    "uint": "I",
    "float": "f",
    "double": "d",
    "int8": "b",
    "uint8": "B",
    "int16": "h",
    "uint16": "H",
    "int32": "i",
    "uint32": "I",
    "float32": "f",
    "float64": "d",
}
_LONGEST_HEADER = 10**6
_FORMATS = {"ascii": None, "binary_little_endian": "<", "binary_big_endian": ">"}


@dataclass
class Property:
    """A property of an element: its type as ``struct`` and NumPy have it, and of a list that of its length."""

    name: str
    kind: str
    count: str | None = None


@dataclass
class Element:
    """An element of the header."""

    name: str
    count: int
    properties: list[Property]


@dataclass(frozen=True, eq=False)
class Column:
    """The values of a property, all rows in one array; of a list the length in every row, too."""

    values: Float[np.ndarray, "values"]
    sizes: Int[np.ndarray, "rows"] | None = None


class Rows(Protocol):
    """The rows of a file, one after another."""

    element: str

    def table(self, element: Element, left: int) -> Float[np.ndarray, "rows properties"]:
        """All rows of an element without lists, behind which so many rows follow."""
        ...

    def take(self, kind: str, count: int) -> Sequence[float]:
        """The next numbers of a row. Raises EOFError where there are none."""
        ...

    def end(self, left: int) -> None:
        """The row ends, and so many follow in the file."""
        ...

    def fail(self, what: str) -> InputError:
        """An error that says where."""
        ...

    def notes(self) -> tuple[str, ...]:
        """Sentences about what was left out, once all rows are read."""
        ...


def read_elements(path: Path, data: bytes) -> tuple[dict[str, dict[str, Column]], tuple[str, ...]]:
    """Columns, by the names of element and property, and notes.

    Raises InputError for what is no PLY file, or not whole.
    """
    elements, order, start = _header(path, data)
    _check(path, elements, len(data) - start, order is not None)
    rows: Rows = _Text(path, data, start) if order is None else _Binary(path, data, start, order)
    left, found = sum(element.count for element in elements), {}
    for element in elements:
        left -= element.count
        rows.element = element.name
        try:
            found[element.name] = _columns(rows, element, left)
        except EOFError:
            what = f"the file ends within its {element.count} elements '{element.name}': is it complete?"
            raise rows.fail(what) from None
    return found, rows.notes()


def _columns(rows: Rows, element: Element, left: int) -> dict[str, Column]:
    names = [p.name for p in element.properties]
    if all(p.count is None for p in element.properties):
        table = rows.table(element, left)
        return {name: Column(table[:, k]) for k, name in enumerate(names)}
    values, sizes = {name: array("d") for name in names}, {name: array("q") for name in names}
    for row in range(element.count):
        for p in element.properties:
            count = 1
            if p.count is not None:
                count = _length(rows, rows.take(p.count, 1)[0])
                sizes[p.name].append(count)
            values[p.name].extend(rows.take(p.kind, count))
        rows.end(left + element.count - 1 - row)
    return {
        p.name: Column(np.array(values[p.name]), np.array(sizes[p.name]) if p.count else None)
        for p in element.properties
    }


def _length(rows: Rows, count: float) -> int:
    """The length of a list, which may be stored as any kind of number."""
    if not (0 <= count < 2**32 and count == int(count)):
        raise rows.fail(f"a list of elements '{rows.element}' has the length {count:.12g}")
    return int(count)


def _header(path: Path, data: bytes) -> tuple[list[Element], str | None, int]:
    """The elements, the byte order (None for text), and where the numbers begin."""
    head = data[:_LONGEST_HEADER]
    first = re.match(rb"ply[ \t]*(\r\n?|\n)", head)
    # a line that ends with a carriage return alone may be followed by a number that begins with a byte 10
    end = rb"\r[ \t]*end_header[ \t]*(\r)" if first and first[1] == b"\r" else rb"\n[ \t]*end_header[ \t]*(\r?\n)"
    found = re.search(end, head)
    if first is None or found is None:
        raise InputError(f"{path} has no PLY header, from 'ply' to 'end_header': is it complete?")
    order: str | None = ""
    elements: list[Element] = []
    lines = re.split(r"\r\n|\r|\n", head[: found.start()].decode("ascii", errors="replace"))
    for number, line in enumerate(lines, 1):
        try:
            match line.split():
                case ["format", name, *_]:
                    order = _FORMATS[name]
                case ["element", name, count]:
                    elements.append(Element(name, _count(count), []))
                case ["property", "list", count, kind, name]:
                    elements[-1].properties.append(Property(name, _TYPES[kind], _TYPES[count]))
                case ["property", kind, name]:
                    elements[-1].properties.append(Property(name, _TYPES[kind]))
                case ["ply"] | ["comment" | "obj_info", *_] | []:
                    pass
                case _:
                    raise KeyError(line)
        except (KeyError, ValueError, IndexError):
            raise InputError(f"{path}, line {number}: {line[:60]!r} is no line of a PLY header") from None
    if order == "":
        raise InputError(f"{path} does not say its format: ascii, binary_little_endian or binary_big_endian")
    return elements, order, found.end()


def _count(item: str) -> int:
    digits = item.removeprefix("-")
    if not (digits.isascii() and digits.isdigit() and len(digits) < 20):
        raise ValueError
    return int(item)


def _check(path: Path, elements: list[Element], available: int, binary: bool) -> None:
    """Raise InputError for elements of the header that cannot be."""
    for element in elements:
        names = [p.name for p in element.properties]
        if not names or len(set(names)) < len(names):
            raise InputError(f"{path}: the header's element '{element.name}' needs properties with different names")
        # as text a number is a digit and, but for the last, what parts it from the next
        each = sum(np.dtype(p.count or p.kind).itemsize for p in element.properties) if binary else 2 * len(names) - 1
        check_count(path, f"elements '{element.name}'", element.count, each, available)
    twice = [name for name in {e.name for e in elements} if sum(e.name == name for e in elements) > 1]
    if twice:
        raise InputError(f"{path}: the header has two elements '{twice[0]}'")


class _Text:
    def __init__(self, path: Path, data: bytes, start: int) -> None:
        self._path, self.element = path, ""
        self._line = len(re.findall(rb"\r\n|\r|\n", data[:start]))
        body = data[start:]
        self._lines = self._split(body)
        self._left = sum(1 for line in lines_of(body) if not line.isspace())  # lines that are not begun
        self._items: list[str] = []
        self._at = 0
        self._longer = 0

    def _split(self, body: bytes) -> Iterator[list[str]]:
        for line in lines_of(body):
            self._line += 1
            if items := line.split():
                self._left -= 1
                yield items

    def fail(self, what: str) -> InputError:
        return InputError(f"{self._path}, line {self._line}: {what}")

    def table(self, element: Element, left: int) -> Float[np.ndarray, "rows properties"]:
        values, width = array("d"), len(element.properties)
        for row in range(element.count):
            values.extend(self.take("", width))
            self.end(left + element.count - 1 - row)
        return np.array(values).reshape(-1, width)

    def take(self, kind: str, count: int) -> list[float]:
        numbers: list[float] = []
        while len(numbers) < count:
            if self._at == len(self._items):
                self._items, self._at = next(self._lines, []), 0
                if not self._items:
                    raise EOFError
            items = self._items[self._at : self._at + count - len(numbers)]
            self._at += len(items)
            numbers += [self._number(item) for item in items]
        return numbers

    def _number(self, item: str) -> float:
        value = parse_real(item)
        if value is None:
            raise self.fail(f"{item[:40]!r} among the elements '{self.element}' is not a number")
        return value

    def end(self, left: int) -> None:
        if self._at < len(self._items) and self._left >= left:
            self._items, self._at = [], 0
            self._longer += 1

    def notes(self) -> tuple[str, ...]:
        notes = []
        if self._longer:
            notes.append(f"{self._longer} rows hold more numbers than the header tells: those behind were left out")
        if self._left:
            notes.append(f"{self._left} lines behind the last row were left out")
        return tuple(notes)


class _Binary:
    def __init__(self, path: Path, data: bytes, start: int, order: str) -> None:
        self._path, self._data, self._order, self._at = path, data, order, start
        self.element = ""

    def fail(self, what: str) -> InputError:
        return InputError(f"{self._path}: {what}")

    def table(self, element: Element, left: int) -> Float[np.ndarray, "rows properties"]:
        dtype = np.dtype([(p.name, self._order + p.kind) for p in element.properties])
        rows = np.ndarray(element.count, dtype, self._data, self._pass(element.count * dtype.itemsize))
        return np.stack([rows[p.name].astype(np.float64) for p in element.properties], axis=1)

    def take(self, kind: str, count: int) -> tuple[float, ...]:
        form = f"{self._order}{count}{kind}"
        return struct.unpack_from(form, self._data, self._pass(struct.calcsize(form)))

    def _pass(self, size: int) -> int:
        """Go on by so many bytes, which have to be there; where they begin."""
        self._at += size
        if self._at > len(self._data):
            raise EOFError
        return self._at - size

    def end(self, left: int) -> None:
        """Nothing: rows are as long as the header says."""

    def notes(self) -> tuple[str, ...]:
        rest = len(self._data) - self._at
        return (f"{rest} bytes behind the last row were left out",) if rest else ()
