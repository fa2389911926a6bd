"""Two runs side by side: which rows belong together, and which of their numbers are other ones."""

from __future__ import annotations

import csv
import json
import math
import os
from pathlib import Path

import pytest

from slefejax.experiments.cli import main
from slefejax.experiments.compare.differences import differ, key_of, matched
from slefejax.experiments.store import Run

NAN = float("nan")
ROWS = [
    {
        "scale": scale,
        "method": "certified",
        "segments": NAN,
        "triangles": 1000 * k,
        "max_error_px": 0.1 * k,
        "render_ms": 2.0 * k,
    }
    for k, scale in enumerate((1.0, 0.8, 0.5), 1)
]


@pytest.fixture(autouse=True)
def in_an_empty_folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


def write(name, rows=ROWS, command="minimality", arguments=None, **record):
    with Run(command, arguments or {}, None) as run:
        run.finish(rows, {"scene": "teapot", **record}).rename(name)


def but(k, rows=ROWS, **values):
    """The same rows, one of them with other values."""
    return [{**row, **values} if number == k else row for number, row in enumerate(rows)]


def compared(capsys, *words):
    status = main(["compare", "a", "b", "--json", *words])
    return status, json.loads(capsys.readouterr().out)


def test_nothing_moved_but_times(capsys):
    write("a")
    write("b", [row | {"render_ms": 3 * row["render_ms"]} for row in ROWS])
    status, found = compared(capsys)
    assert status == 0
    assert found["rows"] == found["only_in_first"] == found["only_in_second"] == []
    assert (found["matched_by"], found["matched_rows"], found["compared"]) == (["scale"], 3, 12)
    assert found["times"] == [{"column": "render_ms", "rows": 3, "median": 3.0, "least": 3.0, "most": 3.0}]
    assert sorted(os.listdir()) == ["a", "b", "runs"], "nothing is written"
    assert os.listdir("runs/minimality") == []


def test_what_moved_the_largest_first(capsys):
    write("a")
    write("b", but(0, but(2, max_error_px=0.36), triangles=1001, max_error_px=0.1 * (1 + 2e-6)))
    status, found = compared(capsys)
    assert status == 1
    told = [(row["case"], row["column"], row["first"], row["second"]) for row in found["rows"]]
    assert told[0] == ("scale 0.5", "max_error_px", 0.1 * 3, 0.36)
    assert told[1] == ("scale 1.0", "triangles", 1000, 1001)
    assert told[2][:2] == ("scale 1.0", "max_error_px")
    assert len(told) == 3
    assert found["rows"][0]["by"] == pytest.approx(0.06, rel=1e-12)
    assert found["rows"][0]["relative_percent"] == pytest.approx(20.0, rel=1e-12)
    assert compared(capsys, "--tolerance", "1e-5")[1]["rows"] == found["rows"][:2], "a count is exact whatever it is"
    assert main(["compare", "a", "b"]) == 1
    assert "minimality, 3 rows: 3 of 12 values moved" in capsys.readouterr().out


def test_numbers_that_are_none_and_texts(capsys):
    write("a")
    write("b", but(1, method="slefe", segments=3, max_error_px=NAN))
    status, found = compared(capsys)
    assert status == 1
    assert {row["column"]: (row["first"], row["second"]) for row in found["rows"]} == {
        "method": ("certified", "slefe"),
        "segments": (None, 3),
        "max_error_px": (0.2, None),
    }


def test_rows_and_columns_that_only_one_has(capsys):
    write("a", [{**row, "sup_error_px": 1.0} for row in ROWS])
    write("b", [ROWS[2], ROWS[0] | {"scale": 0.9}, ROWS[0]])
    status, found = compared(capsys)
    assert status == 1, "of a row that is not there nobody knows"
    assert found["rows"] == []
    assert (found["only_in_first"], found["only_in_second"]) == (["scale 0.8"], ["scale 0.9"])
    assert "only the first has the column sup_error_px" in found["notes"]
    assert "only the second has the row scale 0.9" in found["notes"]


def test_columns_alone_are_no_movement(capsys):
    write("a")
    write("b", [row | {"more": 1} for row in ROWS])
    assert compared(capsys)[0] == 0


def test_what_else_is_different(capsys):
    write("a", arguments={"prediction": {"tiles": 2, "k": None}, "out": None}, opengl={"renderer": "x"})
    write("b", arguments={"prediction": {"tiles": 4, "k": None}, "out": None}, opengl={"renderer": "y"})
    record = json.loads(Path("b/run.json").read_text())
    record["versions"]["jax"] = "0.0.1"
    record["commit"], record["machine"]["cores"] = "abc", 512
    Path("b/run.json").write_text(json.dumps(record))
    status, found = compared(capsys)
    assert status == 0
    notes = " | ".join(found["notes"])
    assert "arguments: prediction tiles 2 → 4" in notes
    assert "opengl: renderer x → y" in notes
    assert "→ 0.0.1" in notes
    assert "→ abc" in notes
    assert "→ 512" in notes
    assert "numpy" not in notes


