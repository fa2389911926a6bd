"""Studies: a row a case, kept as it is found and taken over by the row; tables as files."""

from __future__ import annotations

import csv
import sys
from types import SimpleNamespace

import numpy as np
import pytest

from slefejax.experiments.store import Run
from slefejax.experiments.studies.measures import Measure, measure, pixels_or_none
from slefejax.experiments.studies.study import Case, Study, shown
from slefejax.experiments.studies.times import taking_turns
from slefejax.experiments.tables import write_tables

SQUARE = Measure(("square", "_all"), lambda look: {"square": look**2, "_all": list(range(look))})


@pytest.fixture(autouse=True)
def elsewhere(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


def study(seen, measures=(SQUARE,), numbers=(1, 2, 3), fails=()):
    def look(number):
        if number in fails:
            raise KeyboardInterrupt
        seen.append(number)
        return number

    return Study([Case(f"n{k}", {"number": k}, lambda k=k: look(k)) for k in numbers], measures)


def test_rows_are_taken_over_one_by_one():
    seen: list[int] = []
    with pytest.raises(KeyboardInterrupt), Run("some", {}, None) as run:
        study(seen, fails=[3]).rows(run, "looking")
    with Run("some", {}, None) as run:
        again = study(seen, numbers=(3, 1, 2, 4))
        rows = again.rows(run, "looking")
    assert seen == [1, 2, 3, 4]
    assert again.columns == ("number", "square", "_all")
    assert [row["square"] for row in rows] == [9, 1, 4, 16]
    assert shown(rows)[0] == {"number": 3, "square": 9}


def test_rows_with_other_columns_are_made_again():
    seen: list[int] = []
    with pytest.raises(KeyboardInterrupt), Run("some", {}, None) as run:
        study(seen, fails=[2]).rows(run, "looking")
    with Run("some", {}, None) as run:
        cube = Measure(("cube",), lambda look: {"cube": look**3})
        rows = study(seen, (SQUARE, cube)).rows(run, "looking")
    assert seen == [1, 1, 2, 3]
    assert [row["cube"] for row in rows] == [1, 8, 27]


def test_a_measure_fills_the_columns_that_it_names():
    @measure("one", "two")
    def wrong(look):
        return {"one": 1}

    with pytest.raises(AssertionError):
        wrong(None)


def test_a_picture_in_which_there_is_nothing():
    look = SimpleNamespace(seen=SimpleNamespace(patch=np.full((2, 2), -1)))
    row = pixels_or_none(look)
    assert (row["covered_pixels"], row["slipped_pixels"]) == (0, 0)
    assert np.isnan(row["max_error_px"])


def test_turns_are_taken():
    order: list[str] = []
    found = taking_turns({name: lambda name=name: order.append(name) for name in "ab"}, 3)
    assert order == list("ababab")
    assert all(median >= 0 and apart >= 0 for median, apart in found.values())


ROWS = [
    {"scene": "a", "share_above_0.5": 0.25, "count": 3, "segments": float("nan"), "fine": True},
    {"scene": "b", "share_above_0.5": float("nan"), "count": 4, "segments": (2, 3), "fine": False},
]


def test_a_table_as_parquet(tmp_path):
    parquet = pytest.importorskip("pyarrow.parquet", reason="pyarrow is not installed")
    write_tables(tmp_path, "table", [ROWS[0] | {"count": np.int64(3)}, ROWS[1]])
    table = parquet.read_table(tmp_path / "table.parquet")
    assert table.column_names == ["scene", "share_above_0.5", "share_above_05", "count", "segments", "fine"]
    assert table["share_above_0.5"].to_pylist() == table["share_above_05"].to_pylist() == [0.25, None]
    assert table["segments"].to_pylist() == [None, "(2, 3)"]
    assert [str(table.schema.field(name).type) for name in ("count", "fine")] == ["int64", "bool"]


def test_a_table_without_parquet(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    write_tables(tmp_path, "table", ROWS)
    assert [path.name for path in tmp_path.iterdir()] == ["table.csv"]
    with (tmp_path / "table.csv").open(newline="") as file:
        assert list(csv.reader(file))[1] == ["a", "0.25", "3", "nan", "True"]
