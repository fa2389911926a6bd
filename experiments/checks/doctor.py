"""What is here, what is missing, and what to do about it."""

from __future__ import annotations

import platform
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version

import jax
import numpy as np

from slefejax.errors import NoOpenGLError
from slefejax.experiments.report import Report
from slefejax.experiments.store import PACKAGES, Row
from slefejax.gpu import measure_pattern, open_device
from slefejax.tessellator.rings import direct3d11


@dataclass(frozen=True)
class Doctor:
    """Versions, JAX devices, the OpenGL device and its coverage self-test, and what to do if something is missing."""

    json: bool = False
    """Print one JSON object on standard output instead of the table."""
    quiet: bool = False
    """Print nothing but what is wrong."""

    def run(self) -> Report:
        """Look; the status is 0 if everything is there."""
        rows = [*_packages(), *_jax(), *_opengl()]
        healthy = all(row["ok"] == "yes" for row in rows)
        shown = [row for row in rows if not (self.quiet and row["ok"] == "yes")]
        title = (
            "" if self.quiet and healthy else "slefejax doctor: " + ("all is well" if healthy else "not all is well")
        )
        return Report(None, None, shown, title, as_json=self.json, status=0 if healthy else 2)


def _row(item: str, found: str, advice: str = "") -> Row:
    return {"item": item, "found": found, "ok": "no" if advice else "yes", "what to do": advice}


def _packages() -> list[Row]:
    rows = [_row("python", platform.python_version())]
    for name in PACKAGES:
        try:
            rows.append(_row(name, version(name)))
        except PackageNotFoundError:
            rows.append(_row(name, "missing", f"install it: pip install {name}"))
    return rows


def _jax() -> list[Row]:
    return [_row("JAX device", f"{device.platform}: {device.device_kind}") for device in jax.devices()]


def _opengl() -> list[Row]:
    try:
        device = open_device()
    except NoOpenGLError as error:
        return [_row("OpenGL", "not usable", str(error))]
    return [
        _row("OpenGL renderer", device.renderer),
        _row("OpenGL version", device.version),
        _row("highest tessellation level", str(device.highest_level)),
        _row("coverage self-test", "passed: every pixel is drawn, from the right place"),
        _pattern(),
    ]


def _pattern() -> Row:
    own, known = measure_pattern(), direct3d11()
    if np.all(own.reach <= known.reach) and np.all(own.cell <= known.cell):
        return _row("tessellator's pattern", "that of Direct3D 11, which certified factors take for granted")
    advice = "pass pattern=slefejax.gpu.measure_pattern() to tessellation_factors"
    return _row("tessellator's pattern", "reaches further than Direct3D 11's", advice)
