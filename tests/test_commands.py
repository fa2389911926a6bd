"""What every command says of itself, and of words that it cannot use."""

from __future__ import annotations

import ast
import re

import numpy as np
import pytest
from matplotlib.colors import to_rgb

from slefejax import InputError, Mesh, convert, load
from slefejax.arguments import did_you_mean, no_such
from slefejax.errors import naming
from slefejax.experiments.bench import scaling
from slefejax.experiments.checks import stability
from slefejax.experiments.cli import main
from slefejax.experiments.commands import COMMANDS, command_of
from slefejax.experiments.moves import optimise
from slefejax.experiments.options import option_names
from slefejax.experiments.parsing import parsed
from slefejax.experiments.report import Report
from slefejax.figures.checks.stability import write_stability_figure
from slefejax.figures.page import Page
from slefejax.study.relaxing import Relaxed
from tests.meshes import disc
from tests.test_imports import modules

MARKUP = r"\[/?(bold|dim|red|cyan|green|italic)\]"
LEAKS = re.compile(MARKUP + r"|NoneType|<class|\{None\}|\bNone\b|\btuple\[|\(default: \)|__")


@pytest.fixture(autouse=True)
def in_an_empty_folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


def shown(capsys, *words):
    with pytest.raises(SystemExit) as ended:
        parsed(list(words))
    said = capsys.readouterr()
    return ended.value.code, said.out + said.err


@pytest.mark.parametrize("name", [*COMMANDS, ""])
def test_help_is_plain(capsys, name):
    status, said = shown(capsys, *[name] * bool(name), "--help")
    assert status == 0
    assert not LEAKS.search(said), LEAKS.search(said)
    if name:
        listed = set(re.findall(r"^\W*(--[a-z][a-z-]*)", said, flags=re.MULTILINE))
        own = option_names(command_of(name)) - {"scene", "scenes", "study", "first", "second"}
        assert listed == {f"--{option.replace('_', '-')}" for option in own}


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["factors", "teapot", "--eye", "1", "2", "x"], "could not convert string to float: 'x'"),
        (["factors", "teapot", "--up", "1", "2"], "Expected 3 values"),
        (["factors", "teapot", "--smooth", "None"], "could not convert string to float: 'None'"),
        (["factors", "teapot", "--steps", "1.5"], "invalid literal for int"),
        (["factors", "teapot", "--deform", "x"], "dual-quaternion"),
        (["stability", "--only"], ""),
        (["minimality", "teapot", "--scales", "a"], "could not convert string to float: 'a'"),
        (["factors"], "SCENE"),
        (["factors", "teapot", "--tolerence", "1"], "--tolerance"),
    ],
)
def test_what_cannot_be_typed_is_said_plainly(capsys, words, says):
    if words == ["stability", "--only"]:
        assert parsed(words).only == ()
        return
    status, said = shown(capsys, *words)
    assert status == 2
    assert says in said
    assert not LEAKS.search(said.replace("'None'", "")), said


def one_sentence(capsys, *words):
    assert main(list(words)) == 2
    said = capsys.readouterr()
    assert said.out == ""
    assert said.err.count("\n") == 1
    return said.err.removeprefix("slefejax: ").rstrip("\n")


NEAR = [
    (["factor", "teapot"], "there is no command 'factor' (did you mean factors?): choose one of minimality, factors"),
    (["factors", "teapott"], "there is no file teapott (did you mean teapot?)"),
    (["factors", "Teapot"], "there is no file Teapot (did you mean teapot?)"),
    (["factors", "meshh.obj"], "there is no file meshh.obj (did you mean mesh.obj?): check the name"),
    (["factors", "sub/mesh.objj"], "there is no file sub/mesh.objj (did you mean mesh.obj?), and files of this kind"),
    (["factors", "qqqq.obj"], "there is no file qqqq.obj: check the name"),
    (["factors", "teapot", "--method", "certifed"], "there is no method 'certifed' (did you mean certified?)"),
    (["factors", "walker", "--scheme", "pinch"], "walker: there is no scheme 'pinch' (did you mean pinched?)"),
    (["stability", "--only", "ofset"], "there is no family 'ofset' (did you mean offset?)"),
    (["bench", "--only", "certifed"], "there is no stage 'certifed' (did you mean certified?)"),
]


@pytest.mark.parametrize(("words", "says"), NEAR, ids=[" ".join(words) for words, _ in NEAR])
def test_the_name_that_was_meant(capsys, tmp_path, words, says):
    (tmp_path / "sub").mkdir()
    for name in ("mesh.obj", "sub/mesh.obj"):
        (tmp_path / name).write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    assert one_sentence(capsys, *words).startswith(says)


def test_near_names():
    assert did_you_mean("smil", ["smile", "brows"]) == " (did you mean smile?)"
    assert did_you_mean("", ["smile"]) == did_you_mean("x", []) == did_you_mean(None, ["smile"]) == ""
    assert no_such("joint", "x", ()) == "there is no joint 'x': there is none at all"
    many = no_such("joint", "x", [f"joint {k}" for k in range(326)])
    assert many.endswith("joint 39 and 286 more")


