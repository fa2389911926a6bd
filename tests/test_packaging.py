"""The wheel, installed where the checkout is not."""

from __future__ import annotations

import subprocess
import sys
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


def test_only_slefejax_is_at_the_top(wheel):
    names = zipfile.ZipFile(wheel).namelist()
    assert {name.split("/")[0].split("-")[0] for name in names} == {"slefejax"}
    assert "slefejax/gpu/shaders/patch.tese" in names
    assert not [name for name in names if name.startswith("tests") or "/test_" in name or "conftest" in name]


def test_installed_command_works_outside_the_checkout(wheel, tmp_path):
    site = tmp_path / "site"
    command = [sys.executable, "-m", "pip", "install", "--quiet", "--no-deps", "--no-compile", "--target", str(site)]
    subprocess.run([*command, str(wheel)], check=True)
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
    assert '"sum_of_factors": 560.85' in found.stdout
    assert (site / "bin" / "slefejax").exists()
