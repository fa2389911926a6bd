"""Where letters go: lines as wide as there is room, ticks that read well, labels that keep clear of each other."""

from __future__ import annotations

import re
from collections.abc import Iterator
from functools import lru_cache
from typing import Any

import numpy as np
from matplotlib.font_manager import FontProperties
from matplotlib.text import Text
from matplotlib.textpath import TextToPath
from matplotlib.ticker import FixedLocator, FuncFormatter, NullFormatter
from matplotlib.transforms import Bbox

_DIRECTIONS = ((1, 1), (1, -1), (-1, 1), (-1, -1), (0, 1), (0, -1), (1, 0), (-1, 0))
_DISTANCES = (6.0, 14.0, 26.0, 42.0, 64.0, 90.0)  # points between a mark and its label
_FIRST_FAR = 14.0  # from which a line leads to the mark
# blanks that lines are not broken at: of a size such as 480 x 360, of an error such as 3 ± 1, and before a unit
_UNBROKEN = re.compile(
    r"(?<=\d) (?=[x±] \d)|(?<=\d x) (?=\d)|(?<=±) |(?<=\d) (?=(?:px²?|pixels?|[µm]s|%|degrees?)(?!\w))"
)
_KEPT = "\u00a0"
_SAMPLES = 64  # of a piece of a line
_LEAST_ROOM = 60.0  # points of a line
_STEPS = (
    (3.2, (1.0,)),
    (1.2, (1.0, 3.0)),
    (0.7, (1.0, 2.0, 5.0)),
    (0.45, (1.0, 1.5, 2.0, 3.0, 4.0, 5.0, 7.0)),
)  # decades of an axis, and the first digits that it has ticks at


@lru_cache(maxsize=4096)
def width_of(text: str, size: float) -> float:
    """Points that a line takes."""
    return TextToPath().get_text_width_height_descent(text, FontProperties(size=size), ismath="$" in text)[0]


def room_of(part: Any) -> float:
    """Points from the left to the right side of a figure, a part of one, or axes."""
    return 72 * part.bbox.width / part.get_figure(root=True).dpi


def wrapped(text: str, room: float, size: float) -> str:
    """The text in lines of at most so many points; a word that is longer is broken, formulas are not.

    A number stays with its unit, and so do the two of a size.
    """
    lines = []
    for line in _UNBROKEN.sub(_KEPT, text).split("\n"):
        if "$" in line:
            lines.append(line)
            continue
        now = ""
        for word in _words(line, room, size):
            for piece in _pieces(word, room, size):
                longer = f"{now} {piece}" if now else piece
                if now and width_of(longer, size) > room:
                    lines.append(now)
                    now = piece
                else:
                    now = longer
        lines.append(now)
    return "\n".join(lines).replace(_KEPT, " ")


def _words(line: str, room: float, size: float) -> list[str]:
    """What is not broken, unless it is longer than a line."""
    words = line.split(" ")
    return [own for word in words for own in (word.split(_KEPT) if width_of(word, size) > room else [word])]


def _pieces(word: str, room: float, size: float) -> Iterator[str]:
    while len(word) > 1 and width_of(word, size) > room:
        fits = max(1, int(len(word) * room / width_of(word, size)) - 1)
        yield word[:fits]
        word = word[fits:]
    yield word


def log_ticks(axis: Any, low: float, high: float) -> None:
    """Ticks of a logarithmic axis from ``low`` to ``high``: few enough, as plain numbers where these are short."""
    axis.set_major_locator(FixedLocator(_log_places(low, high)))
    axis.set_major_formatter(FuncFormatter(lambda value, _: plain(value)))
    axis.set_minor_formatter(NullFormatter())


def plain(value: float) -> str:
    """A number for a tick: as it is written by hand; the largest and the smallest as powers of ten."""
    if value == 0 or 1e-3 <= abs(value) < 1e6:
        return f"{value:,.6g}" if abs(value) < 1e4 else f"{value:,.0f}"
    power = int(np.floor(np.log10(abs(value)) + 1e-9))
    front = value / 10.0**power
    return f"$10^{{{power}}}$" if abs(front - 1) < 1e-6 else f"${front:.3g}\\cdot10^{{{power}}}$"


def short(value: float) -> str:
    """A number of two digits for a title, written as ``plain`` does."""
    return plain(float(f"{value:.2g}")) if np.isfinite(value) else str(value)


def _log_places(low: float, high: float) -> list[float]:
    decades = np.log10(high / low)
    digits = next((digits for least, digits in _STEPS if decades >= least), None)
    if digits is None:  # hardly longer than a step of the digits
        step = 10.0 ** np.floor(np.log10((high - low) / 2 or 1.0))
        step *= next((k for k in (1, 2, 5) if (high - low) / (k * step) <= 5), 10)
        return [k * step for k in range(int(np.ceil(low / step)), int(high / step) + 1)]
    powers = range(int(np.floor(np.log10(low))), int(np.ceil(np.log10(high))) + 1)
    powers = powers[:: max(1, round(decades / 6))]
    return [d * 10.0**k for k in powers for d in digits if low * (1 - 1e-9) <= d * 10.0**k <= high * (1 + 1e-9)]