OPTIONS = [
    (
        ["teapot", "--drop-defects"],
        "teapot is a list of patches, no control mesh: --drop-defects has no meaning for it",
    ),
    (["bad.obj"], "or leave such faces out (--drop-defects)"),
    (["one.bpt", "--steps", "2"], "one.bpt holds no control mesh: --steps has no meaning for it"),
    (["one.bpt", "--group", "a"], "one.bpt: --group has a meaning for .obj files only"),
    (["one.bpt", "--animation", "a"], "one.bpt: --animation has a meaning for"),
    (["mesh.obj", "--weld", "1"], "mesh.obj holds a control mesh and nothing else: --weld has no meaning for it"),
    (["one.bpt", "--weld", "-1"], "--weld must be a number of at least 0, not -1.0"),
    (["mesh.obj", "--alpha", "nan"], "mesh.obj: --alpha must be a positive number, not nan"),
    (["mesh.obj", "--steps", "99"], "--steps must be a whole number from 1 to 8, not 99"),
    (["mesh.obj", "--steps", "1"], "not to 'pinched'"),
    (["teapot", "--tolerance", "0"], "--tolerance must be a positive number, not 0.0"),
    (["teapot", "--depth-tolerance", "-1"], "--depth-tolerance must be a positive number, not -1.0"),
    (["teapot", "--method", "filip", "--depth-tolerance", "1"], "method 'filip' knows no --depth-tolerance"),
    *(
        (
            ["teapot", "--normal-tolerance", angle],
            f"--normal-tolerance must be more than 0 and less than 90 degrees, not {said}",
        )
        for angle, said in (("0", "0.0"), ("-1", "-1.0"), ("200", "200.0"), ("nan", "nan"))
    ),
    (["teapot", "--normals", "tangents"], "--normals says which normals --normal-tolerance is for: give that, too"),
    (["teapot", "--normals", "tangents", "--normal-tolerance", "1"], "only those have tangent patches"),
    (["teapot", "--method", "filip", "--normal-tolerance", "1"], "method 'filip' knows no --normal-tolerance"),
    (["teapot", "--method", "slefe", "--verify"], "method 'slefe' has no --verify: its own are segments, k, smooth"),
    (["teapot", "--method", "filip", "--smooth", "0.1"], "method 'filip' has no --smooth: it has nothing to set"),
    (["teapot", "--smooth", "2"], "--smooth is a temperature of at most 1, not 2.0"),
    (["teapot", "--smooth", "0.1", "--verify"], "--smooth is of real factors: --anisotropic and --verify find"),
    (["teapot", "--setting", "1"], "method 'certified' has no --setting"),
    (["teapot", "--tiles", "-3"], "--tiles must be a whole number of at least 1, not -3"),
    (["teapot", "--method", "slefe", "--segments", "0"], "the number of --segments must be a whole number"),
    (["teapot", "--k", "nan", "--method", "slefe"], "--k must be a positive number, not nan"),
    (["teapot", "--fov", "nan"], "--fov must lie between 0 and 180 degrees, not nan"),
    (["teapot", "--near", "-1"], "--near must be positive for a perspective camera, not -1.0"),
    (["teapot", "--near", "5", "--far", "1"], "--far (1.0) must be beyond --near (5.0)"),
    (["teapot", "--far", "inf"], "the camera's --far must be finite, not inf"),
    (["teapot", "--up", "0", "0", "0"], "--up must be a direction"),
    (["teapot", "--eye", "nan", "0", "0"], "the camera's --eye must be finite"),
    (["teapot", "--cover", "0"], "--cover, a share of the screen, must lie between 0 and 1, not 0.0"),
    (["teapot", "--size", "-1x5"], "--size must be WIDTHxHEIGHT"),
    (["teapot", "--time", "nan"], "teapot does not move: --time has no meaning for it"),
]


