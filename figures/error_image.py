"""The error of every pixel in the colours of [YBP12], under a title, with a scale and what the colours mean."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.colors import to_rgb
from matplotlib.font_manager import findfont
from PIL import Image, ImageDraw, ImageFont
from PIL.PngImagePlugin import PngInfo

from slefejax.figures.fitting import wrapped
from slefejax.figures.style import BACKGROUND, ERROR_CLASSES, INK, LINES

_FONT = 19  # pixels
_LINE, _EDGE = 26, 9  # pixels of a line of text, and around everything
_SWATCH, _GAP = 19, 22  # pixels of a sample of a colour, and after its name
_SAFE = 0.97  # of the room: letters of pictures are a little wider than those of figures
_NARROWEST = 320  # pixels of a page
_KEPT = "picture"  # the name, in the file, of where on the page the picture is


def error_colours(error: np.ndarray) -> np.ndarray:
    """``(height, width, 3)`` bytes, row 0 at the top; errors are in pixels, row 0 at the bottom, NaN for background."""
    limits = [limit for limit, _, _ in ERROR_CLASSES[:-1]]
    palette = [*(colour for _, colour, _ in ERROR_CLASSES), BACKGROUND]
    table = np.array([[round(255 * part) for part in to_rgb(colour)] for colour in palette], np.uint8)
    kind = np.where(np.isnan(error), len(ERROR_CLASSES), np.searchsorted(limits, np.nan_to_num(error), side="left"))
    return table[kind][::-1]


def write_error_image(path: Path, error: np.ndarray, title: str) -> None:
    """A PNG: below a title one pixel of the picture a pixel of the screen, a scale, and what the colours mean."""
    page, box = _page(Image.fromarray(error_colours(error)), title)
    kept = PngInfo()
    kept.add_text(_KEPT, " ".join(map(str, box)))
    page.save(path, format="PNG", pnginfo=kept)


def read_error_image(path: Path) -> np.ndarray:
    """``(height, width, 3)`` from 0 to 1, row 0 at the top: the pixels of the screen alone."""
    with Image.open(path) as page:
        left, top, right, bottom = map(int, page.info[_KEPT].split())
        return np.asarray(page.convert("RGB"), float)[top:bottom, left:right] / 255


def _page(picture: Image.Image, title: str) -> tuple[Image.Image, tuple[int, int, int, int]]:
    """The picture on a page, and where it is there: left, top, right, bottom."""
    font = ImageFont.truetype(findfont("DejaVu Sans"), _FONT)
    wide = max(picture.width, _NARROWEST)
    above = wrapped(title, _SAFE * (wide - 2 * _EDGE), _FONT).split("\n")
    below = _rows([name for _, _, name in ERROR_CLASSES], font, wide)
    top = _LINE * len(above) + 2 * _EDGE
    page = Image.new("RGB", (wide, top + picture.height + _LINE * (len(below) + 1) + 2 * _EDGE), BACKGROUND)
    left = (wide - picture.width) // 2
    page.paste(picture, (left, top))
    draw = ImageDraw.Draw(page)
    for number, line in enumerate(above):
        draw.text((_EDGE, _EDGE + number * _LINE), line, INK, font)
    start = top + picture.height + _EDGE
    _draw_scale(draw, font, wide, start, picture.width)
    colours = {name: colour for _, colour, name in ERROR_CLASSES}
    for number, names in enumerate(below):
        x, y = float(_EDGE), start + (number + 1) * _LINE
        for name in names:
            draw.rectangle((x, y, x + _SWATCH, y + _SWATCH - 2), colours[name], LINES)
            draw.text((x + _SWATCH + _GAP / 4, y - 3), name, INK, font)
            x += _SWATCH + _GAP + font.getlength(name)
    return page, (left, top, left + picture.width, top + picture.height)


def _draw_scale(draw: Any, font: Any, wide: int, y: float, width: int) -> None:
    """A bar of 1, 2 or 5 times a power of ten pixels of the screen, and what the colours say."""
    most = max(1.0, width / 5)
    power = 10.0 ** np.floor(np.log10(most))
    pixels = power * max(k for k in (1, 2, 5) if k * power <= most)
    draw.text((_EDGE, y - 3), "error of a pixel:", INK, font)
    name = f"{pixels:g} px"
    right = wide - _EDGE - font.getlength(name) - 6
    draw.text((right + 6, y - 3), name, INK, font)
    draw.line((right - pixels, y + 7, right, y + 7), INK, 3)


def _rows(names: list[str], font: Any, wide: int) -> list[list[str]]:
    """The names of the colours, as many a row as fit."""
    found: list[list[str]] = [[]]
    for name in names:
        taken = sum(font.getlength(own) + _SWATCH + _GAP for own in (*found[-1], name))
        if found[-1] and taken > wide - 2 * _EDGE:
            found.append([])
        found[-1].append(name)
    return found
