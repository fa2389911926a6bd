"""PLY: control meshes of any polygons, as text or binary of either byte order."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from slefejax.errors import InputError
from slefejax.io.content import Content, read_bytes
from slefejax.io.numbers import parse_real
from slefejax.mesh import Mesh

_TYPES = {
    "char": "i1",
    "uchar": "u1",
    "short": "i2",
    "ushort": "u2",
    "int": "i4",
    "uint": "u4",
    "float": "f4",
    "double": "f8",
    "int8": "i1",
    "uint8": "u1",
    "int16": "i2",
    "uint16": "u2",
    "int32": "i4",
    "uint32": "u4",
    "float32": "f4",
    "float64": "f8",
}
_LONGEST_HEADER = 10**6
_MOST = 10**9
_FORMATS = {"ascii": None, "binary_little_endian": "<", "binary_big_endian": ">"}


@dataclass
class _Property:
    name: str
    kind: str
    count: str | None = None  # of a list: the type of its length


@dataclass
class _Element:
    name: str
    count: int
    properties: list[_Property]


def read_ply(path: Path) -> Content:
    """The control mesh of a file: ``x y z`` of its vertices, ``vertex_indices`` of its faces.

    Raises InputError, with the file and what is wrong where, for what is no such file.
    """
    data = read_bytes(path)
    elements, order, start = _header(path, data)
    body: Any = _Text(path, data[start:]) if order is None else _Binary(path, data[start:], order)
    found = {element.name: _columns(path, body, element) for element in elements}
    for name in ("vertex", "face"):
        if name not in found:
            raise InputError(f"{path} has no element '{name}': a control mesh needs vertices and faces")
    lists = {(e.name, p.name): p.count is not None for e in elements for p in e.properties}
    missing = [axis for axis in "xyz" if lists.get(("vertex", axis), True)]
    named = [name for name in ("vertex_indices", "vertex_index") if lists.get(("face", name), False)]
    if missing or not named:
        what = f"number '{missing[0]}' of its vertices" if missing else "list 'vertex_indices' of its faces"
        raise InputError(f"{path} has no {what}")
    faces = found["face"][named[0]]
    faces = [_whole(path, number, face) for number, face in enumerate(faces)]
    points = np.stack([np.asarray(found["vertex"][axis], np.float64) for axis in "xyz"], axis=1)
    try:
        return Content(mesh=Mesh.of(points, faces))
    except InputError as error:
        raise InputError(f"{path}: {error}") from None


def _header(path: Path, data: bytes) -> tuple[list[_Element], str | None, int]:
    """The elements, the byte order (None for text), and where the numbers begin."""
    found = re.search(rb"^end_header[ \t]*\r?\n", data[:_LONGEST_HEADER], re.MULTILINE)
    if not data.startswith(b"ply") or found is None:
        raise InputError(f"{path} has no PLY header, from 'ply' to 'end_header': is it complete?")
    end, start = found.start(), found.end()
    order: Any = ""
    elements: list[_Element] = []
    for number, line in enumerate(data[:end].decode("ascii", errors="replace").splitlines(), 1):
        words = line.split()
        try:
            match words:
                case ["format", name, *_]:
                    order = _FORMATS[name]
                case ["element", name, count]:
                    elements.append(_Element(name, int(count), []))
                case ["property", "list", count, kind, name]:
                    elements[-1].properties.append(_Property(name, _TYPES[kind], _TYPES[count]))
                case ["property", kind, name]:
                    elements[-1].properties.append(_Property(name, _TYPES[kind]))
                case ["ply"] | ["comment" | "obj_info", *_] | []:
                    pass
                case _:
                    raise KeyError(line)
        except (KeyError, ValueError, IndexError):
            raise InputError(f"{path}, line {number}: {line[:60]!r} is no line of a PLY header") from None
    if order == "":
        raise InputError(f"{path} does not say its format: ascii, binary_little_endian or binary_big_endian")
    return elements, order, start


def _whole(path: Path, number: int, face: Any) -> list[int]:
    """The vertex numbers of a face."""
    values = np.asarray(face, np.float64)
    bad = values[~((np.abs(values) < 2.0**53) & (values == np.floor(values)))]
    if bad.size:
        raise InputError(f"{path}: face {number} (counted from 0) names vertex {bad[0]:g}, which is no whole number")
    return values.astype(np.int64).tolist()


def _columns(path: Path, body: Any, element: _Element) -> dict[str, Any]:
    """The values of every property, one entry a row."""
    names = [p.name for p in element.properties]
    if not 0 <= element.count < _MOST or not names or len(set(names)) < len(names):
        raise InputError(
            f"{path}: the header's element '{element.name}' needs from 0 to {_MOST} entries, not {element.count}, and"
            " properties with different names"
        )
    if all(p.count is None for p in element.properties):
        table = body.table(element)
        return {p.name: table[:, k] for k, p in enumerate(element.properties)}
    columns: dict[str, list] = {p.name: [] for p in element.properties}
    for _ in range(element.count):
        for p in element.properties:
            columns[p.name].append(body.values(p, element))
    return columns


def _short(path: Path, element: _Element) -> InputError:
    return InputError(f"{path} ends within its {element.count} elements '{element.name}': is it complete?")


class _Text:
    def __init__(self, path: Path, data: bytes) -> None:
        self._path, self._items, self._at = path, data.decode("ascii", errors="replace").split(), 0

    def _take(self, count: int, element: _Element) -> list[float]:
        items = self._items[self._at : self._at + count]
        if len(items) < count:
            raise _short(self._path, element)
        self._at += count
        numbers = [parse_real(item) for item in items]
        if None in numbers:
            bad = items[numbers.index(None)]
            raise InputError(f"{self._path}: {bad[:40]!r} among the elements '{element.name}' is not a number")
        return numbers  # type: ignore[return-value]

    def table(self, element: _Element) -> np.ndarray:
        width = len(element.properties)
        return np.array(self._take(element.count * width, element)).reshape(element.count, width)

    def values(self, p: _Property, element: _Element) -> Any:
        if p.count is None:
            return self._take(1, element)[0]
        count = self._take(1, element)[0]
        return self._take(_length(self._path, count, element), element)


class _Binary:
    def __init__(self, path: Path, data: bytes, order: str) -> None:
        self._path, self._data, self._order, self._at = path, data, order, 0

    def _take(self, kind: str, count: int, element: _Element) -> np.ndarray:
        dtype = np.dtype(self._order + kind)
        size = dtype.itemsize * count
        if count < 0 or self._at + size > len(self._data):
            raise _short(self._path, element)
        self._at += size
        return np.frombuffer(self._data, dtype, count, self._at - size)

    def table(self, element: _Element) -> np.ndarray:
        dtype = np.dtype([(f"p{k}", self._order + p.kind) for k, p in enumerate(element.properties)])
        raw = self._take("u1", dtype.itemsize * element.count, element)
        rows = np.frombuffer(raw.tobytes(), dtype, element.count)
        return np.stack([rows[name].astype(np.float64) for name in dtype.names or ()], axis=1)

    def values(self, p: _Property, element: _Element) -> Any:
        if p.count is None:
            return self._take(p.kind, 1, element)[0]
        count = self._take(p.count, 1, element)[0]
        return self._take(p.kind, _length(self._path, count, element), element)


def _length(path: Path, count: Any, element: _Element) -> int:
    """The length of a list, which may be stored as any kind of number."""
    if not (0 <= count < 1e6 and count == int(count)):
        raise InputError(f"{path}: a list of elements '{element.name}' has the length {count:g}")
    return int(count)
