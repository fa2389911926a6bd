"""The pictures of a run as a page holds them: as they are while there is room, else smaller ones, and fewer."""

from __future__ import annotations

import io
import re
import warnings
from base64 import b64encode
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from PIL import Image

MOST_BYTES = 16 * 2**20  # of all pictures of a page; as text they take a third more
MOST_FRAMES = 60  # of a sequence whose pictures are made smaller
LONGEST = 960  # pixels of a side of these
_TYPES = {".png": "png", ".jpg": "jpeg", ".jpeg": "jpeg", ".webp": "webp", ".gif": "gif", ".svg": "svg+xml"}
_STILL = (".png", ".jpg", ".jpeg", ".webp")  # what can be made smaller
_NUMBER = re.compile(r"\d+(?:\.\d+)?(?:e[-+]?\d+)?")
_NAMED = 4  # names that a sentence lists


@dataclass
class Group:
    """Pictures that are flipped through, or a single one: (file name, data URI)."""

    title: str
    pictures: list[tuple[str, str]] = field(default_factory=list)


@dataclass
class Pictures:
    """Those of a run, what to open first in front; sentences of what is not as it is in the folder."""

    groups: list[Group]
    notes: list[str]


def pictures_of(files: Sequence[Path], first: str) -> Pictures:
    """Of the files of a run; ``first``: the name of the one in front."""
    shown = [path for path in files if path.suffix.lower() in _TYPES]
    pages = [path.name for path in files if path.suffix.lower() == ".pdf"]
    notes = [f"Figures in PDF are beside this page, not in it: {_listed(pages)}"] * bool(pages)
    packed = _Packed(sum(path.stat().st_size for path in shown) <= MOST_BYTES)
    groups = [packed.group(title, paths, rest) for title, paths, rest in _shares(_grouped(shown, first))]
    return Pictures([group for group in groups if group.pictures], [*notes, *packed.notes])


def _shares(groups: list[tuple[str, list[Path]]]) -> Iterator[tuple[str, list[Path], int]]:
    """With each group, how many pictures come after it."""
    for number, (title, paths) in enumerate(groups):
        yield title, paths, sum(len(own) for _, own in groups[number + 1 :])


def _grouped(paths: Sequence[Path], first: str) -> list[tuple[str, list[Path]]]:
    """Names that differ in numbers make a sequence; so do names of the same first word, if their sizes are the same."""
    rest = sorted((path for path in paths if path.name != first), key=lambda path: path.name)
    sequences = _several(rest, lambda path: (_NUMBER.sub("#", path.stem), path.suffix))
    for path in (path for own in sequences for path in own):
        rest.remove(path)
    alike = _several(rest, lambda path: (path.stem.partition("_")[0], _size(path)))
    for path in (path for own in alike for path in own):
        rest.remove(path)
    singles = [path for path in paths if path.name == first] + rest
    found = [(path.stem, [path]) for path in singles]
    return found + [(_title(own), own) for own in (*alike, *sequences)]


def _several(paths: Sequence[Path], key: Callable[[Path], object]) -> list[list[Path]]:
    """Groups of two and more, by their numbers."""
    found: dict[object, list[Path]] = {}
    for path in paths:
        found.setdefault(key(path), []).append(path)
    return [sorted(own, key=_numbers) for own in found.values() if len(own) > 1]


def _numbers(path: Path) -> tuple[list[float], str]:
    return [float(number) for number in _NUMBER.findall(path.stem)], path.name


def _title(paths: Sequence[Path]) -> str:
    start = paths[0].stem
    while start and not all(path.stem.startswith(start) for path in paths):
        start = start[:-1]
    return f"{_NUMBER.sub('', start).strip('_. ') or paths[0].stem}: {len(paths):,} pictures"


def _size(path: Path) -> object:
    """Width and height; a name that no other file has where that is not told."""
    try:
        with _opened(path) as picture:
            return picture.size
    except _UNREADABLE:
        return path.name


_UNREADABLE = (OSError, ValueError, SyntaxError, Image.DecompressionBombError)


def _opened(path: Path) -> Image.Image:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", Image.DecompressionBombWarning)  # of this run's own pictures
        return Image.open(path)


class _Packed:
    """What is still free of a page's room; sentences of what was made smaller, and of what was left out."""

    def __init__(self, whole: bool) -> None:
        self._whole, self._left = whole, MOST_BYTES
        self.notes: list[str] = []

    def group(self, title: str, paths: list[Path], rest: int) -> Group:
        """Pictures of a group; ``rest``: how many others want some of the room."""
        if self._whole or len(paths) == 1:
            return Group(title, [own for path in paths for own in self._single(path, rest)])
        room = self._left * len(paths) // (len(paths) + rest)
        chosen = _spread(paths, min(MOST_FRAMES, room // max(_weight(paths[len(paths) // 2]), 1)))
        found = [(path.name, uri) for path in chosen if (uri := self._fitting(_smaller(path)))]
        left = [path.name for path in paths if path.name not in dict(found)]
        told = f"{title}, at most {LONGEST} pixels wide and high: {self._room}"
        self.notes.append(f"{told}; {len(left):,} are left out: {_listed(left)}" if left else told)
        return Group(title, found)

    @property
    def _room(self) -> str:
        return f"pictures take at most {MOST_BYTES // 2**20} MB of a page"

    def _single(self, path: Path, rest: int) -> Iterator[tuple[str, str]]:
        if self._whole or path.stat().st_size <= self._left // (rest + 1):
            uri = self._fitting((path.read_bytes(), _TYPES[path.suffix.lower()]))
        else:
            uri = self._fitting(_smaller(path))
            said = f"is at most {LONGEST} pixels wide and high here" if uri else "is left out"
            self.notes.append(f"{path.name} {said}: {self._room}")
        if uri:
            yield path.name, uri

    def _fitting(self, content: tuple[bytes, str] | None) -> str:
        """As a data URI; empty if there is no room for it, or nothing."""
        if content is None or len(content[0]) > self._left:
            return ""
        self._left -= len(content[0])
        return f"data:image/{content[1]};base64,{b64encode(content[0]).decode()}"


def _spread(paths: list[Path], most: int) -> list[Path]:
    """At most so many, evenly, the first and the last among them."""
    if most >= len(paths):
        return paths
    return [paths[round(k * (len(paths) - 1) / max(most - 1, 1))] for k in range(most)]


def _weight(path: Path) -> int:
    """Bytes that a picture takes when it is made smaller."""
    found = _smaller(path)
    return len(found[0]) if found else path.stat().st_size


def _smaller(path: Path) -> tuple[bytes, str] | None:
    """The picture at most so large, and its type; None where it cannot be made smaller."""
    if path.suffix.lower() not in _STILL:
        return None
    try:
        with _opened(path) as picture:
            copy = picture.convert("RGB")
            copy.thumbnail((LONGEST, LONGEST))
    except _UNREADABLE:
        return None
    kept = io.BytesIO()
    copy.save(kept, "WEBP", quality=80, method=1)
    return kept.getvalue(), "webp"


def _listed(names: Sequence[str]) -> str:
    """Some names, and how many more."""
    more = len(names) - _NAMED
    return ", ".join(names[:_NAMED]) + (f" and {more:,} more" if more > 0 else "")
