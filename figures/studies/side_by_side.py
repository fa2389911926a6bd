"""Error images of several rules beside each other."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.image import imread

from slefejax.figures.style import SETTINGS, error_legend, new_figure, occupied, save


def write_side_by_side(path: Path, panels: list[tuple[dict[str, Any], Path]], tolerance: float) -> None:
    """A panel a rule: its row and its error image; ``tolerance`` in pixels is what the rules were asked for."""
    images = [imread(image)[..., :3] for _, image in panels]
    something = np.any([np.any(image != 1.0, axis=-1) for image in images], axis=0)
    box = occupied(something)
    with mpl.rc_context(SETTINGS):
        across, down = min(3, len(panels)), -(-len(panels) // 3)
        figure = new_figure(15, 0.6 + 4.0 * down)
        places = np.ravel(figure.subplots(down, across, squeeze=False))
        for axes in places[len(panels) :]:
            axes.set_axis_off()
        for axes, (row, _), image in zip(places, panels, images, strict=False):
            axes.imshow(image[box], interpolation="nearest")
            share = 100 * row["share_above_0.5"]
            axes.set_title(
                f"{row['method_name']}: {row['triangles']:,} triangles\n{share:.2g} % of the pixels off by more"
                f" than ½ px, worst {row['max_error_px']:.2f} px",
                fontsize=11,
            )
            axes.set_axis_off()
        error_legend(figure)
        figure.suptitle(
            f"{panels[0][0]['scene']} by different rules for tessellation factors, asked for at most {tolerance:g} px:"
            " how far is each pixel from where its texture belongs?",
            fontsize=13,
        )
        save(figure, path)
