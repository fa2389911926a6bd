"""Rows on disk, one line each, whole whatever happens while they are written."""

from __future__ import annotations

import fcntl
import json
import os
from pathlib import Path

from slefejax.errors import InputError
from slefejax.experiments.tables import Row


class Rows:
    """A file of rows, to which any number of processes may add."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def __call__(self) -> list[Row]:
        """All that are whole; none where there is no file."""
        if not self.path.exists():
            return []
        lines = self.path.read_text(errors="replace").splitlines()
        return [row for line in lines if (row := _whole(line)) is not None]

    def add(self, row: Row) -> None:
        """Keep a row at once, so that it survives whatever happens next."""
        with self.path.open("a+b") as file:
            # a run that was stopped, or whose disk was full, may have left half a line
            torn = file.seek(0, os.SEEK_END) and (file.seek(-1, os.SEEK_END), file.read(1))[1] != b"\n"
            file.write(b"\n" * bool(torn) + json.dumps(row).encode() + b"\n")
            file.flush()
            os.fsync(file.fileno())


def _whole(line: str) -> Row | None:
    try:
        row = json.loads(line)
    except ValueError:
        return None
    return row if isinstance(row, dict) else None


def locked(folder: Path, name: str) -> int:
    """A folder that is made if it is not there, held by this process until the file descriptor is closed.

    Raises InputError where it cannot be made, and where another process holds it.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        lock = os.open(folder / name, os.O_CREAT | os.O_RDWR)
    except OSError as error:
        raise InputError(f"the results cannot be written to {folder.parent}: {error.strerror or error}") from None
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        os.close(lock)
        raise InputError(f"the same run is under way in another process ({folder}): wait for it") from None
    return lock
