"""slefejax study: what a file may say, rows that are measured once, and what goes on after a stop."""

from __future__ import annotations

import csv
import json
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

import slefejax as sj
from slefejax import Camera, InputError, Study, View
from slefejax.experiments.cli import main
from slefejax.experiments.grid import running
from slefejax.experiments.grid.measured import MEASURES, TELLING
from slefejax.experiments.grid.running import Running
from slefejax.experiments.studies.measures import Measure
from slefejax.experiments.tables import Rows
from slefejax.gpu import Renderer
from slefejax.measure.error import drawn_error
from tests.test_cli import run_json

SIZE = {"size": [160, 100]}
QUICK = {"scenes": ["twisted-quad"], "views": SIZE, "measure": ["domain"]}


def lines(folder: Path):
    return [json.loads(line) for line in (folder / "rows.jsonl").read_text().splitlines()]


def write(path: Path, **content):
    """A study's file."""
    path.write_text("".join(f"{name} = {_toml(value)}\n" for name, value in content.items()))
    return path


def _toml(value):
    if isinstance(value, dict):
        return "{ " + ", ".join(f"{name} = {_toml(own)}" for name, own in value.items()) + " }"
    return "[" + ", ".join(map(_toml, value)) + "]" if isinstance(value, (list, tuple)) else json.dumps(value)


def test_every_case_once():
    """Tolerances of normals and of depth are for methods that know of them."""
    study = Study(
        scenes=("teapot", "twisted-quad"),
        views={"cameras": 3},
        tolerances_px=(0.25, 0.5),
        tolerances_deg=("none", 1.0, 2.0),
        tolerances_depth=(1e-4,),
        methods=("certified", {"name": "slefe", "segments": 4}, "filip"),
        scales=(1.0, 0.5),
    )
    cases = list(study.cases())
    assert len(cases) == len(set(cases)) == 2 * 3 * 2 * 2 * (3 + 1 + 1)
    by_rule = [{(case.degrees, case.depth) for case in cases if case.rule == k} for k in range(3)]
    assert by_rule == [{(None, 1e-4), (1.0, 1e-4), (2.0, 1e-4)}, {(None, 1e-4)}, {(None, None)}]
    first = study.columns(cases[0], "teapot")
    names = "scene scheme view method segments tolerance_px tolerance_deg tolerance_depth scale spacing"
    assert " ".join(first) == names
    assert np.isnan(first["segments"])
    assert all(name.isidentifier() for name in first)


@pytest.mark.parametrize(
    ("more", "message"),
    [
        ({"tolerence_px": [1.0]}, "no key 'tolerence_px' (did you mean tolerances_px?)"),
        ({"scenes": ["teapott"]}, "did you mean teapot?"),
        ({"scenes": []}, "scenes is empty: the study has no case"),
        ({"scenes": "teapot"}, "scenes is a list, not 'teapot'"),
        ({"scenes": [7]}, "scenes are texts, not 7"),
        ({"scenes": ["teapot", "teapot"]}, "scenes names something twice"),
        ({"tolerances_px": [0.5, -1.0]}, "tolerances_px are positive numbers, not -1.0"),
        ({"tolerances_px": ["none"]}, "tolerances_px are positive numbers, not 'none'"),
        ({"tolerances_deg": ["nome"]}, "tolerances_deg are positive numbers, not 'nome' (did you mean none?)"),
        ({"scales": [True]}, "scales are positive numbers, not True"),
        ({"methods": [{"name": "slefe", "tiles": 2}]}, "tiles"),
        ({"methods": [{"nam": "slefe"}]}, "methods are tables such as"),
        ({"methods": ["slefee"]}, "did you mean slefe?"),
        ({"methods": ["my_rules:Flat"]}, "--trust-rules allows that"),
        ({"methods": [{"name": "certified", "verify": True}], "spacings": ["fractional-odd"]}, "the spacing equal"),
        ({"spacings": ["even"]}, "no spacing 'even'"),
        ({"measure": ["pixel"]}, "no measure 'pixel' (did you mean pixels?)"),
        ({"views": {"camera": 2}}, "views: there is no key 'camera' (did you mean cameras?)"),
        ({"views": {"cameras": 0}}, "cameras"),
        ({"views": {"size": [640]}}, "size is [width, height] in pixels"),
        ({"views": "nothing.json"}, "nothing.json"),
        ({"views": 3}, "views is a table"),
    ],
)
def test_bad_files(capsys, tmp_path, more, message):
    path = write(tmp_path / "study.toml", **{**QUICK, **more})
    assert main(["study", str(path), "--out", str(tmp_path / "out")]) == 2
    said = capsys.readouterr().err
    assert message in said
    assert "Traceback" not in said
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("text", "message"),
    [("scenes = [", "is no TOML file"), ("scales = [1.0]", "names no scenes"), ("\xff", "is no TOML file")],
)
def test_files_that_are_none(tmp_path, text, message):
    path = tmp_path / "study.toml"
    path.write_bytes(text.encode("latin-1"))
    with pytest.raises(InputError, match=message):
        Study.load(path)
    with pytest.raises(InputError, match=r"nothing\.toml"):
        Study.load(tmp_path / "nothing.toml")