def finish(figure: Any, part: Any) -> None:
    """Ticks, line breaks of titles, and places of labels, once everything is drawn."""
    for axes in _all_axes(part):
        for axis, limits in ((axes.xaxis, axes.get_xlim()), (axes.yaxis, axes.get_ylim())):
            if axis.get_scale() == "log" and axis.isDefault_majloc:
                log_ticks(axis, *sorted(limits))
            elif (axis.get_scale() == "symlog" and axis.isDefault_majfmt) or _reads_in_threes(axis, limits):
                axis.set_major_formatter(FuncFormatter(lambda value, _: plain(value)))
    figure.draw_without_rendering()
    for axes in _all_axes(part):
        place, whole = axes.get_position(original=True), axes.figure.bbox
        across, up = 72 * place.width * whole.width / figure.dpi, 72 * place.height * whole.height / figure.dpi
        for text, room in ((axes.title, across), (axes.xaxis.label, across), (axes.yaxis.label, up)):
            text.set_text(wrapped(text.get_text(), max(room, _LEAST_ROOM), text.get_size()))
    figure.draw_without_rendering()
    figure.set_layout_engine("none")  # from here on nothing moves by itself
    _to_whole_pixels(part)
    _keep_clear(figure, part)


def _reads_in_threes(axis: Any, limits: tuple[float, float]) -> bool:
    """Whether a linear axis has numbers that are read in threes."""
    return axis.get_scale() == "linear" and axis.isDefault_majfmt and max(map(abs, limits)) >= 1e4


def _all_axes(part: Any) -> list[Any]:
    return part.axes + [axes for own in part.subfigs for axes in _all_axes(own)]


def _to_whole_pixels(part: Any) -> None:
    """Pictures that ask for it get a whole number of the page's pixels for each of theirs."""
    for axes in _all_axes(part):
        if not any(image.get_gid() == "whole pixels" for image in axes.images):
            continue
        rows, columns = axes.images[0].get_size()
        within, whole = axes.get_position(original=True), axes.figure.transSubfigure
        place = within.transformed(whole)
        zoom = max(1, int(min(place.width / columns, place.height / rows)))
        width, height = zoom * columns, zoom * rows
        left, bottom = (round(0.5 * value) for value in (place.x0 + place.x1 - width, place.y0 + place.y1 - height))
        axes.set_position(Bbox.from_bounds(left, bottom, width, height).transformed(whole.inverted()))


def _keep_clear(figure: Any, part: Any) -> None:
    """Show labels that may move where nothing is, and those that may go unless something is where they are."""
    renderer = figure.canvas.get_renderer()
    for axes in _all_axes(part):
        taken = [text.get_window_extent(renderer) for text in axes.texts if not text.get_gid() and text.get_text()]
        marks = _marks(axes)
        for text in axes.texts:
            if text.get_gid():
                text.set_visible(True)
            if text.get_gid() == "may go":
                _keep(text, text.get_window_extent(renderer).padded(1), taken)
            elif text.get_gid() == "may move":
                _move(text, axes, taken, marks, renderer)


def _keep(text: Any, box: Bbox, taken: list[Bbox]) -> None:
    if any(box.overlaps(other) for other in taken):
        text.set_visible(False)
    else:
        taken.append(box)


def _marks(axes: Any) -> tuple[np.ndarray, np.ndarray]:
    """Pixels of the vertices of all lines, and of what lies between them where that is drawn."""
    vertices, between = [np.zeros((0, 2))], [np.zeros((0, 2))]
    for line in axes.lines:
        points = line.get_transform().transform(line.get_xydata())
        points = points[np.isfinite(points).all(axis=1)]
        if line.get_marker() not in ("", "None", None):
            vertices.append(points)
        if line.get_linestyle() != "None" and len(points) > 1:
            steps = np.linspace(0.0, 1.0, _SAMPLES)[:, None, None]
            between.append(((1 - steps) * points[:-1] + steps * points[1:]).reshape(-1, 2))
    return np.concatenate(vertices), np.concatenate(between)


def _move(text: Any, axes: Any, taken: list[Bbox], marks: tuple[np.ndarray, np.ndarray], renderer: Any) -> None:
    """To the first place that is free, near ones before far ones; left out where there is none."""
    within = axes.get_window_extent(renderer)
    dot, point = renderer.points_to_pixels(4.5), renderer.points_to_pixels(1.0)
    letters = Text.get_window_extent(text, renderer)
    size = np.array([letters.width, letters.height])
    mark = axes.transData.transform(text.xy)
    for distance in _DISTANCES:
        for direction in _DIRECTIONS:
            corner = mark + point * distance * np.array(direction) - size * (1 - np.array(direction)) / 2
            box = Bbox([corner, corner + size]).padded(1)
            clear = _contains(within, box) and not any(box.overlaps(other) for other in taken)
            if clear and not _any_in(marks[0], box.padded(dot)) and not _any_in(marks[1], box):
                taken.append(box)
                text.set_position(distance * np.array(direction))
                text.set_ha({1: "left", 0: "center", -1: "right"}[direction[0]])
                text.set_va({1: "bottom", 0: "center", -1: "top"}[direction[1]])
                text.arrow_patch.set_visible(distance >= _FIRST_FAR)
                return
    text.set_visible(False)


def _contains(outer: Bbox, inner: Bbox) -> bool:
    return outer.x0 <= inner.x0 and inner.x1 <= outer.x1 and outer.y0 <= inner.y0 and inner.y1 <= outer.y1


def _any_in(points: np.ndarray, box: Bbox) -> bool:
    x, y = points.T
    return bool(np.any((x > box.x0) & (x < box.x1) & (y > box.y0) & (y < box.y1)))
