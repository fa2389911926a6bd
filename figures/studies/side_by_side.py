"""Error images of several rules beside each other."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from slefejax.figures.error_image import read_error_image
from slefejax.figures.page import Page
from slefejax.figures.style import bare, drawing, error_legend, hide_rest, occupied


def write_side_by_side(page: Page, panels: list[tuple[dict[str, Any], Path]], tolerance: float) -> None:
    """A panel a rule: its row and its error image; ``tolerance`` in pixels is what the rules were asked for."""
    images = [read_error_image(image) for _, image in panels]
    box = occupied(np.any([np.any(image != 1.0, axis=-1) for image in images], axis=0))
    rows, columns = box
    across, down = min(3, len(panels)), -(-len(panels) // 3)
    tall = (rows.stop - rows.start) / (columns.stop - columns.start)
    title = f"{panels[0][0]['scene']} by different rules for tessellation factors, asked for at most {tolerance:g} px:"
    title += " how far is each pixel from where its texture belongs?"
    with drawing(page, 15, 1.0 + (0.9 + 4.8 * min(1.2, tall)) * down, title) as figure:
        places = np.ravel(figure.subplots(down, across, squeeze=False))
        hide_rest(places, len(panels))
        for axes, (row, _), image in zip(places, panels, images, strict=False):
            axes.imshow(image[box], interpolation="nearest")
            share = 100 * row["share_above_0.5"]
            said = f"{row['method_name']}: {row['triangles']:,} triangles\n{share:.2g} % of pixels off by more"
            bare(axes, f"{said} than ½ px, worst {row['max_error_px']:.2f} px")
        error_legend(figure)
