"""The worst ratio of error to tolerance that was found of every family of nets, asked for in every way."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np

from slefejax.figures.style import FACTOR_MAP, SETTINGS, new_figure, save

_LIGHT = 0.6  # ratios from which letters on the colour are dark
_BROKEN = "#c81e1e"


def write_attack_figure(path: Path, rows: list[dict[str, Any]]) -> None:
    """A table in colour: a row a family, a column a setting; what broke the tolerance is red."""
    families, settings = (list(dict.fromkeys(row[name] for row in rows)) for name in ("family", "setting"))
    with mpl.rc_context({**SETTINGS, "axes.grid": False}):
        figure = new_figure(3.0 + 1.0 * len(settings), 2.4 + 0.45 * len(families))
        axes = figure.subplots()
        values = np.full((len(families), len(settings)), np.nan)
        for row in rows:
            i, j = families.index(row["family"]), settings.index(row["setting"])
            values[i, j] = row["worst_ratio"]
            colour = "black" if row["worst_ratio"] > _LIGHT else "white"
            if row["violations"]:
                values[i, j], colour = np.nan, _BROKEN
            text = f"{row['worst_ratio']:.3f}" if row["worst_ratio"] < 100 else "seen"
            axes.text(j, i, text, ha="center", va="center", color=colour, fontsize=10)
        shown = axes.imshow(values, cmap=FACTOR_MAP, vmin=0.0, vmax=1.0, aspect="auto")
        axes.set_xticks(range(len(settings)), settings, rotation=40, ha="right")
        axes.set_yticks(range(len(families)), families)
        figure.colorbar(shown, ax=axes, label="largest error over the tolerance")
        save(figure, path)
