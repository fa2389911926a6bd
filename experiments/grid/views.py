"""The views of a study: cameras around every scene, or those of a file."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from slefejax import Camera, Scene, View, cameras_around
from slefejax.arguments import check_whole, no_such
from slefejax.errors import InputError
from slefejax.io.content import read_bytes

_SIZE = (1440, 900)
_NEEDED = ("eye", "target", "size")
_KEYS = (*_NEEDED, "up", "fov_y", "height", "near", "far")
_AROUND = ("cameras", "seed", "size")


@dataclass(frozen=True)
class Views:
    """Cameras of every scene.

    cameras, seed, size : the scene's own and others on a sphere around it, as of ``cameras_around``
    listed              : those of a file instead, the same of every scene
    """

    cameras: int = 1
    seed: int = 1
    size: tuple[int, int] = _SIZE
    listed: tuple[View, ...] = ()

    @staticmethod
    def of(asked: Any, folder: Path) -> Views:
        """From what a study says: a table of ``cameras``, ``seed`` and ``size``, or a file's name, beside the study's.

        Raises InputError for what is neither.

        >>> Views.of({"cameras": 4, "size": [640, 400]}, Path()).size
        (640, 400)
        """
        if isinstance(asked, str):
            return Views(listed=read_views(folder / asked))
        if not isinstance(asked, Mapping):
            raise InputError(f"views is a table such as {{ cameras = 4, seed = 1 }} or a file of views, not {asked!r}")
        for name in asked:
            if name not in _AROUND:
                raise InputError(f"views: {no_such('key', name, _AROUND)}")
        found = Views(asked.get("cameras", 1), asked.get("seed", 1), _size(asked.get("size", _SIZE), "views"))
        check_whole("cameras", found.cameras, 1)
        check_whole("seed", found.seed, 0)
        return found

    def __len__(self) -> int:
        return len(self.listed) or self.cameras

    def around(self, scene: Scene) -> list[View]:
        """Those of a scene."""
        return list(self.listed) or cameras_around(scene, *self.size, self.cameras, self.seed)


def read_views(path: Path) -> tuple[View, ...]:
    """The views of a JSON file: a list of ``{"eye", "target", "up", "fov_y" or "height", "near", "far", "size"}``.

    up : (0, 0, 1) if it is not there;  fov_y : degrees;  height : scene units, orthographic;  near, far : 0.1 and 100

    Raises InputError for a file that is missing or no such list.
    """
    try:
        found = json.loads(read_bytes(path))
    except ValueError as error:
        raise InputError(f"{path.name} is no JSON file, or not whole: {error}") from None
    if not isinstance(found, list) or not found:
        raise InputError(f"{path.name} must be a list of views, and one at least")
    return tuple(_view(own, f"view {number} of {path.name}") for number, own in enumerate(found))


def _view(own: Any, which: str) -> View:
    if not isinstance(own, dict):
        raise InputError(f"{which} must be an object with eye, target and size, not {own!r}")
    for name in own:
        if name not in _KEYS:
            raise InputError(f"{which}: {no_such('key', name, _KEYS)}")
    missing = [name for name in _NEEDED if name not in own]
    if missing:
        raise InputError(f"{which} has no {missing[0]}")
    if ("fov_y" in own) == ("height" in own):
        raise InputError(f"{which} needs fov_y in degrees, or height for an orthographic camera: one of them")
    make, extent = (Camera.look_at, own["fov_y"]) if "fov_y" in own else (Camera.orthographic, own["height"])
    up = own.get("up", (0.0, 0.0, 1.0))
    try:
        camera = make(own["eye"], own["target"], up, extent, own.get("near", 0.1), own.get("far", 100.0))
    except (InputError, TypeError, ValueError) as error:
        raise InputError(f"{which}: {error}") from None
    return View(camera, *_size(own["size"], which))


def _size(given: Any, which: str) -> tuple[int, int]:
    if not isinstance(given, (list, tuple)) or len(given) != 2:
        raise InputError(f"{which}: size is [width, height] in pixels, not {given!r}")
    for value in given:
        check_whole("size", value, 1)
    return int(given[0]), int(given[1])
