"""Frames of a film: looks of a scene side by side, under what is to be said of them, and the film that they make."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np
from matplotlib.colors import to_rgb
from PIL import Image
from scipy.spatial.distance import cdist

from slefejax.figures.looks.panels import LEGEND, Heading, panels
from slefejax.figures.page import Page
from slefejax.figures.style import BACKGROUND, ERROR_CLASSES, error_legend, occupied

_WIDEST = 1800  # pixels of the pictures of a frame together; wider ones are made smaller
_GREYS = 64  # of the film: more make it larger, and are not seen


def write_strip(path: Path, pictures: Sequence[np.ndarray]) -> None:
    """A PNG of pictures ``(height, width, 3)``, 0 to 1, row 0 at the bottom, side by side, a pixel a pixel."""
    strip = np.concatenate(pictures, axis=1)[::-1]
    Image.fromarray(np.round(255 * strip).astype(np.uint8)).save(path)


def read_strip(path: Path, count: int) -> list[np.ndarray]:
    """So many pictures, as ``write_strip`` was given them."""
    with Image.open(path) as strip:
        return np.split(np.asarray(strip.convert("RGB"))[::-1] / 255, count, axis=1)


def write_frames(
    pages: Sequence[Page],
    headings: Sequence[Heading],
    strips: Sequence[Path],
    titles: Mapping[str, bool],
    show: Callable[[int], None] = lambda _: None,
) -> None:
    """A page a frame; all are cut alike, so that nothing but the scene moves.

    strips : of ``write_strip``, one a frame
    titles : of the pictures of a strip, and whether their colours are those of errors
    show   : hears how many pages are written
    """
    count = len(titles)
    there = np.any([_anything(own) for path in strips for own in read_strip(path, count)], axis=0)
    box = occupied(there)
    smaller = -(-count * there[box].shape[1] // _WIDEST)
    kept = _reduced(there[box], smaller) > 0.0
    errors = any(titles.values())
    for done, (page, heading, path) in enumerate(zip(pages, headings, strips, strict=True)):
        show(done)
        with panels(page, heading, kept, tuple(titles), below=LEGEND * errors) as own:
            for number, picture in enumerate(read_strip(path, count)):
                own.show(number, _reduced(picture[box], smaller))
            if errors:
                error_legend(own.figure)


def write_film(path: Path, pages: Sequence[Page], seconds_a_frame: float) -> None:
    """An animated GIF of pages, which are PNG; it repeats."""
    frames = [_opened(page.path) for page in pages]
    size = max(own.width for own in frames), max(own.height for own in frames)
    shown = [_indexed(_of_size(own, size)) for own in frames]
    # GIF counts in hundredths of a second, and viewers slow down below 2
    duration = max(20, 10 * round(100 * seconds_a_frame))
    shown[0].save(path, save_all=True, append_images=shown[1:], duration=duration, loop=0, optimize=False)


def _anything(picture: np.ndarray) -> np.ndarray:
    return np.any(picture != 1.0, axis=2)


def _reduced(values: np.ndarray, times: int) -> np.ndarray:
    """Means of squares of so many pixels; what is left over at the edges is left out."""
    rows, columns = (n // times for n in values.shape[:2])
    whole = values[: rows * times, : columns * times].reshape(rows, times, columns, times, *values.shape[2:])
    return whole.mean(axis=(1, 3))


def _opened(path: Path) -> Image.Image:
    with Image.open(path) as picture:
        return picture.convert("RGB")


def _of_size(frame: Image.Image, size: tuple[int, int]) -> Image.Image:
    """With an empty strip below: a title of one line more makes a page higher."""
    page = Image.new("RGB", size, BACKGROUND)
    page.paste(frame, (0, 0))
    return page


def _indexed(frame: Image.Image) -> Image.Image:
    """With the film's palette, colours as the nearest ones: a palette of the frame's own would leave out rare ones."""
    classes = [255 * part for _, colour, _ in ERROR_CLASSES for part in to_rgb(colour)]
    palette = np.round([*np.repeat(np.linspace(0, 255, _GREYS), 3), *classes]).astype(int)
    there, which = np.unique(np.asarray(frame, int).reshape(-1, 3), axis=0, return_inverse=True)
    nearest = cdist(there, palette.reshape(-1, 3)).argmin(axis=1).astype(np.uint8)
    indexed = Image.fromarray(nearest[which].reshape(frame.height, frame.width), "P")
    indexed.putpalette(palette.tolist())
    return indexed