def test_a_folder_for_all_values(capsys):
    write("a")
    write("b", but(1, triangles=7))
    assert main(["compare", "a", "b", "--out", "c"]) == 1
    assert capsys.readouterr().out.endswith("c: open report.html first\n")
    with open("c/table.csv", newline="") as file:
        table = list(csv.DictReader(file))
    assert len(table) == 12
    assert [row["moved"] for row in table] == ["True"] + ["False"] * 11
    assert (table[0]["first"], table[0]["second"], table[0]["by"]) == ("2000", "7", "-1993")
    assert json.loads(Path("c/run.json").read_text())["experiment"] == "compare"


def test_rows_are_matched_by_their_cases():
    rows = [
        {"scene": scene, "patch": patch, "method": "x", "cores": cores, "runs": 5 * cores, "error": 0.5}
        for scene in "ab"
        for patch in range(2)
        for cores in (1, 2)
    ]
    assert key_of(rows, rows[::-1]) == ("scene", "patch", "cores"), "neither what is the same nor what is measured"
    found = matched(rows, rows[::-1])
    assert all(one is other for _, one, other in found.pairs)
    twice = [{"triangles": 1}, {"triangles": 2}]
    assert [case for case, *_ in matched(twice, twice).pairs] == ["row 1", "row 2"]
    assert matched(twice, twice[:1]).only == (["row 2"], [])
    one, other = matched([{"scale": 1.0, "n": 1}], [{"scale": 0.5, "n": 1}]).only
    assert (one, other) == (["scale 1.0"], ["scale 0.5"]), "a case is one where there is a single row, too"


def test_what_is_rounding():
    assert not differ(NAN, NAN, 0.0)
    assert differ(NAN, 0.0, 1.0)
    assert not differ(math.inf, math.inf, 0.0)
    assert differ(math.inf, -math.inf, 0.0)
    assert not differ(1e-16, 3e-16, 1e-6), "what rounding leaves of a zero"
    assert not differ(0.0, -0.0, 0.0)
    assert differ(1e-9, 2e-9, 1e-6)
    assert differ(10**9, 10**9 + 1, 1e-6)


def refused(capsys, *words):
    assert main(["compare", *words]) == 2
    said = capsys.readouterr()
    assert said.out == ""
    assert said.err.count("\n") == 1
    return said.err


def test_bad_input_is_one_sentence(capsys, tmp_path):
    write("a")
    write("b", command="certify")
    write("other", [{"scale": 7.0, "triangles": 1}])
    (tmp_path / "empty").mkdir()
    (tmp_path / "link").symlink_to("a")
    assert "there is no folder c: name the folder" in refused(capsys, "a", "c")
    assert "there is no folder a/table.csv" in refused(capsys, "a/table.csv", "a")
    assert "empty is not the folder of a finished run: it has no run.json and no table.csv" in refused(
        capsys, "a", "empty"
    )
    assert "a is a run of minimality and b one of certify" in refused(capsys, "a", "b")
    assert "are the same folder" in refused(capsys, "a", "a")
    assert "are the same folder" in refused(capsys, "a", "link")
    assert "have no row of the same case" in refused(capsys, "a", "other")
    assert "--tolerance must be a number of at least 0, not -1" in refused(capsys, "a", "b", "--tolerance", "-1")
    write("again")
    assert "--out a exists and is not an empty folder" in refused(capsys, "a", "again", "--out", "a")


BROKEN = [
    ("table.csv", lambda data: data[:-9], "table.csv, row 4 has 5 of 6 cells: the table is not whole"),
    ("table.csv", lambda data: data[:-3], "table.csv, row 4 does not end: the table is not whole"),
    ("table.csv", lambda data: data.splitlines(keepends=True)[0], "table.csv has no rows"),
    ("table.csv", lambda data: b"", "table.csv has no rows"),
    ("table.csv", lambda data: b"\xff\xfe\x00" + data, "table.csv is not whole, or no table"),
    ("table.csv", lambda data: data.replace(b"method", b"scale"), "table.csv has two columns of the same name"),
    ("run.json", lambda data: data[:100], "run.json is not whole, or no record of a run"),
    ("run.json", lambda data: b"[1]", "run.json does not say which command it is of"),
]


@pytest.mark.parametrize(("name", "breaks", "says"), BROKEN, ids=[says for *_, says in BROKEN])
def test_files_that_are_not_whole(capsys, tmp_path, name, breaks, says):
    write("a")
    write("b")
    path = tmp_path / "b" / name
    path.write_bytes(breaks(path.read_bytes()))
    assert says in refused(capsys, "a", "b")
