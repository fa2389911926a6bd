"""What was asked, by what, where and when, as HTML: everything that a run was given is text there, whatever it is."""

from __future__ import annotations

import json
import os
import re
from collections.abc import Iterable, Iterator, Sequence
from html import escape
from pathlib import Path
from typing import Any
from urllib.parse import quote

from slefejax.experiments.tables import Row

_ABOVE = ("experiment", "open_first", "arguments", "versions", "machine", "notes", "command", "scene")
_MOST_FILES, _MOST_ROWS, _MOST_LETTERS = 200, 200, 2000  # that are shown: of files, of a record's tables and values
_MOST_SCENES = 5  # that the title names
_FEW_FILES = 20  # that are seen without asking for them


def title_of(record: Row) -> str:
    """The command and its scenes."""
    scene = record.get("scene")
    scenes = list(map(str, scene if isinstance(scene, (list, tuple)) else [scene] if scene else []))
    if len(scenes) > _MOST_SCENES:
        scenes = [*scenes[: _MOST_SCENES - 1], f"{len(scenes) - _MOST_SCENES + 1} more"]
    return f"{record['experiment']}: {', '.join(scenes)}" if scenes else str(record["experiment"])


def notes_html(notes: Sequence[str]) -> str:
    """A list; empty without notes."""
    items = "".join(f"<li>{escape(str(note))}</li>" for note in notes)
    return f'<ul class="notes">{items}</ul>' if items else ""


def command_html(record: Row) -> str:
    """What to type for the same run again."""
    if not record.get("command"):
        return "<p>Called from Python, with the arguments below.</p>"
    return f'<p>Again: <code class="command">{escape(record["command"])}</code></p>'


def arguments_html(record: Row) -> str:
    """Everything that was asked for, groups of options after one another; names alone of what was not given."""
    every = [*_flat(record.get("arguments") or {})]
    absent = ", ".join(name for name, value in every if value is None)
    return _pairs((name, value) for name, value in every if value is not None) + (
        f'<p class="quiet">Not given: {escape(absent)}</p>' if absent else ""
    )


def made_html(record: Row) -> str:
    """When, on which machine, with which versions, and whatever else the record has; lists of rows as tables."""
    tables = {key: value for key, value in record.items() if _is_table(value)}
    rest = {key: value for key, value in record.items() if key not in (*_ABOVE, *tables)}
    pairs = _pairs([*_flat(rest), *_flat({"machine": record["machine"], "versions": record["versions"]})])
    return pairs + "".join(_table(name, rows) for name, rows in tables.items())


def _is_table(value: Any) -> bool:
    return isinstance(value, (list, tuple)) and bool(value) and all(isinstance(row, dict) for row in value)


def _table(name: str, rows: Sequence[Row]) -> str:
    head = "".join(f'<th scope="col">{_broken(str(key))}</th>' for key in rows[0])
    cells = [[_cell(row.get(key)) for key in rows[0]] for row in rows[:_MOST_ROWS]]
    body = "".join(f"<tr>{''.join(own)}</tr>" for own in cells)
    more = f"<p>and {len(rows) - _MOST_ROWS:,} more rows in run.json</p>" if len(rows) > _MOST_ROWS else ""
    table = f'<table class="static"><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>'
    box = f'<div class="box" tabindex="0" role="region" aria-label="{escape(name)}">{table}</div>'
    return f"<h3>{escape(name)}</h3>{box}{more}"


def _cell(value: Any) -> str:
    if isinstance(value, (int, float)) and not isinstance(value, bool):
        return f'<td class="number">{value:{".5g" if isinstance(value, float) else ","}}</td>'
    return f"<td>{escape(_said(value))}</td>"


def files_html(files: Sequence[Path]) -> str:
    """Links to the files beside the page."""
    links = [(quote(b"./" + os.fsencode(path.name)), escape(path.name)) for path in files[:_MOST_FILES]]
    shown = "".join(f'<li><a href="{place}">{name}</a></li>' for place, name in links)
    more = len(files) - _MOST_FILES
    listed = f'<ul class="files">{shown}</ul>' + (f"<p>and {more:,} more</p>" if more > 0 else "")
    opened = " open" * (len(files) <= _FEW_FILES)
    return f"<details{opened}><summary>{len(files):,} files beside this page</summary>{listed}</details>"


def _flat(content: Row, before: str = "") -> Iterator[tuple[str, Any]]:
    for key, value in content.items():
        name = f"{before}{key}"
        if isinstance(value, dict):
            yield from _flat(value, f"{name}.")
        else:
            yield name, value


def _said(value: Any) -> str:
    if value is None:
        return "none"
    if isinstance(value, bool):
        return "yes" if value else "no"
    simple = isinstance(value, (list, tuple)) and all(isinstance(own, (str, int, float)) for own in value)
    said = ", ".join(map(str, value)) or "none" if simple else value
    said = said if isinstance(said, str) else json.dumps(said, default=str, ensure_ascii=False)
    return said if len(said) <= _MOST_LETTERS else f"{said[:_MOST_LETTERS]}… (all of it is in run.json)"


def _pairs(pairs: Iterable[tuple[str, Any]]) -> str:
    rows = "".join(f"<div><dt>{_broken(name)}</dt><dd>{escape(_said(value))}</dd></div>" for name, value in pairs)
    return f"<dl>{rows}</dl>"


def _broken(name: str) -> str:
    """With places where a line may end."""
    return re.sub(r"([._])", r"\1<wbr>", escape(name))
