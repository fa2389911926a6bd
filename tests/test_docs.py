"""Examples in docstrings, in the README and in docs/ do what they say."""

from __future__ import annotations

import ast
import doctest
import json
import re
import shlex
import subprocess
import sys
from importlib import import_module
from pathlib import Path

import numpy as np
import pytest

from slefejax import Study
from slefejax.experiments.commands import COMMANDS as COMMAND_NAMES
from slefejax.experiments.parsing import parsed
from tests.meshes import cube
from tests.test_gltf import figure, save
from tests.test_imports import modules

ROOT = Path(__file__).resolve().parents[1]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
LANGUAGES = {"", "python", "json", "toml"}
WITH_EXAMPLES = sorted(name for name, path in modules().items() if ">>>" in path.read_text())


def test_half_of_what_is_public_has_an_example():
    """One that runs: functions and classes of the computations."""
    public = [
        ast.get_docstring(node) or ""
        for path in modules().values()
        for node in ast.parse(path.read_text()).body
        if isinstance(node, (ast.FunctionDef, ast.ClassDef)) and not node.name.startswith("_")
    ]
    assert sum(">>>" in text for text in public) >= 0.5 * len(public)


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
    assert len(whole) == 6
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
    assert [int(number) for number in shown[7].split()] == [32, 15732]


def test_every_work_that_is_cited_is_in_the_bibliography():
    page = (ROOT / "docs" / "math.md").read_text()
    known = set(re.findall(r"^- \*\*\[(\w+)\]\*\*", page, flags=re.MULTILINE))
    source = [*PAGES, *modules().values(), *(ROOT / "tests").glob("*.py")]
    for folder in ("experiments", "figures", "gpu"):
        source += (ROOT / folder).rglob("*.py")
    cited = {key for path in source for key in re.findall(r"\[([A-Z][A-Za-z]+\d\d)[],]", path.read_text())}
    assert {"YBP12", "YBP14", "LP01", "FMM86"} <= cited
    assert cited <= known
    assert len(known) > 20


def blocks(language):
    """(page and line, text) of every block of code of a language."""
    found = []
    for page in PAGES:
        text = page.read_text()
        for match in re.finditer(r"^```(\w*)\n(.*?)^```", text, flags=re.DOTALL | re.MULTILINE):
            assert match[1] in LANGUAGES, f"{page.name}: who runs blocks of {match[1]!r}?"
            if match[1] == language:
                found.append((f"{page.name}:{text.count(chr(10), 0, match.start()) + 1}", match[2]))
    return found


def commands():
    """(page and line, words) of every command that a block shows, as it is typed."""
    found = []
    for place, text in blocks(""):
        page, first = place.split(":")
        for number, line in enumerate(text.splitlines(), int(first) + 1):
            if re.match(r"(\$ )?slefejax ", line):
                found.append((f"{page}:{number}", shlex.split(line.removeprefix("$ "), comments=True)[1:]))
    return found


def mentioned():
    """(page, words) of every command that the text names, with words that can be typed: no SCENE, no a|b."""
    found = []
    for page in PAGES:
        for text in re.findall(r"`slefejax ([^`]*)`", page.read_text().replace("\n", " ")):
            found.append((page.name, shlex.split(text.replace("…", ""))))
    return found


PYTHON, COMMANDS = blocks("python"), commands()


def test_blocks_are_found():
    assert len(PYTHON) >= 8
    assert len(COMMANDS) >= 10
    for place, text in blocks(""):
        assert "import slefejax" not in text, f"{place}: call this block python, so that it is run"
    for place, text in blocks("json"):
        assert json.loads(text), place


def test_studies_of_the_docs_have_cases(tmp_path):
    for _, text in blocks("toml"):
        (tmp_path / "study.toml").write_text(text)
        assert len(list(Study.load(tmp_path / "study.toml").cases())) > 1


@pytest.mark.parametrize("place", sorted({page for page, _ in mentioned()}))
def test_commands_of_the_text_can_be_typed(place):
    """Not run, but understood: no option is misspelt or gone."""
    for _, words in (own for own in mentioned() if own[0] == place):
        assert words[0] in COMMAND_NAMES
        if len(words) > 1:
            parsed([*words, "--triangles", "100"] if words[0] == "budget" and "--triangles" not in words else words)


@pytest.mark.slow
@pytest.mark.gl
@pytest.mark.parametrize(("place", "text"), PYTHON, ids=[place for place, _ in PYTHON])
def test_python_of_the_docs(device, tmp_path, place, text):
    """Every block by itself: a process of its own, JAX as it comes, warnings as errors."""
    (tmp_path / "block.py").write_text(text)
    command = [sys.executable, "-W", "error", "block.py"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr[-3000:]


@pytest.mark.slow
@pytest.mark.gl
@pytest.mark.parametrize(("place", "words"), COMMANDS, ids=[place for place, _ in COMMANDS])
def test_commands_of_the_docs(device, tmp_path, place, words):
    """As they are typed, in a folder where the user's own files lie."""
    mesh = cube()
    lines = ["v " + " ".join(map(repr, vertex)) for vertex in mesh.vertices.tolist()]
    lines += ["vt 0 0", "vt 1 0", "vt 1 1", "vt 0 1"]
    faces = mesh.corners.reshape(-1, 4).tolist()
    lines += ["f " + " ".join(f"{corner + 1}/{k + 1}" for k, corner in enumerate(face)) for face in faces]
    (tmp_path / "spot_control_mesh.obj").write_text("\n".join(lines) + "\n")
    _, content = figure(np.random.default_rng(1))
    content["animations"][0]["name"] = "Walk"
    save(tmp_path, content, "fox.glb")
    (tmp_path / "study.toml").write_text(blocks("toml")[0][1])
    command = [sys.executable, "-m", "slefejax", *words]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr[-3000:]
    assert "Traceback" not in done.stderr
    assert done.stdout
