"""Where the published estimate fails and the certified factor holds, and what the proof costs."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.image import imread

from slefejax.figures.style import METHOD_STYLES, SETTINGS, error_legend, new_figure, occupied, save

Rows = list[dict[str, Any]]


def write_certify_figure(path: Path, rows: Rows, summary: Rows, images: list[list[Path]], tolerance: float) -> None:
    """A line of pictures a scene (certified, slefe), and below errors patch by patch, triangles and time.

    rows, summary : a row a patch, a row a scene and method
    images        : for every scene the error images of the certified factor, and of the estimate if it has one
    """
    names = list(dict.fromkeys(row["scene"] for row in summary))
    with mpl.rc_context(SETTINGS):
        figure = new_figure(14, 4.4 * len(names) + 5.6)
        parts: Any = figure.subfigures(2, 1, height_ratios=[4.4 * len(names), 5.2])
        across = max(map(len, images))
        grid = np.reshape(parts[0].subplots(len(names), across), (len(names), across))
        for line, name, own_images in zip(grid, names, images, strict=True):
            pictures = [imread(image)[..., :3] for image in own_images]
            something = np.any([np.any(picture != 1.0, axis=-1) for picture in pictures], axis=0)
            box = occupied(something) if something.any() else (slice(None), slice(None))
            own = {row["method"]: row for row in summary if row["scene"] == name}
            for axes, picture, method in zip(line, pictures, ("certified", "slefe"), strict=False):
                axes.imshow(picture[box], interpolation="nearest")
                axes.set_title(_picture_title(own[method]), fontsize=11)
            for axes in line:
                axes.set_axis_off()
        error_legend(parts[0])
        left, middle, right = parts[1].subplots(1, 3, width_ratios=[1.6, 1, 1])
        _plot_errors(left, rows, tolerance)
        _plot_ratio(middle, summary, names, "triangles", "minimal_triangles", "triangles drawn, over minimal")
        _plot_times(right, summary, names)
        figure.suptitle(
            f"Asked for at most {tolerance:g} px: how far is each pixel from where its texture belongs, and what does"
            " a factor with a proof cost?",
            fontsize=13,
        )
        save(figure, path)


def _picture_title(row: dict[str, Any]) -> str:
    return (
        f"{row['scene']}, {row['method']}: {row['triangles']:,} triangles\nworst pixel {row['max_error_px']:.2f} px;"
        f" over the domain {max(row['sup_error_px'], row['drawn_sup_error_px']):.2f} px,"
        f" {row['patches_above']} of {row['patches']} patches above"
    )


def _plot_errors(axes: Axes, rows: Rows, tolerance: float) -> None:
    """The largest error of every visible patch, in order of the estimate's."""
    seen = [row for row in rows if row["minimal"] > 0]
    for method, prefix in (("slefe", "slefe_"), ("certified", "")):
        worst = np.array([max(row[f"{prefix}sup_error_px"], row[f"{prefix}drawn_sup_error_px"]) for row in seen])
        there = worst[~np.isnan(worst)]
        if there.size:
            axes.plot(np.sort(np.maximum(there, 1e-3)), ls="", ms=5, label=method, **METHOD_STYLES[method])
    axes.axhline(tolerance, color="0.2", lw=1)
    axes.annotate(f"tolerance {tolerance:g} px", (0, tolerance), (2, 4), textcoords="offset points", fontsize=10)
    axes.set_yscale("log")
    axes.set_xlabel("patches, each method in order of its errors")
    axes.set_ylabel("largest error over the domain (pixels)")
    axes.set_title("does it hold? (uniform and as drawn)")
    axes.legend(frameon=True)


def _plot_ratio(axes: Axes, summary: Rows, names: list[str], key: str, over: str, title: str) -> None:
    methods = list(dict.fromkeys(row["method"] for row in summary))
    for k, method in enumerate(methods):
        own = {row["scene"]: row for row in summary if row["method"] == method}
        there = [i for i, name in enumerate(names) if name in own and own[name][over] > 0]
        heights = [own[names[i]][key] / own[names[i]][over] for i in there]
        bars = axes.bar(
            np.array(there) + 0.27 * (k - (len(methods) - 1) / 2),
            heights,
            0.25,
            label=method,
            color=METHOD_STYLES[method]["color"],
        )
        axes.bar_label(bars, [f"{h:.2f}" for h in heights], fontsize=9)
    axes.axhline(1.0, color="0.2", lw=1)
    axes.set_xticks(range(len(names)), [name.replace("-", "-\n") for name in names])
    axes.set_yscale("log")
    axes.set_ylabel(title)
    axes.set_title("what it costs in triangles")
    axes.set_ylim(top=20)
    axes.legend(frameon=True, fontsize=9, loc="upper left", ncols=3)


def _plot_times(axes: Axes, summary: Rows, names: list[str]) -> None:
    methods = list(dict.fromkeys(row["method"] for row in summary))
    for k, method in enumerate(methods):
        own = {row["scene"]: row["predict_ms"] for row in summary if row["method"] == method}
        there = [i for i, name in enumerate(names) if name in own]
        heights = [own[names[i]] for i in there]
        bars = axes.bar(
            np.array(there) + 0.27 * (k - (len(methods) - 1) / 2),
            heights,
            0.25,
            label=method,
            color=METHOD_STYLES[method]["color"],
        )
        axes.bar_label(bars, [f"{h:.1f}" for h in heights], fontsize=9)
    axes.set_xticks(range(len(names)), [name.replace("-", "-\n") for name in names])
    axes.set_ylabel("milliseconds a view, once compiled")
    axes.set_title("what it costs in time")
