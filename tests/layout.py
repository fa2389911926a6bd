"""What is wrong with the layout of a figure: letters over letters or off the page, legends over data."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.legend import Legend
from matplotlib.text import Text

_TOUCH = 1.0  # pixels that boxes may share: letters have room above and below within theirs


class Box:
    """A rectangle in pixels that may be turned.

    corners : ``(4, 2)``, in order
    """

    def __init__(self, corners: np.ndarray) -> None:
        self.corners = corners

    @staticmethod
    def upright(x: float, y: float, width: float, height: float) -> Box:
        return Box(np.array([[x, y], [x + width, y], [x + width, y + height], [x, y + height]]))

    @staticmethod
    def of(text: Text, renderer: Any) -> Box:
        """Of letters: their box as it is without being turned, turned about its middle."""
        around, angle = Text.get_window_extent(text, renderer), text.get_rotation()
        text.set_rotation(0.0)
        flat = Text.get_window_extent(text, renderer)
        text.set_rotation(angle)
        half = np.maximum(0.5, np.array([flat.width, flat.height]) / 2 - _TOUCH)
        (c, s), signs = (np.cos(np.radians(angle)), np.sin(np.radians(angle))), [(-1, -1), (1, -1), (1, 1), (-1, 1)]
        turned = (half * signs) @ np.array([[c, s], [-s, c]])
        return Box(turned + [(around.x0 + around.x1) / 2, (around.y0 + around.y1) / 2])

    def overlaps(self, other: Box) -> bool:
        """Whether no line along a side of either lies between them."""
        for box in (self, other):
            for side in np.diff(box.corners[:3], axis=0):
                across = np.array([-side[1], side[0]])
                one, two = self.corners @ across, other.corners @ across
                if one.max() <= two.min() or two.max() <= one.min():
                    return False
        return True

    def holds(self, points: np.ndarray) -> bool:
        """Whether any of the points is within an upright box."""
        low, high = self.corners.min(axis=0) + _TOUCH, self.corners.max(axis=0) - _TOUCH
        return bool(np.any(np.all((points > low) & (points < high), axis=1)))


def faults(figure: Figure) -> list[str]:
    """A sentence for everything that is wrong; empty if nothing is."""
    written, renderer = _written(figure)
    boxes = [(text, Box.of(text, renderer)) for text in written]
    width, height = figure.bbox.width, figure.bbox.height
    found = []
    for text, box in boxes:
        if box.corners.min() < -_TOUCH or np.any(box.corners.max(axis=0) > np.array([width, height]) + _TOUCH):
            found.append(f"{_name(text)} is not all on the page")
    for k, (text, box) in enumerate(boxes):
        found += [f"{_name(text)} and {_name(other)} overlap" for other, own in boxes[:k] if box.overlaps(own)]
    for legend in figure.findobj(Legend):
        around = legend.get_window_extent(renderer)  # type: ignore[attr-defined]
        box = Box.upright(around.x0, around.y0, around.width, around.height)
        for axes in figure.axes:
            found += [f"a legend lies over {what}" for what, points in _data(axes, renderer) if box.holds(points)]
    return found


def _written(figure: Figure) -> tuple[list[Text], Any]:
    """All letters that are drawn, and what draws them."""
    found: list[Text] = []
    draw = Text.draw

    def remember(self: Text, renderer: Any) -> None:
        if self.get_visible() and self.get_text().strip():
            found.append(self)
        draw(self, renderer)

    canvas = FigureCanvasAgg(figure)
    Text.draw = remember  # type: ignore[method-assign]
    try:
        canvas.draw()
    finally:
        Text.draw = draw  # type: ignore[method-assign]
    return found, canvas.get_renderer()


def _name(text: Text) -> str:
    return repr(text.get_text()[:60])


def _data(axes: Axes, renderer: Any) -> list[tuple[str, np.ndarray]]:
    """Points of lines, collections, bars and pictures, in pixels, as far as they are within the axes."""
    found = []
    for line in axes.lines:
        points = line.get_transform().transform(line.get_xydata())
        steps = np.linspace(0.0, 1.0, 50)[:, None, None]
        between = ((1 - steps) * points[:-1] + steps * points[1:]).reshape(-1, 2)
        found.append((f"the line {line.get_label()!r}", np.concatenate([points, between])))
    for collection in axes.collections:
        middle = collection.get_offset_transform().transform(collection.get_offsets())
        paths = [collection.get_transform().transform_path(path).vertices for path in collection.get_paths()]
        found.append(("a collection", np.concatenate([middle, *paths])))
    for patch in axes.patches:
        found.append(("a bar or region", _filled(patch.get_window_extent(renderer))))
    for picture in axes.images:
        found.append(("a picture", _filled(picture.get_window_extent(renderer))))
    within = axes.get_window_extent(renderer)
    low, high = np.array([within.x0, within.y0]), np.array([within.x1, within.y1])
    return [(name, points[np.all((points >= low) & (points <= high), axis=1)]) for name, points in found]


def _filled(box: Any) -> np.ndarray:
    """Points all over a box."""
    x, y = np.meshgrid(np.linspace(box.x0, box.x1, 30), np.linspace(box.y0, box.y1, 30))
    return np.stack([x.ravel(), y.ravel()], axis=1)
