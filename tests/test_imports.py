"""Imports run one way, and the package is light to import."""

from __future__ import annotations

import ast
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from slefejax.late import APP

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
    {"scene", "cameras", "session", "testing", "samples", "fitting", "budget", "sensitivity", "relaxing"},
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
    assert parts == ANALYSIS | {"gpu", "experiments", "figures", "__main__"}


@pytest.mark.parametrize(
    ("part", "allowed"),
    [
        ("gpu", GROUND | {"gpu"}),
        ("figures", {"figures", "late"}),
        ("experiments", ANALYSIS | {"", "gpu", "figures", "experiments"}),
        ("__main__", {"experiments"}),
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


PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
MODULES = {"pillow": "PIL", "scikit-image": "skimage", "usd-core": "pxr"}  # of packages that are imported otherwise
EXTRAS = PROJECT["optional-dependencies"]


def module_names(requirements: list[str]) -> set[str]:
    names = {re.split(r"[^\w-]", requirement)[0] for requirement in requirements}
    return {MODULES.get(name, name) for name in names}


def packages_imported(path: Path) -> set[str]:
    """Everything that a file imports, late or not, but for Python's own and slefejax."""
    nodes = list(ast.walk(ast.parse(path.read_text())))
    names = {alias.name for node in nodes if isinstance(node, ast.Import) for alias in node.names}
    names |= {node.module or "" for node in nodes if isinstance(node, ast.ImportFrom)}
    return {name.split(".")[0] for name in names} - sys.stdlib_module_names - {"slefejax"}


def test_what_only_pictures_and_the_command_line_need_is_an_extra():
    base, app = module_names(PROJECT["dependencies"]), module_names(EXTRAS["app"])
    assert app == set(APP)
    computing = [path for name, path in modules().items() if name != "slefejax.covering"] + files_of("gpu")
    found = set().union(*map(packages_imported, computing))
    assert found == base | module_names(EXTRAS["usd"] + EXTRAS["rhino"])
    assert packages_imported(ROOT / "slefejax" / "covering.py") - base == {"skimage"}
    shown = set().union(*map(packages_imported, files_of("experiments") + files_of("figures")))
    assert shown <= base | app


def test_the_extra_of_all_brings_the_others():
    (everything,) = EXTRAS["all"]
    wanted = set(EXTRAS) - {"all", "test", "lint", "torch"}
    assert set(re.findall(r"\[(.*)\]", everything)[0].split(",")) == wanted


def without_app(code: str, *arguments: str) -> subprocess.CompletedProcess:
    """A process of its own in which the packages of the extra ``app`` cannot be imported."""
    hidden = f"import sys; sys.modules.update(dict.fromkeys({APP!r}))\n"
    command = [sys.executable, "-c", hidden + code, *arguments]
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)


def test_computations_need_no_extra():
    names = [name.removesuffix(".__init__") for name in modules()] + [f"slefejax.gpu.{p.stem}" for p in files_of("gpu")]
    code = (
        "from importlib import import_module\n"
        "for name in sys.argv[1:]: import_module(name)\n"
        "import slefejax as sj\n"
        "scene = sj.load('steep-patch')\n"
        "view = sj.View(scene.default_camera(cover=0.2), 160, 100)\n"
        "print(sj.tessellation_factors(scene.patches(), view).factor.shape)\n"
    )
    found = without_app(code, *names)
    assert found.stdout == "(1,)\n", found.stderr


@pytest.mark.parametrize("words", [["factors", "teapot"], ["--help"], []])
def test_the_command_without_its_extra_is_one_sentence(words):
    found = without_app("from slefejax.__main__ import entry; entry()", *words)
    assert found.returncode == 2
    assert found.stdout == ""
    assert found.stderr == (
        "slefejax: experiments and the command line need packages that are not installed"
        f" ({', '.join(APP)}): pip install 'slefejax[app]'\n"
    )


@pytest.mark.parametrize("name", ["figures.style", "experiments.options"])
def test_pictures_and_experiments_say_which_extra_they_need(name):
    found = without_app(f"import slefejax.{name}")
    assert found.stderr.splitlines()[-1].startswith(f"ImportError: {name.split('.')[0]}")
    assert found.stderr.endswith(f"not installed ({', '.join(APP)}): pip install 'slefejax[app]'\n")


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
