"""Wavefront OBJ: control meshes of any polygons, with OpenSubdiv's tags for creases.

Read are ``v``, ``vt``, ``f``, ``g``, ``o`` and ``t crease``, ``t corner``; comments, which begin where a word begins
with #, lines continued by a backslash, negative numbers (counted back from the last vertex) and any line ends. Normals
and materials do not matter here. Other statements are left out, and said.
"""

from __future__ import annotations

import re
from array import array
from collections import Counter
from dataclasses import dataclass, field
from itertools import pairwise, repeat
from pathlib import Path
from typing import Any

import numpy as np

from slefejax.arguments import no_such
from slefejax.errors import InputError, naming
from slefejax.io.content import Y_UP, Content, read_bytes
from slefejax.io.limits import LARGEST_TEXT
from slefejax.io.numbers import parse_real, parse_whole, words_before
from slefejax.model.mesh import Mesh

_IRRELEVANT = {"vn", "s", "usemtl", "mtllib", "usemap", "maplib", "shadow_obj", "trace_obj", "lod", "bevel"}
_IRRELEVANT |= {"c_interp", "d_interp", "mg"}
_DIGITS = 10  # of a number that is none any more
_LINE = re.compile(r"[^\r\n]*+(?:\r\n|\r|\n)?")
_RUN = r"(?:%s[ \t]*+\r?\n){1,4096}+"  # lines that are held at once
_FINITE = r"[-+]?+(?:[0-9]{1,40}+(?:\.[0-9]*+)?+|\.[0-9]++)(?:[eE][-+]?+[0-9]{1,2}+)?+"
_PLAIN_VERTICES = re.compile(_RUN % rf"v(?:[ \t]++{_FINITE}){{3}}")
_PLAIN_TEXTURE = {count: re.compile(_RUN % rf"vt(?:[ \t]++{_FINITE}){{{count}}}") for count in (2, 3)}
_WHOLE = r"[1-9][0-9]{0,8}+"
_PLAIN_FACES = re.compile(_RUN % rf"f(?:[ \t]++{_WHOLE}(?:/(?:{_WHOLE})?+){{0,2}}+)++")
_PLAIN_NORMALS = re.compile(_RUN % r"vn[ \t][^\r\n\\]*+")
_NUMBERS = re.compile(r"[0-9]++")
_HEADS = re.compile(r"[ \t]([0-9]++)(?:/([0-9]*+))?+")


def _whole() -> array:
    return array("q")


def _real() -> array:
    return array("d")


@dataclass
class _Names:
    """The groups or the object that faces belong to from here on."""

    names: frozenset[str]
    wanted: bool
    used: bool = False


