"""Every figure of several scenes side by side, as large as they are and half as large, to be looked at.

``python -m slefejax.experiments.contact_sheets FOLDER [SCENE ...]`` makes two pages a figure. What a command refuses of
a scene is left out of its pages, and said.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory

from PIL import Image

from slefejax.errors import InputError
from slefejax.experiments.cli import start_jax
from slefejax.experiments.parsing import parsed

SCENES = ("teapot", "walker", "twisted-quad", "steep-patch")
OF_A_SCENE = {
    "inspect": (),
    "render": (
        *("--look", "shaded", "wire", "error", "normals", "reflection", "factors", "depth", "checker"),
        *("triangle-size", "--scale", "0.5"),
    ),
    "minimality": ("--scales", "1", "0.8", "0.5"),
    "certify": (),
    "error-time": ("--cameras", "1", "--repeats", "1"),
    "animate": ("--frames", "3", "--seconds", "0.05"),
    "budget": ("--triangles", "2000", "5000", "5500"),
    "sensitivity": (),
    "optimise": ("--cameras", "2", "--solver-steps", "3"),
    "limit": (),
    "gaussian": ("--levels", "1", "2", "--conditions", "1", "10"),
    "scaling": ("--repeats", "1"),
    "fit-km": ("--cameras", "2"),
}
OF_NONE = {
    "tightness": ("--curves", "5"),
    "stability": ("--quick", "--only", "offset", "flat", "weights"),
    "bench": ("--quick", "--counts", "100", "1000", "--only", "stencils", "fused"),
    "attack": ("--pairs", "200"),
}
_WITHOUT_SIZE = ("fit-km",)
_ACROSS, _GAP = 2, 20  # pictures in a row, and pixels between them


def words(command: str, scene: str, size: str) -> list[str]:
    """What is typed for the cheapest run of a command that draws all of its figures."""
    sized = [] if command in _WITHOUT_SIZE else ["--size", size]
    return [command, scene, *OF_A_SCENE[command], *sized]


def drawn(typed: list[str], folder: Path) -> dict[str, Image.Image]:
    """The figures of a command by their names, error images too. Raises InputError for what it refuses."""
    report = parsed([*typed, "--out", str(folder / "run")]).run()
    found = {}
    for path in sorted(report.out.glob("*.png")):
        with Image.open(path) as picture:
            found[path.stem] = picture.convert("RGB")
    return found


def page(pictures: list[Image.Image], scale: float) -> Image.Image:
    """Pictures in rows of two, each as large as it is times the scale."""
    shown = [
        own.resize((round(scale * own.width), round(scale * own.height)), Image.Resampling.BOX) for own in pictures
    ]
    rows = [shown[k : k + _ACROSS] for k in range(0, len(shown), _ACROSS)]
    wide = max(sum(own.width + _GAP for own in row) for row in rows) + _GAP
    found = Image.new("RGB", (wide, sum(max(own.height for own in row) + _GAP for row in rows) + _GAP), "silver")
    y = _GAP
    for row in rows:
        x = _GAP
        for own in row:
            found.paste(own, (x, y))
            x += own.width + _GAP
        y += max(own.height for own in row) + _GAP
    return found


def sheets(scenes: tuple[str, ...], size: str = "720x450") -> Iterator[tuple[str, list[Image.Image]]]:
    """The name of a figure, and that figure of all scenes that its command takes."""
    for command in OF_A_SCENE:
        found: dict[str, list[Image.Image]] = {}
        for scene in scenes:
            with TemporaryDirectory() as folder:
                try:
                    for name, picture in drawn(words(command, scene, size), Path(folder)).items():
                        found.setdefault(name, []).append(picture)
                except InputError as error:
                    print(f"{command} {scene}: {error}", file=sys.stderr)
        yield from ((f"{command}_{name}", pictures) for name, pictures in found.items())
    for command, options in OF_NONE.items():
        with TemporaryDirectory() as folder:
            for name, picture in drawn([command, *options], Path(folder)).items():
                yield f"{command}_{name}", [picture]


if __name__ == "__main__":
    start_jax(keep=True)
    place = Path(sys.argv[1])
    place.mkdir(parents=True, exist_ok=True)
    for name, pictures in sheets(tuple(sys.argv[2:]) or SCENES):
        for size, scale in (("full", 1.0), ("half", 0.5)):
            page(pictures, scale).save(place / f"{name}_{size}.png")
