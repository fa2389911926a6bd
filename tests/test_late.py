"""Packages that are imported when they are first needed: threads that need several of them at once do not hang."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from slefejax import save
from tests.meshes import cube
from tests.test_io import BV, OBJ, write
from tests.test_ply import ply
from tests.test_usd import USD, nurbs_usd
from tests.test_usd_skel import ARM

ROOT = Path(__file__).resolve().parents[1]
PROGRAM = """
import sys, threading
import slefejax
together = threading.Barrier(len(sys.argv) - 1)
def work(name):
    together.wait()
    slefejax.load(name)
threads = [threading.Thread(target=work, args=(name,), daemon=True) for name in sys.argv[1:]]
for thread in threads:
    thread.start()
for thread in threads:
    thread.join()
print("done", flush=True)
"""
PATIENCE = 240  # seconds, a guard only: a process that hangs never ends
AGAIN = 3


def test_threads_that_load_everything_at_once(tmp_path, teapot):
    pytest.importorskip("pxr", reason="usd-core is not installed")
    save(teapot, tmp_path / "f.bpt")
    files = [
        write(tmp_path, "a.usda", USD),
        write(tmp_path, "b.obj", OBJ),
        write(tmp_path, "c.usda", ARM),
        write(tmp_path, "d.ply", ply(cube(), "ascii")),
        write(tmp_path, "e.usda", nurbs_usd()),
        tmp_path / "f.bpt",
        write(tmp_path, "g.bv", BV),
    ]
    command = [sys.executable, "-c", PROGRAM, *map(str, files)]
    for _ in range(AGAIN):
        ended = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=PATIENCE)
        assert ended.stdout == "done\n", ended.stderr
