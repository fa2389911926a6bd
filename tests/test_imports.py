"""Imports run one way, and the package is light to import."""

from __future__ import annotations

import ast
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]

# Each layer may import itself and those before it.
LAYERS = [
    {"errors", "late"},
    {
        "bezier",
        "view",
        "layout",
        "maxima",
        "edges",
        "tessellator",
        "slefe_tables",
        "arguments",
        "direct3d11",
        "rings",
        "fewest",
        "mesh",
        "stencils",
        "skinning",
        "plain",
    },
    {
        "slefe",
        "bspline",
        "tiles",
        "optimum",
        "coincidence",
        "rivals",
        "projection",
        "estimate",
        "packed",
        "kernel",
        "methods",
        "nets",
        "certified",
        "verified",
        "rules",
        "supremum",
        "triangles",
        "triangulation",
        "error",
        "defects",
        "rig",
        "conversion",
        "framing",
        "io",
        "data",
    },
    {"certificate", "proved", "drawn", "factors", "widths", "curves", "deviation", "minimal", "covering"},
    {"scene", "session", "testing", "samples", "fitting", "budget", "sensitivity", "relaxing"},
]
ANALYSIS = set().union(*LAYERS)
GROUND = LAYERS[0] | LAYERS[1]


def modules() -> dict[str, Path]:
    own = {p.relative_to(ROOT).with_suffix(""): p for p in (ROOT / "slefejax").rglob("*.py")}
    return {".".join(name.parts): path for name, path in own.items()}


def imported_parts(path: Path) -> set[str]:
    """First parts below slefejax of everything that a file imports ('' for the package itself)."""
    parts = set()
    for node in ast.walk(ast.parse(path.read_text())):
        names = []
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: relative import"
            names = [node.module or ""]
            if node.module == "slefejax":
                names = [f"slefejax.{a.name}" if files_of(a.name)[0].exists() else "slefejax" for a in node.names]
        for name in names:
            if name.split(".")[0] == "slefejax":
                parts.add([*name.split("."), ""][1])
    return parts


def files_of(part: str) -> list[Path]:
    folder = ROOT / "slefejax" / part
    return sorted(folder.glob("*.py")) if folder.is_dir() else [folder.with_suffix(".py")]


@pytest.mark.parametrize("level", range(len(LAYERS)))
def test_analysis_modules_import_their_own_layer_and_below(level):
    allowed = set().union(*LAYERS[: level + 1])
    for part in LAYERS[level]:
        for path in files_of(part):
            assert imported_parts(path) <= allowed, path


def test_every_module_has_its_place():
    parts = {name.split(".")[1] for name in modules() if "." in name} - {"__init__"}
    parts |= {"gpu", "experiments", "figures"}  # links, which a search by name does not enter
    assert parts == ANALYSIS | {"gpu", "experiments", "figures"}


@pytest.mark.parametrize(
    ("part", "allowed"),
    [
        ("gpu", GROUND | {"gpu"}),
        ("figures", {"figures"}),
        ("experiments", ANALYSIS | {"", "gpu", "figures", "experiments"}),
    ],
)
def test_upper_floors(part, allowed):
    for path in files_of(part):
        assert imported_parts(path) <= allowed, path


def test_import_loads_no_graphics_and_starts_no_backend():
    code = (
        "import sys, slefejax; import jax._src.xla_bridge as bridge;"
        "bad = [m for m in ('moderngl', 'matplotlib', 'tyro', 'rich') if m in sys.modules];"
        "assert not bad, bad; assert not bridge._backends, bridge._backends;"
        "import jax; assert not jax.config.jax_enable_x64"
    )
    subprocess.run([sys.executable, "-c", code], check=True, cwd=ROOT.parent)


def late_imports(path: Path) -> list[tuple[int, bool]]:
    """Line of every import of a package in a function, and whether one lock holds others off meanwhile."""
    found = []

    def visit(node: ast.AST, inside: bool, locked: bool) -> None:
        if isinstance(node, (ast.Import, ast.ImportFrom)):
            own = isinstance(node, ast.ImportFrom) and (node.module or "").startswith("slefejax")
            if inside and not own:
                found.append((node.lineno, locked))
        inside = inside or isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef))
        names = [ast.unparse(item.context_expr) for item in node.items] if isinstance(node, ast.With) else []
        for child in ast.iter_child_nodes(node):
            visit(child, inside, locked or "one_at_a_time" in names)

    visit(ast.parse(path.read_text()), inside=False, locked=False)
    return found


def test_packages_that_are_imported_late_are_imported_by_one_thread_at_a_time():
    """Two threads that import compiled packages for the first time can wait for each other for ever."""
    paths = [path for path in modules().values() if path.name != "probe.py"]  # a process of its own
    every = {path: late_imports(path) for path in [*paths, ROOT / "gpu" / "strays.py"]}
    assert sum(map(len, every.values())) > 10
    assert not [f"{path}:{line}" for path, lines in every.items() for line, locked in lines if not locked]
