"""report.html: nothing is loaded, everything is text, numbers have all their digits, and it works in a browser."""

from __future__ import annotations

import json
import math
import re
import subprocess
import sys
from base64 import b64decode, b64encode
from hashlib import sha256
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from slefejax import Study
from slefejax.experiments.grid.running import Running
from slefejax.experiments.page import charts, columns, pictures
from slefejax.experiments.page.writing import write_page
from slefejax.experiments.store import Run, typed
from tests.browser import CHROMIUM, Browser
from tests.tables import SHOWN

HOSTILE = (
    "<img src=x onerror=alert(1)>",
    "</script><script>alert(1)</script>",
    "<!--<script>",
    "$$x^2$$",
    "\\(y\\)",
    "{{data}}",
)
RECORD = {
    "experiment": "minimality",
    "open_first": "minimality.png",
    "command": "slefejax minimality teapot",
    "arguments": {"scene": "teapot", "prediction": {"tolerance": 0.5, "tiles": None}},
    "time": "2026-11-29T21:00:00+00:00",
    "versions": {"python": "3.11"},
    "commit": None,
    "machine": {"cores": 2},
    "scene": "teapot",
    "notes": (),
}
METHODS = ("certified", "slefe", "filip", "edge-length")
ROWS = [
    {
        **{"scene": scene, "method": method, "tolerance_px": tolerance, "triangles": 1000 * (k + 1) // (j + 1)},
        **{"max_error_px": tolerance * (k + 1) / 3, "covered_pixels": 2925},
    }
    for scene in ("teapot", "twisted-quad")
    for j, tolerance in enumerate((0.25, 0.5, 1.0))
    for k, method in enumerate(METHODS)
]


class Tags(HTMLParser):
    """Start tags with their attributes, the text of scripts, and text that is seen."""

    def __init__(self, page: str) -> None:
        super().__init__()
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.scripts: list[str] = []
        self.seen = ""
        self.feed(page)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))
        if tag == "script":
            self.scripts.append("")

    def handle_data(self, data: str) -> None:
        if self.cdata_elem == "script":
            self.scripts[-1] += data
        else:
            self.seen += data

    @property
    def data(self) -> dict[str, Any]:
        """What the page's scripts work on."""
        (own,) = [k for k, (_, told) in enumerate(own for own in self.tags if own[0] == "script") if told.get("id")]
        return json.loads(self.scripts[own])

    def cells(self, name: str) -> list[Any]:
        """Of a column."""
        return next(own["cells"] for own in self.data["columns"] if own["name"] == name)


def written(folder: Path, rows: list[dict[str, Any]], **record: Any) -> Tags:
    """The page of a folder."""
    write_page(folder, "report.html", RECORD | record, rows, "table.csv")
    return Tags((folder / "report.html").read_text())


def picture(path: Path, colour: int = 0, size: tuple[int, int] = (40, 30)) -> None:
    Image.new("RGB", size, (colour % 256, 90, 90)).save(path)


def test_nothing_is_loaded_and_no_other_script_runs(tmp_path):
    picture(tmp_path / "minimality.png")
    page = written(tmp_path, ROWS)
    told = [
        value or "" for _, own in page.tags for key, value in own.items() if key in ("src", "href", "action", "data")
    ]
    assert not [value for value in told if not re.match(r"#|\./|data:,$", value)]
    (policy,) = [own["content"] or "" for _, own in page.tags if own.get("http-equiv") == "Content-Security-Policy"]
    rules = dict(rule.strip().split(" ", 1) for rule in policy.split(";"))
    assert rules["default-src"] == "'none'"
    assert rules["img-src"] == "data: blob:"
    hashes = {f"'sha256-{b64encode(sha256(own.encode()).digest()).decode()}'" for own in page.scripts}
    allowed = set(rules["script-src"].split())
    assert len(allowed & hashes) == len(allowed) == 3
    assert len(page.scripts) == 4, "the data, and these"
    assert "http" not in (Path(columns.__file__).parent / "parts" / "page.html").read_text().replace("http-equiv", "")
    assert page.data["groups"][0]["pictures"][0][0] == "minimality.png"


