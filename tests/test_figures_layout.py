"""Figures can be read: no letters over letters or off the page, no legend over data, in any format."""

from __future__ import annotations

import ast
import json
import re
from itertools import combinations
from pathlib import Path

import numpy as np
import pytest
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from PIL import Image
from skimage.color import rgb2lab

import slefejax
from slefejax.errors import InputError
from slefejax.experiments.contact_sheets import OF_A_SCENE, OF_NONE, words
from slefejax.experiments.parsing import parsed
from slefejax.experiments.report import Report
from slefejax.experiments.store import Run, open_first
from slefejax.figures import style
from slefejax.figures.bench.bench import write_growth
from slefejax.figures.bench.scaling import write_scaling
from slefejax.figures.error_image import error_colours, read_error_image, write_error_image
from slefejax.figures.fitting import log_ticks, plain, wrapped
from slefejax.figures.looks.film import read_strip, write_film, write_frames, write_strip
from slefejax.figures.looks.panels import Heading
from slefejax.figures.moves.budget import write_budget
from slefejax.figures.page import Page
from slefejax.figures.studies.enough import told_apart, write_enough
from slefejax.figures.studies.error_time import write_pixels_against_triangles
from slefejax.figures.style import ERROR_CLASSES, beside, drawing, legend_below
from tests.layout import faults

FIGURES = Path(style.__file__).parent
LONG = "a_scene_whose_name_has_been_given_by_somebody_who_likes_names_that_say_everything_" * 2


@pytest.fixture
def seen(monkeypatch) -> list[tuple[str, list[str]]]:
    """Name and faults of every figure that is written."""
    found: list[tuple[str, list[str]]] = []
    save = style.save

    def look(figure: Figure, page: Page) -> None:
        found.append((page.path.name, faults(figure)))
        save(figure, page)

    monkeypatch.setattr(style, "save", look)
    return found


def test_the_checker_finds_planted_faults():
    figure = Figure(figsize=(6, 4))
    axes = figure.subplots()
    axes.plot(np.linspace(0, 1, 9), label="a line")
    assert faults(figure) == []
    legend = axes.legend(loc="lower right")
    axes.plot([0, 8], [0, 0.05])
    assert any("a legend lies over the line" in fault for fault in faults(figure))
    legend.remove()
    axes.text(2, 0.8, "one")
    axes.text(2, 0.82, "another")
    assert faults(figure) == ["'another' and 'one' overlap"]
    axes.texts[-1].set_rotation(90)
    axes.texts[-1].set_position((1.5, 0.8))
    assert faults(figure) == []
    axes.text(-4, 0.5, "outside")
    assert faults(figure) == ["'outside' is not all on the page"]


def hostile_bench() -> list[dict]:
    stages = [f"stage number {k}" for k in range(12)]
    return [
        {
            **{"stage": stage, "cores": 1, "precision": "single", "count": count, "peer": "NumPy", "peer_ms": 9.0 + k},
            **{"median_ms": 3.0 + 0.1 * k, "low_ms": 2.9 + 0.1 * k, "high_ms": 3.3 + 0.1 * k},
        }
        for k, stage in enumerate(stages)
        for count in (310, 490)
    ]


def test_growth_has_a_look_for_each_stage_and_few_ticks(tmp_path, seen, monkeypatch):
    drawn = []
    monkeypatch.setattr(style, "finish", lambda figure, part: (drawn.append(part), FINISH(figure, part)))
    write_growth(Page(tmp_path / "x.png", "caption " * 60), hostile_bench())
    assert seen == [("x.png", [])]
    axes = drawn[0].axes[0]
    looks = [(line.get_color(), line.get_marker()) for line in axes.lines if line.get_linestyle() == "-"]
    assert len(set(looks)) == 12
    assert 2 <= len([label for label in axes.get_xticklabels() if label.get_text()]) <= 7


FINISH = style.finish


def test_crowded_curves_keep_letters_apart(tmp_path, seen):
    close = [
        {"budget": 1000 + k, "triangles": 998 + k, "tolerance_px": 0.5 - 1e-4 * k, "sup_error_px": 0.49}
        for k in range(4)
    ]
    curve = np.geomspace(0.3, 0.7, 9), np.geomspace(1400, 800, 9)
    write_budget(Page(tmp_path / "budget.svg", "caption"), close, curve, "tolerance", LONG)
    assert seen == [("budget.svg", [])]
    assert (tmp_path / "budget.svg").read_text().count("<text") > 10, "letters stay letters"