@dataclass
class _Reader:
    """What was read so far, in packed arrays. Vertices are numbered from 0; of a face the line that it stands on.

    texture : coordinates;  textured : which of them each corner has, numbered from 0, -1 for none
    """

    path: Path
    wanted: frozenset[str] | None
    line: int = 0
    coordinates: array = field(default_factory=_real)
    corners: array = field(default_factory=_whole)
    texture: array = field(default_factory=_real)
    textured: array = field(default_factory=_whole)
    sizes: array = field(default_factory=_whole)
    lines: array = field(default_factory=_whole)
    numbers: array = field(default_factory=_whole)
    count: int = 0
    creases: array = field(default_factory=_whole)
    crease_sharpness: array = field(default_factory=_real)
    points: array = field(default_factory=_whole)
    point_sharpness: array = field(default_factory=_real)
    named: set[str] = field(default_factory=set)
    others: Counter[str] = field(default_factory=Counter)

    def __post_init__(self) -> None:
        self.groups, self.object = self.names(["default"]), self.names([""])

    def names(self, names: list[str]) -> _Names:
        found = frozenset(names)
        return _Names(found, self.wanted is None or bool(self.wanted & found))

    @property
    def vertex_count(self) -> int:
        return len(self.coordinates) // 3

    @property
    def texture_count(self) -> int:
        return len(self.texture) // 2

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
        elif keyword == "vt":
            self.texel(rest)
        elif keyword == "g":
            self.groups = self.names(rest or ["default"])
        elif keyword == "o":
            self.object = self.names([" ".join(rest)])
        elif keyword == "t":
            self.tag(rest)
        elif keyword not in _IRRELEVANT:
            self.others[keyword] += 1

    def vertex(self, items: list[str]) -> None:
        if len(items) < 3:
            raise self.fail(f"a vertex needs three coordinates, not {len(items)}: is the file complete?")
        self.coordinates.extend([self.real(item, "a coordinate") for item in items[:3]])

    def vertices(self, run: str) -> None:
        """Lines of three numbers each."""
        words = run.split()
        found = np.array([words[1::4], words[2::4], words[3::4]], np.float64)
        self.coordinates.frombytes(found.T.tobytes())
        self.line += found.shape[1]

    def texel(self, items: list[str]) -> None:
        if not items:
            raise self.fail("texture coordinates need a number at least: is the file complete?")
        for item in [*items, "0"][:2]:
            value = parse_real(item)
            if value is None:
                raise self.fail(f"a texture coordinate should be a number, not {item[:40]!r}")
            # exporters write nan for faces that have no size in the picture: they have none
            self.texture.append(value if np.isfinite(value) else np.nan)

    def texels(self, run: str) -> None:
        """Lines of two numbers each, or of three."""
        words, lines = run.split(), run.count("\n")
        each = len(words) // lines
        found = np.array([words[1::each], words[2::each]], np.float64)
        self.texture.frombytes(found.T.tobytes())
        self.line += lines

    def polygons(self, run: str) -> None:
        """Lines of corners that are counted from the first vertex."""
        sizes = [len(line.split()) - 1 for line in run.splitlines()]
        first, count = self.count, len(sizes)
        self.count += count
        if self.wants_faces():
            if "/" not in run:
                self.corners.extend([int(head) - 1 for head in _NUMBERS.findall(run)])
            else:
                heads = _HEADS.findall(run)
                self.corners.extend([int(head) - 1 for head, _ in heads])
                self.textured.extend([int(texel) - 1 if texel else -1 for _, texel in heads])
            self.untextured()
            self.sizes.extend(sizes)
            self.lines.extend(range(self.line + 1, self.line + 1 + count))
            self.numbers.extend(range(first, first + count))
        self.line += count

    def skip(self, run: str) -> None:
        """Lines of normals."""
        self.line += run.count("\n")

    def wants_faces(self) -> bool:
        """Whether faces of the present groups and object are read; these are groups with faces then."""
        for owner in (self.groups, self.object):
            if not owner.used:
                owner.used = True
                self.named |= owner.names
        return self.groups.wanted or self.object.wanted

    def polygon(self, items: list[str]) -> None:
        self.count += 1
        if not self.wants_faces():
            return
        self.corners.extend(self.index(item.split("/", 1)[0], "vertex", self.vertex_count) for item in items)
        if any("/" in item for item in items):
            self.textured.extend(self.texel_of(item) for item in items)
        self.untextured()
        self.sizes.append(len(items))
        self.lines.append(self.line)
        self.numbers.append(self.count - 1)

    def texel_of(self, item: str) -> int:
        """-1 for a corner that has none."""
        own = item.split("/", 2)[1:2]
        return self.index(own[0], "texture coordinate", self.texture_count) if own and own[0] else -1

    def untextured(self) -> None:
        """Corners so far that nothing was said of have no texture coordinates."""
        self.textured.extend(repeat(-1, len(self.corners) - len(self.textured)))

    def index(self, item: str, what: str, count: int) -> int:
        """The number from 0 on of a vertex or the like, of which there are so many up to here."""
        number = parse_whole(item)
        if not number:
            many = "vertices" if what == "vertex" else f"{what}s"
            raise self.fail(f"a face should name {many} by their numbers, from 1 on, not {item[:40]!r}")
        if number < 0 and -number > count:
            raise self.fail(f"{what} {number} is counted back beyond the first of {count}")
        return number - 1 if number > 0 else count + number

    def tag(self, items: list[str]) -> None:
        """``t NAME ints/floats/strings …``: creases are chains of vertices, numbered from 0, with their sharpness."""
        name, counts = items[0] if items else "", [parse_whole(n) for n in "".join(items[1:2]).split("/")]
        if len(counts) < 2 or any(n is None or n < 0 for n in counts):
            raise self.fail("a tag should be 't NAME ints/floats/strings' and so many values")
        many, some = counts[0] or 0, counts[1] or 0
        ints = [parse_whole(n) for n in items[2 : 2 + many]]
        if None in ints:
            raise self.fail(f"a tag {name!r} should begin with {many} whole numbers")
        sharpness = [self.real(item, "a sharpness") for item in items[2 + many : 2 + many + some]]
        if name in ("crease", "corner"):
            self.sharp(name, ints, sharpness)  # type: ignore[arg-type]
        elif name != "interpolateboundary" or ints != [1]:  # 1 is how boundaries are treated here
            self.others[f"t {name}"] += 1

    def sharp(self, name: str, vertices: list[int], sharpness: list[float]) -> None:
        many = len(vertices) - 1 if name == "crease" else len(vertices)
        if many < 1 or len(sharpness) not in (1, many):
            raise self.fail(f"a tag {name!r} needs vertices and one sharpness, or one each")
        if min(sharpness) < 0:
            raise self.fail(f"a sharpness must not be negative: {min(sharpness):g}")
        each = sharpness * (many if len(sharpness) == 1 else 1)
        if name == "crease":
            for pair in pairwise(vertices):
                self.creases.extend(pair)
            self.crease_sharpness.extend(each)
        else:
            self.points.extend(vertices)
            self.point_sharpness.extend(each)


