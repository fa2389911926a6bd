"""A run that is killed at a chosen moment: before its k-th operation on a file, or after some time.

python -m tests.killing FOLDER OUT|- MOMENT ROWS
"""

from __future__ import annotations

import os
import signal
import sys
import types
from pathlib import Path
from typing import Any

PACKAGE = Path(__file__).resolve().parents[1] / "slefejax"
OPERATIONS = ("open", "os.rename", "os.remove", "os.mkdir", "os.rmdir", "os.link", "os.truncate")


def _kill_before(moment: int, folder: str) -> None:
    count = 0

    def hook(event: str, arguments: tuple[Any, ...]) -> None:
        nonlocal count
        if event in OPERATIONS and isinstance(arguments[0], str) and os.path.abspath(arguments[0]).startswith(folder):
            count += 1
            if count == moment:
                os.kill(os.getpid(), signal.SIGKILL)

    sys.addaudithook(hook)


def main() -> None:
    """A sweep of rows, each with a file beside it."""
    folder, out, moment, rows = sys.argv[1:]
    package = types.ModuleType("slefejax")  # without importing all of it
    package.__path__ = [str(PACKAGE)]
    sys.modules["slefejax"] = package
    from slefejax.experiments.store import Run

    os.chdir(folder)
    _kill_before(int(moment), folder)
    with Run("sweep", {"rows": rows}, None if out == "-" else Path(out)) as run:

        def row(k: int) -> dict[str, Any]:
            with (Path(folder) / "made").open("a") as file:
                file.write(f"{k}\n")
            run.file(f"{k}.txt").write_text(str(k))
            return {"square": k * k}

        found = run.each("k", list(range(int(rows))), row, lambda _: None, lambda k: f"{k}.txt")
        run.finish(found, {"scene": None})


if __name__ == "__main__":
    main()
