"""Examples in docstrings and in the README do what they say."""

from __future__ import annotations

import doctest
import re
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
def test_scripts_of_the_readme(device, capsys):
    scripts = re.findall(r"```python\n(.*?)```", (ROOT / "README.md").read_text(), flags=re.DOTALL)
    whole = [script for script in scripts if script.startswith("import")]
    assert len(whole) == 5
    for script in whole:
        exec(compile(script, "README.md", "exec"), {})
    shown = capsys.readouterr().out.split("\n")
    assert round(float(shown[0].split()[0])) == 561
    assert int(shown[0].split()[1]) == 0, "no pixel is off by more than was asked for"
    assert shown[1].startswith("[0.25 0.25 0.25] 12")
    assert [line.partition("(")[2] for line in shown[2:5]] == ["'pose', 'view')", ")", "'pose', 'view')"]
    assert shown[5].startswith("(32, 4, 4, 3) 99")
    assert shown[6].startswith("20178 15994 0.499")