def read_obj(path: Path, group: Any = None) -> Content:
    """The control mesh of a file. Vertices keep their numbers, used or not.

    group : names of groups or objects: only their faces are read

    Raises InputError, with the file and the line, for what is no such file; for a group that is not there.
    """
    data = read_bytes(path, LARGEST_TEXT)
    if b"\0" in data:
        raise InputError(f"{path} is not a text file: an .obj file is plain text")
    names = (group,) if isinstance(group, str) else group
    if names is not None and not (isinstance(names, tuple) and names and all(isinstance(n, str) for n in names)):
        raise InputError(f"group must be a name or a tuple of names, not {group!r}")
    wanted = None if names is None else frozenset(names)
    reader = _Reader(path, wanted)
    _take_all(reader, data.decode("utf-8-sig", "replace"))
    if wanted is not None and (missing := sorted(wanted - reader.named)):
        raise InputError(f"{path}: {no_such('group with faces', missing[0], sorted(reader.named - {''}))}")
    if not reader.sizes:
        raise InputError(f"{path} has no faces: a control mesh needs at least one line 'f …'")
    return Content(mesh=_mesh(reader), up=Y_UP, notes=_notes(reader))


def _take_all(reader: _Reader, text: str) -> None:
    """Statement by statement, but for runs of plain lines of one kind, which are taken at once."""
    texels = [(run, reader.texels) for run in _PLAIN_TEXTURE.values()]
    others = (_PLAIN_FACES, reader.polygons), (_PLAIN_NORMALS, reader.skip)
    runs = (_PLAIN_VERTICES, reader.vertices), *texels, *others
    place = 0
    while place < len(text):
        for run, take in runs:
            found = run.match(text, place)
            if found:
                take(found[0])
                place = found.end()
                break
        else:
            words, place = _statement(reader, text, place)
            if words:
                reader.take(words)


def _statement(reader: _Reader, text: str, place: int) -> tuple[list[str], int]:
    """The words of a statement, comments left out, continued lines joined, and where the next one begins."""
    words: list[str] = []
    while place < len(text):
        line = _LINE.match(text, place)
        assert line is not None
        place = line.end()
        reader.line += 1
        found = list(words_before(line[0], "#"))
        if not found or not found[-1].endswith("\\"):
            return words + found, place
        words += [*found[:-1], *found[-1][:-1].split()]
    return words, place


def _mesh(reader: _Reader) -> Mesh:
    corners, sizes = (np.array(part, np.int64) for part in (reader.corners, reader.sizes))
    textured = np.array(reader.textured, np.int64)
    for what, own, count in (
        ("vertex", corners, reader.vertex_count),
        ("texture coordinate", textured, reader.texture_count),
    ):
        beyond = np.flatnonzero(own >= count)
        if beyond.size:
            reader.line = reader.lines[int(np.searchsorted(np.cumsum(sizes), beyond[0], side="right"))]
            said = f"the face names {what} {own[beyond[0]] + 1}, but there are {count}"
            raise reader.fail(f"{said}: is the file complete?")
    with naming(reader.path):
        mesh = Mesh.packed(
            np.array(reader.coordinates).reshape(-1, 3),
            corners,
            sizes,
            np.array(reader.numbers),
            _texture(np.array(reader.texture).reshape(-1, 2), textured),
            creases=np.array(reader.creases, np.int64).reshape(-1, 2),
            crease_sharpness=np.array(reader.crease_sharpness),
            points=np.array(reader.points, np.int64),
            point_sharpness=np.array(reader.point_sharpness),
        )
    # creases of other groups are not this mesh's
    return mesh if reader.wanted is None else mesh.keep(np.ones(mesh.face_count, bool))


def _texture(coordinates: np.ndarray, textured: np.ndarray) -> np.ndarray | None:
    """Of every corner, NaN where it has none; None if no corner has any."""
    there = textured >= 0
    if not there.any():
        return None
    found = np.full((len(textured), 2), np.nan)
    found[there] = coordinates[textured[there]]
    return found


def _notes(reader: _Reader) -> tuple[str, ...]:
    if not reader.others:
        return ()
    said = ", ".join(f"{count} of '{name}'" for name, count in sorted(reader.others.items()))
    return (f"statements that are not read were left out: {said}",)
