"""Compiled programs that the next process finds."""

from __future__ import annotations

import subprocess
import sys

SCRIPT = """
import sys, jax, slefejax as sj
from pathlib import Path
where = sj.keep_programs(sys.argv[1] if len(sys.argv) > 1 else None)
x = sj.tessellation_factors(sj.load("teapot").patches(), sj.View(sj.load("teapot").default_camera(), 90, 60), "minmax")
print(where, len(list(Path(where).iterdir())) if where else 0, x.factor.shape)
"""


def test_the_next_process_adds_nothing(tmp_path, monkeypatch):
    monkeypatch.delenv("JAX_COMPILATION_CACHE_DIR")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "user"))

    def run(*arguments: str) -> list[str]:
        done = subprocess.run([sys.executable, "-c", SCRIPT, *arguments], capture_output=True, text=True, check=True)
        return done.stdout.split(maxsplit=2)

    first, again = run(str(tmp_path / "own")), run(str(tmp_path / "own"))
    assert first == again
    assert int(first[1]) > 0
    assert run()[0].startswith(str(tmp_path / "user" / "slefejax" / "jax-"))
    (tmp_path / "file").write_text("no folder")
    assert run(str(tmp_path / "file" / "below"))[:2] == ["None", "0"]