def test_views_of_a_file(tmp_path):
    listed = [{"eye": [0, 0, 5], "target": [0, 0, 0], "up": [0, 1, 0], "fov_y": 30, "size": [64, 48]}]
    listed += [{"eye": [0, 0, 5], "target": [0, 0, 0], "up": [0, 1, 0], "height": 4, "size": [64, 48], "far": 9}]
    (tmp_path / "views.json").write_text(json.dumps(listed))
    (one, other) = Study(**{**QUICK, "views": "views.json"}, folder=tmp_path).views.around(None)
    assert (one.width, one.camera.perspective, float(one.camera.extent)) == (64, True, 30.0)
    assert (other.camera.perspective, float(other.camera.far)) == (False, 9.0)
    for bad, message in [
        ({"eye": [0, 0, 5]}, "view 0 of views.json has no target"),
        ({**listed[0], "height": 2}, "one of them"),
        ({**listed[0], "fov": 2}, "did you mean fov_y"),
        ({**listed[0], "eye": [0, 0, 0]}, "view 0 of views.json"),
        ("teapot", "must be an object"),
    ]:
        (tmp_path / "views.json").write_text(json.dumps([bad]))
        with pytest.raises(InputError, match=message):
            Study(**{**QUICK, "views": "views.json"}, folder=tmp_path)


def test_rows_say_what_the_functions_say(tmp_path):
    """Of the same view, without anything that studies share."""
    views = [{"eye": [4.5, -6, 4], "target": [0, 0, 1.2], "fov_y": 30, "size": [160, 100]}]
    (tmp_path / "views.json").write_text(json.dumps(views))
    study = Study(
        ("teapot",),
        "views.json",
        methods=({"name": "slefe", "segments": 2},),
        scales=(1.0, 0.5),
        measure=("pixels", "domain", "drawn", "minimal"),
        folder=tmp_path,
    )
    rows = study.run(tmp_path / "out")
    patches = sj.load("teapot").patches()
    view = View(Camera.look_at((4.5, -6.0, 4.0), (0.0, 0.0, 1.2), fov_y=30.0), 160, 100)
    factors = sj.tessellation_factors(patches, view, "slefe", segments=2)
    minimal = sj.minimal_factors(patches, view)
    renderer = Renderer(patches)
    for row in rows:
        own = factors.scaled(row["scale"])
        error = drawn_error(patches, view, renderer.draw(view, own.inner, own.edges))
        assert row["max_error_px"] == pytest.approx(np.nanmax(error), rel=1e-12)
        assert row["sup_error_px"] == pytest.approx(sj.sampled_error(patches, own.levels, view).max(), rel=1e-12)
        assert row["minimal_triangles"] == 2 * np.sum(minimal**2)
        assert row["drawn_sup_error_px"] >= row["max_error_px"] - 1e-3
    assert [row["scale"] for row in rows] == [1.0, 0.5]
    assert rows[0]["max_error_px"] < rows[1]["max_error_px"]


