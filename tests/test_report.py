"""What a command shows: tables that fit the terminal, and what is under way."""

from __future__ import annotations

import io
import os
import pty
import re
import subprocess
import sys
import time

import pytest
from rich.cells import cell_len

from slefejax.experiments import report
from slefejax.experiments.report import Report, progress
from slefejax.experiments.store import Run
from slefejax.experiments.terminal import MOST_ROWS, fitted

NAMES = ("scale", "method", "patches", "triangles", "share_above_0.5", "max_error_px", "max_slip_px", "render_ms")
WIDE = (*NAMES, *(f"another_measure_number_{k}" for k in range(30)))


def rows(count=3, names=WIDE, **others):
    found = []
    for k in range(count):
        own = {name: (k + 1) * 1234.5 for name in names}
        kinds = {"method": "certified", "patches": 32, "share_above_0.5": 0.25 / (k + 1)}
        found.append(own | {name: value for name, value in kinds.items() if name in names} | others)
    return found


def lines(text):
    """Those of the table, which stand between two empty lines."""
    return text.split("\n\n")[1].split("\n")


@pytest.fixture
def finished(tmp_path):
    """The folder of a run with these rows."""
    with Run("some", {}, tmp_path / "out") as run:
        return run.finish(rows(), {})


@pytest.mark.parametrize("width", [80, 120, 200])
def test_a_wide_table_fits(monkeypatch, finished, width):
    monkeypatch.setenv("COLUMNS", str(width))
    text = Report(None, finished, rows(), "scene: 32 patches")._text()
    assert max(map(cell_len, text.splitlines()[:-1])) <= width
    assert max(map(cell_len, lines(text))) > 0.8 * width, "the width that is there is used"
    assert lines(text)[-1].split()[0] == "3703.5", "the column that says which case it is stays"
    assert "25.00 %" in text
    (elsewhere,) = [line for line in text.splitlines() if line.startswith("Only in table.csv: ")]
    assert re.search(r": slip px, .*another measure number \d+ and \d+ more$", elsewhere)


def test_no_heading_is_broken(monkeypatch, finished):
    monkeypatch.setenv("COLUMNS", "80")
    table = lines(Report(None, finished, rows(), "")._text())
    rule = next(k for k, line in enumerate(table) if "──" in line)
    whole = {word for name in ("scale", "triangles", "> 0.5 px", "largest px", *WIDE[8:]) for word in name.split()}
    words = {word for name in whole for word in name.split("_")}
    assert {word for line in table[:rule] for word in line.split()} <= words


def test_where_there_is_room_everything_is_shown(monkeypatch, finished):
    monkeypatch.setenv("COLUMNS", "200")
    text = Report(None, finished, rows(names=NAMES), "")._text()
    assert "Only in" not in text
    assert lines(text)[0].split("   ")[1:] == ["scale", "triangles", "> 0.5 px", "largest px", " slip px", "render ms"]


def test_what_is_the_same_in_every_row_stands_in_the_title():
    text = Report(None, None, rows(names=NAMES), "teapot: 32 patches")._text()
    assert text.startswith("teapot: 32 patches; method certified\n")
    assert "every row" not in text
    text = Report(None, None, rows(names=NAMES), "teapot, method certified")._text()
    assert text.startswith("teapot, method certified; patches 32\n")
    never = [{"item": name, "errors": 0, "what to do": ""} for name in "ab"]
    text = Report(None, None, never, "fine")._text()
    assert "what to do" not in text, "an empty column"
    assert [line.split() for line in lines(text)[2:]] == [["a", "0"], ["b", "0"]], "a measure is no setting"


def test_columns_that_no_table_has(monkeypatch):
    """Of a summary, or of a command that writes nothing."""
    monkeypatch.setenv("COLUMNS", "80")
    assert "\nNo room for: slip px, render ms, " in Report(None, None, rows(), "")._text()


def test_the_least_telling_columns_go_first():
    names = ("frame", "max_slip_px", "covered_pixels", *(f"measure_{k}" for k in range(6)), "last")
    table = fitted(rows(names=names), 80)
    assert table.left_out[:2] == ("max_slip_px", "covered_pixels")
    assert "last" in table.text
    still = [row | {"measure_3": 0} for row in rows(names=[name for name in names if "_p" not in name])]
    assert fitted(still, 74).left_out == ("measure_3",), "then what never changes"


LONG = "a_scene_of_my_own_whose_name_nobody_wants_to_type_more_than_once_in_a_year_or_two.obj"
TEXTS = (
    LONG,
    "曲面細分割の係数を予測する道具箱" * 4,
    "words that go on and on " * 9,
    "[bold]x[/bold]",
    "two\nlines\x1b[31m",
)


@pytest.mark.parametrize("width", [80, 40, 200])
@pytest.mark.parametrize("text", TEXTS)
def test_long_and_strange_texts(text, width):
    found = [row | {"scene": f"{k}{text}"} for k, row in enumerate(rows(names=("scene", *NAMES)))]
    table = fitted(found, width).text
    assert max(map(cell_len, table.splitlines())) <= width
    assert min(sum(f"{k}{text[:3]}" in line for line in table.splitlines()) for k in range(3)) == 1
    if " " in text:
        assert set(re.findall(r"[a-z]+", table)) >= {"words", "that", "go", "on", "and"}
    assert "\x1b" not in table
    alone = fitted([{"scene": text, "patches": 32}], width).text
    assert max(map(cell_len, alone.splitlines())) <= width
    assert alone.splitlines()[-1].split() == ["patches", "32"]


