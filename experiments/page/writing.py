"""The page put together: a template, scripts and data, and the rule that no others run and nothing is loaded."""

from __future__ import annotations

import json
import os
import re
from base64 import b64encode
from collections.abc import Sequence
from hashlib import sha256
from html import escape
from pathlib import Path
from typing import Any

from slefejax.experiments.page.asked import (
    arguments_html,
    command_html,
    files_html,
    made_html,
    notes_html,
    title_of,
)
from slefejax.experiments.page.charts import LIBRARY, cases_of, chosen, library, looks
from slefejax.experiments.page.columns import Column, columns_of_table
from slefejax.experiments.page.pictures import Pictures, pictures_of
from slefejax.experiments.tables import Row

_PARTS = Path(__file__).resolve().parent / "parts"
_SCRIPTS = ("cells.js", "table.js", "charts.js", "pictures.js", "start.js")
_OWN = ("lock", "rows.jsonl")  # of a run under way
_WITHOUT = f"There are no charts: the package that draws them is missing (pip install {LIBRARY}, or 'slefejax[app]')"


def write_page(folder: Path, name: str, record: Row, rows: Sequence[Row], table: str) -> None:
    """Write the page of that name, whole or not at all, of a folder that has the run's other files.

    record : what run.json says
    table  : the file that has the whole table
    """
    files = sorted(path for path in folder.iterdir() if _is_shown(path) and path.name != name)
    columns, scripts = columns_of_table(rows), library()
    pictures = pictures_of(files, record["open_first"])
    content = _content(columns, len(rows), record, pictures, bool(scripts))
    own = "\n".join((_PARTS / name).read_text(encoding="utf-8") for name in _SCRIPTS)
    notes = [*(record.get("notes") or ()), *([] if scripts else [_WITHOUT])]
    page = _filled(
        {
            "policy": _policy([*scripts, own]),
            "title": escape(title_of(record)),
            "style": (_PARTS / "page.css").read_text(encoding="utf-8"),
            "when": escape(f"{len(rows):,} rows, {record['time']}"),
            "command": command_html(record),
            "notes": notes_html(notes),
            "left_out": notes_html(pictures.notes),
            "table": escape(table),
            "arguments": arguments_html(record),
            "made": made_html(record),
            "files": files_html(files),
            "data": _embedded(content),
            "library": "".join(f"<script>{script}</script>\n" for script in scripts),
            "script": own,
        }
    )
    beside = folder / f".{name}"
    beside.write_bytes(page.encode("utf-8", "replace"))  # a file's name may be no text
    os.replace(beside, folder / name)


def _is_shown(path: Path) -> bool:
    return not path.name.startswith(".") and path.name not in _OWN and path.is_file()


def _content(columns: Sequence[Column], rows: int, record: Row, pictures: Pictures, draws: bool) -> dict[str, Any]:
    """What the page's scripts work on."""
    cases = cases_of(columns, record.get("case_columns") or ())
    return {
        "columns": [{"name": own.name, "kind": own.kind, "cells": own.cells} for own in columns],
        "rows": rows,
        "charts": chosen(columns, cases) if draws else [],
        "cases": [own.name for own in cases],
        "looks": looks(),
        "groups": [{"title": own.title, "pictures": own.pictures} for own in pictures.groups],
        "front": bool(pictures.groups) and pictures.groups[0].pictures[0][0] == record["open_first"],
    }


def _embedded(content: Any) -> str:
    """JSON that no browser takes for anything else: no tag begins or ends in it."""
    text = json.dumps(content, ensure_ascii=False, allow_nan=False, separators=(",", ":"))
    for letter in "<>&\u2028\u2029":
        text = text.replace(letter, f"\\u{ord(letter):04x}")
    return text


def _policy(scripts: Sequence[str]) -> str:
    """Nothing is loaded, and no script runs but these, which are known by their hashes."""
    hashes = " ".join(f"'sha256-{b64encode(sha256(own.encode()).digest()).decode()}'" for own in scripts)
    return (
        f"default-src 'none'; script-src {hashes}; style-src 'unsafe-inline'; img-src data: blob:;"
        " base-uri 'none'; form-action 'none'"
    )


def _filled(parts: dict[str, str]) -> str:
    """The template with its marks replaced, once: what is put in is not looked at again."""
    template = (_PARTS / "page.html").read_text(encoding="utf-8")
    return re.sub(r"\{\{(\w+)\}\}", lambda mark: parts[mark[1]], template)
