"""The worst ratio of error to tolerance that was found of every family of nets, asked for in every way."""

from __future__ import annotations

from typing import Any

import numpy as np

from slefejax.figures.page import Page
from slefejax.figures.style import FACTOR_MAP, INK, ON_DARK, TITLE, WRONG, drawing

_LIGHT = 0.6  # ratios from which letters on the colour are dark


def write_attack_figure(page: Page, rows: list[dict[str, Any]]) -> None:
    """A table in colour: a row a family, a column a setting; what broke the tolerance is red."""
    families, settings = (list(dict.fromkeys(row[name] for row in rows)) for name in ("family", "setting"))
    broken = sum(bool(row["violations"]) for row in rows)
    title = "Largest error over the tolerance that an attack found, by family of nets and setting;"
    title += f" the tolerance was broken in {broken} of {len(rows)} (red)"
    width, height = max(6.5, 4.0 + 1.0 * len(settings)), 2.4 + 0.45 * len(families)
    with drawing(page, width, height, title, grid=False) as figure:
        axes = figure.subplots()
        values = np.full((len(families), len(settings)), np.nan)
        for row in rows:
            i, j = families.index(row["family"]), settings.index(row["setting"])
            values[i, j] = row["worst_ratio"]
            colour = INK if row["worst_ratio"] > _LIGHT else ON_DARK
            if row["violations"]:
                values[i, j], colour = np.nan, WRONG
            text = f"{row['worst_ratio']:.3f}" if row["worst_ratio"] < 100 else "seen"
            axes.text(j, i, text, ha="center", va="center", color=colour, size=TITLE)
        shown = axes.imshow(values, cmap=FACTOR_MAP, vmin=0.0, vmax=1.0, aspect="auto")
        axes.set_xticks(range(len(settings)), settings, rotation=40, ha="right", rotation_mode="anchor")
        axes.set_yticks(range(len(families)), families)
        axes.set_xlabel("setting")
        axes.set_ylabel("family of nets")
        figure.colorbar(shown, ax=axes, label="largest error over the tolerance")