def test_what_is_added_is_measured_alone(tmp_path):
    folder = tmp_path / "out"
    first = Study(**QUICK).run(folder)
    assert len(lines(folder)) == len(first) == 1
    again = Study(**QUICK, tolerances_px=(0.5, 0.25)).run(folder)
    assert len(lines(folder)) == 2
    assert again[0] == first[0]
    more = Study(**{**QUICK, "measure": ["domain", "minimal"]}, tolerances_px=(0.25, 0.5)).run(folder)
    added = lines(folder)[2:]
    assert len(added) == 2
    assert not any("sup_error_px" in row for row in added)
    assert [row["sup_error_px"] for row in more] == [again[1]["sup_error_px"], again[0]["sup_error_px"]]
    assert all(row["minimal_triangles"] > 0 for row in more)
    with (folder / "table.csv").open() as file:
        assert [row["tolerance_px"] for row in csv.DictReader(file)] == ["0.25", "0.5"]
    assert json.loads((folder / "run.json").read_text())["experiment"] == "study"


def test_it_goes_on_where_it_was(tmp_path, monkeypatch):
    """Stopped in a row, with half a line of it written."""
    study, folder = Study(**QUICK, tolerances_px=(0.125, 0.25, 0.5, 1.0)), tmp_path / "out"
    own, measured = MEASURES["domain"], []

    def counted(look):
        if len(measured) == 2:
            raise KeyboardInterrupt
        measured.append(look)
        return own(look)

    monkeypatch.setitem(MEASURES, "domain", Measure(own.columns, counted))
    with pytest.raises(KeyboardInterrupt):
        study.run(folder)
    with (folder / "rows.jsonl").open("a") as file:
        file.write(json.dumps(lines(folder)[0])[:40])
    measured.append("no stop any more")
    rows = study.run(folder)
    assert len(rows) == 4
    assert len(measured) == 3 + 2
    kept = Rows(folder / "rows.jsonl")()
    assert len({row["case"] for row in kept}) == len(kept) == 4


def test_rows_of_another_version_are_made_again(tmp_path, monkeypatch):
    folder = tmp_path / "out"
    Study(**QUICK).run(folder)
    monkeypatch.setattr(running, "commit", lambda: "another")
    own = Running(Study(**QUICK), folder)
    assert own.table() == []
    own.rows()
    assert len(lines(folder)) == 2
    assert any("another version" in note for note in own.notes)


def test_what_a_method_refuses_is_a_row(tmp_path):
    """A level that no tessellator has, in the middle of a study."""
    methods = ({"name": "fixed", "setting": 1e7}, {"name": "fixed", "setting": 4.0})
    own = Running(Study(**QUICK, methods=methods), tmp_path / "out")
    refused, fine = own.rows()
    assert "scene 'twisted-quad'" in refused["refused"]
    assert np.isnan(refused["sup_error_px"])
    assert fine["refused"] == ""
    assert fine["sup_error_px"] > 0
    assert "1 of 2 cases were refused" in own.notes[0]


def test_a_terminal_shows_what_was_measured(tmp_path, capsys, monkeypatch):
    """Columns in which no two cases differ are in the table on disk alone."""
    monkeypatch.setenv("COLUMNS", "80")
    measure = ["domain", "minimal"]
    path = write(tmp_path / "study.toml", **{**QUICK, "measure": measure}, tolerances_px=[0.5, 1.0])
    assert main(["study", str(path), "--out", str(tmp_path / "out")]) == 0
    said = capsys.readouterr().out
    heads = next(line for line in said.splitlines() if "sup px" in line)
    assert "/ minimal" in heads
    assert "view" not in heads
    assert set(TELLING) == set(MEASURES)
    assert all(TELLING[name] in MEASURES[name].columns for name in MEASURES)


def test_two_studies_are_compared_case_by_case(tmp_path, capsys):
    """By settings and tolerances too, which no other table has."""
    study = {**QUICK, "tolerances_px": (0.5, 1.0), "methods": ({"name": "certified", "tiles": 1}, "certified")}
    Study(**study).run(tmp_path / "one")
    Study(**study).run(tmp_path / "other")
    assert main(["compare", str(tmp_path / "one"), str(tmp_path / "other")]) == 0
    Study(**{**study, "tolerances_px": (0.5, 2.0)}).run(tmp_path / "third")
    capsys.readouterr()
    assert main(["compare", str(tmp_path / "one"), str(tmp_path / "third"), "--json"]) == 1
    found = json.loads(capsys.readouterr().out)
    assert found["rows"] == []
    assert (len(found["only_in_first"]), len(found["only_in_second"])) == (2, 2)