@pytest.mark.parametrize("text", HOSTILE)
def test_whatever_it_is_it_is_text(tmp_path, text):
    name = text.replace("/", "|")
    picture(tmp_path / f"{name}.png")
    plain = written(tmp_path, ROWS)
    own = {
        "scene": text,
        "notes": (text,),
        "command": text,
        "arguments": {text: text, "more": [text]},
        "modes": [{text: text}],
    }
    rows = [{"scene": text, text: 1.0}, {"scene": text, text: 2.0}]
    page = written(tmp_path, rows, **own)
    kinds = {tag for tag, _ in plain.tags} | {"li", "ul", "h3", "td", "th", "tr", "thead", "tbody", "table"}
    assert {tag for tag, _ in page.tags} <= kinds
    assert not [key for _, own in page.tags for key in own if key.startswith("on")]
    assert page.seen.count(text) >= 8
    assert page.cells("scene") == [text, text]
    assert page.cells(text) == [1.0, 2.0]
    assert len(page.scripts) == 4


def test_numbers_keep_their_digits(tmp_path, rng):
    values = [*(rng.standard_normal(300) * 10.0 ** rng.integers(-300, 300, 300)).tolist(), 0.1, 1 / 3, 5e-324, -0.0]
    rows = [{"x": value, "single": np.float32(k / 3), "whole": np.int64(k)} for k, value in enumerate(values)]
    page = written(tmp_path, rows)
    assert page.cells("x") == values
    assert page.cells("single")[:2] == [0.0, float(np.float32(1 / 3))]
    assert page.cells("whole") == list(range(len(values)))


def test_cells_that_are_no_plain_numbers(tmp_path):
    odd = [math.nan, math.inf, -math.inf, None, "", 2**53 + 1, 7, 0.5]
    rows = [
        {"number": value, "text": True, "list": [1, value], "mixed": k if k else "none"} for k, value in enumerate(odd)
    ]
    page = written(tmp_path, rows)
    assert page.cells("number") == ["NaN", "Infinity", "-Infinity", None, None, "9007199254740993", 7, 0.5]
    kinds = {own["name"]: own["kind"] for own in page.data["columns"]}
    assert kinds == {"number": "number", "text": "text", "list": "text", "mixed": "text"}
    assert page.cells("text")[0] == "true"
    assert page.cells("mixed")[:2] == ["none", "1"]


@pytest.mark.parametrize("rows", [[], ROWS[:1]], ids=["none", "one"])
def test_small_tables(tmp_path, rows):
    page = written(tmp_path, rows)
    assert page.data["rows"] == len(rows)
    assert page.data["charts"] == []
    assert f"{len(rows)} rows" in page.seen


