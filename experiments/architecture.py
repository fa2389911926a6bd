"""Which folder imports which, read from the source.

``python -m slefejax.experiments.architecture docs/architecture.png`` draws it.
"""

from __future__ import annotations

import ast
import sys
from pathlib import Path

from slefejax.figures.architecture import write_architecture

ROOT = Path(__file__).resolve().parents[1]
BESIDE = ("gpu", "figures", "experiments")  # top-level folders of a checkout, linked into the package

# Folders and single modules of slefejax: each may import itself, and those of the rows above it.
LADDER = (
    {"errors", "late"},
    {"arguments"},
    {"lanes"},
    {"geometry"},
    {"bounds", "tessellator", "model"},
    {"conversion", "framing"},
    {"io"},
    {"data"},
    {"scene"},
    {"loading"},
    {"predict", "measure"},
    {"cameras", "session", "testing"},
    {"study"},
)
# column and row of the picture, from below; what nearly everything imports, errors and the like, is left out
SHOWN = {
    "lanes": (2.4, 0),
    "geometry": (2.4, 1),
    "tessellator": (0.9, 2),
    "bounds": (2.0, 2),
    "model": (3.95, 2),
    "conversion": (2.8, 3),
    "io": (3.9, 3),
    "data": (3.95, 4),
    "gpu": (-0.2, 5),
    "measure": (0.9, 5),
    "predict": (2.0, 5),
    "scene": (2.75, 4),
    "loading": (3.6, 5),
    "study": (1.2, 6),
    "session": (2.6, 6),
    "figures": (-0.2, 7),
    "experiments": (1.2, 7),
}


def files_of(part: str) -> list[Path]:
    """The files of a folder or module below slefejax."""
    folder = ROOT / part if part in BESIDE else ROOT / "slefejax" / part
    return sorted(folder.rglob("*.py")) if folder.is_dir() else [folder.with_suffix(".py")]


def imported_parts(path: Path) -> set[str]:
    """First parts below slefejax of everything that a file imports ('' for the package itself)."""
    known = {*set().union(*LADDER), *BESIDE}
    names: list[str] = []
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            names += [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            own = node.module == "slefejax"
            names += [f"slefejax.{a.name}" if a.name in known else "slefejax" for a in node.names] if own else []
            names += [] if own else [node.module or ""]
    return {[*name.split("."), ""][1] for name in names if name.split(".")[0] == "slefejax"}


def arrows() -> list[tuple[str, str]]:
    """Pairs of what is shown, the first of which imports the second."""
    found = {(part, other) for part in SHOWN for path in files_of(part) for other in imported_parts(path)}
    return sorted(pair for pair in found if pair[1] in SHOWN and pair[0] != pair[1])


def direct(pairs: list[tuple[str, str]]) -> list[tuple[str, str]]:
    """Those that do not follow from the others."""
    below: dict[str, set[str]] = {}

    def reached(part: str) -> set[str]:
        if part not in below:
            own = {other for first, other in pairs if first == part}
            below[part] = own.union(*map(reached, own))
        return below[part]

    return [
        (one, other)
        for one, other in pairs
        if not any(other in reached(between) for first, between in pairs if first == one and between != other)
    ]


def write(path: Path) -> None:
    """The picture, with the arrows it shows in its own text."""
    sizes = {part: sum(file.name != "__init__.py" for file in files_of(part)) for part in SHOWN}
    write_architecture(path, SHOWN, sizes, direct(arrows()))


if __name__ == "__main__":
    write(Path(sys.argv[1]))
