"""A scene in motion: triangles and error over time, where the time goes, and the film itself."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.colors import to_rgb
from matplotlib.font_manager import findfont
from PIL import Image, ImageDraw, ImageFont

from slefejax.figures.style import ERROR_CLASSES, METHOD_STYLES, SETTINGS, new_figure, occupied, save

Rows = list[dict[str, Any]]

# [YBP14], Table 2, in per cent of a frame
PUBLISHED = {"skinning_ms": 58.0, "boxes_ms": 4.0, "view_ms": 6.0, "render_ms": 32.0}
# Colours for the colour-blind [OI]
PARTS = {
    "skinning_ms": ("shape keys, skinning, conversion", "#56b4e9"),
    "boxes_ms": ("slefe boxes", "#f0e442"),
    "view_ms": ("view: projection, widths, factors", "#009e73"),
    "levels_ms": ("levels of shared edges and rings", "#cc79a7"),
    "hand_over_ms": ("control points to OpenGL", "#bbbbbb"),
    "render_ms": ("rendering", "#0072b2"),
}
_WIDEST = 720  # pixels of the film


def write_timeline(path: Path, rows: Rows, scene: str, tolerance: float) -> None:
    """Triangles, errors, and what pops, over the time of the motion."""
    times = [row["time"] for row in rows]
    style = METHOD_STYLES.get(rows[0]["method"], {"color": "0.3"}) | {"marker": "."}
    with mpl.rc_context(SETTINGS):
        figure = new_figure(10, 9)
        top, middle, bottom = figure.subplots(3, 1, sharex=True)
        top.plot(times, [row["triangles"] for row in rows], **style)
        top.set_ylabel("triangles")
        top.set_ylim(0, 1.1 * max(row["triangles"] for row in rows))
        middle.plot(times, [row["max_error_px"] for row in rows], label="largest of a pixel", **style)
        middle.axhline(tolerance, color="black", lw=1, ls="--", label=f"asked for: {tolerance:g} px")
        middle.set_ylabel("error (pixels)")
        middle.set_ylim(0, 1.1 * max(tolerance, float(np.nanmax([row["max_error_px"] for row in rows]))))
        middle.legend(loc="lower left", ncols=2)
        popping = rows[1:]
        for name, label, line in (("pop_max_px", "largest", "^-"), ("pop_p99_px", "of 99 % of the pixels", "o--")):
            bottom.plot(times[1:], [row[name] for row in popping], line, ms=4, color="0.25", label=label)
        bottom.set_ylabel("popping (pixels)")
        bottom.set_xlabel("time of the motion")
        bottom.set_ylim(0, 1.4 * max([0.01, *(row["pop_max_px"] for row in popping)]))
        bottom.legend(loc="upper left", title="how far new levels alone move the texture", ncols=2)
        title = (
            f"{scene}, {rows[0]['patches']:,} patches: factors by '{rows[0]['method']}', {rows[0]['spacing']} spacing"
        )
        figure.suptitle(title, fontsize=13)
        save(figure, path)


def write_work(path: Path, modes: Rows, scene: str, renderer: str) -> None:
    """Shares of a frame in which the pose changes, beside the published ones; and frames a second of all modes."""
    every = [row for row in modes if row["mode"] == modes[0]["mode"]]
    bars = [("published\n(GTX 580)", PUBLISHED), *((f"here:\n{row['method']}", row) for row in every)]
    with mpl.rc_context(SETTINGS):
        figure = new_figure(12, 3.2 + 0.9 * len(bars) + 0.45 * len(modes))
        top, bottom = figure.subplots(2, 1, height_ratios=[len(bars) + 1, 0.5 * len(modes) + 1])
        _shares(top, bars)
        places = np.arange(len(modes))[::-1]
        rates = [row["frames_per_second"] for row in modes]
        colours = [METHOD_STYLES.get(row["method"], {"color": "0.4"})["color"] for row in modes]
        bottom.barh(places, rates, color=colours)
        for place, rate in zip(places, rates, strict=True):
            bottom.annotate(f" {rate:.3g}", (rate, place), va="center", fontsize=10)
        bottom.set_yticks(places, [f"{row['method']}: {row['mode']}" for row in modes])
        bottom.set_xlabel("frames a second")
        bottom.margins(x=0.08)
        bottom.grid(axis="y", visible=False)
        figure.suptitle(f"{scene}: where the time of a frame goes, and what posing less often saves ({renderer})")
        save(figure, path)


def _shares(axes: Any, bars: list[tuple[str, dict[str, Any]]]) -> None:
    """One bar of 100 % each; parts of 4 % and more have their number in them."""
    places = np.arange(len(bars))[::-1]
    starts = np.zeros(len(bars))
    totals = np.array([sum(bar.get(part, 0.0) for part in PARTS) for _, bar in bars])
    for part, (label, colour) in PARTS.items():
        shares = 100.0 * np.array([bar.get(part, 0.0) for _, bar in bars]) / totals
        axes.barh(places, shares, left=starts, color=colour, label=label, edgecolor="white")
        for place, start, share in zip(places, starts, shares, strict=True):
            if share >= 4.0:
                ink = {"color": "white" if part == "render_ms" else "black", "fontsize": 10}
                axes.annotate(f"{share:.0f}", (start + share / 2.0, place), ha="center", va="center", **ink)
        starts += shares
    axes.set_yticks(places, [name for name, _ in bars])
    axes.set_xlim(0, 100)
    axes.set_xlabel("share of a frame whose pose and view are new (%)")
    axes.grid(visible=False)
    axes.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=3, frameon=False, fontsize=10)


def write_film(path: Path, pictures: list[np.ndarray], captions: list[str], seconds_a_frame: float) -> None:
    """Error images as an animated GIF that repeats. ``pictures``: as ``imread`` gives them, one a frame."""
    shown = np.any([np.any(p[..., :3] != 1.0, axis=2) for p in pictures], axis=0)
    box = occupied(shown)
    width = max(_width(picture[box], caption) for picture, caption in zip(pictures, captions, strict=True))
    frames = [_captioned(picture[box], caption, width) for picture, caption in zip(pictures, captions, strict=True)]
    # GIF counts in hundredths of a second, and viewers slow down below 2
    duration = max(20, 10 * round(100 * seconds_a_frame))
    frames[0].save(path, save_all=True, append_images=frames[1:], duration=duration, loop=0, optimize=False)


def _font() -> Any:
    return ImageFont.truetype(findfont("DejaVu Sans"), 13)


def _words() -> list[str]:
    return [f"{name}   " for _, _, name in ERROR_CLASSES]


def _width(picture: np.ndarray, caption: str) -> int:
    """Of a frame with its caption; a film has the widest of all its frames."""
    font = _font()
    legend = sum(24 + font.getlength(word) for word in _words())
    return int(max(min(_WIDEST, picture.shape[1]), font.getlength(caption) + 16, legend + 16))


def _captioned(picture: np.ndarray, caption: str, wide: int) -> Image.Image:
    """The picture, no wider than the film, with a line of text above it and the colours' meaning below."""
    image = Image.fromarray((255 * picture[..., :3]).astype(np.uint8))
    scale = min(1.0, _WIDEST / image.width)
    image = image.resize((max(1, round(scale * image.width)), max(1, round(scale * image.height))))
    font, words = _font(), _words()
    page = Image.new("RGB", (wide, image.height + 52), "white")
    page.paste(image, ((wide - image.width) // 2, 26))
    draw = ImageDraw.Draw(page)
    draw.text((8, 5), caption, "black", font)
    x, y = 8.0, page.height - 20
    for (_, colour, _), word in zip(ERROR_CLASSES, words, strict=True):
        draw.rectangle((x, y, x + 16, y + 12), colour)
        draw.text((x + 22, y - 3), word, "black", font)
        x += 24 + font.getlength(word)
    return page.quantize(palette=_palette(), dither=Image.Dither.NONE)


def _palette() -> Image.Image:
    """The colours of the classes and greys for text: a palette of the picture's own would leave out rare ones."""
    classes = [round(255 * part) for _, colour, _ in ERROR_CLASSES for part in to_rgb(colour)]
    greys = [grey for level in range(0, 256, 15) for grey in (level,) * 3]
    palette = Image.new("P", (1, 1))
    palette.putpalette(classes + greys)
    return palette
