"""Compiled programs that outlive the process."""

from __future__ import annotations

import os
import warnings
from pathlib import Path

import jax

_WORTH_KEEPING = 0.1  # seconds of compilation


def keep_programs(folder: str | os.PathLike[str] | None = None) -> Path | None:
    """Keep what JAX compiles in a folder, from now on and for other processes too: the first calls of the next one do
    not compile.

    folder : None: JAX_COMPILATION_CACHE_DIR, or the user's cache folder (``$XDG_CACHE_HOME/slefejax``), a folder for
             each version of JAX. The command ``slefejax`` uses the same

    Returns the folder; None where nothing can be written: then nothing is kept, and nothing else is different.

    >>> keep_programs("/dev/null/no-folder") is None
    True
    """
    # a disk that is full or a file cut off by a kill costs time to compile, and nobody has to do anything about it
    warnings.filterwarnings("ignore", "Error (reading|writing) persistent compilation cache")
    found = folder or os.environ.get("JAX_COMPILATION_CACHE_DIR") or _of_the_user()
    try:
        Path(found).mkdir(parents=True, exist_ok=True)
    except OSError:
        return None
    jax.config.update("jax_compilation_cache_dir", os.fspath(found))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", _WORTH_KEEPING)
    return Path(found)


def _of_the_user() -> Path:
    root = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(root) / "slefejax" / f"jax-{jax.__version__}"