def test_a_table_that_is_too_large_is_cut_and_said(tmp_path, monkeypatch):
    monkeypatch.setattr(columns, "MOST_CELLS", 20)
    page = written(tmp_path, ROWS)
    assert page.data["rows"] == 24
    assert page.cells("method") == [row["method"] for row in ROWS[: 20 // 6]]


SWEEP = [{"scale": scale, "triangles": 9 * scale, "share_above_0.5": 1 - scale} for scale in (0.5, 0.9)]
TEXTS = [("a", "x"), ("b", "x"), ("c", "y")]
ATTACK = [{"family": one, "setting": other, "worst_ratio": ratio} for ratio, (one, other) in enumerate(TEXTS)]
NO_NUMBERS = [{"name": "a", "time": math.nan}, {"name": "b", "time": math.inf}]


@pytest.mark.parametrize(
    ("rows", "ups", "rest"),
    [
        (ROWS, ["max_error_px", "triangles"], ("tolerance_px", "method", "scene")),
        (SWEEP, ["share_above_0.5", "triangles"], ("scale", None, None)),
        (ATTACK, ["worst_ratio"], ("family", "setting", None)),
        (NO_NUMBERS, [], ()),
    ],
    ids=["study", "sweep", "texts", "no numbers"],
)
def test_charts_that_are_shown_first(rows, ups, rest):
    own = columns.columns_of_table(rows)
    shown = charts.chosen(own, charts.cases_of(own))
    assert [one["y"] for one in shown] == ups
    assert all((one["x"], one["series"], one["panel"]) == rest for one in shown)


def test_an_axis_over_decades_is_logarithmic():
    own = columns.columns_of_table([{"scale": 1.0, "triangles": 10}, {"scale": 2.0, "triangles": 1000}])
    (chart,) = charts.chosen(own, charts.cases_of(own))
    assert (chart["logX"], chart["logY"]) == (False, True)


def test_series_have_the_looks_of_figures():
    looks = charts.looks()
    assert looks["methods"]["certified"] == ["#009e73", "star", "★"]
    shapes = [tuple(own) for own in looks["shapes"]]
    both = {(k % len(looks["colours"]), k % len(shapes)) for k in range(charts.MOST_SERIES)}
    assert len(both) == charts.MOST_SERIES, "no two series look alike"
    assert len(set(shapes)) == len(shapes) >= 8


def test_without_the_library_there_is_everything_else(tmp_path, monkeypatch):
    monkeypatch.setattr(charts, "find_spec", lambda _: None)
    page = written(tmp_path, ROWS)
    assert "There are no charts: the package that draws them is missing (pip install bokeh" in page.seen
    assert page.data["charts"] == []
    assert page.cells("method") == [row["method"] for row in ROWS]
    assert len(page.scripts) == 2


def test_pictures_in_their_order(tmp_path):
    for number in (0.5, 1, 0.75, 10):
        picture(tmp_path / f"error_scale_{number}.png", int(9 * number))
    for name in ("minimality", "enough", "look_wire", "look_error"):
        picture(tmp_path / f"{name}.png")
    (tmp_path / "broken.png").write_bytes(b"no picture")
    (tmp_path / "figure.pdf").write_bytes(b"%PDF")
    page = written(tmp_path, ROWS)
    groups = [[name for name, _ in own["pictures"]] for own in page.data["groups"]]
    assert groups[0] == ["minimality.png"]
    assert [f"error_scale_{number}.png" for number in (0.5, 0.75, 1, 10)] in groups
    assert ["look_error.png", "look_wire.png"] in groups
    assert "Figures in PDF are beside this page, not in it: figure.pdf" in page.seen
    uri = dict(page.data["groups"][0]["pictures"])["minimality.png"]
    assert b64decode(uri.partition(",")[2]) == (tmp_path / "minimality.png").read_bytes(), "as it is"


def test_pictures_have_a_limit_and_what_is_left_out_is_said(tmp_path, monkeypatch, rng):
    monkeypatch.setattr(pictures, "MOST_BYTES", 2**20)
    for number in range(40):
        noise = rng.integers(0, 256, (60, 80, 3), np.uint8).repeat(8, 0).repeat(8, 1)
        Image.fromarray(noise).save(tmp_path / f"frame_{number:04d}.png")
    picture(tmp_path / "minimality.png")
    (tmp_path / "animation.gif").write_bytes(b"GIF89a" + bytes(2**20))
    page = written(tmp_path, ROWS)
    groups = {own["title"]: [name for name, _ in own["pictures"]] for own in page.data["groups"]}
    kept = groups["frame: 40 pictures"]
    assert 2 <= len(kept) < 40
    assert kept == sorted(kept)
    assert kept[0] == "frame_0000.png"
    left = [f"frame_{number:04d}.png" for number in range(40) if f"frame_{number:04d}.png" not in kept]
    assert f"{len(left)} are left out: {', '.join(left[:4])}" in page.seen
    assert "at most 960 pixels wide and high: pictures take at most 1 MB of a page" in page.seen
    assert "animation.gif is left out: pictures take at most 1 MB of a page" in page.seen
    assert "animation" not in groups
    total = sum(len(b64decode(uri.partition(",")[2])) for own in page.data["groups"] for _, uri in own["pictures"])
    assert total <= 2**20


def test_every_run_has_its_page(tmp_path):
    with (
        typed(["sweep", "my scene", "--out", str(tmp_path / "run"), "--k", "1"]),
        Run("sweep", {"k": 1}, tmp_path / "run") as run,
    ):
        run.add({"k": 1})
        out = run.finish([{"k": 1}], {"scene": "my scene", "notes": ("of the scene",)})
    page = Tags((out / "report.html").read_text())
    assert "Again: slefejax sweep 'my scene' --k 1" in page.seen
    assert "of the scene" in page.seen
    assert json.loads((out / "run.json").read_text())["command"] == "slefejax sweep 'my scene' --k 1"
    assert {path.name for path in out.iterdir()} >= {"report.html", "run.json", "table.csv"}
    assert not [path for path in out.iterdir() if path.name.startswith(".")]
    links = {own["href"] for tag, own in page.tags if tag == "a" and (own["href"] or "").startswith("./")}
    assert links == {f"./{name}" for name in SHOWN - {"report.html"}}, "what is there when the run is finished"


def test_a_study_has_its_page(tmp_path):
    study = Study(("steep-patch",), views={"size": (48, 32)}, methods=("fixed",), measure=("domain",))
    Running(study, tmp_path / "study").rows()
    page = Tags((tmp_path / "study" / "report.html").read_text())
    assert page.cells("scene") == ["steep-patch"]
    assert "Called from Python" in page.seen
    assert "scene" in page.data["cases"]


def test_the_page_imports_neither_the_library_nor_matplotlib(tmp_path):
    code = (
        "import sys; from pathlib import Path; from slefejax.experiments.store import Run\n"
        "assert not [name for name in sys.modules if name.startswith('slefejax.experiments.page')]\n"
        f"Run('sweep', {{}}, Path({str(tmp_path / 'run')!r})).finish([{{'k': 1}}], {{}})\n"
        "assert 'slefejax.experiments.page.writing' in sys.modules\n"
        "assert not {'bokeh', 'matplotlib'} & set(sys.modules)"
    )
    subprocess.run([sys.executable, "-c", code], check=True)
    assert (tmp_path / "run" / "report.html").exists()


@pytest.fixture(scope="module")
def browser():
    if CHROMIUM is None:
        pytest.skip("there is no Chromium")
    with Browser() as own:
        yield own


def focus(browser, what):
    browser.value(f"document.querySelector({json.dumps(what)}).focus()")


def shown_column(browser, number):
    return browser.value(
        f"[...document.querySelectorAll('#table tbody tr td:nth-child({number})')].map((own) => own.textContent)"
    )


@pytest.fixture(scope="module")
def page_of_study(tmp_path_factory):
    folder = tmp_path_factory.mktemp("study")
    picture(folder / "minimality.png", size=(900, 500))
    for number in range(5):
        picture(folder / f"frame_{number}.png", 50 * number)
    written(folder, ROWS, notes=("a note",))
    return folder / "report.html"


@pytest.mark.slow
@pytest.mark.parametrize("width", [360, 800, 1440])
def test_a_browser_shows_it_at_any_width(browser, page_of_study, width):
    browser.open(page_of_study, width)
    assert browser.wrong == []
    assert [own for own in browser.asked if not own.startswith(("file:", "data:", "blob:"))] == []
    assert browser.value("document.documentElement.scrollWidth") == width, "nothing sticks out"
    assert browser.value("document.querySelectorAll('.drawn').length") == 4, "two charts of two scenes"
    assert browser.value(
        "[...document.querySelectorAll('.drawn')].every((own) => own.getBoundingClientRect().width > 200)"
    )
    points = "charts[0].views.flatMap((own) => own.model.renderers.filter((one) => one.name === 'points'))"
    data = browser.value(f"{points}.map((own) => [...own.data_source.data.y])")
    assert sorted(value for own in data for value in own) == sorted(row["max_error_px"] for row in ROWS)


@pytest.mark.slow
def test_a_keyboard_sorts_filters_and_flips(browser, page_of_study):
    browser.open(page_of_study)
    focus(browser, "#table th:nth-child(4) button")
    browser.press("Enter")
    assert browser.value("document.querySelector('#table th:nth-child(4)').getAttribute('aria-sort')") == "ascending"
    numbers = [int(text.replace(",", "")) for text in shown_column(browser, 4)]
    assert numbers == sorted(row["triangles"] for row in ROWS), "as numbers, not as texts"
    assert browser.value("document.activeElement.closest('th').cellIndex") == 3, "the focus stays"
    browser.press("Enter")
    assert [int(text.replace(",", "")) for text in shown_column(browser, 4)] == numbers[::-1]
    browser.press("Enter")
    assert shown_column(browser, 2) == [row["method"] for row in ROWS], "as it was"
    focus(browser, "#table input[type=checkbox]")
    browser.press(" ")
    assert [float(text) for text in shown_column(browser, 5)] == [row["max_error_px"] for row in ROWS], "all digits"
    focus(browser, "#table input[type=search]")
    browser.type("SLEFE")
    browser.until("document.querySelectorAll('#table tbody tr').length === 6")
    browser.settle()
    assert "6 of 24 rows" in browser.value("document.querySelector('#table [role=status]').textContent")
    assert browser.value("charts[0].rows.length") == 6, "charts show what is left"
    focus(browser, "#pictures input[type=range]")
    browser.press("ArrowRight", 2)
    assert browser.value("document.querySelector('#pictures figcaption').textContent") == "3 of 5: frame_2.png"
    first, third = (browser.value(f"content.groups.at(-1).pictures[{k}][1]") for k in (0, 2))
    assert browser.value("document.querySelector('#pictures img').src") == third != first
    browser.press("Tab")
    browser.press("Enter")
    assert browser.value("document.querySelector('#pictures figcaption').textContent") == "2 of 5: frame_1.png"
    outline = browser.value("getComputedStyle(document.activeElement).outlineStyle")
    assert outline == "solid", "where the focus is can be seen"
    assert browser.wrong == []


@pytest.mark.slow
def test_a_reader_chooses_axes_and_series(browser, page_of_study):
    browser.open(page_of_study)
    choose = (
        "(name, value) => { const own = [...document.querySelectorAll('.chart')][0].querySelectorAll('label');"
        "const select = [...own].find((one) => one.firstChild.textContent === name).querySelector('select');"
        "select.value = value; select.dispatchEvent(new Event('change')); }"
    )
    for name, value in (("across", "scene"), ("up", "triangles"), ("colour and mark", "method"), ("a panel each", "")):
        browser.value(f"({choose})({name!r}, {value!r})")
    browser.settle()
    assert browser.wrong == []
    figure = "charts[0].views[0].model"
    assert browser.value("charts[0].views.length") == 1
    assert browser.value(f"{figure}.x_range.factors") == ["teapot", "twisted-quad"]
    marks = f"{figure}.renderers.filter((own) => own.name === 'points').map((own) => own.glyph.marker.value)"
    assert sorted(browser.value(marks)) == ["circle", "square", "star", "x"], "they are told apart in grey"
    focus(browser, ".legend button")
    browser.press("Enter")
    browser.settle()
    assert browser.value("document.activeElement.getAttribute('aria-pressed')") == "false"
    assert browser.value(f"{figure}.renderers.length") == 3


@pytest.mark.slow
@pytest.mark.parametrize("text", [*HOSTILE, "名前 ünïcode", "long" * 300])
def test_a_browser_runs_nothing_that_is_text(browser, tmp_path, text):
    rows = [{"scene": text + end, "method": text, text: k, "scale": 2.0 + k} for k, end in enumerate(("", "2", "3"))]
    picture(tmp_path / f"{text[:40].replace('/', '|')}.png")
    written(tmp_path, [*rows, rows[0] | {text: math.nan, "scale": None}], scene=text, notes=(text,), command=text)
    browser.open(tmp_path / "report.html", 360)
    assert browser.wrong == []
    assert [own for own in browser.asked if not own.startswith(("file:", "data:", "blob:"))] == []
    assert browser.value("document.documentElement.scrollWidth") == 360
    assert browser.value("document.querySelector('h1').textContent") == f"minimality: {text}"
    assert shown_column(browser, 1)[0] == text
    axes = "charts[0].views[0].axis_views.map((own) => own._axis_label_view.model.type)"
    assert browser.value(axes) == ["PlainText", "PlainText"], "no formula"
    assert "1 row has no place here" in browser.value("document.querySelector('.chart p').textContent")


@pytest.mark.slow
@pytest.mark.parametrize("rows", [[], ROWS[:1]], ids=["none", "one"])
def test_a_browser_shows_small_tables(browser, tmp_path, rows):
    written(tmp_path, rows)
    browser.open(tmp_path / "report.html")
    assert browser.wrong == []
    assert browser.value("document.querySelectorAll('tbody tr').length") == len(rows)


@pytest.mark.slow
def test_what_is_no_number_has_its_place(browser, tmp_path):
    values = [math.nan, 7, math.inf, None, 2**53 + 1, 0.5, -math.inf, 1234]
    written(tmp_path, [{"case": k, "x": value} for k, value in enumerate(values)])
    browser.open(tmp_path / "report.html")
    upwards = ["-∞", "0.5", "7", "1,234", "9007199254740993", "∞"]
    for order in (upwards, upwards[::-1]):
        focus(browser, "#table th:nth-child(2) button")
        browser.press("Enter")
        assert shown_column(browser, 2) == [*order, "nan", ""], "what is missing is last"
    assert browser.value("document.querySelector('.chart p').textContent").startswith("4 rows have no place here")
    focus(browser, "#table input[type=search]")
    browser.type("1,23")
    browser.until("document.querySelectorAll('#table tbody tr').length === 1")
    assert shown_column(browser, 2) == ["1,234"], "it is found as it is shown"


@pytest.mark.slow
def test_a_hundred_thousand_rows_open_and_sort(browser, tmp_path, rng):
    values = rng.random(100_000)
    rows = [
        {"frame": k, "method": METHODS[k % 4], "max_error_px": float(own), "note": f"row {k}"}
        for k, own in enumerate(values)
    ]
    written(tmp_path, rows)
    browser.open(tmp_path / "report.html")
    assert "Rows 1 to 50; 100,000 rows" in browser.value("document.querySelector('#table [role=status]').textContent")
    assert "every 5th is drawn" in browser.value("document.querySelector('.chart p').textContent")
    focus(browser, "#table th:nth-child(3) button")
    browser.press("Enter")
    assert float(shown_column(browser, 3)[0]) == pytest.approx(values.min(), rel=1e-4)
    assert browser.wrong == []
