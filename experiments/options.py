"""Command-line options that several experiments share."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from slefejax.errors import InputError
from slefejax.scene import Scene
from slefejax.view import Camera, View

Three = tuple[float, float, float]


@dataclass(frozen=True)
class ViewOptions:
    """The camera and the size of the picture. What is not given is the scene's own, or frames the scene."""

    size: str = "1440x900"
    """Width x height of the picture in pixels."""
    eye: Three | None = None
    """Position of the camera."""
    target: Three | None = None
    """A point that the camera looks at."""
    up: Three | None = None
    """The direction that is up in the picture."""
    fov: float | None = None
    """Vertical field of view in degrees."""
    near: float | None = None
    """Distance of the near clipping plane."""
    far: float | None = None
    """Distance of the far clipping plane."""

    def view(self, scene: Scene) -> View:
        """The view that these options ask for. Raises InputError for numbers that make no camera."""
        width, height = parse_size(self.size)
        own = scene.default_camera()
        pick = {
            "eye": own.eye,
            "target": own.target,
            "up": own.up,
            "fov_y": own.extent,
            "near": own.near,
            "far": own.far,
        }
        given = {
            "eye": self.eye,
            "target": self.target,
            "up": self.up,
            "fov_y": self.fov,
            "near": self.near,
            "far": self.far,
        }
        pick.update({name: value for name, value in given.items() if value is not None})
        return View(Camera.look_at(**pick), width, height)


@dataclass(frozen=True)
class OutputOptions:
    """Where results go."""

    out: Path | None = None
    """Folder of this run's results; without it runs/EXPERIMENT/TIME."""
    json: bool = False
    """Print one JSON object on standard output instead of the table."""


@dataclass(frozen=True)
class PredictionOptions:
    """How factors are predicted."""

    method: str = "slefe"
    """How factors are predicted: slefe, the papers' estimate."""
    segments: int = 3
    """Pieces m of a slefe in each direction."""
    tolerance: float = 0.5
    """Error in pixels that is allowed."""
    depth_tolerance: float | None = None
    """Error in window depth (0 to 1) that is allowed; not looked at if not given."""
    k: float = 1.0
    """The constant k_m."""

    def arguments(self) -> dict:
        """Keyword arguments for tessellation_factors."""
        return {
            "method": self.method,
            "segments": self.segments,
            "tolerance": self.tolerance,
            "depth_tolerance": self.depth_tolerance,
            "k": self.k,
        }


def parse_size(text: str) -> tuple[int, int]:
    """(width, height) from a text such as 1440x900."""
    match = re.fullmatch(r"([1-9][0-9]{0,4})x([1-9][0-9]{0,4})", text)
    if not match:
        raise InputError(f"--size must be WIDTHxHEIGHT in pixels, such as 1440x900, not {text!r}")
    return int(match.group(1)), int(match.group(2))


def check_scales(scales: tuple[float, ...]) -> None:
    """Raise InputError unless there is a scale and all of them are positive, finite and different."""
    if not scales:
        raise InputError("--scales needs at least one number")
    bad = [scale for scale in scales if not (np.isfinite(scale) and scale > 0)]
    if bad:
        raise InputError(f"--scales must be positive numbers, not {bad[0]}")
    if len(set(scales)) < len(scales):
        raise InputError("--scales names a number twice")