@pytest.mark.slow
def test_crowded_points_and_panels_keep_letters_apart(tmp_path, seen):
    names = [
        "certified",
        "slefe m=3",
        "slefe m=4",
        "filip",
        "edge-length 8",
        "edge-length 9",
        "screen-box 1",
        "fixed 16",
    ]
    rows = [
        {
            **{"scene": LONG, "method_name": name, "triangles": 1000 + 5 * k, "minimal_triangles": 1000},
            "share_above_0.5": 1e-5 * k,
        }
        for k, name in enumerate(names)
    ]
    write_pixels_against_triangles(Page(tmp_path / "pixels.pdf", "caption"), rows, 0.5)
    measured = [
        {"render_ms": 1.0 + k, "patches": 1_000_000 + k, "triangles": 20_000_000 * k, "shaded_pixels": 1_200_000}
        for k in range(5)
    ]
    terms = ("frame", "patches", "triangles", "shaded_pixels")
    cost = [{"term": term, "us_each": 1e-3, "standard_error_us": 1e-5} for term in terms]
    write_scaling(Page(tmp_path / "scaling.png", "caption"), measured, cost, 0.99, "some renderer " * 9, LONG)
    assert seen == [("pixels.pdf", []), ("scaling.png", [])]
    assert (tmp_path / "pixels.pdf").read_bytes().startswith(b"%PDF")


def test_labels_without_a_free_place_are_left_out(tmp_path, seen):
    with drawing(Page(tmp_path / "x.png"), 4, 3, "many") as part:
        axes = part.subplots()
        axes.plot([0, 1, 0.5], [0, 1, 0.5], "o", label="a mark")
        for k in range(40):
            beside(axes, (0.5, 0.5), f"label {k}")
        legend_below(part)
    shown = [text for text in axes.texts if text.get_visible()]
    assert 5 < len(shown) < 40
    assert seen == [("x.png", [])]


