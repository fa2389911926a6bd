"""Fixed levels of Gaussian products beside certified ones, and the Gaussians that they are of."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.image import imread

from slefejax.figures.style import METHOD_STYLES, SETTINGS, error_legend, new_figure, occupied, save

Row = dict[str, Any]
_STYLES = {
    "published": {"color": "#d55e00", "marker": "o", "label": "published, fixed level"},
    "certified": {**METHOD_STYLES["certified"], "label": "certified", "markersize": 13},
    "recursive": {"color": "#0072b2", "marker": "s", "label": "subdivision on the host"},
}


def write_levels(path: Path, rows: list[Row], scene: str) -> None:
    """Errors against triangles, milliseconds of a frame against triangles, and of the preparation."""
    with mpl.rc_context(SETTINGS):
        figure = new_figure(16, 5.4)
        axes = figure.subplots(1, 3)
        for method, style in _STYLES.items():
            own = [row for row in rows if row["method"] == method and np.isfinite(row["triangles"])]
            if not own:
                continue  # refused
            own.sort(key=lambda row: row["triangles"])
            of = lambda name, own=own: np.array([row[name] for row in own], float)  # noqa: E731
            if method != "recursive":
                axes[0].plot(of("triangles"), of("max_error_px"), **style)
                axes[0].plot(of("triangles"), of("sup_error_px"), **{**style, "label": None}, ls=":", mfc="none")
            predict = np.nan_to_num(of("predict_ms"))
            axes[1].plot(of("triangles"), of("render_ms") + predict, **style)
            axes[2].plot(of("triangles"), of("prepare_ms"), **style)
            for row, x, y in zip(own, of("triangles"), of("render_ms"), strict=True):
                if method == "published":
                    axes[1].annotate(f" {row['level']}", (x, y), va="top")
        axes[0].axhline(0.5, color="0.4", lw=1)
        axes[0].annotate("½ px", (0.01, 0.5), xycoords=("axes fraction", "data"), va="bottom", color="0.3")
        labels = (
            ("largest error, pixels\n(dotted: over the domain)", "error"),
            ("milliseconds a frame, factors included", "time a frame (levels at the points)"),
            ("milliseconds, on the host", "preparation, once a mesh"),
        )
        for own, (label, title) in zip(axes, labels, strict=True):
            own.set(xlabel="triangles", ylabel=label, title=title)
            if own.get_legend_handles_labels()[0]:
                own.set(xscale="log", yscale="log")
        for own in axes[:2]:
            if own.get_legend_handles_labels()[0]:
                own.legend(frameon=True)
        figure.suptitle(f"{scene}: Gaussian products at fixed levels, as published, and at certified ones")
        save(figure, path)


def write_differences(path: Path, rows: list[Row], image: Callable[[Row], Path]) -> None:
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
    pictures = {key: imread(image(row)) for key, row in found.items() if image(row).exists()}
    # what breaks may fill the picture
    sound = [own for key, own in pictures.items() if key[1] == "certified"] or list(pictures.values())
    box = occupied(np.any([np.any(own[..., :3] < 1.0, axis=2) for own in sound], axis=0))
    across, down = (own.stop - own.start for own in (box[1], box[0]))
    with mpl.rc_context({**SETTINGS, "axes.grid": False}):
        figure = new_figure(3.3 * len(conditions) + 1.2, (0.5 + 3.2 * down / across) * len(kinds) + 1.8)
        grid = np.reshape(figure.subplots(len(kinds), len(conditions)), (len(kinds), len(conditions)))
        for (orientation, method), line in zip(kinds, grid, strict=True):
            for condition, axes in zip(conditions, line, strict=True):
                _difference(axes, found.get((orientation, method, condition)), pictures, box)
            label = method if method == "certified" else f"published, level {_level(rows)}"
            line[0].annotate(
                f"{orientation}\n{label}", (-0.04, 0.5), xycoords="axes fraction", rotation=90, ha="right", va="center"
            )
        for condition, axes in zip(conditions, grid[0], strict=True):
            axes.annotate(
                f"condition {condition:g}",
                (0.5, 1.0),
                (0, 30),
                "axes fraction",
                "offset points",
                ha="center",
                fontweight="bold",
            )
        error_legend(figure)
        figure.suptitle(f"{rows[0]['scene']}: error of every pixel over anisotropies of the covariances")
        save(figure, path)


def _level(rows: list[Row]) -> int:
    return next(row["level"] for row in rows if row["method"] == "published")


def _difference(axes: Any, row: Row | None, pictures: dict[Any, np.ndarray], box: Any) -> None:
    axes.set_xticks([])
    axes.set_yticks([])
    for spine in axes.spines.values():
        spine.set_visible(False)
    if row is None:
        return
    picture = pictures.get((row["orientation"], row["method"], row["condition"]))
    if picture is None:
        axes.annotate("refused", (0.5, 0.5), xycoords="axes fraction", ha="center", va="center", color="0.4")
        return
    axes.imshow(picture[box], interpolation="nearest")
    axes.set_title(f"{row['max_error_px']:.3g} px, {row['triangles'] / 1000:,.0f} k triangles", fontsize=10)


def write_surface(path: Path, picture: np.ndarray, gaussians: tuple[np.ndarray, np.ndarray], scene: str) -> None:
    """The surface, and the control mesh with its Gaussians before it."""
    edges, outlines = gaussians
    seen = ~np.isnan(picture)
    box = occupied(seen)
    rows, columns = box
    with mpl.rc_context({**SETTINGS, "axes.grid": False}):
        figure = new_figure(15, 7.5)
        left, right = figure.subplots(1, 2)
        for axes in (left, right):
            axes.imshow(np.where(seen, picture, 1.0), cmap="gray", vmin=0.0, vmax=1.0)
            axes.set_axis_off()
        height = picture.shape[0]
        upside = lambda x: np.stack([x[..., 0], height - x[..., 1]], axis=-1)  # noqa: E731
        right.add_collection(LineCollection(list(upside(edges)), colors="#0072b2", linewidths=0.6))
        right.add_collection(
            PolyCollection(list(upside(outlines)), facecolors="#e69f0080", edgecolors="#d55e00", linewidths=0.6)
        )
        # a coarse control mesh reaches far beyond its surface
        shown = np.concatenate([upside(x).reshape(-1, 2) for x in gaussians])
        low = np.minimum(shown.min(axis=0, initial=np.inf), [columns.start, rows.start])
        high = np.maximum(shown.max(axis=0, initial=-np.inf), [columns.stop, rows.stop])
        left.set(xlim=(columns.start, columns.stop), ylim=(rows.stop, rows.start))
        right.set(xlim=(low[0], high[0]), ylim=(high[1], low[1]))
        left.set_title("the surface")
        right.set_title("its control mesh, and the Gaussians of its vertices (all scaled alike)")
        figure.suptitle(f"{scene}: Gaussian products")
        save(figure, path)
