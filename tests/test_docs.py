"""Examples in docstrings and in the README do what they say."""

from __future__ import annotations

import doctest
import json
import re
import subprocess
import sys
from importlib import import_module
from pathlib import Path

import pytest

from tests.test_imports import modules

ROOT = Path(__file__).resolve().parents[1]
WITH_EXAMPLES = sorted(name for name, path in modules().items() if ">>>" in path.read_text())


@pytest.mark.parametrize("name", WITH_EXAMPLES)
def test_examples_of_a_module(name):
    failed, tried = doctest.testmod(import_module(name.removesuffix(".__init__")), verbose=False)
    assert tried > 0
    assert failed == 0


@pytest.mark.gl
def test_scripts_of_the_readme(device, tmp_path):
    """As they are typed: in a fresh process, with JAX as it comes, warnings as errors."""
    scripts = re.findall(r"```python\n(.*?)```", (ROOT / "README.md").read_text(), flags=re.DOTALL)
    whole = [script for script in scripts if script.startswith("import")]
    assert len(whole) == 5
    (tmp_path / "scripts.json").write_text(json.dumps(whole))
    run = "import json\nfor text in json.load(open('scripts.json')): exec(compile(text, 'README.md', 'exec'), {})"
    command = [sys.executable, "-W", "error", "-c", run]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr[-3000:]
    shown = done.stdout.split("\n")
    assert round(float(shown[0].split()[0])) == 561
    assert int(shown[0].split()[1]) == 0, "no pixel is off by more than was asked for"
    assert shown[1].startswith("[0.25 0.25 0.25] 12")
    assert [line.partition("(")[2] for line in shown[2:5]] == ["'pose', 'view')", ")", "'pose', 'view')"]
    assert shown[5].startswith("(32, 4, 4, 3) ")
    assert 9_900 <= int(shown[5].split()[4]) <= 10_000, "of a budget of 10,000"
    assert shown[6].startswith("20178 15994 0.499")