def test_a_name_that_is_cut_keeps_both_ends():
    table = fitted([row | {"scene": f"{k}{LONG}"} for k, row in enumerate(rows(names=("scene", *NAMES)))], 60).text
    assert "0a_scene" in table
    assert ".obj" in table
    assert "…" in table


def test_one_row_is_a_column():
    table = fitted([{"vertices": 5123, "motion": "time 0 to 24, " * 12, "proved": True}], 80).text.splitlines()
    assert table[0].split() == ["vertices", "5,123"]
    assert table[1].startswith("  motion     time 0 to")
    assert table[2].startswith("             ")
    assert table[-1].split() == ["proved", "yes"]


def test_more_rows_than_are_shown(finished):
    many = rows(MOST_ROWS + 5, NAMES)
    assert "… and 5 more rows in table.csv\n" in Report(None, finished, many, "")._text()
    assert "… and 5 more rows with --json\n" in Report(None, None, many, "")._text()


CODE = """
from slefejax.experiments.report import Report
from tests.test_report import rows
Report(None, None, rows(), "x " * 60).print()
"""


@pytest.mark.parametrize(("columns", "width"), [(None, 80), ("130", 130)])
def test_in_a_pipe(columns, width):
    environment = {name: value for name, value in os.environ.items() if name != "COLUMNS"}
    environment |= {} if columns is None else {"COLUMNS": columns}
    found = subprocess.run([sys.executable, "-c", CODE], env=environment, capture_output=True, text=True, check=True)
    title, *others = found.stdout.splitlines()
    assert title.startswith("x " * 60), "a sentence stays in one line"
    assert 0.8 * width < max(map(len, others)) <= width


def in_a_terminal(code):
    """What a process writes that believes to be in a terminal of 80 columns."""
    own, other = pty.openpty()
    environment = {**os.environ, "COLUMNS": "80", "TERM": "xterm"}
    with subprocess.Popen([sys.executable, "-c", code], stdout=other, stderr=other, env=environment) as process:
        os.close(other)
        found = b""
        while True:
            try:
                found += os.read(own, 4096)
            except OSError:  # the other end is closed
                break
    os.close(own)
    assert process.returncode == 0, found
    return re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "", found.decode()).replace("\r", "\n")


def test_in_a_terminal_titles_are_folded():
    assert max(map(len, in_a_terminal(CODE).splitlines())) <= 80


WORKING = """
import time
from slefejax.experiments.report import progress, working
with working("minimality"):
    time.sleep(0.6)
    with progress("rendering", 6) as show:
        time.sleep(0.6)
        show(2, "spot " * 30)
        time.sleep(0.6)
    time.sleep(0.6)
"""


def test_bars():
    """Something is said from the first moment on, before there are rows, too."""
    said = in_a_terminal(WORKING)
    states = [said.find(text) for text in ("minimality: preparing", "rendering", "0 of 6", "2 of 6", "writing results")]
    assert -1 < states[0] < states[1] < states[2] < states[3] < states[4]
    assert max(map(len, said.splitlines())) <= 80


class Clock:
    """Goes on when it is told."""

    def __init__(self):
        self.now = 0.0

    def monotonic(self):
        return self.now


@pytest.fixture
def clock(monkeypatch):
    own = Clock()
    monkeypatch.setattr(report, "time", own)
    return own


def test_lines_where_there_is_no_terminal(monkeypatch, clock):
    said = io.StringIO()
    monkeypatch.setattr(sys, "stderr", said)
    with progress("rendering", 1000) as show:
        for done in range(1, 1001):
            clock.now = done / 10
            show(done)
    assert said.getvalue().splitlines() == [f"rendering: {k}00 of 1000, 0:{10 * k}" for k in range(1, 6)] + [
        f"rendering: {k}00 of 1000, 1:{10 * k - 60:02d}" for k in range(6, 11)
    ]
    assert not re.search(r"[^\x20-\x7e\n]", said.getvalue())


def test_lines_are_few(monkeypatch, clock):
    said = io.StringIO()
    monkeypatch.setattr(sys, "stderr", said)
    with progress("at once", 10) as show:
        for done in range(11):
            clock.now += 0.2
            show(done)
    assert said.getvalue() == "", "of what is over soon there is nothing to say"
    clock.now = 3.0
    with progress("drawing", 20) as show:
        for done in range(1, 21):
            clock.now = 3.0 + 2 * done
            show(done, "teapot")
    found = said.getvalue().splitlines()
    assert found[0] == "drawing teapot: 2 of 20, 0:04"
    assert len(found) == 10


def test_a_line_while_nothing_happens(monkeypatch):
    said = io.StringIO()
    monkeypatch.setattr(sys, "stderr", said)
    monkeypatch.setattr(report, "_QUIET", 0.5)
    with progress("rendering", 6):
        time.sleep(1.3)
    assert said.getvalue() == "rendering: 0 of 6, 0:01\n"
