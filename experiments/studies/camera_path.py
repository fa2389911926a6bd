"""Where the camera is while a scene moves: it stays, goes round, comes closer, or follows a table."""

from __future__ import annotations

import csv
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from slefejax import Scene, View
from slefejax.errors import InputError
from slefejax.framing import clipping_planes
from slefejax.geometry.view import Camera, bounding_sphere

COLUMNS = ("eye_x", "eye_y", "eye_z", "target_x", "target_y", "target_z")
ViewPath = Callable[[float], View]  # from 0, the first frame, to 1, the last


def camera_path(text: str, scene: Scene, view: View) -> ViewPath:
    """The views along a path, by the share of the way that is done.

    text : ``"still"``; ``"orbit:DEGREES"`` around the target, about the direction that is up; ``"zoom:FACTOR"``, so
           many times as close in the end; or the name of a .csv file with the columns eye_x … target_z, one row a
           point of the path, which are joined by straight lines

    Raises InputError for what is none of these.
    """
    kind, _, number = text.partition(":")
    if text == "still":
        return lambda _: view
    if kind in ("orbit", "zoom") and number:
        value = _number(text, number, positive=kind == "zoom")
        return _views(scene, view, _orbit(value) if kind == "orbit" else _zoom(value))
    if text.lower().endswith(".csv"):
        return _views(scene, view, _table(Path(text)))
    raise InputError(f"--camera-path must be still, orbit:DEGREES, zoom:FACTOR or a .csv file, not {text!r}")


Places = Callable[[float, Camera], tuple[np.ndarray, np.ndarray]]


def _views(scene: Scene, view: View, places: Places) -> ViewPath:
    """The view from each place of a path, with near and far where they have to be from there."""

    def at(share: float) -> View:
        own = view.camera
        eye, target = places(share, own)
        near, far = map(float, clipping_planes(bounding_sphere(scene.points()), own, eye))
        return replace(view, camera=Camera.look_at(eye, target, own.up, own.extent, near, far))

    return at


def _number(text: str, number: str, positive: bool) -> float:
    try:
        value = float(number)
    except ValueError:
        value = np.nan
    if not np.isfinite(value) or (positive and value <= 0):
        raise InputError(f"--camera-path {text!r} needs a {'positive ' if positive else ''}number behind the colon")
    return value


def _orbit(degrees: float) -> Places:
    def places(share: float, own: Any) -> tuple[np.ndarray, np.ndarray]:
        angle, axis = np.deg2rad(degrees * share), own.up / np.linalg.norm(own.up)
        arm = own.eye - own.target
        along = axis * (axis @ arm)
        turned = along + np.cos(angle) * (arm - along) + np.sin(angle) * np.cross(axis, arm)
        return own.target + turned, own.target

    return places


def _zoom(factor: float) -> Places:
    return lambda share, own: (own.target + (own.eye - own.target) * factor**-share, own.target)


def _table(path: Path) -> Places:
    try:
        with path.open(newline="") as file:
            rows = list(csv.DictReader(file))
    except FileNotFoundError:
        raise InputError(f"there is no file {path}: check the name") from None
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise InputError(f"{path} cannot be read as a table: {error}") from None
    points = []
    for line, row in enumerate(rows, start=2):
        try:
            points.append([float(row[name]) for name in COLUMNS])
        except (KeyError, TypeError, ValueError):
            raise InputError(f"{path}, line {line}: a number is needed for each of {', '.join(COLUMNS)}") from None
    if not points or not np.isfinite(points).all():
        raise InputError(f"{path}: a path needs at least one row of finite numbers")
    table, places = np.array(points), np.linspace(0.0, 1.0, len(points))

    def at(share: float, _: Any) -> tuple[np.ndarray, np.ndarray]:
        found = np.array([np.interp(share, places, column) for column in table.T])
        return found[:3], found[3:]

    return at