@pytest.mark.parametrize(("words", "says"), OPTIONS, ids=[" ".join(words) for words, _ in OPTIONS])
def test_messages_spell_options_as_they_are_typed(capsys, tmp_path, words, says):
    (tmp_path / "mesh.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    (tmp_path / "bad.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\nf 1 2 3\n")
    (tmp_path / "one.bpt").write_text("1\n1 1\n0 0 0\n0 1 0\n1 0 0\n1 1 0.5\n")
    assert says in one_sentence(capsys, "factors", *words)


def test_python_spells_them_its_own_way(tmp_path):
    with pytest.raises(InputError, match=r"^drop_defects must be True or False") as raised:
        load("x.obj", drop_defects=3)
    assert raised.value.typed(()) == str(raised.value), "another command line may have no such option"
    (tmp_path / "group").mkdir()
    path = tmp_path / "group" / "group.ply"
    path.write_text("ply\n")
    with pytest.raises(InputError) as raised:
        load(path, group="a")
    assert raised.value.typed({"group"}) == f"{path}: --group has a meaning for .obj files only", "paths stay"


def test_messages_that_name_parameters_say_so():
    """Every message of the package with the name of a parameter in it, as far as it is one word with a line in it."""
    named = {own for name in COMMANDS for own in option_names(command_of(name)) if "_" in own}
    assert {"drop_defects", "depth_tolerance", "camera_path", "solver_steps"} <= named
    for path in modules().values():
        for call in ast.walk(ast.parse(path.read_text())):
            if not (isinstance(call, ast.Call) and getattr(call.func, "id", "") == "InputError" and call.args):
                continue
            words = set(re.findall(r"\w+", " ".join(literals(call.args[0])))) & named
            told = {word for keyword in call.keywords for word in literals(keyword.value)}
            assert words <= told, f"{path}: InputError(…, options={tuple(words)})"


def literals(node):
    return [own.value for own in ast.walk(node) if isinstance(own, ast.Constant) and isinstance(own.value, str)]


def test_naming_what_it_is_about():
    with pytest.raises(InputError, match=r"^a\.obj: steps are wrong$") as raised, naming("a.obj"):
        raise InputError("steps are wrong", options=("steps",))
    assert raised.value.options == ("steps",)
    with pytest.raises(InputError, match=r"^there is no file a\.obj$"), naming("a.obj"):
        raise InputError("there is no file a.obj")


def test_weights_that_cannot_agree_name_the_file(tmp_path):
    """Whatever part of loading refuses a file: its name stands in the sentence."""
    (tmp_path / "flat.bpt").write_text("1\n1 1\n0 0 0\n0 1e200 0\n1 0 0\n1 1 0.5\n")
    with pytest.raises(InputError, match=r"flat\.bpt"):
        load(tmp_path / "flat.bpt")


def test_price_of_ngons():
    mesh = disc(6)  # quads around a vertex
    pentagon = Mesh.of([[np.cos(k), np.sin(k), 0.0] for k in 2 * np.pi * np.arange(5) / 5], [range(5)])
    (note,) = convert(pentagon).notes
    assert note.startswith("1 face of more than four vertices (n-gons) among 1 made a step of subdivision")
    assert "necessary: 5 patches" in note
    assert convert(pentagon, "catmull-clark+acc").notes == (), "whoever asks for it knows"
    assert convert(mesh).notes == ()


def test_nothing_moved_is_a_sentence():
    still = Relaxed(np.zeros((3, 4, 4, 3)), np.zeros(3), np.zeros(3), np.zeros(3, bool), "")
    (said,) = optimise._stayed(still)
    assert said.startswith("none of the 3 patches was moved")
    (said,) = optimise._stayed(still._replace(moved=np.array([True, False, False])))
    assert said.startswith("2 of 3 patches stayed where they are")
    assert optimise._stayed(still._replace(moved=np.ones(3, bool))) == ()


def test_costs_that_are_not_determined_are_said():
    row = {"term": "frame", "us_each": -520.0, "standard_error_us": 800.0}
    clear = {"term": "patches", "us_each": 4.0, "standard_error_us": 0.1}
    (note,) = scaling.undetermined([row, clear])
    assert "frame -520 ± 800 µs" in note
    assert "patches" not in note
    assert scaling.undetermined([clear]) == ()


def test_cases_of_stability_are_in_order():
    for quick in (False, True):
        cells = stability.Stability(quick=quick)._cells().values()
        for family in stability.FAMILIES:
            values = [value for own, value, precision in cells if own is family and precision == "single"]
            assert values == [value for value in family.values if value in values]
            assert len(values) == (min(3, len(family.values)) if quick else len(family.values))


def test_errors_of_zero_are_drawn_and_told_as_zero(tmp_path, monkeypatch):
    rows = [
        {"family": "flat", "parameter": "height", "value": value, "precision": precision, "factor_error": error}
        | dict.fromkeys(("containment_violations", "certificate_violations", "nonfinite", "refused"), 0)
        | {"certified_over_double": 1.0}
        for value, error in ((0.3, 1e-7), (1e-5, 0.0), (1e-17, 0.0))
        for precision in ("single", "double")
    ]
    drawn = []
    monkeypatch.setattr("slefejax.figures.style.save", lambda figure, page: drawn.append(figure))
    write_stability_figure(Page(tmp_path / "x.png"), rows)
    axes = drawn[0].axes[0]
    assert axes.get_yticklabels()[0].get_text() == "0"
    lines = [line for line in axes.get_lines() if line.get_label() == "single precision"]
    assert np.isnan(np.asarray(lines[0].get_ydata(), float)[1:]).all(), "no line goes down to a zero"
    zero = [line for line in axes.get_lines() if len(line.get_xdata()) == 2 and line.get_linestyle() == "None"]
    assert len(zero) == 2
    assert all(to_rgb(line.get_markerfacecolor()) == (1, 1, 1) for line in zero)
    rows = [{"case": 1, "single_error": 0.0}, {"case": 2, "single_error": 1e-7}]
    assert re.search(r"1 +0\n +2 +1\.0e-07", Report(None, None, rows, "")._text())
