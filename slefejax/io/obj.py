"""Wavefront OBJ: control meshes of any polygons, with OpenSubdiv's tags for creases.

Read are ``v``, ``f``, ``g``, ``o`` and ``t crease``, ``t corner``; comments, lines continued by a backslash, negative
numbers (counted back from the last vertex) and any line ends. Texture coordinates, normals and materials do not matter
here. Other statements are left out, and said.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from slefejax.errors import InputError
from slefejax.io.content import Y_UP, Content, read_bytes
from slefejax.io.numbers import parse_real
from slefejax.mesh import Mesh

_MANY = 10**9
_IRRELEVANT = {"vt", "vn", "s", "usemtl", "mtllib", "usemap", "maplib", "shadow_obj", "trace_obj", "lod", "bevel"}
_IRRELEVANT |= {"c_interp", "d_interp", "mg"}


@dataclass
class _Reader:
    """What was read so far. A face is kept as vertex numbers from 0, with the line that it stands on."""

    path: Path
    wanted: frozenset[str] | None
    line: int = 0
    vertices: list[list[float]] = field(default_factory=list)
    faces: list[list[int]] = field(default_factory=list)
    lines: list[int] = field(default_factory=list)
    numbers: list[int] = field(default_factory=list)
    count: int = 0
    creases: list[tuple[int, int, float]] = field(default_factory=list)
    points: list[tuple[int, float]] = field(default_factory=list)
    groups: frozenset[str] = frozenset({"default"})
    object: str = ""
    named: set[str] = field(default_factory=set)
    others: Counter[str] = field(default_factory=Counter)

    def fail(self, what: str) -> InputError:
        return InputError(f"{self.path}, line {self.line}: {what}")

    def real(self, item: str, wanted: str) -> float:
        value = parse_real(item)
        if value is None or not np.isfinite(value):
            raise self.fail(f"{wanted} should be a finite number, not {item[:40]!r}")
        return value

    def take(self, words: list[str]) -> None:
        """One statement."""
        keyword, rest = words[0], words[1:]
        if keyword == "v":
            self.vertex(rest)
        elif keyword == "f":
            self.polygon(rest)
        elif keyword == "g":
            self.groups = frozenset(rest) or frozenset({"default"})
        elif keyword == "o":
            self.object = " ".join(rest)
        elif keyword == "t":
            self.tag(rest)
        elif keyword not in _IRRELEVANT:
            self.others[keyword] += 1

    def vertex(self, items: list[str]) -> None:
        if len(items) < 3:
            raise self.fail(f"a vertex needs three coordinates, not {len(items)}: is the file complete?")
        self.vertices.append([self.real(item, "a coordinate") for item in items[:3]])

    def polygon(self, items: list[str]) -> None:
        if len(items) < 3:
            raise self.fail(f"a face needs at least three vertices, not {len(items)}: is the file complete?")
        self.count += 1
        names = self.groups | {self.object}
        self.named |= names
        if self.wanted is not None and not (self.wanted & names):
            return
        self.faces.append([self.index(item) for item in items])
        self.lines.append(self.line)
        self.numbers.append(self.count - 1)

    def index(self, item: str) -> int:
        text = item.split("/", 1)[0]
        digits = text[1:] if text[:1] == "-" else text
        if not (digits.isascii() and digits.isdigit() and len(digits) < 10 and int(digits) > 0):
            raise self.fail(f"a face should name vertices by their numbers, from 1 on, not {item[:40]!r}")
        number = int(text)
        if number < 0 and -number > len(self.vertices):
            raise self.fail(f"vertex {number} is counted back beyond the first of {len(self.vertices)}")
        return number - 1 if number > 0 else len(self.vertices) + number

    def tag(self, items: list[str]) -> None:
        """``t NAME ints/floats/strings …``: creases are chains of vertices, numbered from 0, with their sharpness."""
        try:
            name, counts, numbers = items[0], [int(n) for n in items[1].split("/")], items[2:]
            ints, floats = ([int(n) for n in numbers[: counts[0]]], numbers[counts[0] : counts[0] + counts[1]])
        except (IndexError, ValueError):
            raise self.fail("a tag should be 't NAME ints/floats/strings' and so many values") from None
        sharpness = [self.real(item, "a sharpness") for item in floats]
        if name not in ("crease", "corner"):
            if name != "interpolateboundary" or ints != [1]:  # 1 is how boundaries are treated here
                self.others[f"t {name}"] += 1
            return
        if any(abs(number) >= _MANY for number in ints):
            raise self.fail(f"a tag {name!r} names a vertex that no file has: {max(ints, key=abs)}")
        many = len(ints) - 1 if name == "crease" else len(ints)
        if many < 1 or len(sharpness) not in (1, many):
            raise self.fail(f"a tag {name!r} needs vertices and one sharpness, or one each")
        if min(sharpness) < 0:
            raise self.fail(f"a sharpness must not be negative: {min(sharpness):g}")
        each = sharpness * (many if len(sharpness) == 1 else 1)
        if name == "crease":
            self.creases += [(a, b, s) for a, b, s in zip(ints[:-1], ints[1:], each, strict=True)]
        else:
            self.points += list(zip(ints, each, strict=True))


def read_obj(path: Path, group: Any = None) -> Content:
    """The control mesh of a file. Vertices keep their numbers, used or not.

    group : names of groups or objects: only their faces are read

    Raises InputError, with the file and the line, for what is no such file; for a group that is not there.
    """
    data = read_bytes(path)
    if b"\0" in data:
        raise InputError(f"{path} is not a text file: an .obj file is plain text")
    names = (group,) if isinstance(group, str) else group
    if names is not None and not (isinstance(names, tuple) and names and all(isinstance(n, str) for n in names)):
        raise InputError(f"group must be a name or a tuple of names, not {group!r}")
    wanted = None if names is None else frozenset(names)
    reader = _Reader(path, wanted)
    for reader.line, words in _statements(data.decode("utf-8-sig", errors="replace")):
        reader.take(words)
    if wanted is not None and (missing := sorted(wanted - reader.named)):
        there = ", ".join(sorted(reader.named - {""})[:12])
        raise InputError(f"{path} has no faces in a group {missing[0]!r}: there are {there or 'none'}")
    if not reader.faces:
        raise InputError(f"{path} has no faces: a control mesh needs at least one line 'f …'")
    return Content(mesh=_mesh(reader), up=Y_UP, notes=_notes(reader))


def _statements(text: str) -> Iterator[tuple[int, list[str]]]:
    """(line, words) of every statement, comments left out, continued lines joined."""
    words: list[str] = []
    number = 0
    for number, line in enumerate(text.replace("\r\n", "\n").replace("\r", "\n").split("\n"), 1):
        line = line.split("#", 1)[0].rstrip()
        goes_on = line.endswith("\\")
        words += line.removesuffix("\\").split()
        if words and not goes_on:
            yield number, words
            words = []
    if words:
        yield number, words


def _mesh(reader: _Reader) -> Mesh:
    count = len(reader.vertices)
    for line, face in zip(reader.lines, reader.faces, strict=True):
        if max(face) >= count:
            reader.line = line
            raise reader.fail(f"the face names vertex {max(face) + 1}, but there are {count}: is the file complete?")
    try:
        mesh = _packed(reader)
    except InputError as error:
        raise InputError(f"{reader.path}: {error}") from None
    # creases of other groups are not this mesh's
    return mesh if reader.wanted is None else mesh.keep(np.ones(mesh.face_count, bool))


def _packed(reader: _Reader) -> Mesh:
    return Mesh.packed(
        np.array(reader.vertices),
        np.concatenate(reader.faces),
        [len(face) for face in reader.faces],
        reader.numbers,
        creases=np.array([c[:2] for c in reader.creases], np.int64).reshape(-1, 2),
        crease_sharpness=np.array([c[2] for c in reader.creases], np.float64),
        points=np.array([p[0] for p in reader.points], np.int64),
        point_sharpness=np.array([p[1] for p in reader.points], np.float64),
    )


def _notes(reader: _Reader) -> tuple[str, ...]:
    if not reader.others:
        return ()
    said = ", ".join(f"{count} of '{name}'" for name, count in sorted(reader.others.items()))
    return (f"statements that are not read were left out: {said}",)
