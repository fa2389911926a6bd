"""Fixed levels of Gaussian products beside certified ones, and the Gaussians that they are of."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.colors import to_rgba
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from slefejax.figures.error_image import read_error_image
from slefejax.figures.page import Page
from slefejax.figures.style import (
    COLOURS,
    GREY_MAP,
    MARKED,
    METHOD_STYLES,
    QUIET,
    bare,
    beside,
    drawing,
    error_legend,
    legend_below,
    level,
    occupied,
)

Row = dict[str, Any]
_MESH = 1.0  # points
_STYLES: dict[str, dict[str, Any]] = {
    "published": {"color": COLOURS[1], "marker": "o", "label": "published, fixed level (its number beside)"},
    "certified": {**METHOD_STYLES["certified"], "label": "certified", "markersize": 13},
    "recursive": {"color": COLOURS[0], "marker": "s", "label": "subdivision on the host"},
}


def write_levels(page: Page, rows: list[Row], scene: str) -> None:
    """Errors against triangles, milliseconds of a frame against triangles, and of the preparation."""
    title = f"{scene}: Gaussian products at fixed levels, as published, and at certified ones"
    with drawing(page, 16, 6, title) as figure:
        axes = figure.subplots(1, 3)
        for method, style in _STYLES.items():
            own = [row for row in rows if row["method"] == method and np.isfinite(row["triangles"])]
            if own:  # not refused
                _plot_method(axes, sorted(own, key=lambda row: row["triangles"]), method, style)
        level(axes[0], 0.5, "½ px")
        axes[0].plot([], [], ls=":", marker="o", mfc="none", color=QUIET, label="over the whole domain")
        labels = (
            ("largest error (pixels)", "error"),
            ("time (ms), factors included", "time of a frame"),
            ("time on the host (ms)", "preparation, once a mesh"),
        )
        for own, (label, heading) in zip(axes, labels, strict=True):
            own.set(xlabel="triangles", ylabel=label, title=heading)
            if any(len(line.get_xdata()) for line in own.lines if line.get_label() in _NAMES):
                own.set(xscale="log", yscale="log")
        legend_below(figure)


_NAMES = {style["label"] for style in _STYLES.values()}


def _plot_method(axes: Any, own: list[Row], method: str, style: dict[str, Any]) -> None:
    """A method in all three panels."""
    of = {name: np.array([row[name] for row in own], float) for name in own[0] if name.endswith(("_px", "_ms"))}
    triangles = [row["triangles"] for row in own]
    if method != "recursive":
        axes[0].plot(triangles, of["max_error_px"], **style)
        axes[0].plot(triangles, of["sup_error_px"], **{**style, "label": None}, ls=":", mfc="none")
    times = of["render_ms"] + np.nan_to_num(of["predict_ms"])
    axes[1].plot(triangles, times, **style)
    axes[2].plot(triangles, of["prepare_ms"], **style)
    for row, x, y in zip(own, triangles, times, strict=True):
        if method == "published":
            beside(axes[1], (x, y), str(row["level"]))


def write_differences(page: Page, rows: list[Row], image: Callable[[Row], Path]) -> None:
    """Error images over anisotropies: a row an orientation, above as published, below certified."""
    rows = [row for row in rows if row["orientation"] != "own"]
    if not rows:
        return
    conditions = sorted({row["condition"] for row in rows})
    kinds = [
        (orientation, method)
        for orientation in dict.fromkeys(row["orientation"] for row in rows)
        for method in ("published", "certified")
    ]
    found = {(row["orientation"], row["method"], row["condition"]): row for row in rows}
    pictures = {key: read_error_image(image(row)) for key, row in found.items() if image(row).exists()}
    # what breaks may fill the picture
    sound = [own for key, own in pictures.items() if key[1] == "certified"] or list(pictures.values())
    box = occupied(np.any([np.any(own < 1.0, axis=2) for own in sound], axis=0))
    across, down = (own.stop - own.start for own in (box[1], box[0]))
    width = max(7.0, 3.3 * len(conditions) + 1.2)
    height = (0.9 + 3.2 * down / across) * len(kinds) + 1.2
    title = f"{rows[0]['scene']}: error of every pixel over anisotropies of the covariances (condition numbers)"
    with drawing(page, width, height, title, grid=False) as figure:
        grid = np.reshape(figure.subplots(len(kinds), len(conditions)), (len(kinds), len(conditions)))
        for (orientation, method), line in zip(kinds, grid, strict=True):
            for condition, axes in zip(conditions, line, strict=True):
                _difference(axes, found.get((orientation, method, condition)), pictures, box)
            label = method if method == "certified" else f"published, level {_level(rows)}"
            line[0].set_ylabel(f"{orientation}\n{label}")
        error_legend(figure)


def _level(rows: list[Row]) -> int:
    return next(row["level"] for row in rows if row["method"] == "published")


def _difference(axes: Any, row: Row | None, pictures: dict[Any, np.ndarray], box: Any) -> None:
    bare(axes)
    if row is None:
        return
    said = f"condition {row['condition']:g}"
    picture = pictures.get((row["orientation"], row["method"], row["condition"]))
    if picture is None:
        bare(axes, f"{said}: refused")
        return
    axes.imshow(picture[box], interpolation="nearest")
    bare(axes, f"{said}: {row['max_error_px']:.3g} px,\n{row['triangles'] / 1000:,.0f} k triangles")


def write_surface(page: Page, picture: np.ndarray, gaussians: tuple[np.ndarray, np.ndarray], scene: str) -> None:
    """The surface, and the control mesh with its Gaussians before it."""
    edges, outlines = gaussians
    seen = ~np.isnan(picture)
    rows, columns = occupied(seen)
    with drawing(
        page, 15, 7.5, f"{scene}: a surface of Gaussian products, and what it is made of", grid=False
    ) as figure:
        left, right = figure.subplots(1, 2)
        for axes in (left, right):
            axes.imshow(np.where(seen, picture, 1.0), cmap=GREY_MAP, vmin=0.0, vmax=1.0)
        height = picture.shape[0]
        upside = lambda x: np.stack([x[..., 0], height - x[..., 1]], axis=-1)  # noqa: E731
        right.add_collection(LineCollection(list(upside(edges)), colors=COLOURS[0], linewidths=_MESH))
        ellipses: Any = {"facecolor": to_rgba(COLOURS[4], 0.5), "edgecolor": MARKED, "linewidth": _MESH}
        right.add_collection(PolyCollection(list(upside(outlines)), **ellipses))
        # a coarse control mesh reaches far beyond its surface
        shown = np.concatenate([upside(x).reshape(-1, 2) for x in gaussians])
        low = np.minimum(shown.min(axis=0, initial=np.inf), [columns.start, rows.start])
        high = np.maximum(shown.max(axis=0, initial=-np.inf), [columns.stop, rows.stop])
        bare(left, "the surface")
        bare(right, "its control mesh, and the Gaussians of its vertices (all scaled alike)")
        left.set(xlim=(columns.start, columns.stop), ylim=(rows.stop, rows.start))
        right.set(xlim=(low[0], high[0]), ylim=(high[1], low[1]))
        mesh = Line2D([], [], color=COLOURS[0], lw=_MESH, label="control mesh")
        legend_below(figure, [mesh, Patch(**ellipses, label="Gaussian of a vertex")])
