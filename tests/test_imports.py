"""Imports run one way, and the package is light to import."""

from __future__ import annotations

import ast
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
from PIL import Image

from slefejax.experiments.architecture import BESIDE, LADDER, arrows, direct, files_of, imported_parts
from slefejax.experiments.page.charts import LIBRARY
from slefejax.figures.architecture import described
from slefejax.late import APP

ROOT = Path(__file__).resolve().parents[1]

ANALYSIS = set().union(*LADDER)
MOST_MODULES = 12  # of a folder
MOST_ARROWS = 25  # between folders


def modules() -> dict[str, Path]:
    own = {p.relative_to(ROOT).with_suffix(""): p for p in (ROOT / "slefejax").rglob("*.py")}
    return {".".join(name.parts): path for name, path in own.items()}


@pytest.mark.parametrize("step", range(len(LADDER)))
def test_folders_import_themselves_and_what_stands_above(step):
    above = set().union(*LADDER[:step])
    for part in LADDER[step]:
        for path in files_of(part):
            assert imported_parts(path) <= above | {part}, path


def test_every_module_has_its_place():
    parts = {name.split(".")[1] for name in modules() if "." in name} - {"__init__"}
    assert parts | {*BESIDE} == ANALYSIS | {*BESIDE, "__main__"}  # links, which the search may enter or not


def test_prediction_and_measurement_do_not_know_each_other():
    for one, other in (("predict", "measure"), ("measure", "predict"), ("gpu", "predict")):
        assert not any(other in imported_parts(path) for path in files_of(one))


def test_no_module_imports_relatively():
    for path in modules().values():
        assert not [n for n in ast.walk(ast.parse(path.read_text())) if isinstance(n, ast.ImportFrom) and n.level]


def test_the_picture_of_the_house_is_what_the_source_says():
    shown = direct(arrows())
    with Image.open(ROOT / "docs" / "architecture.png") as picture:
        assert picture.info["Description"] == described(shown)
    assert ("session", "predict") in shown
    assert ("predict", "lanes") in arrows()
    assert ("predict", "lanes") not in shown, "it follows from others"


def test_few_folders_know_each_other():
    """Those of the computations."""
    folders = {folder.name for folder in (ROOT / "slefejax").iterdir() if folder.is_dir()} - {*BESIDE, "__pycache__"}
    known = {pair for pair in arrows() if set(pair) <= folders}
    assert len(known) <= MOST_ARROWS, sorted(known)


def test_folders_are_small_enough_to_be_seen_at_once():
    folders = {path.parent for path in modules().values()}
    folders |= {path.parent for own in BESIDE for path in (ROOT / own).rglob("*.py")}
    sizes = {folder: sum(path.name != "__init__.py" for path in folder.glob("*.py")) for folder in folders}
    assert max(sizes.values()) <= MOST_MODULES, sizes


def test_no_function_has_the_name_of_its_module():
    """Otherwise ``import slefejax.x as m`` gives the function."""
    import slefejax

    own = {name.split(".")[1] for name in modules() if "." in name}
    assert not own & set(slefejax.__all__) - {"__init__"}


@pytest.mark.parametrize("name", ["covering", "edges", "error", "rig", "rivals", "skinning"])
def test_modules_that_were_named_before_they_stood_in_folders(name):
    code = f"import slefejax; import slefejax.{name}; import slefejax.{name} as own; assert slefejax.{name} is own"
    subprocess.run([sys.executable, "-c", code], check=True, cwd=ROOT)


@pytest.mark.parametrize(
    ("part", "allowed"),
    [
        ("gpu", {"gpu", "errors", "late", "arguments", "geometry", "tessellator"}),
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
        "bad = [m for m in ('moderngl', 'matplotlib', 'tyro', 'rich', 'slefejax.experiments') if m in sys.modules];"
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
    assert app == {*APP, LIBRARY}, "pages of runs do without the one, and say so"
    computing = [path for name, path in modules().items() if name != "slefejax.measure.covering"] + files_of("gpu")
    found = set().union(*map(packages_imported, computing))
    assert found == base | module_names(EXTRAS["usd"] + EXTRAS["rhino"])
    assert packages_imported(ROOT / "slefejax" / "measure" / "covering.py") - base == {"skimage"}
    shown = set().union(*map(packages_imported, files_of("experiments") + files_of("figures")))
    assert shown <= base | app | module_names(EXTRAS["parquet"] + EXTRAS["cluster"]) | {"dask"}


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
