"""Strict settings for the whole suite: float64, annotations checked at run time, warnings are errors."""

from __future__ import annotations

import atexit
import ctypes
import gc
import os
import re
import shutil
import tempfile
from collections.abc import Iterator
from pathlib import Path

import jax
import numpy as np
import pytest
from hypothesis import HealthCheck, settings
from jaxtyping import install_import_hook

from tests.closing import pytest_deselected, pytest_sessionfinish, pytest_testnodedown, pytest_unconfigure

# Hooks that print a line in words at the end of a run; pytest finds them here by their names.
__all__ = ["pytest_deselected", "pytest_sessionfinish", "pytest_testnodedown", "pytest_unconfigure"]

jax.config.update("jax_enable_x64", True)

# Commands that tests start as processes of their own, and tests that run beside, find what was compiled before them.
if "PYTEST_XDIST_WORKER" not in os.environ:
    os.environ["JAX_COMPILATION_CACHE_DIR"] = tempfile.mkdtemp(prefix="slefejax-tests-")
    os.environ["JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS"] = "0.01"
    atexit.register(shutil.rmtree, os.environ["JAX_COMPILATION_CACHE_DIR"], ignore_errors=True)
jax.config.update("jax_compilation_cache_dir", os.environ["JAX_COMPILATION_CACHE_DIR"])
jax.config.update(
    "jax_persistent_cache_min_compile_time_secs", float(os.environ["JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS"])
)

install_import_hook(
    [
        *("slefejax.arguments", "slefejax.conversion", "slefejax.framing", "slefejax.scene"),
        *("slefejax.gpu.buffers", "slefejax.gpu.renderer"),
        *(
            "slefejax.bounds.slefe",
            "slefejax.bounds.slefe_tables",
            "slefejax.geometry.bezier",
            "slefejax.geometry.view",
        ),
        *("slefejax.lanes.layout", "slefejax.measure.error", "slefejax.model", "slefejax.predict.estimate"),
        *("slefejax.tessellator.edges", "slefejax.tessellator.levels", "slefejax.tessellator.rings"),
    ],
    "beartype.beartype",
)

# derandomize: the same cases every time; deadline: the first call compiles
settings.register_profile(
    "seeded", derandomize=True, deadline=None, max_examples=60, suppress_health_check=[HealthCheck.too_slow]
)
settings.load_profile("seeded")

_MUCH, _SOME = 1_200_000, 250_000  # kB; a test may add a few hundred thousand
MODELS = Path(__file__).resolve().parents[2] / "shared" / "models"


@pytest.fixture(scope="session")
def models() -> Path:
    """Real models beside the checkout; tests that need them skip without."""
    if not MODELS.is_dir():
        pytest.skip("the folder of models is not beside the checkout")
    return MODELS


@pytest.fixture(scope="session")
def device():
    """The OpenGL device; tests that need it skip without, and say why."""
    from slefejax.errors import NoOpenGLError
    from slefejax.gpu import open_device

    try:
        return open_device()
    except NoOpenGLError as error:
        if os.environ.get("SLEFEJAX_REQUIRE_OPENGL"):
            raise
        pytest.skip(f"no OpenGL: {error}")


@pytest.fixture(scope="session")
def teapot():
    from slefejax import load

    return load("teapot")


@pytest.fixture(scope="session")
def main_view(teapot):
    """The view of the main job."""
    from slefejax import View

    return View(teapot.default_camera(), 1440, 900)


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(20261122)


@pytest.fixture(params=[np.float64, np.float32], ids=["double", "single"])
def precision(request) -> Iterator[type]:
    """A test runs twice, with JAX in double precision and as it comes: numbers that it makes should be of this type."""
    with jax.enable_x64(request.param == np.float64):
        yield request.param


@pytest.fixture(autouse=True)
def few_programs():
    """What was compiled takes memory, and some of the mappings that Linux allows a process: forget it in time."""
    yield
    if _memory() > _Kept.most:
        jax.clear_caches()
        gc.collect()
        if hasattr(libc := ctypes.CDLL(None), "malloc_trim"):  # without it the process keeps what was freed
            libc.malloc_trim(0)
        _Kept.most = max(_MUCH, _memory() + _SOME)


def _memory() -> int:
    """Of this process, kB; 0 where that is not told."""
    status = Path("/proc/self/status")
    return int(re.findall(r"VmRSS:\s+(\d+) kB", status.read_text())[0]) if status.exists() else 0


class _Kept:
    most = _MUCH
