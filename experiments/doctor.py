"""What is here, what is missing, and what to do about it."""

from __future__ import annotations

import json
import platform
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version

import jax
from rich.console import Console
from rich.table import Table

from slefejax.errors import NoOpenGLError
from slefejax.experiments.store import PACKAGES
from slefejax.gpu import open_device
from slefejax.gpu.selftest import wrong_pixels


@dataclass(frozen=True)
class Doctor:
    """Versions, JAX devices, the OpenGL device and its coverage self-test, and what to do if something is missing."""

    json: bool = False
    """Print one JSON object on standard output instead of the table."""
    quiet: bool = False
    """Print nothing but what is wrong."""

    def examine(self) -> int:
        """Look, print, and return the exit status: 0 if everything is there."""
        rows = [*_packages(), *_jax(), *_opengl()]
        healthy = all(row["ok"] for row in rows)
        if self.json:
            print(json.dumps({"scene": None, "out": None, "ok": healthy, "rows": rows}))
        else:
            _show([row for row in rows if not (self.quiet and row["ok"])])
        return 0 if healthy else 2


def _row(item: str, found: str, ok: bool = True, advice: str = "") -> dict:
    return {"item": item, "found": found, "ok": ok, "advice": advice}


def _packages() -> list[dict]:
    rows = [_row("python", platform.python_version())]
    for name in PACKAGES:
        try:
            rows.append(_row(name, version(name)))
        except PackageNotFoundError:
            rows.append(_row(name, "missing", False, f"install it: pip install {name}"))
    return rows


def _jax() -> list[dict]:
    return [_row("JAX device", f"{device.platform}: {device.device_kind}") for device in jax.devices()]


def _opengl() -> list[dict]:
    try:
        device = open_device()
    except NoOpenGLError as error:
        return [_row("OpenGL", "not usable", False, str(error))]
    wrong = wrong_pixels(device)
    return [
        _row("OpenGL renderer", device.renderer),
        _row("OpenGL version", device.version),
        _row("highest tessellation level", str(device.highest_level)),
        _row("coverage self-test", f"{wrong} wrong pixels", wrong == 0),
    ]


def _show(rows: list[dict]) -> None:
    if not rows:
        return
    table = Table("", "found", "what to do")
    for row in rows:
        table.add_row(row["item"], row["found"], row["advice"])
    Console().print(table)