def test_rows_of_something_else_are_refused(tmp_path):
    """As a stopped run of another command leaves them."""
    (tmp_path / "rows.jsonl").write_text('{"scale": 1.0, "triangles": 20207}\n')
    with pytest.raises(InputError, match="has rows that are no study's"):
        Study(**QUICK).run(tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["rows.jsonl"]


def test_a_folder_of_something_else_is_refused(tmp_path):
    folder = tmp_path / "out"
    Study(**QUICK).run(folder)
    with pytest.raises(InputError, match="holds another study"):
        Study(**{**QUICK, "scenes": ["steep-patch"]}).run(folder)
    (tmp_path / "notes").mkdir()
    (tmp_path / "notes" / "letter.txt").write_text("dear")
    with pytest.raises(InputError, match="no study's folder"):
        Study(**QUICK).run(tmp_path / "notes")
    assert (tmp_path / "notes" / "letter.txt").read_text() == "dear"


def test_a_rule_of_ones_own(tmp_path, monkeypatch, capsys):
    (tmp_path / "grid_rules.py").write_text("from tests.test_methods import EverySo as Mine\n")
    monkeypatch.chdir(tmp_path)
    path = write(
        tmp_path / "study.toml",
        **QUICK,
        methods=[{"name": "grid_rules:Mine", "pixels": pixels} for pixels in (5.0, 20.0)],
    )
    result = run_json(capsys, "study", str(path), "--trust-rules", "--out", str(tmp_path / "out"))
    fine, coarse = result["rows"]
    assert (fine["method"], fine["pixels"], coarse["pixels"]) == ("EverySo", 5.0, 20.0)
    assert fine["triangles"] > coarse["triangles"]


def test_how_long_it_will_take(tmp_path, capsys):
    path = write(tmp_path / "study.toml", **QUICK, tolerances_px=[0.5])
    arguments = ("study", str(path), "--out", str(tmp_path / "out"))
    (row,) = run_json(capsys, *arguments, "--dry-run")["rows"]
    assert (row["cases"], row["left"], row["minutes"]) == (1, 1, None)
    assert not (tmp_path / "out").exists()
    run_json(capsys, *arguments)
    write(path, **QUICK, tolerances_px=[0.5, 1.0, 2.0])
    (row,) = run_json(capsys, *arguments, "--dry-run")["rows"]
    assert (row["cases"], row["left"]) == (3, 2)
    assert 0 < row["minutes"] < 10


@pytest.mark.slow
def test_every_measure_of_patches_and_meshes(tmp_path):
    study = Study(
        ("teapot", "walker"),
        SIZE,
        tolerances_deg=(2.0,),
        methods=("certified",),
        spacings=("equal", "fractional-odd"),
        measure=tuple(MEASURES),
    )
    teapot, odd, walker, _ = study.run(tmp_path / "out")
    assert teapot["max_error_px"] <= 0.5
    assert teapot["max_normal_error_deg"] <= 2.0
    assert odd["triangles"] != teapot["triangles"]
    assert np.isnan(teapot["limit_max_px"])
    assert walker["limit_max_px"] > 0
    assert all(row["render_ms"] > 0 and row["machine"] for row in (teapot, walker))


@pytest.mark.slow
@pytest.mark.parametrize("kind", [signal.SIGINT, signal.SIGTERM, signal.SIGKILL])
def test_killed_again_and_again(tmp_path, kind):
    """As soon as there is one row more; no row is lost, none is there twice."""
    path = write(tmp_path / "study.toml", **QUICK, tolerances_px=[0.5 * 1.25**k for k in range(6)])
    folder = tmp_path / "out"
    command = [sys.executable, "-m", "slefejax", "study", str(path), "--out", str(folder)]
    kept = Rows(folder / "rows.jsonl")
    for _ in range(3):
        before = len(kept())
        with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as running:
            while running.poll() is None and len(kept()) == before:
                time.sleep(0.02)
            running.send_signal(kind)
        assert len(kept()) > before
    assert subprocess.run(command, capture_output=True, check=False).returncode == 0
    assert len({row["case"] for row in kept()}) == len(kept()) == 6