def films(folder: Path, height: int = 60, width: int = 90) -> tuple[list[Path], np.ndarray]:
    """Strips of two frames: a block that moves, grey, and in the colours of the classes; and where it is."""
    there, strips = np.zeros((2, height, width), bool), []
    there[0, 10:50, 20:40] = there[1, 10:50, 30:60] = True
    classes = error_colours(np.tile(np.array([[0.05, 0.3], [0.7, 3.0]]), (height // 2, width // 2))) / 255
    for number, own in enumerate(there[..., None]):
        strips.append(folder / f"strip_{number}.png")
        write_strip(strips[-1], [np.where(own, 0.2, np.ones(3)), np.where(own, classes, 1.0)])
    return strips, there


def test_frames_of_a_film(tmp_path, seen):
    """Cut alike, with every colour as it is; the film is as long as they are many."""
    strips, there = films(tmp_path)
    grey, classes = read_strip(strips[1], 2)
    assert np.array_equal(np.any(grey != 1.0, axis=2), there[1])
    assert len(np.unique(classes[there[1]], axis=0)) == 4
    pages = [Page(tmp_path / f"frame_{k}.png", "caption " * 9) for k in range(2)]
    headings = [Heading(LONG, f"frame {k}", "every pixel " * (1 + 9 * k)) for k in range(2)]
    write_frames(pages, headings, strips, {"shaded": False, "error": True})
    assert [fault for _, found in seen for fault in found] == []
    write_film(tmp_path / "film.gif", pages, 0.25)
    with Image.open(tmp_path / "film.gif") as film:
        assert getattr(film, "n_frames", 1) == 2
        assert film.info["duration"] == 250
        film.seek(1)
        colours = {colour for _, colour in film.convert("RGB").getcolors(1 << 16) or ()}
    wanted = {tuple(round(255 * part) for part in to_rgb(colour)) for _, colour, _ in ERROR_CLASSES}
    assert wanted | {(255, 255, 255)} <= colours
    with Image.open(pages[0].path) as one, Image.open(pages[1].path) as other:
        assert one.width == other.width


def test_wide_frames_become_smaller(tmp_path, seen):
    strips, _ = films(tmp_path, 60, 2400)
    there = np.zeros((60, 2400), bool)
    there[20:40, 100:2300] = True
    write_strip(strips[0], 2 * [np.where(there[..., None], 0.2, np.ones(3))])
    page = Page(tmp_path / "frame.png")
    write_frames([page], [Heading("one", "wide", "as it is")], strips[:1], {"a": False, "b": False})
    with Image.open(page.path) as picture:
        assert 1400 < picture.width < 1800, "a third of 2 x 2,224, and what stands around"
    assert seen == [("frame.png", [])]


@pytest.mark.parametrize("size", [(40, 60), (300, 480)])
def test_too_few_enough_and_more(tmp_path, seen, size):
    rows = [
        {"scale": scale, "triangles": triangles, "max_error_px": error}
        for scale, triangles, error in ((1.0, 1_020_207, 0.46), (0.25, 990_710, 16.4), (2.0, 47_131_000, 0.113))
    ]
    told = told_apart(rows, 0.5)
    assert [(row["scale"], word) for row, word in told] == [
        *((0.25, "too few"), (1.0, "enough"), (2.0, "more than enough"))
    ]
    error = np.linspace(0, 2, size[0] * size[1]).reshape(size)
    images = [tmp_path / f"error_{k}.png" for k in range(3)]
    for image in images:
        write_error_image(image, error, "title")
    wires = [np.full((*size, 3), 0.5)] * 3
    write_enough(Page(tmp_path / "enough.png", "caption"), told, wires, images, Heading(LONG, "how many?", "as it is"))
    assert seen == [("enough.png", [])]
    assert [word for _, word in told_apart(rows[1:2], 0.5)] == ["too few"]
    assert [word for _, word in told_apart(rows[:1], 0.5)] == ["enough"]


@pytest.mark.parametrize(
    ("low", "high", "least", "most"),
    [(300, 450, 3, 8), (1.0, 1.05, 3, 8), (0.2, 30, 3, 9), (1e-9, 1e4, 3, 9), (7, 40, 2, 9)],
)
def test_ticks_of_logarithmic_axes(low, high, least, most):
    axes = Figure().subplots()
    axes.set(xscale="log", xlim=(low, high))
    log_ticks(axes.xaxis, low, high)
    ticks = [tick for tick in axes.get_xticks() if low <= tick <= high]
    assert least <= len(ticks) <= most
    assert len({plain(tick) for tick in ticks}) == len(ticks), "no two look alike"


def test_numbers_and_lines_as_they_are_written():
    assert [plain(x) for x in (0.0, 0.01, 3.0, 2500.0, 20000.0, 2e7, 1e-9)] == [
        *("0", "0.01", "3", "2,500", "20,000", "$2\\cdot10^{7}$", "$10^{-9}$")
    ]
    lines = wrapped(f"short words and {LONG}", 200.0, 12).split("\n")
    assert len(lines) > 3
    assert "".join(lines).replace(" ", "") == f"shortwordsand{LONG}"


def test_lines_keep_sizes_and_units_together():
    """Whatever the room: no line begins with a unit, or in the middle of a size."""
    text = "at 0.5 px and 3 degrees, 20 x 15 pixels, of 5 patterns"
    for room in range(110, 320, 10):
        lines = wrapped(text, room, 12).split("\n")
        assert " ".join(lines) == text
        assert not any(line.startswith(("px", "degrees", "x", "15", "pixels")) for line in lines), lines
    assert wrapped(text, 110, 12).count("\n") == 3
    assert wrapped(text, 60, 12).split("\n")[-4:] == ["20 x 15", "pixels, of", "5", "patterns"], "rather than letters"


# Machado, Oliveira, Fernandes, IEEE TVCG 15 (6), 2009, of the severest kind; for linear RGB
VISIONS = {
    "normal": np.eye(3),
    "protan": [[0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216], [-0.003882, -0.048116, 1.051998]],
    "deutan": [[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413], [-0.011820, 0.042940, 0.968881]],
    "tritan": [[1.255528, -0.076749, -0.178779], [-0.078411, 0.930809, 0.147602], [0.004733, 0.691367, 0.303900]],
}


@pytest.mark.parametrize("vision", VISIONS)
def test_error_colours_can_be_told_apart(vision):
    """By whoever sees colours so, and in grey: lightness falls from class to class."""
    colours = np.array([to_rgb(colour) for _, colour, _ in ERROR_CLASSES])
    linear = np.where(colours <= 0.04045, colours / 12.92, ((colours + 0.055) / 1.055) ** 2.4)
    as_seen = np.clip(linear @ np.transpose(VISIONS[vision]), 0.0, 1.0)
    lab = rgb2lab(np.where(as_seen <= 0.0031308, 12.92 * as_seen, 1.055 * as_seen ** (1 / 2.4) - 0.055)[None])[0]
    apart = [float(np.linalg.norm(one - other)) for one, other in combinations(lab, 2)]
    assert min(apart) > 20, "twice what is told apart in small areas"
    assert np.all(np.diff(lab[:, 0]) < -8)


def test_colours_and_letters_are_set_in_one_place():
    """The style, and the plain colours of series that it and pages take."""
    for path in FIGURES.rglob("*.py"):
        if path.name in ("style.py", "colours.py"):
            continue
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Constant) and isinstance(node.value, str):
                assert not re.fullmatch(r"#[0-9a-fA-F]{6,8}|0?\.\d+|black|white|red|gr[ae]y", node.value), path
            if isinstance(node, ast.keyword) and node.arg in ("fontsize", "size", "ms_font", "weight_size"):
                assert not isinstance(node.value, ast.Constant), (path, node.arg)


def test_error_images_say_what_they_show_and_keep_their_pixels(tmp_path):
    error = np.linspace(0, 2, 180 * 120).reshape(120, 180)
    error[:20] = np.nan
    write_error_image(tmp_path / "error.png", error, f"{LONG} at some tolerance")
    assert np.array_equal(np.round(255 * read_error_image(tmp_path / "error.png")), error_colours(error))
    with Image.open(tmp_path / "error.png") as page:
        assert page.height > 120 + 60
        strip = np.asarray(page.convert("L"))
    assert strip[:, [0, -1]].min() == 255, "letters end before the page does"
    assert (strip[:20] < 128).any()


def test_formats_and_names_of_figures(tmp_path, capsys):
    command = parsed(["tightness", "--curves", "3", "--format", "svg"])
    with Run("tightness", {}, tmp_path / "run", {}, command.output.pages(command)) as run:
        for name in ("most", "more"):
            with drawing(run.figure(name), 4, 2, "a figure"):
                pass
        out = run.finish([{"x": 1}], {})
    assert Report(None, out, [], "")._text().splitlines()[-1] == f"Results are in {out}: open most.svg first"
    assert json.loads((out / "run.json").read_text())["open_first"] == "most.svg"
    assert f"slefejax {slefejax.__version__}: tightness --curves 3<" in (out / "more.svg").read_text()
    with Run("some", {}, tmp_path / "other") as run:
        assert open_first(run.finish([{"x": 1}], {})).name == "report.html"
    with pytest.raises(SystemExit):
        parsed(["tightness", "--format", "jpg"])
    said = capsys.readouterr().err
    assert "--format" in said
    assert "png" in said
    with pytest.raises(ValueError, match="png, pdf, svg"):
        Page(Path("x.jpg"))


@pytest.mark.gl
@pytest.mark.slow
@pytest.mark.parametrize("size", ["360x240", "1440x900"])
@pytest.mark.parametrize("scene", ["teapot", "walker", "spot_control_mesh.obj", "monsterfrog.obj"])
@pytest.mark.parametrize("command", OF_A_SCENE)
def test_figures_of_scenes(command, scene, size, device, models, seen, tmp_path):
    place = str(models / scene) if scene.endswith(".obj") else scene
    try:
        parsed([*words(command, place, size), "--out", str(tmp_path / "run")]).run()
    except InputError as refused:
        pytest.skip(str(refused))
    assert seen
    assert [fault for name, found in seen for fault in found] == []


@pytest.mark.gl
@pytest.mark.slow
@pytest.mark.parametrize("command", OF_NONE)
def test_figures_of_no_scene(command, device, seen, tmp_path):
    parsed([command, *OF_NONE[command], "--out", str(tmp_path / "run")]).run()
    assert seen
    assert [fault for name, found in seen for fault in found] == []
