"""What the page's charts show before the reader chooses, how series look, and the library that draws them."""

from __future__ import annotations

from collections.abc import Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from slefejax.experiments.compare.differences import ALWAYS, SOMETIMES
from slefejax.experiments.page.columns import NUMBER, Column
from slefejax.figures.colours import COLOURS, MARKS, METHOD_STYLES

LIBRARY = "bokeh"
_SCRIPTS = ("bokeh.min.js", "bokeh-api.min.js")  # of its package: marks and axes, and how a page asks for them
MOST_SERIES, MOST_PANELS = 24, 6
_WIDE = 30.0  # the largest over the least, from which on an axis is logarithmic
_ACROSS = ("scale", "tolerance_px", "tolerance_deg", "tolerance_depth", "frame", "count", "budget", "level")
_UP = (
    *("max_error_px", "drawn_sup_error_px", "sup_error_px", "max_normal_error_deg", "limit_max_px", "worst_ratio"),
    *("width_over_optimum_median", "share_above_0.5", "us_per_curve", "fused_ms", "median_ms"),
)
_BESIDE = (
    "triangles",
    "us_per_curve",
    "triangles_over_minimal",
    "render_ms",
    "predict_ms",
    "sum_of_factors",
    "peer_ms",
)
_APART = ("method", "bound", "rule", "stage", "family", "scheme", "scene", "case")

# Of Matplotlib's marks those that the library has too: its name, and a letter that looks like it
_SHAPES = {
    "o": ("circle", "●"),
    "s": ("square", "■"),
    "^": ("triangle", "▲"),
    "D": ("diamond", "◆"),
    "v": ("inverted_triangle", "▼"),
    "P": ("plus", "✚"),
    "*": ("star", "★"),
    "X": ("x", "✖"),
    "h": ("hex", "⬢"),
}


def library() -> list[str]:
    """The library's scripts; none where it is not installed."""
    found = find_spec(LIBRARY)
    if found is None or not found.submodule_search_locations:
        return []
    folder = Path(found.submodule_search_locations[0], "server", "static", "js")
    paths = [folder / name for name in _SCRIPTS]
    return [path.read_text(encoding="utf-8") for path in paths] if all(path.is_file() for path in paths) else []


def looks() -> dict[str, Any]:
    """Colours and marks of series, and of methods, the same as in figures."""
    shapes = [_SHAPES[mark] for mark in MARKS if mark in _SHAPES]
    methods = {name: [own["color"], *_SHAPES[own["marker"]]] for name, own in METHOD_STYLES.items()}
    return {"colours": COLOURS, "shapes": shapes, "methods": methods, "mostSeries": MOST_SERIES}


def cases_of(columns: Sequence[Column], told: Sequence[str] = ()) -> list[Column]:
    """Those that say which case a row is of; ``told``: their names, if the run knows, else those of all commands."""
    return [own for own in columns if own.name in (told or (*ALWAYS, *SOMETIMES, *_ACROSS))]


def chosen(columns: Sequence[Column], cases: Sequence[Column]) -> list[dict[str, Any]]:
    """At most two charts: what goes across and up, which column has a colour and a mark a value, which a panel.

    cases : the columns that say which case a row is of
    """
    numbers = [own for own in columns if own.kind == NUMBER and len(set(own.finite.tolist())) > 1]
    if not numbers:
        return []
    texts = [own for own in columns if own.kind != NUMBER and 1 < own.different <= MOST_SERIES]
    across = _first(_ACROSS, [own for own in numbers if own in cases] or _most(texts) or numbers[:1])
    measured = [own for own in numbers if own is not across and own not in cases] or numbers
    up = _first(_UP, measured)
    beside = _first(_BESIDE, [own for own in measured if own is not up and own.name in _BESIDE])
    apart = [own for own in (*texts, *cases) if own is not across and 1 < own.different <= MOST_SERIES]
    series = _first(_APART, apart)
    panels = [own for own in apart if own is not series and own in cases and own.different <= MOST_PANELS]
    panel = _first(("scene", "view"), panels)
    return [_chart(across, own, series, panel) for own in (up, beside) if own is not None]


def _most(columns: Sequence[Column]) -> list[Column]:
    """The one that has the most values, the first of several; none of none."""
    return sorted(columns, key=lambda own: -own.different)[:1]


def _first(names: Sequence[str], columns: Sequence[Column]) -> Column | None:
    """The one whose name stands first; the first column if none does."""
    known = {own.name: own for own in reversed(columns)}
    return next((known[name] for name in names if name in known), columns[0] if columns else None)


def _chart(across: Column | None, up: Column, series: Column | None, panel: Column | None) -> dict[str, Any]:
    names = {"x": across, "y": up, "series": series, "panel": panel}
    logarithmic = {"logX": across is not None and across.kind == NUMBER and _is_wide(across), "logY": _is_wide(up)}
    return {key: own.name if own else None for key, own in names.items()} | logarithmic


def _is_wide(own: Column) -> bool:
    return bool(own.finite.size and own.finite.min() > 0 and own.finite.max() > _WIDE * own.finite.min())
