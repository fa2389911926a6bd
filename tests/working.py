"""Work for processes of their own: some of it kills the process that does it."""

from __future__ import annotations

import os
import signal
from pathlib import Path


def ready() -> None:
    """What runs before the first task."""
    os.environ["SLEFEJAX_TEST_READY"] = "1"


def square(value: int, folder: str) -> int:
    """Dies at 3 the first time, at 13 always; 23 is refused."""
    assert os.environ["SLEFEJAX_TEST_READY"] == "1"
    tried = Path(folder) / str(value)
    if value == 13 or (value == 3 and not tried.exists()):
        tried.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    if value == 23:
        raise ValueError("not 23")
    return value * value
