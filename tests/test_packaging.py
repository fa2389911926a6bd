"""The wheel, installed where the checkout is not, and what it says of itself."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tomllib
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]


@pytest.fixture(scope="module")
def wheel(tmp_path_factory) -> Path:
    """Built from a copy of the checkout, so that nothing is left in it."""
    folder = tmp_path_factory.mktemp("wheel")
    source = folder / "source"
    files = subprocess.run(["git", "ls-files", "-co", "--exclude-standard"], cwd=ROOT, capture_output=True, text=True)
    for name in files.stdout.splitlines():
        origin, copy = ROOT / name, source / name
        if not origin.exists():
            continue
        copy.parent.mkdir(parents=True, exist_ok=True)
        if origin.is_symlink():
            copy.symlink_to(origin.readlink())
        else:
            copy.write_bytes(origin.read_bytes())
    command = [sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps", "--no-build-isolation", "-w", str(folder)]
    subprocess.run([*command, str(source)], check=True)
    return next(folder.glob("*.whl"))


@pytest.fixture(scope="module")
def site(wheel, tmp_path_factory) -> Path:
    """A folder that the wheel alone is installed in."""
    site = tmp_path_factory.mktemp("site")
    command = [sys.executable, "-m", "pip", "install", "--quiet", "--no-deps", "--no-compile", "--target", str(site)]
    subprocess.run([*command, str(wheel)], check=True)
    return site


def test_only_slefejax_is_at_the_top(wheel):
    names = zipfile.ZipFile(wheel).namelist()
    assert {name.split("/")[0].split("-")[0] for name in names} == {"slefejax"}
    parts = {"slefejax/experiments/page/parts/page.html", "slefejax/experiments/page/parts/charts.js"}
    assert {"slefejax/py.typed", "slefejax/gpu/shaders/patch.tese", *parts} <= set(names)
    assert not [name for name in names if name.startswith("tests") or "/test_" in name or "conftest" in name]


def test_installed_command_works_outside_the_checkout(site, tmp_path):
    code = (
        f"import sys; sys.path.insert(0, {str(site)!r});"
        "import slefejax; from importlib.util import find_spec;"
        f"assert slefejax.__file__.startswith({str(site)!r}), slefejax.__file__;"
        "assert not [n for n in ('gpu', 'experiments', 'figures', 'tests') if find_spec(n)];"
        "from slefejax.gpu.programs import _source; assert 'quads' in _source('patch.tese', {});"
        "from slefejax.experiments.cli import main; sys.exit(main(['factors', 'teapot', '--json']))"
    )
    found = subprocess.run([sys.executable, "-I", "-c", code], cwd=tmp_path, capture_output=True, text=True)
    assert found.returncode == 0, found.stderr
    assert '"sum_of_factors": 560.38' in found.stdout
    assert (site / "bin" / "slefejax").exists()


def test_version_is_that_of_the_metadata(site, tmp_path):
    wanted = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["version"]
    code = (
        f"import sys; sys.path.insert(0, {str(site)!r}); import slefejax; assert '__version__' in dir(slefejax);"
        "print(slefejax.__version__); assert 'tyro' not in sys.modules;"
        "from slefejax.experiments.cli import main; status = main(['--version']);"
        "assert 'tyro' not in sys.modules, 'it is told at once'; sys.exit(status)"
    )
    found = subprocess.run([sys.executable, "-I", "-c", code], cwd=tmp_path, capture_output=True, text=True)
    assert found.returncode == 0, found.stderr
    assert found.stdout.splitlines() == [wanted, f"slefejax {wanted}"]


SCRIPT = """
import slefejax as sj
from slefejax.gpu import Renderer

patches = sj.load("teapot").patches()
view = sj.View(sj.Camera.look_at((4.5, -6, 4), (0, 0, 1.2)), width=1440, height=900)
factors = sj.tessellation_factors(patches, view, tolerance=0.5)
seen = Renderer(patches).draw(view, factors.inner, factors.edges)
print(sj.fit_km, sj.__version__.upper())
"""


def complaints(site: Path, folder: Path, script: str) -> list[str]:
    """What a type checker says of a script that uses the installed package."""
    pyright = Path(sys.executable).with_name("pyright")
    if not pyright.exists():
        pytest.skip("pyright is not installed")
    (folder / "script.py").write_text(script)
    (folder / "pyrightconfig.json").write_text('{"reportMissingTypeStubs": "error"}')
    found = subprocess.run(
        [str(pyright), "--outputjson", "--pythonpath", sys.executable, "script.py"],
        env={**os.environ, "PYTHONPATH": str(site)},
        cwd=folder,
        capture_output=True,
        text=True,
    )
    return [entry["message"] for entry in json.loads(found.stdout)["generalDiagnostics"]]


def test_a_type_checker_knows_the_package(site, tmp_path):
    assert complaints(site, tmp_path, SCRIPT) == []


@pytest.mark.parametrize(
    ("right", "wrong", "says"),
    [
        ("tolerance=0.5", "tolerence=0.5", 'No parameter named "tolerence"'),
        ("sj.tessellation_factors", "sj.tesselation_factors", '"tesselation_factors" is not a known attribute'),
        (".draw(", ".drew(", 'Cannot access attribute "drew"'),
        ("width=1440, ", "", 'Argument missing for parameter "width"'),
    ],
)
def test_a_type_checker_sees_what_is_misspelt(site, tmp_path, right, wrong, says):
    (message,) = complaints(site, tmp_path, SCRIPT.replace(right, wrong))
    assert message.startswith(says)
